"""An emitter of one's own is one class: tracing, direct light and spectra need nothing else."""

from dataclasses import dataclass

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax.scene.digest import scene_digests
from photonrelax.scene.emission_region import DISK, EmissionRegion, Sphere
from photonrelax.scene.emitters import DirectLight, Emitter
from photonrelax.transport.direct_light import direct_irradiance
from photonrelax.transport.raycast import RayCaster


@dataclass(frozen=True, eq=False)
class BeamEmitter(Emitter):
    """Parallel light down the z axis, within a radius."""

    radius: float
    irradiance: float

    def emission_region(
        self, target: Sphere, scene: Sphere, emitter_offset: float
    ) -> EmissionRegion:
        area = np.pi * self.radius**2
        return EmissionRegion(
            DISK,
            origin=np.array([0.0, 0.0, scene.centre[2] + 1.01 * scene.radius]),
            frame=np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]]),
            shape=np.array([self.radius, 0.0, 0.0, 0.0]),
            area=area,
            flux=np.full(3, area * self.irradiance),
        )

    def direct(self, position, emitter_offset):
        lit = np.linalg.norm(position[:, :2], axis=1) < self.radius
        return DirectLight(
            np.tile([0.0, 0.0, 1.0], (len(position), 1)),
            np.full(len(position), np.inf),
            np.where(lit[:, np.newaxis], self.irradiance, 0.0) * np.ones(3),
        )


def scene(emitter, *, ior=1.0):
    floor = trimesh.creation.box((20, 20, 1))
    floor.apply_translation((0, 0, -1))
    plate = trimesh.creation.box((9, 9, 0.5))
    plate.apply_translation((0, 0, 2))
    return pr.Scene(
        [pr.SceneObject(floor, pr.Diffuse()), pr.SceneObject(plate, pr.Dielectric(ior))],
        [emitter],
        pr.Camera((0, 0, 9), (0, 0, 0), (0, 1, 0), width=32, height=32, orthographic_height=8),
    )


def test_photons_of_a_new_emitter_carry_its_flux_within_its_region():
    photons = pr.trace_photons(scene(BeamEmitter(0.7, 3.0)), 5000)
    assert len(photons) == 5000
    np.testing.assert_allclose(photons.flux.sum(axis=0), 3.0 * np.pi * 0.7**2, rtol=1e-12)
    distance = np.linalg.norm(photons.position[:, :2], axis=1)
    assert distance.max() <= 0.7 + 1e-9
    # Half of the photons in half of the area.
    assert np.mean(distance < 0.7 / np.sqrt(2)) == pytest.approx(0.5, abs=0.01)
    np.testing.assert_allclose(photons.emitter_density, 5000 / (np.pi * 0.7**2), rtol=1e-12)
    assert photons.emitter_coords.shape == (5000, 2)


def test_photons_of_a_new_emitter_can_carry_spectra():
    photons = pr.trace_photons(scene(BeamEmitter(0.7, 3.0)), 200, frequency_share=1.0)
    assert np.isfinite(photons.spectrum).all()


def test_direct_light_of_a_new_emitter_is_what_it_says():
    beam = scene(BeamEmitter(0.7, 3.0))
    position = np.array([[0.0, 0, 2.25], [0.6, 0, 2.25], [0.8, 0, 2.25], [0, 0, -0.5]])
    up = np.tile([0.0, 0, 1.0], (4, 1))
    arriving = direct_irradiance(beam, RayCaster(beam.objects), position, up)
    np.testing.assert_array_equal(arriving[:, 0], [3.0, 3.0, 0.0, 0.0])


def test_light_of_another_shape_is_refused(monkeypatch):
    beam = scene(BeamEmitter(0.7, 3.0))
    monkeypatch.setattr(
        BeamEmitter, "direct", lambda *_: DirectLight(np.ones((4, 3)), np.ones(4), np.ones(4))
    )
    message = r"irradiance of BeamEmitter.direct should have shape \(4, 3\), but has \(4,\)"
    points, up = np.zeros((4, 3)), np.tile([0.0, 0, 1.0], (4, 1))
    with pytest.raises(ValueError, match=message):
        direct_irradiance(beam, RayCaster(beam.objects), points, up)


def test_an_image_of_a_new_emitter_has_the_irradiance_of_its_beam():
    image = pr.render(scene(BeamEmitter(2.0, 3.0)), method="standard", n_emitted=20_000)
    caustic = image.layers["caustic"]
    np.testing.assert_allclose(caustic[14:18, 14:18].mean(), 3.0 * 0.8 / np.pi, rtol=0.02)
    assert not caustic[:4].any()


def test_scenes_of_other_emitters_have_other_digests():
    digests = [scene_digests(scene(BeamEmitter(*beam))) for beam in ((1, 2), (1, 2), (1, 3))]
    assert digests[0] == digests[1] != digests[2]


def test_what_is_no_emitter_is_refused():
    with pytest.raises(TypeError, match=r"emitters\[0\] should be an Emitter.*, but is object"):
        scene(object())
    with pytest.raises(TypeError, match="abstract"):
        Emitter()
