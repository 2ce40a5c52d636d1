"""Progressive photon mapping: statistics of hit points over passes of photons."""

from itertools import pairwise

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.estimation.progressive import HitPointStatistics, initial_radius, radius_share
from photonrelax.estimation.split_passes import assign_passes
from tests.helpers.photon_maps import flat_map, plane, uniform_map

CENTRE = plane([[0.5, 0.5]])


def photons_at(distances, n_emitted, flux=1.0):
    """Photons of so many W, before they are divided by their number, off the centre."""
    along = np.column_stack([0.5 + np.asarray(distances), np.full(len(distances), 0.5)])
    photons = flat_map(along, n_emitted)
    return photons.replace(flux=photons.flux * flux)


def test_two_passes_by_hand():
    """Hachisuka et al. 2008: N + αM kept of N + M, R² and τ in the same ratio."""
    statistics = pr.ProgressiveStatistics(*CENTRE, 0.1, alpha=0.7)
    statistics.add(photons_at([0.0, 0.05, 0.1, 0.2], 10, flux=3.0))
    share = 0.7 * 3 / 3
    np.testing.assert_allclose(statistics.n, [0.7 * 3])
    np.testing.assert_allclose(statistics.tau, np.full((1, 3), 9.0 * share))
    np.testing.assert_allclose(statistics.radius**2, [0.01 * share])
    radius, tau = statistics.radius[0], 9.0 * share
    statistics.add(photons_at([0.01, 0.095], 20))
    assert radius < 0.095
    share = (2.1 + 0.7) / (2.1 + 1)
    np.testing.assert_allclose(statistics.n, [2.8])
    np.testing.assert_allclose(statistics.tau[0, 0], (tau + 1.0) * share)
    np.testing.assert_allclose(statistics.radius**2, [radius**2 * share])
    expected = (tau + 1.0) / (np.pi * radius**2 * 30)
    np.testing.assert_allclose(statistics.irradiance(), np.full((1, 3), expected))


def test_a_pass_that_finds_nothing_counts_as_such():
    statistics = pr.ProgressiveStatistics(*CENTRE, 0.1)
    np.testing.assert_array_equal(statistics.irradiance(), np.zeros((1, 3)))
    statistics.add(photons_at([0.3], 10))
    assert (statistics.radius, statistics.n) == (0.1, 0.0)
    np.testing.assert_array_equal(statistics.irradiance(), np.zeros((1, 3)))
    statistics.add(photons_at([0.0], 10))
    once = statistics.irradiance()
    statistics.add(uniform_map(40, "random").subset(slice(0)).replace(n_emitted=20))
    np.testing.assert_allclose(statistics.irradiance(), once / 2)


def test_with_alpha_one_passes_of_any_size_are_one_map(interior):
    maps = [uniform_map(n, "random", seed=n) for n in (500, 3000, 1000)]
    statistics = pr.ProgressiveStatistics(*interior, 0.1, alpha=1.0)
    for photons in maps:
        statistics.add(photons)
    whole = np.concatenate([photons.position for photons in maps])
    pooled = pr.ProgressiveStatistics(*interior, 0.1, alpha=1.0)
    pooled.add(flat_map(whole[:, :2], 4500))
    np.testing.assert_allclose(statistics.irradiance(), pooled.irradiance(), rtol=1e-12)
    np.testing.assert_array_equal(statistics.radius, 0.1)


def test_weights_take_the_place_of_numbers_emitted():
    statistics = pr.ProgressiveStatistics(*CENTRE, 0.1, alpha=1.0)
    bare = photons_at([0.0], 1).replace(n_emitted=None)
    with pytest.raises(ValueError, match=r"n_emitted should say .* but is None"):
        statistics.add(bare)
    statistics.add(bare, weight=1.0)
    statistics.add(bare.replace(flux=4.0 * bare.flux), weight=2.0)
    np.testing.assert_allclose(statistics.irradiance()[0, 0], (1 + 8) / 3 / (np.pi * 0.01))


