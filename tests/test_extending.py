"""New things are added in one place: a class or function, and one record."""

from dataclasses import asdict, dataclass

import numpy as np
import pytest

import photonrelax as pr
from photonrelax import gallery
from photonrelax.cli import commands
from photonrelax.estimation import methods
from photonrelax.estimation.field import PhotonField
from photonrelax.rendering import layers
from photonrelax.scene.emission_region import cap_region, start_distance
from photonrelax.scene.emitters import DirectLight, Emitter
from photonrelax.scene.materials import Material, MaterialRow
from tests.helpers.photon_maps import uniform_map


@dataclass(frozen=True)
class MeanSettings:
    """Settings of the toy method."""

    factor: float = 1.0


class MeanField(PhotonField):
    """The same everywhere: the total over the square metre that photons are on."""

    def __init__(self, photons, settings):
        self.photons, self.settings = photons, settings
        self.seconds, self.used, self._n_threads = {}, {"mean": asdict(settings)}, 1

    def _lay_out(self, values, part):
        return values.sum(axis=0)

    def _fill(self, out, values, points):
        out[points.rows] = self.settings.factor * values.laid_out(points.part)


def mean_field(inputs):
    return MeanField(inputs.photons, inputs.settings.of("mean"))


@pytest.fixture
def mean_method(monkeypatch):
    for known in (methods.METHODS, methods.SETTINGS_CLASSES):
        monkeypatch.setitem(known, "mean", None)  # to be deleted afterwards
        del known["mean"]
    methods.register(methods.Method("mean", ("mean",), mean_field), mean=MeanSettings)


@pytest.fixture
def scene():
    return gallery.scene("ring", pixels=16, sections=64)


@pytest.mark.usefixtures("mean_method")
def test_a_method_is_its_module_and_one_record(scene, tmp_path):
    field = pr.irradiance_field(uniform_map(1000, "random"), method="mean", mean=MeanSettings(2.0))
    np.testing.assert_allclose(field([[0.5, 0.5, 0.0]], [[0.0, 0.0, 1.0]]), 2.0)

    image = pr.render(scene, method="mean", n_emitted=2000)
    seen = image.layers["caustic"][np.isfinite(image.layers["Z"])]
    assert seen.max() > 0.0

    size = ("--photons", "2000", "--width", "16", "--quiet")
    output = tmp_path / "ring.exr"
    options = ("--method", "mean", "--set", "mean.factor=2", "-o", str(output))
    assert commands.main(["render", "ring", *options, *size]) == 0
    folder = tmp_path / "compared"
    options = ("--methods", "mean", "standard", "--reference-passes", "1", "-o", str(folder))
    assert commands.main(["compare", "ring", *options, *size, "--reference-photons", "2000"]) == 0
    assert (folder / "mean.exr").exists()


@pytest.mark.usefixtures("mean_method")
def test_a_method_without_footprints_says_so():
    field = pr.irradiance_field(uniform_map(1000, "random"), method="mean")
    with pytest.raises(ValueError, match="MeanField has estimates at points only, but a footprint"):
        field([[0.5, 0.5, 0.0]], [[0.0, 0.0, 1.0]], footprint=[0.1])


@pytest.mark.usefixtures("mean_method")
def test_names_of_methods_and_stages_are_taken_once():
    mean = methods.METHODS["mean"]
    methods.register(mean, mean=MeanSettings)
    with pytest.raises(ValueError, match="method 'standard' should have a name of its own"):
        methods.register(methods.Method("standard", ("mean",), mean_field))
    with pytest.raises(ValueError, match="stage 'gather' should have a name of its own"):
        methods.register(mean, gather=MeanSettings)
    assert methods.SETTINGS_CLASSES["gather"] is pr.GatherSettings


@pytest.mark.usefixtures("mean_method")
def test_stages_that_share_a_class_have_settings_of_their_own(monkeypatch):
    monkeypatch.setitem(methods.SETTINGS_CLASSES, "mode", MeanSettings)
    given = methods.Settings(mean=MeanSettings(2.0), mode=MeanSettings(3.0))
    assert (given.of("mean").factor, given.of("mode").factor) == (2.0, 3.0)


@dataclass(frozen=True)
class HalfEmitter(Emitter):
    """A point of half of the power that it is given."""

    position: tuple
    power: float = 2.0

    @property
    def point(self):
        return np.asarray(self.position)

    def emission_region(self, target, scene, emitter_offset):
        position = np.asarray(self.position)
        start = start_distance(position, scene, emitter_offset)
        return cap_region(position, np.full(3, self.power / 2.0), target, start)

    def direct(self, position, emitter_offset):
        offset = np.asarray(self.position) - position
        distance = np.linalg.norm(offset, axis=1)
        irradiance = self.power / 2.0 / (4.0 * np.pi * distance**2)
        return DirectLight(
            offset / distance[:, None], distance, np.repeat(irradiance[:, None], 3, axis=1)
        )


@dataclass(frozen=True)
class HalfMirror(Material):
    """A mirror that reflects half of the light."""

    def row(self):
        return MaterialRow("mirror", reflectance=np.full(3, 0.5))


def test_a_material_is_one_class(scene):
    """Pictures are those of a mirror of half the reflectance."""
    floor = scene.objects[0]
    metal = next(item for item in scene.objects if item.material.is_specular)
    ours, expected = (
        pr.render(
            pr.Scene([floor, pr.SceneObject(metal.mesh, material)], scene.emitters, scene.camera),
            n_emitted=2000,
            method="standard",
        )
        for material in (HalfMirror(), pr.Mirror(0.5))
    )
    assert expected.layers["caustic"].max() > 0.0
    for name, layer in expected.layers.items():
        np.testing.assert_array_equal(ours.layers[name], layer, err_msg=name)


def test_an_emitter_is_one_class(scene):
    """Photons, direct light and images are those of a point emitter of half the power."""
    lit = [
        pr.Scene(scene.objects, [emitter], scene.camera)
        for emitter in (HalfEmitter((0.3, 0.2, 3.0)), pr.PointEmitter((0.3, 0.2, 3.0)))
    ]
    ours, expected = (pr.render(each, n_emitted=2000, method="standard") for each in lit)
    assert expected.layers["direct"].max() > 0.0
    for name, layer in expected.layers.items():
        np.testing.assert_allclose(ours.layers[name], layer, rtol=1e-12, err_msg=name)


def test_a_layer_is_one_record(scene, monkeypatch):
    """Written, and merged over progressive passes, as its record says."""
    hits = layers.Layer(
        "hits",
        "hit points in a pixel",
        lambda band, _: band.sums(np.ones((len(band.hits), 1))),
        channels=1,
    )
    monkeypatch.setattr(layers, "RECORDS", (*layers.RECORDS, hits))
    image = pr.render(scene, method="standard", n_emitted=2000, supersampling=2)
    assert image.layers["hits"].max() == 4.0
    many = pr.render_progressive(scene, n_passes=2, photons_per_pass=500, stochastic=True)
    assert many.layers["hits"].max() == 4.0
    assert many.layers["hits"].shape == image.layers["hits"].shape
