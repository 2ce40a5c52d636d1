"""Frequency-driven progressive photon mapping."""

import numpy as np
import pytest
from conftest import flat_map, plane, unit_square

import photonrelax as pr
from photonrelax import gallery
from photonrelax.frequency import FrequencyField
from photonrelax.spectrum import kernel_radius

PASSES = pr.ProgressiveSettings(n_passes=8)


def with_spectra(a, n=20_000, kind="random"):
    """Uniform light whose photons claim, one in five, a spectrum of variance a(xy)."""
    xy = unit_square(n, kind)
    spectra = np.full((n, 3), np.nan)
    spectra[::5] = 0.0
    spectra[::5, 0] = a(xy[::5])
    return flat_map(xy, n, spectrum=spectra)


def irradiance(photons, points, method="frequency", **settings):
    settings = {"progressive": PASSES} | settings
    return pr.irradiance_field(photons, method=method, **settings)(*points)


def test_photons_need_spectra():
    photons = flat_map(unit_square(100, "random"), 100)
    for spectra in (None, np.full((100, 3), np.nan)):
        with pytest.raises(ValueError, match=r"none of them does: trace_photons\(…, frequency_sh"):
            pr.irradiance_field(photons.replace(spectrum=spectra), method="frequency")


def test_an_empty_map_is_dark(interior):
    photons = with_spectra(lambda xy: 0.0).subset([])
    assert not irradiance(photons, interior).any()


def test_discs_of_rough_light_shrink_as_those_of_progressive_photon_mapping(interior):
    photons = with_spectra(lambda xy: 1e12)
    np.testing.assert_array_equal(
        irradiance(photons, interior), irradiance(photons, interior, "progressive")
    )


def test_discs_of_smooth_light_stay(interior):
    photons = with_spectra(lambda xy: 0.0)
    lasting = pr.ProgressiveSettings(n_passes=8, alpha=1.0)
    expected = irradiance(photons, interior, "progressive", progressive=lasting)
    kept = irradiance(photons, interior)
    # But for those that no photon with a spectrum is in.
    same = np.isclose(kept, expected, rtol=1e-12).all(axis=1)
    assert same.mean() > 0.99
    shrinking = irradiance(photons, interior, "progressive")
    assert kept[:, 0].std() < shrinking[:, 0].std() / 1.2
    assert kept[:, 0].mean() == pytest.approx(1.0, abs=0.01)


def test_the_bound_is_the_largest_variance_in_and_around_the_disc():
    rng = np.random.default_rng(7)
    photons = with_spectra(lambda xy: rng.uniform(1.0, 50.0, len(xy)), n=2_000)
    points, normals = plane(rng.random((300, 2)))
    radius = rng.uniform(0.01, 0.2, 300)
    distance = np.linalg.norm(points[:, None] - photons.position[::5], axis=2)
    within = np.where(distance <= 1.5 * radius[:, None], photons.spectrum[::5, 0], -np.inf)
    largest = within.max(axis=1)
    known = np.isfinite(largest)
    assert 0.5 < known.mean() < 1.0
    expected = np.zeros(300)
    expected[known] = np.minimum(kernel_radius(largest[known]), radius[known])
    field = FrequencyField(photons, PASSES, pr.FrequencySettings(reach=1.5), n_threads=1)
    np.testing.assert_allclose(field.least_radius(points, normals, radius), expected, rtol=1e-12)
    looser = FrequencyField(photons, PASSES, pr.FrequencySettings(bias=0.2, reach=1.5), n_threads=1)
    larger = looser.least_radius(points, normals, radius)
    np.testing.assert_allclose(larger, np.minimum(2 * expected, radius), rtol=1e-12)


def test_photons_behind_a_point_bound_nothing():
    photons = with_spectra(lambda xy: 1.0)
    points, normals = plane(np.full((1, 2), 0.5))
    field = FrequencyField(photons, PASSES)
    assert field.least_radius(points, normals, np.full(1, 0.05))[0] == 0.05
    assert field.least_radius(points, -normals, np.full(1, 0.05))[0] == 0.0


def test_threads_change_no_bit(interior):
    photons = with_spectra(lambda xy: 10.0 * xy[:, 0])
    points, normals = interior
    one, many = (irradiance(photons, (points[:3000], normals[:3000]), n_threads=n) for n in (1, 3))
    assert one.tobytes() == many.tobytes()


@pytest.fixture(scope="module")
def reflector():
    """Photons of the scene, and points in the middle of its floor with their irradiance."""
    scene = gallery.scene("reflector")
    photons = pr.trace_photons(scene, 600_000, sampler="random", frequency_share=0.02)
    rng = np.random.default_rng(5)
    points, normals = plane(rng.uniform((-1.0, -0.3), (-0.6, 0.3), (2_000, 2)))
    many = pr.trace_photons(scene, 2_000_000, seed=1)
    reference = pr.estimate_irradiance(many, points, normals, pr.GatherSettings(k=300))
    return photons, (points, normals), reference[:, 0]


def test_smooth_light_of_the_reflector_is_less_noisy_than_progressive(reflector):
    """`python -m bench frequency` measures it at length, and elsewhere."""
    photons, points, reference = reflector
    passes = pr.ProgressiveSettings(n_passes=48)
    error = {}
    for method in ("progressive", "frequency"):
        estimate = irradiance(photons, points, method, progressive=passes)[:, 0]
        error[method] = np.sqrt(np.mean((estimate / reference - 1.0) ** 2))
    assert error["frequency"] < error["progressive"] / 1.2


def test_rendering_traces_spectra_when_they_are_needed():
    scene = gallery.scene("reflector", resolution=128, pixels=16)
    calls = []
    image = pr.render(
        scene,
        method="frequency",
        n_emitted=5_000,
        frequency=pr.FrequencySettings(share=0.2),
        progress=lambda *call: calls.append(call),
    )
    stages = {stage for stage, _, _ in calls}
    assert "spectra" in stages
    assert '"share": 0.2' in image.metadata["photonrelax.settings"]
    pr.render(scene, n_emitted=5_000, method="progressive", progress=lambda *c: stages.clear())
    assert not stages


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"share": 0.0}, "FrequencySettings.share should be a positive number"),
        ({"share": 1.5}, "FrequencySettings.share should be at most 1, but is 1.5"),
        ({"reach": -1.0}, "FrequencySettings.reach should be a positive number"),
        ({"bias": 1.0}, "FrequencySettings.bias should be less than 1"),
    ],
)
def test_errors_name_the_setting(settings, message):
    with pytest.raises(ValueError, match=message):
        pr.FrequencySettings(**settings)