def test_discs_do_not_shrink_below_their_least_radius():
    """A reduced disc keeps its density, and all photons count once it stays."""
    points, normals = plane(np.tile([[0.5, 0.5]], (3, 1)))
    statistics = pr.ProgressiveStatistics(points, normals, 0.1, alpha=0.5)
    statistics.add(photons_at([0.0] * 8, 8), least_radius=[0.2, 0.09, 0.01])
    np.testing.assert_allclose(statistics.radius, [0.1, 0.09, 0.1 * np.sqrt(0.5)])
    np.testing.assert_allclose(statistics.n, 8 * np.array([1.0, 0.81, 0.5]))
    np.testing.assert_allclose(statistics.irradiance(), 1.0 / (np.pi * 0.01))


def test_photons_on_other_faces_do_not_count():
    statistics = pr.ProgressiveStatistics(*CENTRE, 0.1)
    photons = photons_at([0.0, 0.01, 0.02], 3)
    statistics.add(photons.replace(normal=[[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0]]))
    np.testing.assert_allclose(statistics.n, [0.7])


def test_same_bits_for_every_number_of_threads(interior):
    runs = []
    for n_threads in (1, 2, 7):
        statistics = pr.ProgressiveStatistics(*interior, 0.05, n_threads=n_threads)
        for seed in range(3):
            statistics.add(uniform_map(3000, "random", seed=seed))
        runs.append(statistics)
    for name in ("radius", "n", "tau"):
        assert len({getattr(run, name).tobytes() for run in runs}) == 1


PASSES = 2 ** np.arange(2, 8)
WAVE = 2.0 * np.pi * 4.0


@pytest.mark.kernels_run_elsewhere
def test_discs_shrink_and_noise_and_bias_fall_as_theory_says():
    """R² ~ i^(α - 1), bias ~ R², N ~ i^α, variance ~ i^-α: slopes over passes 4 to 128.

    The light is 1 + 0.8 cos (8π x). On top of its ridges bias is that of the curvature; noise is
    what three runs differ by.
    """
    alpha, inside = 0.7, np.linspace(0.15, 0.85, 57)
    points, normals = plane(np.stack(np.meshgrid(inside, inside), -1).reshape(-1, 2))
    points[:, 0] = np.round(8 * points[:, 0]) / 8
    top = np.cos(WAVE * points[:, 0]) > 0.99
    runs = [pr.ProgressiveStatistics(points, normals, 0.06, alpha=alpha) for _ in range(3)]
    found = []
    for number in range(1, PASSES[-1] + 1):
        for seed, run in enumerate(runs):
            run.add(waves(1500, [seed, number]))
        if number in PASSES:
            estimates = np.array([run.irradiance()[:, 0] for run in runs])
            bias = 1.8 - estimates[:, top].mean()
            shrunk = [(run.radius**2).mean() for run in runs]
            kept = [run.n.mean() for run in runs]
            found.append((np.mean(shrunk), np.mean(kept), bias, estimates.var(axis=0).mean()))
    squared, n, bias, variance = np.transpose(found)
    assert slope(squared) == pytest.approx(alpha - 1.0, abs=0.02)
    assert slope(n) == pytest.approx(alpha, abs=0.02)
    assert slope(bias) == pytest.approx(alpha - 1.0, abs=0.05)
    assert slope(variance) == pytest.approx(-alpha, abs=0.1)


def waves(n, seed):
    xy = np.random.default_rng(seed).random((n, 2))
    photons = flat_map(xy, n)
    return photons.replace(flux=photons.flux * (1.0 + 0.8 * np.cos(WAVE * xy[:, :1])))


def slope(values):
    return np.polyfit(np.log(PASSES), np.log(values), 1)[0]


def test_discs_start_just_short_of_the_kth_photon():
    photons, points = uniform_map(2000, "random"), np.random.default_rng(7).random((50, 2))
    settings = pr.ProgressiveSettings(k=9)
    radius = initial_radius(photons, *plane(points), settings)
    gaps = np.linalg.norm(photons.position[:, :2] - points[:, np.newaxis], axis=2)
    ninth = np.sort(gaps, axis=1)[:, 8]
    reached = ninth < radius.max()
    assert 0.5 < reached.mean() < 1.0
    np.testing.assert_allclose(radius[reached], ninth[reached], rtol=1e-8)
    assert (radius[reached] < ninth[reached]).all()
    assert (ninth[~reached] >= radius.max()).all()
    given = pr.ProgressiveSettings(radius=0.25)
    np.testing.assert_array_equal(initial_radius(photons, *plane(points), given), 0.25)


