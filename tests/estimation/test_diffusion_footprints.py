"""Diffusion over footprints: by definition, kernels, known fields, what must not matter."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr

import photonrelax as pr
from photonrelax.estimation.diffusion import DiffusionField
from photonrelax.estimation.footprint import kernel_integral
from tests.estimation.test_diffusion import CASES, gradients, kernels, landed
from tests.helpers import simd_paths
from tests.helpers.diffusion_maps import FIXED, LOCAL, METHODS, rotation, steep_map, turned
from tests.helpers.footprint_rule import (
    DEVIATION,
    FOOTPRINTS,
    around,
    profile,
    radius_of,
    rectangle,
)
from tests.helpers.photon_maps import endless_map, even_points, flat_map, plane, unit_square

# --- the definition ---------------------------------------------------------------------------


def bandwidth_over(photons, point, normal, edges, settings):
    """That of the rule, just short of a photon, or the largest."""
    if settings.k is None:
        return settings.bandwidth
    seen = around(photons, point, normal, edges)
    radius, _ = radius_of(seen.squared, seen.sides, settings.k, settings.bandwidth)
    return (1 - 1e-9) * radius if radius < settings.bandwidth else radius


def squared_distance(offset, sides, tensor):
    """From the rectangle in the metric of the inverse of a tensor: that from its four edges."""
    root = np.linalg.inv(np.linalg.cholesky(tensor))
    inside = (np.abs(offset) <= sides / 2).all(axis=1)
    least = np.where(inside, 0.0, np.inf)
    for axis in range(2):
        along = root @ (np.eye(2)[axis] * sides[axis])
        for middle in (-0.5, 0.5):
            apart = offset @ root.T - root @ (np.eye(2)[1 - axis] * sides[1 - axis] * middle)
            share = np.clip(apart @ along / max(along @ along, 1e-300), -0.5, 0.5)
            least = np.minimum(least, np.square(apart - np.outer(share, along)).sum(axis=1))
    return np.where(inside, 0.0, least)


def mean_gaussian(offset, sides, tensor, n_nodes=None):
    """Mean over a rectangle, the shorter side first, of the Gaussian of covariance (0.41)² D."""
    covariance = DEVIATION**2 * tensor
    if n_nodes is None:
        least = np.sqrt(np.linalg.det(covariance) / covariance[1, 1])
        n_nodes = min(3 + int(sides[0] / (0.95 * least)), 8)
    nodes, weights = np.polynomial.legendre.leggauss(n_nodes)
    first = offset[:, :1] - sides[0] / 2 * nodes
    second = offset[:, 1:] - covariance[0, 1] / covariance[0, 0] * first
    deviation = np.sqrt(np.linalg.det(covariance) / covariance[0, 0])
    density = profile(second, sides[1], deviation)
    density = density * profile(first, 0.0, np.sqrt(covariance[0, 0]))
    return density @ (weights / 2)


def kernel(offset, sides, tensor):
    """Weights at offsets, all in bandwidths."""
    within = squared_distance(offset, sides, tensor) <= 1.0
    values, vectors = np.linalg.eigh(tensor)
    edges = np.diag(sides) @ vectors / np.sqrt(values)
    whole = kernel_integral(*np.linalg.svd(edges)[1])
    weights = np.zeros(len(offset))
    weights[within] = mean_gaussian(offset[within], sides, tensor) / whole
    return weights


def one_by_definition(photons, slopes, where, settings, *, largest, isotropic):
    point, normal, edges = where
    h = bandwidth_over(photons, point, normal, edges, settings)
    axes, sides = rectangle(edges, normal, skewed=False)
    if sides.max() >= 2 * h:
        seen = around(photons, point, normal, edges)
        return seen.weights(h) @ photons.flux[seen.rows]
    order = np.argsort(sides, kind="stable")
    axes, sides = axes[order], sides[order] / h
    fixed = replace(settings, k=None, bandwidth=h)
    _, _, _, tensor, irradiance = next(kernels(photons, slopes, [point], [normal], fixed))
    values, vectors = np.linalg.eigh(axes @ tensor @ axes.T)
    edge = values[1] / (largest or (irradiance / h) ** 2)
    across = 1 / (1 + (edge / settings.edge_threshold) ** (1 + settings.edge_steepness))
    across = max(across, settings.least_eigenvalue, sides[1] ** 2 / 4)
    along = across if isotropic else 1.0
    diffusion = vectors @ np.diag([along, across]) @ vectors.T
    offset, lands = landed(photons, point, normal)
    apart = np.linalg.norm(photons.position - point, axis=1) / h
    lands &= apart <= 1 + np.hypot(*sides) / 2
    return lands * kernel(offset @ axes.T / h, sides, diffusion) @ photons.flux / h**2


def bent(flat):
    height, slope = 0.3 * flat.position[:, 0] ** 2, 0.6 * flat.position[:, 0]
    return flat.replace(
        position=flat.position + np.column_stack([0 * height, 0 * height, height]),
        normal=np.column_stack([-slope, 0 * slope, np.ones_like(slope)]),
    )


@pytest.mark.parametrize("settings", CASES)
def test_means_equal_their_definition(settings):
    """Of footprints of all shapes, on a plane and on a bent surface.

    But for squares, of whose sides the shorter is up to rounding.
    """
    q, edges = rotation(), np.array(list(FOOTPRINTS.values())) * [[[0.97], [0.99]]]
    for photons in (turned(steep_map(500), q), turned(bent(steep_map(500)), q)):
        rows = np.arange(0, 500, 500 // len(edges))[: len(edges)]
        where = photons.position[rows] + 0.01 * photons.wi[rows], photons.normal[rows], edges @ q.T
        slopes, largest = gradients(photons, settings)
        for isotropic in (False, True):
            how = {"largest": largest, "isotropic": isotropic}
            expected = [
                one_by_definition(photons, slopes, each, settings, **how)
                for each in zip(*where, strict=True)
            ]
            field = DiffusionField(photons, settings, isotropic=isotropic)
            found = field(*where[:2], footprint=where[2])
            np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


# --- kernels ----------------------------------------------------------------------------------


def tensors(n=200, seed=0):
    """Sides, in bandwidths, and diffusion tensors as narrow as these allow."""
    rng = np.random.default_rng(seed)
    for _ in range(n):
        sides = np.sort(rng.uniform(0.0, 2.0) * np.array([1.0, 10 ** rng.uniform(-2, 0)]))
        across = rng.uniform(max(sides[1] ** 2 / 4, 0.01), 1.0) if rng.random() < 0.5 else 0.0
        across = max(across, sides[1] ** 2 / 4, 0.01)
        angle = rng.uniform(0, np.pi)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        yield sides, turn @ np.diag([1.0, across]) @ turn.T


@pytest.mark.kernels_run_elsewhere
def test_so_few_nodes_suffice():
    """Along the first side, within 5e-5 of the peak."""
    # Kernels are the same on both sides of their middle.
    grid = np.linspace(-2, 2, 41)
    offset = np.stack(np.meshgrid(grid, grid[20:]), -1).reshape(-1, 2)
    for sides, tensor in tensors():
        found, exact = (mean_gaussian(offset, sides, tensor, n) for n in (None, 40))
        np.testing.assert_allclose(found, exact, atol=5e-5 * exact.max())


@pytest.mark.kernels_run_elsewhere
def test_every_kernel_integrates_to_one():
    """Within 0.4 %: that of an oblique parallelogram is taken for that of a rectangle."""
    ticks = np.linspace(-2.2, 2.2, 221)
    offset = np.stack(np.meshgrid(ticks, ticks), -1).reshape(-1, 2)
    cell = (ticks[1] - ticks[0]) ** 2
    sums = [cell * kernel(offset, *each).sum() for each in tensors(60)]
    np.testing.assert_allclose(sums, 1.0, atol=4e-3)


# --- continuity -------------------------------------------------------------------------------


@pytest.mark.parametrize("isotropic", [False, True])
def test_means_are_continuous_where_kernels_lose_their_shape(isotropic):
    """At sides of two bandwidths, where they are the means of the rule."""
    photons, (points, normals) = steep_map(4000), plane(unit_square(200, "random", 7))
    field = DiffusionField(photons, FIXED, isotropic=isotropic)
    for shape in ([1.0, 1.0], [0.05, 1.0]):
        edges = 2 * FIXED.bandwidth * np.diag([*shape, 0.0])[:2]
        below, above = (
            field(points, normals, footprint=np.broadcast_to(scale * edges, (200, 2, 3)))
            for scale in (1 - 1e-7, 1 + 1e-7)
        )
        np.testing.assert_allclose(below, above, rtol=2e-5, atol=1e-6 * above.max())


def test_footprints_that_shrink_have_the_estimate_of_a_gaussian_at_the_point():
    photons, (points, normals) = steep_map(4000), plane(unit_square(200, "random", 7))
    never = pr.DiffusionSettings(k=60, bandwidth=0.2, edge_threshold=np.inf)
    gather = pr.GatherSettings(k=60, kernel="gaussian", gather_radius=0.2)
    expected = pr.IrradianceField(photons.replace(wi=None), gather)(points, normals)
    for side in (0.0, 1e-9):
        field = DiffusionField(photons.replace(wi=None), never)
        found = field(points, normals, footprint=np.full(200, side))
        np.testing.assert_allclose(found, expected, rtol=1e-6)
    for settings in (FIXED, LOCAL):
        field = DiffusionField(photons, settings)
        sides = (0.0, 1e-8, 1e-6)
        none, *tiny = (field(points, normals, footprint=np.full(200, side)) for side in sides)
        for one in tiny:
            np.testing.assert_allclose(one, none, rtol=1e-3)


# --- fields that are known ---------------------------------------------------------------------


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", ["random", "halton"])
def test_a_uniform_field_returns_its_own_value(method, kind):
    n = 10_000
    photons, (points, normals) = endless_map(n, kind), even_points(610, 1000)
    for settings in (None, replace(LOCAL, bandwidth=0.16)):
        field = pr.irradiance_field(photons, method=method, diffusion=settings)
        for size in (0.1, 1.0, 10.0, 100.0):
            means = field(points, normals, footprint=np.full(len(points), np.sqrt(size / n)))
            assert means.mean() == pytest.approx(1.0, abs=5e-3)


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("texels", [30, 150])
def test_energy_is_kept(method, texels):
    """A disc of light, its edge and all, and a map of it."""
    xy = unit_square(60_000, "random")
    photons = flat_map(xy[np.linalg.norm(xy - 0.5, axis=1) < 0.35], 60_000)
    middle = (np.arange(texels) + 0.5) / texels
    points, normals = plane(np.stack(np.meshgrid(middle, middle), -1).reshape(-1, 2))
    field = pr.irradiance_field(photons, method=method)
    means = field(points, normals, footprint=np.full(texels**2, 1 / texels))[:, 0]
    assert means.mean() == pytest.approx(photons.flux[:, 0].sum(), rel=0.01)


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("angle", [0.0, 0.3, np.pi / 4])
def test_edges_stay_as_sharp_as_pixels(angle):
    """Pixels on the edge of half a plane of light, in any direction, have the share lit of them."""
    xy = unit_square(200_000, "halton")
    across = np.array([np.cos(angle), np.sin(angle)])
    photons = flat_map(xy[(xy - 0.5) @ across < 0.0], 200_000)
    offset = np.linspace(-0.06, 0.06, 61)
    points, normals = plane(0.5 + np.outer(offset, across))
    side, field = 0.02, pr.irradiance_field(photons, method="diffusion")
    found = field(points, normals, footprint=np.full(61, side))[:, 0]
    # The Gaussian's deviation is at least 0.41 · ½ sides.
    width = np.hypot(0.205 * side, side / np.sqrt(12))
    np.testing.assert_allclose(found, ndtr(-offset / width), atol=0.06)


# --- what must not matter ----------------------------------------------------------------------


def varied(n=300):
    rng = np.random.default_rng(3)
    return 10 ** rng.uniform(-5, -1, (n, 1, 1)) * rng.normal(size=(n, 2, 3))


def means(photons, method, settings=LOCAL, n_threads=None):
    field = pr.irradiance_field(photons, method=method, diffusion=settings, n_threads=n_threads)
    return field(*plane(unit_square(300, "random", 7)), footprint=varied())


@pytest.mark.parametrize("method", METHODS)
def test_same_bits_for_every_number_of_threads(method):
    one, *others = (means(steep_map(4000), method, n_threads=n) for n in (1, 2, 7))
    for other in others:
        np.testing.assert_array_equal(one, other)


@simd_paths.each("path")
def test_instruction_sets_do_not_matter(path):
    with simd_paths.forced("portable"):
        expected = means(steep_map(4000), "diffusion")
    with simd_paths.forced(path):
        np.testing.assert_array_equal(means(steep_map(4000), "diffusion"), expected)


@pytest.mark.parametrize("method", METHODS)
def test_rotation_place_and_unit_do_not_matter(method):
    photons, (points, normals) = steep_map(4000), plane(unit_square(300, "random", 7))
    q, scale, shift = rotation(2), 250.0, np.array([30.0, -4.0, 9.0])
    scaled = replace(LOCAL, bandwidth=scale * LOCAL.bandwidth)
    field = pr.irradiance_field(turned(photons, q, scale, shift), method=method, diffusion=scaled)
    found = field(scale * points @ q.T + shift, normals @ q.T, footprint=scale * varied() @ q.T)
    np.testing.assert_allclose(scale**2 * found, means(photons, method), rtol=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_maps_with_next_to_nothing(method):
    points, normals = plane(np.array([[0.5, 0.5], [9.0, 9.0]]))
    for side in (0.0, 0.05, 1.0):
        footprint = np.full(2, side)
        empty = pr.irradiance_field(flat_map(np.empty((0, 2)), 1), method=method)
        assert (empty(points, normals, footprint=footprint) == 0.0).all()
        for n in (1, 5):
            few = flat_map(unit_square(n, "random"), n)
            found = pr.irradiance_field(few, method=method, diffusion=FIXED)(
                points, normals, footprint=footprint
            )
            assert np.isfinite(found).all()
            assert (found[1] == 0.0).all()


def test_a_single_photon_over_the_point_has_the_weight_of_the_middle():
    """Of a fixed bandwidth: a square of it."""
    photons = flat_map(np.array([[0.5, 0.5]]), 1)
    field = pr.irradiance_field(photons, method="diffusion", diffusion=FIXED)
    found = field(*plane(np.array([[0.5, 0.5]])), footprint=np.array([0.1]))[0, 0]
    peak = profile(np.zeros(1), 1.0, DEVIATION)[0] ** 2 / kernel_integral(1.0, 1.0)
    assert found == pytest.approx(peak / 0.1**2, rel=1e-4)
