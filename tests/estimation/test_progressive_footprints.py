"""Progressive photon mapping over footprints: by definition, uniform light, convergence."""

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.estimation.progressive import HitPointStatistics, InitialRadius, PhotonPass
from photonrelax.estimation.split_passes import assign_passes
from photonrelax.photons.photon_trees import PhotonTrees
from tests.helpers.footprint_rule import (
    FOOTPRINTS,
    around,
    places,
    radius_of,
    square,
    uneven,
)
from tests.helpers.photon_maps import (
    endless_map,
    even_points,
    flat_map,
    plane,
    uniform_map,
    unit_square,
)

SETTINGS = pr.ProgressiveSettings(n_passes=3, k=6, alpha=0.6)


def by_definition(photons, point, normal, edges, settings=SETTINGS):
    """Passes of one footprint: a disc of the radius holds photons at their mean density."""
    number = assign_passes(photons, settings.n_passes)
    passes = [photons.subset(number == one) for one in range(settings.n_passes)]
    largest = InitialRadius(passes[0], settings, 1).largest
    seen = around(passes[0], point, normal, edges)
    radius, _ = radius_of(seen.squared, seen.sides, settings.k, largest)
    if radius < largest:
        radius *= 1.0 - 1e-9
    kept, estimate = 0.0, 0.0
    for one in passes:
        seen = around(one, point, normal, edges)
        weights = seen.weights(radius)
        estimate = estimate + weights @ one.flux[seen.rows]
        found = np.pi * radius**2 * weights.sum()
        share = (kept + settings.alpha * found) / (kept + found) if found > 0.0 else 1.0
        kept = (kept + found) * share
        radius *= np.sqrt(share)
    return estimate


@pytest.mark.parametrize("edges", FOOTPRINTS.values(), ids=FOOTPRINTS)
def test_means_equal_their_definition(edges):
    photons, where = uneven(), places()
    every = np.broadcast_to(edges, (40, 2, 3))
    field = pr.irradiance_field(photons, method="progressive", progressive=SETTINGS)
    expected = [by_definition(photons, *each, edges) for each in zip(*where, strict=True)]
    np.testing.assert_allclose(field(*where, footprint=every), expected, rtol=1e-9)


def test_discs_of_a_given_size():
    photons, where = uneven(), places()
    fixed = pr.ProgressiveSettings(n_passes=1, radius=0.03)
    field = pr.irradiance_field(photons, method="progressive", progressive=fixed)
    found = field(*where, footprint=np.full(40, 0.05))
    seen = [around(photons, *each, square(0.05)) for each in zip(*where, strict=True)]
    expected = [one.weights(0.03) @ photons.flux[one.rows] for one in seen]
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_photons_that_coincide_are_counted_one_by_one():
    """Numbers and sums of a pass: of three times as many photons of a third of the flux."""
    photons = uneven(500)
    rows = np.random.default_rng(0).permutation(np.repeat(np.arange(500), 3))
    thirds = photons.subset(rows)
    radius, footprint = np.full(40, 0.05), np.full(40, 0.1)
    counts, sums = (
        PhotonPass(PhotonTrees(some, 1), some.flux, 1).within(places(), radius, footprint=footprint)
        for some in (photons, thirds)
    )
    np.testing.assert_allclose(sums[0], 3.0 * counts[0])
    np.testing.assert_allclose(sums[1], 3.0 * counts[1])