def test_discs_have_a_size_where_photons_lie_on_their_centre():
    photons = uniform_map(2000, "random")
    """Those of the k-th nearest of the points that photons are at."""
    spot = photons.replace(position=np.vstack([photons.position[:-50], [CENTRE[0][0]] * 50]))
    once = spot.subset(slice(0, -49))
    np.testing.assert_array_equal(initial_radius(spot, *CENTRE), initial_radius(once, *CENTRE))
    assert np.isfinite(pr.irradiance_field(spot, method="progressive")(*CENTRE)).all()


def test_the_first_pass_alone_is_unbiased(interior):
    """The k - 1 photons within the k-th distance, over many maps."""
    means = []
    for seed in range(20):
        photons = uniform_map(2000, "random", seed=seed)
        one = pr.ProgressiveSettings(n_passes=1, k=6)
        field = pr.irradiance_field(photons, method="progressive", progressive=one)
        means.append(field(*interior)[:, 0].mean())
    assert np.mean(means) == pytest.approx(1.0, abs=4 * np.std(means) / np.sqrt(20))
    assert np.std(means) < 0.03


@pytest.mark.parametrize("kind", ["random", "halton"])
def test_the_field_of_uniform_light_is_uniform(kind, interior):
    photons = uniform_map(100_000, kind)
    estimates = pr.irradiance_field(photons, method="progressive")(*interior)[:, 0]
    # Of the k - 1 photons that are within a disc at first, and all that follow.
    n_kept = 4 * 8**0.7
    assert estimates.mean() == pytest.approx(1.0, abs=0.01)
    assert estimates.std() < (1.0 if kind == "random" else 0.5) / np.sqrt(n_kept) * 1.1


def test_passes_are_dealt_alike_whatever_the_order_of_the_map():
    photons = uniform_map(5003, "halton")
    number = assign_passes(photons, 16)
    assert np.ptp(np.bincount(number)) <= 1
    order = np.random.default_rng(0).permutation(5003)
    turn = np.array([[0.6, 0.8, 0.0], [0.0, 0.0, 1.0], [0.8, -0.6, 0.0]])
    moved = photons.replace(position=3.7 * photons.position @ turn + [5.0, -2.0, 1.0])
    np.testing.assert_array_equal(assign_passes(photons.subset(order), 16), number[order])
    np.testing.assert_array_equal(assign_passes(moved, 16), number)


def test_passes_of_a_halton_map_are_spread_over_the_light():
    """Every 16th photon of the sequence would lie in a sixteenth of the square."""
    photons = uniform_map(4096, "halton")
    number = assign_passes(photons, 16)
    cells = (photons.position[:, :2] * 8).astype(int) @ [8, 1]
    counts = np.histogram2d(number, cells, bins=(16, 64))[0]
    # Dealt at random, numbers would deviate by 2; here 60 of 64 cells would be empty.
    assert counts.std() < 2.5
    assert (counts > 0).mean() > 0.9


def test_a_field_estimates_anything_photons_carry(interior):
    photons = uniform_map(20_000, "random")
    field = pr.irradiance_field(photons, method="progressive")
    values = np.hstack([photons.flux, 2.0 * photons.flux[:, :1]])
    found = field.densities(values)(*interior)
    np.testing.assert_array_equal(found[:, :3], field(*interior))
    np.testing.assert_allclose(found[:, 3], 2.0 * found[:, 0], rtol=1e-12)
    seen = []
    field(*interior, progress=lambda *step: seen.append(step))
    assert seen[-1] == ("estimate", 20_000, 20_000)


