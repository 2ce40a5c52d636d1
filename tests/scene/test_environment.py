"""A constant environment: a furnace that makes white, mirrors and clear glass look the same."""

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.rendering.layers import band_layers, with_radiance
from photonrelax.rendering.view import View
from photonrelax.transport.direct_light import LightSamples, direct_irradiance
from photonrelax.transport.emission import emit, plan_emission
from photonrelax.transport.raycast import RayCaster
from tests.helpers.aimed_light import assert_aimed_light_is_that_of_all_paths
from tests.helpers.tracing_scenes import ball, floor, sheet

RADIANCE = np.array([1.0, 2.0, 3.0])
SKY = pr.EnvironmentEmitter(RADIANCE)


def test_a_plate_gets_pi_times_the_radiance():
    scene = pr.Scene([floor()], [SKY])
    position = np.array([[0.0, 0, 0], [1.0, 2.0, 0]])
    for normal in ([0.0, 0, 1], [0.6, 0, 0.8]):
        caster, normals = RayCaster(scene.surfaces), np.tile(normal, (2, 1))
        E = direct_irradiance(scene, caster, position, normals, samples=LightSamples(4096))
        # The plate hides what is below the horizon of a point that leans.
        share = 0.5 * (1 + normal[2])
        np.testing.assert_allclose(E, np.pi * share * np.tile(RADIANCE, (2, 1)), rtol=3e-3)


def test_photons_bring_the_same_light():
    scene = pr.Scene([pr.SceneObject(sheet(1.0), pr.Diffuse(0.0))], [SKY])
    photons = pr.trace_photons(scene, 200_000, paths="all")
    around = 4 * np.pi * np.pi * scene.bounding_sphere().radius ** 2
    np.testing.assert_allclose(photons.ledger.emitted[0], around * RADIANCE, rtol=1e-12)
    for side in (1.0, -1.0):
        flux = photons.flux[photons.normal[:, 2] == side].sum(axis=0)
        np.testing.assert_allclose(flux / 4.0, np.pi * RADIANCE, rtol=0.01)
    assert not photons.well_spaced
    assert not photons.emitter_coords.any()
    assert photons.extended_ids.tolist() == [0]


@pytest.mark.parametrize("sampler", ["halton", "random"])
def test_directions_are_uniform_over_the_sphere(sampler):
    plan = plan_emission(pr.Scene([floor()], [SKY]), 20_000, "all", sampler=sampler)
    direction = emit(plan, 0, range(20_000)).direction
    cells = np.histogram2d(
        direction[:, 2],
        np.arctan2(direction[:, 1], direction[:, 0]),
        bins=(6, 6),
        range=[[-1, 1], [-np.pi, np.pi]],
    )[0]
    np.testing.assert_allclose(cells / 20_000, 1 / 36, atol=5e-4 if sampler == "halton" else 6e-3)


def furnace(material, sky=SKY):
    """A ball that fills most of the image, and around it the background."""
    camera = pr.Camera((0, -4, 0), (0, 0, 0), width=32, height=32, vertical_fov=40.0)
    item = pr.SceneObject(ball(1.0, (0, 0, 0), 5), material, smooth=True)
    view = View(pr.Scene([item], [sky], camera), max_depth=16)
    return with_radiance(band_layers(next(view.bands()), {"caustic": np.zeros((32, 32, 3))}))


@pytest.mark.parametrize(
    ("material", "is_direct"),
    [(pr.Diffuse(1.0), True), (pr.Mirror(), False), (pr.Dielectric(1.5), False)],
    ids=["white", "mirror", "glass"],
)
def test_nothing_is_seen_in_a_furnace(material, is_direct):
    layers = furnace(material)
    np.testing.assert_allclose(layers["radiance"] / RADIANCE, 1.0, rtol=0.05)
    tiles = layers["radiance"].reshape(2, 16, 2, 16, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(tiles / RADIANCE, 1.0, rtol=0.01)
    on_ball = layers["direct"][16, 16] if is_direct else layers["emission"][16, 16]
    np.testing.assert_allclose(on_ball, RADIANCE, rtol=0.02)
    np.testing.assert_allclose(layers["emission"][0, 0], RADIANCE, rtol=1e-12)


def test_a_tinted_mirror_tints_the_background():
    emission = furnace(pr.Mirror((0.5, 0.2, 0.1)))["emission"]
    np.testing.assert_allclose(emission[16, 16], RADIANCE * [0.5, 0.2, 0.1], rtol=1e-9)


def test_backgrounds_add_up_and_others_have_none():
    lights = [SKY, pr.EnvironmentEmitter(1.0), pr.CollimatedEmitter((0, 0, -1))]
    camera = pr.Camera((0, -4, 5), (0, 0, 5), width=4, height=4, vertical_fov=1.0)
    scene = pr.Scene([floor(1.0)], lights, camera)
    layers = band_layers(next(View(scene).bands()))
    np.testing.assert_allclose(layers["emission"], np.tile(RADIANCE + 1.0, (4, 4, 1)))
    dark = View(pr.Scene([floor(1.0)], lights[2:], camera))
    assert "emission" not in band_layers(next(dark.bands()))


def test_caustics_of_the_sky_are_those_of_all_its_light():
    """Flux of the light that is aimed at a mirror, and of the same paths among all light."""
    mirror = pr.SceneObject(ball(0.5, (0, 0, 1)), pr.Mirror(0.5))
    scene = pr.Scene([floor(albedo=0.0), mirror], [pr.EnvironmentEmitter(1.0)])
    aimed, _ = assert_aimed_light_is_that_of_all_paths(scene)
    relaxed = pr.relax(aimed, pr.detect_structure(aimed))
    assert np.isfinite(relaxed.position).all()


def test_a_radiance_that_is_no_colour_is_refused():
    with pytest.raises(ValueError, match="radiance"):
        pr.EnvironmentEmitter(np.ones((8, 3)))
    with pytest.raises(ValueError, match="radiance"):
        pr.EnvironmentEmitter(-1.0)