SIZES = [0.1, 0.6, 2.5, 10.0, 100.0]


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("kind", ["random", "halton"])
def test_a_uniform_field_returns_its_own_value(kind):
    """Over 0.1 … 100 photons of the map, of which passes have an eighth."""
    means = np.empty((12, len(SIZES)))
    for seed, row in enumerate(means):
        field = pr.irradiance_field(endless_map(10_000, kind, seed, 0.2), method="progressive")
        points, normals = even_points(610, 1000 + seed)
        for i, size in enumerate(SIZES):
            footprint = np.full(len(points), np.sqrt(size / 10_000))
            row[i] = field(points, normals, footprint=footprint)[:, 0].mean()
    error = means.std(axis=0) / np.sqrt(len(means) - 1)
    assert (np.abs(means.mean(axis=0) - 1.0) < 2e-3 + 3 * error).all()


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("texels", [40, 150, 500])
def test_a_partition_of_the_plane_has_the_whole_flux(texels):
    xy = unit_square(100_000, "random")
    xy = xy + 0.06 * np.sin(9 * xy[:, ::-1]) * np.sin(11 * xy)
    side = 1.5 / texels
    middle = np.linspace(-0.25, 1.25, texels + 1)[:-1] + side / 2
    points, normals = plane(np.stack(np.meshgrid(middle, middle), -1).reshape(-1, 2))
    field = pr.irradiance_field(flat_map(xy, 100_000), method="progressive")
    means = field(points, normals, footprint=np.full(texels**2, side))
    assert means[:, 0].sum() * side**2 == pytest.approx(1.0, rel=5e-3)


def test_passes_converge_to_the_mean_over_the_footprint():
    """Pixels on the edge of the light, to the share of them that is lit; points do to 0 or 1."""
    share = np.array([0.2, 0.5, 0.9])
    x = 0.5 + 0.1 * (0.5 - share)
    y = np.linspace(0.3, 0.7, 200)
    points, normals = plane(np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2))
    footprint = np.full(600, 0.1)
    errors, statistics = {}, None
    for number in range(128):
        xy = unit_square(2000, "random", number)
        photons = flat_map(xy[xy[:, 0] < 0.5], 2000)
        if statistics is None:
            start = InitialRadius(photons, pr.ProgressiveSettings(k=20), 1)
            statistics = HitPointStatistics(
                start(points, normals, footprint), 3, alpha=0.7, n_threads=1
            )
        gathered = PhotonPass(PhotonTrees(photons, 1), photons.flux, 1)
        found = gathered.within((points, normals), statistics.radius, footprint=footprint)
        statistics.update(*found, 1.0)
        means = statistics.densities()[:, 0].reshape(3, 200).mean(axis=1)
        errors[number + 1] = np.abs(means - share).max()
    assert errors[128] < 0.65 * errors[8] < 0.04


def test_discs_shrink_as_at_points():
    """R² ~ i^(α - 1), whatever the footprint holds."""
    points, normals = plane(np.random.default_rng(0).uniform(0.3, 0.7, (300, 2)))
    footprint = 10 ** np.random.default_rng(1).uniform(-3, -1, 300)
    statistics = HitPointStatistics(np.full(300, 0.05), 3, alpha=0.7, n_threads=1)
    radii = {}
    for number in range(1, 65):
        photons = uniform_map(2000, "random", number)
        gathered = PhotonPass(PhotonTrees(photons, 1), photons.flux, 1)
        found = gathered.within((points, normals), statistics.radius, footprint=footprint)
        statistics.update(*found, 1.0)
        radii[number] = (statistics.radius**2).mean()
    slope = np.log(radii[64] / radii[4]) / np.log(16)
    assert slope == pytest.approx(0.7 - 1.0, abs=0.02)


def test_same_bits_for_every_number_of_threads():
    rng = np.random.default_rng(3)
    edges = 10 ** rng.uniform(-5, -1, (300, 1, 1)) * rng.normal(size=(300, 2, 3))
    one, *others = (
        pr.irradiance_field(uneven(20_000), method="progressive", n_threads=n)(
            *places(300), footprint=edges
        )
        for n in (1, 2, 7)
    )
    for other in others:
        np.testing.assert_array_equal(one, other)


def test_an_empty_map_is_black():
    field = pr.irradiance_field(uneven(20).subset([]), method="progressive")
    np.testing.assert_array_equal(field(*places(3), footprint=np.ones(3)), np.zeros((3, 3)))