def test_a_map_of_few_photons_makes_few_passes():
    field = pr.irradiance_field(uniform_map(20, "random"), method="progressive")
    assert field.settings.n_passes == 4
    assert field.used["progressive"]["n_passes"] == 4
    empty = pr.irradiance_field(uniform_map(40, "random").subset([]), method="progressive")
    np.testing.assert_array_equal(empty(*CENTRE), np.zeros((1, 3)))


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"alpha": 0.0}, ValueError, r"ProgressiveSettings.alpha should be a positive number"),
        ({"alpha": 1.1}, ValueError, r"ProgressiveSettings.alpha should be at most 1, but is 1.1"),
        ({"n_passes": 0}, ValueError, r"ProgressiveSettings.n_passes should be at least 1"),
        ({"k": 1}, ValueError, r"ProgressiveSettings.k should be at least 2"),
        ({"radius": -1.0}, ValueError, r"ProgressiveSettings.radius should be a positive"),
        ({"radius": 1e160}, ValueError, r"radius should lie in \[1e-150, 1e\+150\]"),
        ({"n_passes": 1.5}, TypeError, r"ProgressiveSettings.n_passes should be an integer"),
    ],
)
def test_bad_settings_are_refused(arguments, error, message):
    with pytest.raises(error, match=message):
        pr.ProgressiveSettings(**arguments)


@pytest.mark.parametrize(
    ("radius", "message"),
    [
        (0.0, "radius should be positive, but its least value is 0.0"),
        ([0.1, 0.2], r"radius should be a number or of shape \(1,\), but has \(2,\)"),
        (np.nan, "radius should be finite"),
        (1e160, r"radius should lie in \[1e-150, 1e\+150\], but spans 1e\+160 to 1e\+160"),
        (1e-160, r"radius should lie in \[1e-150, 1e\+150\]"),
    ],
)
def test_bad_radii_are_refused(radius, message):
    with pytest.raises(ValueError, match=message):
        pr.ProgressiveStatistics(*CENTRE, radius)


def test_points_and_normals_must_fit():
    with pytest.raises(ValueError, match="normals should have shape"):
        pr.ProgressiveStatistics([[0.0, 0.0, 0.0]], [[0, 0, 1.0]] * 2, 0.1)
    with pytest.raises(ValueError, match="normals should hold directions"):
        pr.ProgressiveStatistics([[0.0, 0.0, 0.0]], [[0, 0, 0.0]], 0.1)


def test_global_radii_are_those_of_local_ones_in_uniform_light():
    """On average; and pass after pass as Knaus & Zwicker 2011 have them."""
    shares = [radius_share(number, 0.7) for number in range(50)]
    np.testing.assert_allclose(
        [after / before for before, after in pairwise(shares)],
        [(i + 0.7) / (i + 1) for i in range(1, 50)],
    )
    local, everywhere = (
        HitPointStatistics(np.full(3, 0.1), 2, alpha=0.7, n_threads=1, is_global=is_global)
        for is_global in (False, True)
    )
    for _ in range(50):
        for each in (local, everywhere):
            counts = 1000.0 * np.pi * each.pass_radius() ** 2
            each.update(counts, np.column_stack([counts, 2.0 * counts]), 5.0)
    np.testing.assert_allclose(local.densities(), [[1000.0, 2000.0]] * 3)
    np.testing.assert_allclose(everywhere.densities(), [[1000.0, 2000.0]] * 3)
    np.testing.assert_allclose(everywhere.pass_radius(), local.pass_radius(), rtol=0.2)


def test_the_radius_of_any_pass_follows_from_its_number():
    one = HitPointStatistics(np.full(4, 0.1), 1, alpha=0.7, n_threads=1, is_global=True)
    square = np.prod([(k + 0.7) / (k + 1) for k in range(1, 8)])
    np.testing.assert_allclose(one.pass_radius(7), 0.1 * np.sqrt(square))


def test_global_radii_are_refused_with_spectra():
    photons = pr.PhotonMap(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)))
    with pytest.raises(ValueError, match='radius should be none or a number with method="frequ'):
        pr.irradiance_field(
            photons, method="frequency", progressive=pr.ProgressiveSettings(radius="global")
        )
    with pytest.raises(ValueError, match="radius should be"):
        pr.ProgressiveSettings(radius="local")
