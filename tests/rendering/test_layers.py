"""Layers: one record each, from rendering to files; light components add up to the radiance."""

import numpy as np
import pytest

import photonrelax as pr
from photonrelax import gallery
from photonrelax.evaluation import ComparisonRequest, SceneSubject, compare
from photonrelax.imaging.image import read_exr
from photonrelax.rendering import layers
from photonrelax.rendering.layers import MINIMUM, Layer
from photonrelax.rendering.pass_statistics import PassSettings, StochasticHitPoints
from photonrelax.rendering.view import View
from tests.helpers.short_runs import FEW


def mean_y(band, estimates):
    return band.sums(band.hits.weight * band.hits.position[:, 1:2])[..., :1]


def nearest_x(band, estimates):
    nearest = np.full(len(band.rows) * band.width, np.inf)
    pixel = band.hits.pixel - band.rows.start * band.width
    np.minimum.at(nearest, pixel, band.hits.position[:, 0])
    return np.nan_to_num(nearest, posinf=9.0).reshape(len(band.rows), band.width, 1)


def glow(band, estimates):
    return band.radiance(np.full_like(band.direct, 3.0))


def caustic_share(band, estimates):
    if "caustic" not in estimates:
        return None
    return estimates["caustic"] / (estimates["caustic"] + band.radiance(band.direct) + 1.0)


TOYS = (
    Layer("toy.y", "mean y, m", mean_y, channels=1),
    Layer("toy.x", "least x, m", nearest_x, channels=1, merge=MINIMUM),
    Layer("glow", "radiance of everything", glow, is_light=True),
    Layer("toy.share", "share of the caustic", caustic_share),
)


@pytest.fixture
def toys(monkeypatch):
    monkeypatch.setattr(layers, "RECORDS", (*layers.RECORDS, *TOYS))


@pytest.fixture(scope="module")
def ring():
    return gallery.scene("ring", pixels=16, sections=64)


def added(image):
    return image.layers["caustic"] + image.layers["direct"] + image.layers["glow"]


def test_one_record_adds_a_layer_to_images_and_files(ring, toys, tmp_path):
    image = pr.render(ring, n_emitted=3000, method="standard")
    assert list(image.layers)[-4:] == [toy.name for toy in TOYS]
    assert image.layers["toy.y"].shape == (16, 16)
    assert image.layers["toy.share"].shape == (16, 16, 3)
    np.testing.assert_array_equal(image.layers["radiance"], added(image))
    assert (image.layers["glow"][image.layers["albedo"] > 0.0] > 0.0).all()
    image.write_exr(tmp_path / "a.exr")
    assert {toy.name for toy in TOYS} <= read_exr(tmp_path / "a.exr").layers.keys()


def test_passes_merge_it_as_its_record_says(ring, toys):
    """A mean over passes, or the least; layers that need photons are left out."""
    run = pr.render_progressive(ring, n_passes=3, stochastic=True, **FEW)
    settings = PassSettings(pr.ProgressiveSettings(), 2000, 3, 2, stochastic=True, max_depth=8)
    view = View(ring)
    points = StochasticHitPoints(view, settings)
    passes = [[*view.bands(points.offset(number))] for number in range(3)]
    mean = np.mean([mean_y(band, {})[..., 0] for (band,) in passes], axis=0)
    least = np.min([nearest_x(band, {})[..., 0] for (band,) in passes], axis=0)
    assert np.ptp([mean_y(band, {}).sum() for (band,) in passes]) > 0.01
    np.testing.assert_allclose(run.layers["toy.y"], mean, rtol=1e-12)
    np.testing.assert_array_equal(run.layers["toy.x"], least)
    assert "toy.share" not in run.layers


@pytest.mark.parametrize("stochastic", [False, True])
def test_light_components_add_up_in_passes(ring, stochastic, toys, tmp_path):
    how = {"stochastic": stochastic, **FEW}
    image = pr.render_progressive(ring, n_passes=3, **how)
    np.testing.assert_array_equal(image.layers["radiance"], added(image))
    state = pr.Checkpoints(state=tmp_path / "run.npz")
    for n_passes in (1, 3):
        resumed = pr.render_progressive(ring, n_passes=n_passes, checkpoints=state, **how)
    for toy in TOYS[:3]:
        np.testing.assert_array_equal(resumed.layers[toy.name], image.layers[toy.name])


def test_light_components_add_up_in_comparisons(ring, toys):
    subject = SceneSubject(ring)
    request = ComparisonRequest(
        subject=subject, methods=("standard",), n_emitted=3000, supersampling=1
    )
    image = pr.render(ring, n_emitted=3000, method="standard", supersampling=1)
    (entry,) = compare(request, image).entries
    np.testing.assert_array_equal(entry.image.layers["radiance"], image.layers["radiance"])
    bare = pr.Image({"radiance": image.layers["radiance"]})
    (entry,) = compare(request, bare).entries
    assert entry.errors.relative_l1 < 1e-12


class WithFlux(pr.IrradianceField):
    """A field that names two layers of its own."""

    @property
    def layers(self):
        flux = self.photons.flux
        return {**super().layers, "own.flux": flux, "own.red": flux[:, :1]}


def test_layers_that_a_field_names_need_no_record(ring):
    photons = pr.trace_photons(ring, 3000)
    found = layers.photon_layers(View(ring).bands(), WithFlux(photons))
    lit = found["caustic"].sum(axis=2) > 0.0
    assert found["own.red"].shape == (16, 16)
    # All photons have the same flux, and so has their mean.
    np.testing.assert_allclose(found["own.flux"][lit], photons.flux[:1].repeat(lit.sum(), 0))
    np.testing.assert_array_equal(found["own.red"], found["own.flux"][..., 0])
