"""Frequency-driven progressive photon mapping."""

import numpy as np
import pytest
from bench.studies import frequency as bench

import photonrelax as pr
from photonrelax import gallery
from photonrelax.estimation.frequency import FrequencyField
from photonrelax.transport.frequency.operators import kernel_radius
from tests.helpers.photon_maps import flat_map, plane, unit_square

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


def test_photons_traced_without_spectra_are_refused():
    photons = flat_map(unit_square(100, "random"), 100)
    with pytest.raises(ValueError, match=r"none of them does: trace_photons\(…, frequency_sh"):
        pr.irradiance_field(photons, method="frequency")


def test_where_none_of_the_photons_was_chosen_discs_shrink_as_ever(interior):
    photons = flat_map(unit_square(2_000, "random"), 2_000, spectrum=np.full((2_000, 3), np.nan))
    found, expected = (irradiance(photons, interior, m) for m in ("frequency", "progressive"))
    assert found.any()
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("n_emitted", [30, 300])
def test_few_photons_of_which_none_is_chosen_are_rendered(ring, n_emitted):
    photons = pr.trace_photons(ring, n_emitted, frequency_share=pr.FrequencySettings().share)
    assert len(photons) > 5
    assert np.isnan(photons.spectrum).all()
    frequency, progressive = (
        pr.render(ring, method=method, n_emitted=n_emitted, supersampling=1)
        for method in ("frequency", "progressive")
    )
    assert frequency.layers["caustic"].any()
    np.testing.assert_array_equal(frequency.layers["caustic"], progressive.layers["caustic"])


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


def test_around_footprints_spectra_are_searched_within_half_their_diagonal_more():
    rng = np.random.default_rng(7)
    photons = with_spectra(lambda xy: rng.uniform(1.0, 50.0, len(xy)), n=2_000)
    points, normals = plane(rng.random((300, 2)))
    radius, sides = rng.uniform(0.01, 0.1, (2, 300))
    field = FrequencyField(photons, PASSES, pr.FrequencySettings(reach=1.5))
    wider = FrequencyField(photons, PASSES, pr.FrequencySettings(reach=1.0))
    expected = wider.least_radius(points, normals, 1.5 * radius + np.sqrt(0.5) * sides)
    found = field.least_radius(points, normals, radius, sides)
    np.testing.assert_allclose(found, np.minimum(expected, radius), rtol=1e-12)
    edges = np.zeros((300, 2, 3))
    edges[:, 0, 0] = edges[:, 1, 1] = sides
    np.testing.assert_allclose(field.least_radius(points, normals, radius, edges), found)


def test_over_footprints_discs_of_smooth_light_stay(interior):
    points, normals = (array[:3000] for array in interior)
    photons, footprint = with_spectra(lambda xy: 0.0), np.full(3000, 0.02)
    lasting = pr.ProgressiveSettings(n_passes=8, alpha=1.0)
    kept, expected, shrinking = (
        pr.irradiance_field(photons, method=method, progressive=settings)(
            points, normals, footprint=footprint
        )
        for method, settings in (
            ("frequency", PASSES),
            ("progressive", lasting),
            ("progressive", PASSES),
        )
    )
    assert np.isclose(kept, expected, rtol=1e-12).all(axis=1).mean() > 0.99
    assert kept[:, 0].std() < shrinking[:, 0].std()
    assert kept[:, 0].mean() == pytest.approx(1.0, abs=0.01)


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
    one, many = (
        pr.irradiance_field(photons, method="frequency", progressive=PASSES, n_threads=n)(
            points[:3000], normals[:3000], footprint=np.linspace(0.0, 0.1, 3000)
        )
        for n in (1, 3)
    )
    assert one.tobytes() == many.tobytes()


PEAKS = 4
AMPLITUDE = {
    "egg box": lambda x, y: 1.0 + np.cos(2 * np.pi * PEAKS * x) * np.cos(2 * np.pi * PEAKS * y),
    "Gaussians": lambda x, y: np.exp(-(offset(x) ** 2 + offset(y) ** 2) / (2 * 0.04**2)),
}
VARIANCE = {"egg box": PEAKS**2, "Gaussians": 1 / (2 * np.pi * 0.04) ** 2}


def offset(x):
    """From the next of the peaks at (i + 1/2) / PEAKS."""
    return x - (np.floor(PEAKS * x) + 0.5) / PEAKS


@pytest.mark.parametrize("light", AMPLITUDE)
@pytest.mark.parametrize(("start", "low", "high"), [(0.9, 0.03, 0.05), (1.6, 0.05, 0.05 / 0.7)])
def test_estimates_of_known_light_keep_the_bias_stated(light, start, low, high):
    """On its peaks, of amplitude one: 5 % of discs that stay, 5 %/α of those that shrank.

    Discs start with so many times the radius allowed. Estimates of uniform light from the same
    photons, whose mean is one, give the number in the discs by chance.
    """
    allowed = kernel_radius(np.array([VARIANCE[light]]))[0]
    xy = unit_square(200_000, "random")
    spectra = np.full((len(xy), 3), np.nan)
    spectra[::5] = [VARIANCE[light], 0.0, 0.0]
    passes = pr.ProgressiveSettings(n_passes=32, radius=start * allowed)
    field = FrequencyField(flat_map(xy, len(xy), spectrum=spectra), passes)
    values = np.column_stack([AMPLITUDE[light](*xy.T), np.ones(len(xy))]) / len(xy)
    i = (np.arange(PEAKS) + 0.5) / PEAKS
    at = np.stack(np.meshgrid(i, i), axis=-1).reshape(-1, 2)
    found, uniform = field.densities(values)(*plane(at)).T
    bias = AMPLITUDE[light](*at.T) - found / uniform
    assert bias.std() / np.sqrt(len(at)) < 0.002
    assert low < bias.mean() < high


@pytest.fixture(scope="module")
def reflector():
    """Squared errors (1, points) of 1,000,000 photons on the scene's floor, by method."""
    on = bench.floor(1_000_000)
    return on, bench.errors(on, 1_000_000, "halton", range(1), passes=32, share=0.02)[0]


@pytest.mark.kernels_run_elsewhere
def test_smooth_light_of_the_reflector_is_less_noisy_than_progressive(reflector):
    """`python -m bench frequency` measures it at length."""
    on, squared = reflector
    progressive, frequency = (
        np.sqrt(squared[method][:, on.region == 0].mean()) for method in bench.METHODS
    )
    assert (on.region == 0).mean() > 0.05
    assert frequency < progressive / 1.5


@pytest.mark.kernels_run_elsewhere
def test_errors_are_significantly_higher_nowhere(reflector):
    """In blocks of 0.15 m, edges and folds among them."""
    on, squared = reflector
    progressive, frequency = (bench.blocks(on, squared[method]) for method in bench.METHODS)
    known = np.isfinite(progressive)
    assert known.sum() > 100
    assert (frequency[known] < 1.1 * progressive[known]).all()


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
