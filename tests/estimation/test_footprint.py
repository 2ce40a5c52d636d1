"""Means over footprints: the rule by definition, uniform fields, invariants, what is refused."""

import itertools

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from photonrelax._ext.spatial.blocks import to_soa_blocks
from photonrelax._ext.spatial.node_sums import node_sums
from scipy.integrate import dblquad

import photonrelax as pr
from photonrelax._ext.estimation import footprint as kernel
from photonrelax.estimation.footprint import (
    Footprints,
    kernel_integral,
    kernel_integrals,
    rule_radii,
)
from photonrelax.spatial.kdtree import KDTree
from tests.helpers import simd_paths
from tests.helpers.footprint_rule import (
    DEVIATION,
    FOOTPRINTS,
    TURN,
    around,
    places,
    profile,
    radius_of,
    rectangle,
    square,
    uneven,
)
from tests.helpers.photon_maps import (
    endless_map,
    even_points,
    flat_map,
    mean_irradiance,
    plane,
    uniform_map,
    unit_square,
)

# The rule by definition, one footprint at a time


def by_definition(photons, point, normal, edges, gather):
    seen = around(photons, point, normal, edges)
    radius, at_photon = radius_of(seen.squared, seen.sides, gather.k, gather.gather_radius)
    if not np.isfinite(radius):
        return np.zeros(3)
    return seen.weights(radius, with_rim=not at_photon) @ photons.flux[seen.rows]


def assert_is_by_definition(photons, where, edges, gather=None):
    points, normals = where
    gather = gather or pr.GatherSettings(gather_radius=np.inf)
    edges = np.broadcast_to(edges, (len(points), 2, 3))
    field = pr.IrradianceField(photons, gather)
    found = field(points, normals, footprint=edges)
    expected = [
        by_definition(photons, *each, gather) for each in zip(points, normals, edges, strict=True)
    ]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-300)


@pytest.mark.parametrize("edges", FOOTPRINTS.values(), ids=FOOTPRINTS)
@pytest.mark.parametrize("gather_radius", [np.inf, 0.05])
@pytest.mark.parametrize("k", [8, 15])
def test_means_equal_their_definition(edges, gather_radius, k):
    gather = pr.GatherSettings(k=k, gather_radius=gather_radius)
    assert_is_by_definition(uneven(), places(), edges, gather)


def test_a_map_of_few_photons():
    for n in (1, 2, 14, 15, 16, 40):
        for edges in (square(0.0), square(0.2), square(3.0)):
            for radius in (0.3, np.inf):
                gather = pr.GatherSettings(gather_radius=radius)
                assert_is_by_definition(uneven(n), places(10), edges, gather)


def test_an_empty_map_is_black():
    field = pr.IrradianceField(uneven(20).subset(np.zeros(20, dtype=bool)))
    np.testing.assert_array_equal(field(*places(3), footprint=np.ones(3)), np.zeros((3, 3)))


def test_thousands_of_photons_on_a_large_footprint():
    assert_is_by_definition(uneven(100_000), places(10), 0.4 * TURN)


def test_the_same_photons_for_any_side_of_squares():
    """Axes of squares given by their side are those of edges along them: x and y on a floor."""
    field = pr.IrradianceField(uneven())
    side = np.linspace(0.0, 0.3, 40)
    of_sides = field(*places(), footprint=side)
    of_edges = field(*places(), footprint=side[:, np.newaxis, np.newaxis] * np.eye(3)[:2])
    np.testing.assert_allclose(of_sides, of_edges, rtol=1e-13)


def on_sphere(n, seed=0):
    rng = np.random.default_rng(seed)
    position = rng.normal(size=(n, 3))
    position /= np.linalg.norm(position, axis=1, keepdims=True)
    return position, rng.random((n, 3))


def test_curved_receivers():
    """Normals on axes of the tree; edges in space, of any length of normals."""
    position, flux = on_sphere(5000)
    photons = pr.PhotonMap(position, position, flux)
    points, _ = on_sphere(30, seed=1)
    for size in (0.01, 0.2, 1.5):
        edges = size * np.random.default_rng(2).normal(size=(30, 2, 3))
        assert_is_by_definition(photons, (points, 3.0 * points), edges)


def test_photons_of_a_curved_surface_under_a_wide_footprint_count():
    """The mean over a cap is the flux on the footprint over its area."""
    position, _ = on_sphere(200_000)
    photons = pr.PhotonMap(position, position, np.full(len(position), 4 * np.pi / len(position)))
    field = pr.IrradianceField(photons)
    top = np.array([[0.0, 0.0, 1.0]])
    found = field(top, top, footprint=np.array([0.8]))[0, 0]
    on_it = (np.abs(position[:, :2]) < 0.4).all(axis=1) & (position[:, 2] > 0)
    assert found == pytest.approx(on_it.sum() * photons.flux[0, 0] / 0.8**2, rel=3e-3)


def test_several_sets_of_faces():
    """A floor, a wall and a slope of 45°, which sees both."""
    rng = np.random.default_rng(0)
    normals = np.array([[0, 0, 1], [1, 0, 0], [np.sqrt(0.5), 0, np.sqrt(0.5)]])
    face = rng.integers(0, 3, 6000)
    position = np.einsum(
        "ni,nij->nj",
        rng.random((6000, 3)),
        np.eye(3) - normals[face][..., None] * normals[face][:, None],
    )
    photons = pr.PhotonMap(position, normals[face], rng.random((6000, 3)))
    rows = rng.integers(0, 6000, 60)
    edges = 0.1 * rng.normal(size=(60, 2, 3))
    assert_is_by_definition(photons, (position[rows], photons.normal[rows]), edges)


@example(edges=[0.0, 1e-127, 0.0, 0.0, 0.0, 0.0], scale=0, n=1, k=2)
@settings(max_examples=60, deadline=None)
@given(
    edges=st.lists(st.floats(-3, 3, allow_subnormal=False), min_size=6, max_size=6),
    scale=st.integers(-6, 0),
    n=st.integers(1, 300),
    k=st.integers(2, 40),
)
def test_any_parallelogram_on_any_map(edges, scale, n, k):
    edges = 10.0**scale * np.reshape(edges, (2, 3))
    gather = pr.GatherSettings(k=k, gather_radius=0.5)
    _, sides = rectangle(edges, np.array([0.0, 0.0, 1.0]))
    # On the border the axes of either case are right.
    if abs(sides[0] / max(sides[1], 1e-300) - 1.5) > 1e-6:
        assert_is_by_definition(uneven(n, seed=k), places(5, seed=n), edges, gather)


@pytest.mark.parametrize("degrees", [60, 75, 90, 105, 120])
@pytest.mark.parametrize("ratio", [1.0, 3.0])
def test_a_parallelogram_has_all_light_in_its_corners_and_none_beside_them(degrees, ratio):
    """A focus far smaller than the footprint, 5 % of its edges inside and outside of a corner."""
    angle = np.radians(degrees)
    edges = np.array([[1.0, 0.0, 0.0], [ratio * np.cos(angle), ratio * np.sin(angle), 0.0]])
    focus = 1e-4 * np.random.default_rng(2).random((500, 2))
    photons = flat_map(focus, 500)
    corners = np.array([[s, t] for s in (-0.5, 0.5) for t in (-0.5, 0.5)])
    for share, expected in ((0.9, photons.flux.sum(axis=0) / (ratio * np.sin(angle))), (1.1, 0.0)):
        points = photons.position.mean(axis=0) - share * corners @ edges
        footprints = np.broadcast_to(edges, (4, 2, 3))
        gather = pr.GatherSettings(gather_radius=1e-3)
        field = pr.irradiance_field(photons, method="standard", gather=gather)
        means = field(points, np.broadcast_to([0.0, 0.0, 1.0], (4, 3)), footprint=footprints)
        np.testing.assert_allclose(means, np.broadcast_to(expected, (4, 3)), rtol=1e-5)


def test_coincident_photons_count_once_with_the_flux_of_all():
    photons = uneven(3000)
    rows = np.random.default_rng(0).permutation(np.repeat(np.arange(3000), 3))
    parts = photons.subset(rows)
    parts = parts.replace(flux=parts.flux / 3)
    for side in (0.0, 0.02, 0.5):
        where, footprint = places(), np.full(40, side)
        gather = pr.GatherSettings(gather_radius=0.1)
        whole = pr.IrradianceField(photons, gather)(*where, footprint=footprint)
        found = pr.IrradianceField(parts, gather)(*where, footprint=footprint)
        np.testing.assert_allclose(found, whole, rtol=1e-12)


def test_photons_at_one_distance_of_the_point():
    """Thousands on a circle: they set the radius together, and none counts."""
    angle = 2 * np.pi * np.arange(5000) / 5000
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    inside = 0.3 * unit_square(5, "random")
    photons = flat_map(np.concatenate([circle, inside]), 1)
    field = pr.IrradianceField(photons, pr.GatherSettings(gather_radius=np.inf))
    found = field(*plane(np.zeros((1, 2))), footprint=np.zeros(1))[0, 0]
    squared = np.square(inside).sum(axis=1)
    peak = 1 / (2 * np.pi * DEVIATION**2 * (1 - np.exp(-0.5 / DEVIATION**2)))
    rim = np.exp(-0.5 / DEVIATION**2)
    few = peak * np.exp(-0.5 * squared / DEVIATION**2).sum()
    # Rounding tells the distances apart.
    assert few * (1 - 1e-9) <= found <= few + 5000 * peak * rim


def test_all_photons_at_the_point():
    """As at points: the radius is the gather radius."""
    up = np.random.default_rng(0).normal(size=(100, 3)) * 0.1 + [0, 0, 1]
    photons = pr.PhotonMap(np.zeros((100, 3)), up, np.ones((100, 3)))
    field = pr.IrradianceField(photons, pr.GatherSettings(gather_radius=0.5))
    found = field([[0, 0, 0]], [[0, 0, 1]], footprint=[0.0])
    peak = 1 / (2 * np.pi * (0.5 * DEVIATION) ** 2 * (1 - np.exp(-0.5 / DEVIATION**2)))
    np.testing.assert_allclose(found, 100 * peak)


# Radii alone, and densities of given radii


def flat_tree(photons):
    return KDTree(photons.position, n_metric=3)


@pytest.mark.parametrize("edges", FOOTPRINTS.values(), ids=FOOTPRINTS)
@pytest.mark.parametrize("largest", [np.inf, 0.05])
def test_radii_equal_their_definition(edges, largest):
    photons, (points, normals) = uneven(), places()
    every = np.broadcast_to(edges, (40, 2, 3)).copy()
    footprints = Footprints(points, normals, every, np.arange(40))
    found = rule_radii(flat_tree(photons), footprints, 8, largest=largest, n_threads=2)
    for radius, point in zip(found, points, strict=True):
        seen = around(photons, point, normals[0], edges)
        expected, _ = radius_of(seen.squared, seen.sides, 8, largest)
        assert radius == pytest.approx(expected, rel=1e-12)


def test_radii_of_some_rows_and_of_maps_with_next_to_nothing():
    points, normals = places(3)
    some = Footprints(points, normals, np.zeros(3), np.array([2, 0]))
    found = rule_radii(flat_tree(uneven()), some, 3, largest=1.0, n_threads=1)
    distance = pr.KDTree(uneven().position).query(points[[2, 0]], 3).distance
    np.testing.assert_allclose(found, distance[:, 2])
    empty, one = uneven(20).subset([]), uneven(1)
    for photons in (empty, one):
        found = rule_radii(flat_tree(photons), some, 3, largest=0.7, n_threads=1)
        np.testing.assert_array_equal(found, 0.7)
    here = flat_map(np.tile(points[0, :2], (5, 1)), 1)
    assert rule_radii(flat_tree(here), some, 3, largest=0.7, n_threads=1)[1] == 0.0


def densities_within(photons, footprint, radius, n_threads=1):
    """Densities of the flux at `places`, by the kernel."""
    tree = flat_tree(photons)
    values = to_soa_blocks(photons.flux, np.asarray(tree.kernel.ids), 1)
    points, normals = places(len(radius))
    out = np.full((len(radius), 3), np.nan)
    kernel.gather_within(
        *(tree.kernel, values, points, np.arange(len(radius)), out),
        normals=normals,
        sums=node_sums(tree.kernel, values, 1),
        footprint=footprint,
        integrals=kernel_integrals(),
        radius=radius,
        range_radius=-1.0,
        n_threads=n_threads,
    )
    return out


@pytest.mark.parametrize("edges", FOOTPRINTS.values(), ids=FOOTPRINTS)
def test_densities_of_given_radii_equal_their_definition(edges):
    photons, (points, normals) = uneven(), places()
    radius = 10 ** np.random.default_rng(5).uniform(-4, 0, 40)
    found = densities_within(photons, np.broadcast_to(edges, (40, 2, 3)).copy(), radius)
    for density, point, r in zip(found, points, radius, strict=True):
        seen = around(photons, point, normals[0], edges)
        expected = seen.weights(r) @ photons.flux[seen.rows]
        np.testing.assert_allclose(density, expected, rtol=1e-9)


def test_photons_at_a_given_radius_count():
    photons = flat_map(places()[0][:1, :2] + [0.25, 0.0], 1)
    radius = np.abs(photons.position[0, 0] - places()[0][0, 0])
    assert densities_within(photons, np.zeros(1), np.array([radius]))[0, 0] > 0.0
    assert densities_within(photons, np.zeros(1), np.nextafter([radius], 0.0))[0, 0] == 0.0


def test_given_radii_do_not_depend_on_threads_and_other_footprints():
    photons, sides = uneven(20_000), 10 ** np.random.default_rng(6).uniform(-4, 0, 300)
    radius = 0.3 * sides[::-1].copy()
    one, many = (densities_within(photons, sides, radius, n) for n in (1, 7))
    np.testing.assert_array_equal(one, many)
    fewer = densities_within(photons, sides[:1], radius[:1])
    np.testing.assert_array_equal(fewer[0], one[0])


def test_sides_are_those_of_rectangles():
    edges = np.array(list(FOOTPRINTS.values()))
    normals = np.tile([0.0, 0.0, 3.0], (len(edges), 1))
    up = np.array([0.0, 0.0, 1.0])
    expected = [rectangle(one, up, skewed=False)[1] for one in edges]
    found = kernel.rectangle_sides(normals, edges)
    np.testing.assert_allclose(np.sort(found), np.sort(expected), rtol=1e-9, atol=1e-15)
    sides = kernel.rectangle_sides(normals[:2], np.array([0.5, 2.0]))
    np.testing.assert_array_equal(sides, [[0.5, 0.5], [2.0, 2.0]])


# The integral of the kernel


@pytest.mark.parametrize("sides", [(0.0, 0.0), (1e-5, 0.3), (0.7, 1.3), (4.0, 0.1), (3.0, 8.0)])
def test_the_kernel_integrates_to_one(sides):
    def weight(y, x):
        return profile(np.array(x), sides[0], DEVIATION) * profile(np.array(y), sides[1], DEVIATION)

    def reach(x):
        return 0.5 * sides[1] + np.sqrt(max(0.0, 1 - max(0.0, x - 0.5 * sides[0]) ** 2))

    parts = [0.0, 0.5 * sides[0], 0.5 * sides[0] + 1.0]
    total = sum(
        4 * dblquad(weight, low, high, 0.0, reach, epsabs=1e-10)[0]
        for low, high in itertools.pairwise(parts)
        if high > low
    )
    assert kernel_integral(*sides) == pytest.approx(total, abs=1e-9)


def test_the_table_of_integrals_is_fine_enough():
    """Footprints of all shapes over a single photon at their centre, within a radius of one."""
    rng = np.random.default_rng(0)
    sides = 10 ** rng.uniform(-3, 3, (300, 2))
    photons = flat_map(np.zeros((1, 2)), 1)
    field = pr.IrradianceField(photons, pr.GatherSettings(gather_radius=1.0))
    edges = np.zeros((300, 2, 3))
    edges[:, 0, 0], edges[:, 1, 1] = sides.T
    found = field(*plane(np.zeros((300, 2))), footprint=edges)[:, 0]
    peak = [np.prod([profile(np.zeros(1), s, DEVIATION) for s in pair]) for pair in sides]
    np.testing.assert_allclose(found, peak / kernel_integral(*sides.T), rtol=1e-9)


# Points


@pytest.mark.parametrize("well_spaced", [False, True])
@pytest.mark.parametrize("k", [2, 15, 50])
def test_a_footprint_that_shrinks_to_a_point_has_the_estimate_there(k, well_spaced):
    photons = uneven().replace(well_spaced=well_spaced)
    gather = pr.GatherSettings(k=k, kernel="gaussian")
    field = pr.IrradianceField(photons, gather)
    where = places(200)
    tiny = field(*where, footprint=np.full(200, 1e-9 / np.sqrt(len(photons))))
    np.testing.assert_allclose(field(*where), tiny, rtol=1e-6)
    np.testing.assert_allclose(field(*where), field(*where, footprint=np.zeros(200)), rtol=1e-13)


@pytest.mark.parametrize("kernel", ["constant", "cone", "epanechnikov"])
def test_the_kernel_at_points_does_not_matter_to_footprints(kernel):
    footprint = np.full(40, 0.02)
    fields = [
        pr.IrradianceField(uneven(), pr.GatherSettings(kernel=k)) for k in (kernel, "gaussian")
    ]
    one, other = (field(*places(), footprint=footprint) for field in fields)
    np.testing.assert_array_equal(one, other)


# Uniform light


SIZES = [0.0, 0.1, 0.6, 2.5, 10.0, 100.0]


@pytest.fixture(scope="module")
def uniform_maps():
    """Maps of 1 W/m²: several where chance or the part of the sequence matters."""
    halton = [uniform_map(100_000, "halton", seed) for seed in range(3)]
    return {
        "random": [endless_map(10_000, "random", seed) for seed in range(16)],
        "halton": [endless_map(10_000, "halton", seed) for seed in range(12)],
        "relaxed": [pr.relax(one, pr.detect_structure(one)) for one in halton],
    }


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize(("kind", "side"), [("random", 1.0), ("halton", 1.0), ("relaxed", 0.5)])
@pytest.mark.parametrize("k", [8, 15, 50])
def test_a_uniform_field_returns_its_own_value(kind, side, k, uniform_maps):
    """At points and over 0.1 … 100 photons, squares and 10 : 1 and 100 : 1, turned at random."""
    shapes = [(size, 1) for size in SIZES] + [(size, 10) for size in SIZES[2:]]
    shapes += [(size, 100) for size in SIZES[3:]]
    means = np.empty((len(uniform_maps[kind]), len(shapes)))
    for seed, photons in enumerate(uniform_maps[kind]):
        points, normals = even_points(round(610 / side**2), 1000 + seed, side)
        angle = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(points))
        axes = np.zeros((len(points), 2, 3))
        axes[:, 0, 0] = axes[:, 1, 1] = np.cos(angle)
        axes[:, 0, 1] = np.sin(angle)
        axes[:, 1, 0] = -axes[:, 0, 1]
        exact = mean_irradiance(photons, side)
        field = pr.IrradianceField(photons, pr.GatherSettings(k=k))
        for i, (size, ratio) in enumerate(shapes):
            edges = np.sqrt([size * ratio, size / ratio]) / np.sqrt(photons.n_emitted)
            found = field(points, normals, footprint=edges[:, np.newaxis] * axes)
            means[seed, i] = found[:, 0].mean() / exact
    error = means.std(axis=0) / np.sqrt(len(means) - 1)
    assert (np.abs(means.mean(axis=0) - 1.0) < 2e-3 + 3 * error).all()


def test_a_partition_of_the_plane_has_the_whole_flux():
    uv = unit_square(100_000, "halton")
    wave = 0.06 * np.sin(9 * uv[:, ::-1]) * np.sin(11 * uv)
    photons = flat_map(uv + wave, 100_000, coords=uv, well_spaced=True)
    for n in (40, 150, 500):
        middle = np.linspace(-0.25, 1.25, n + 1)[:-1] + 0.75 / n
        points, normals = plane(np.stack(np.meshgrid(middle, middle), -1).reshape(-1, 2))
        field = pr.IrradianceField(photons)
        means = field(points, normals, footprint=np.full(n * n, 1.5 / n))
        assert means[:, 0].sum() * (1.5 / n) ** 2 == pytest.approx(1.0, rel=5e-3)


# Invariants


def varied(n=300):
    """Edge vectors from points to a tenth of the map, of any shape."""
    rng = np.random.default_rng(3)
    return 10 ** rng.uniform(-5, -1, (n, 1, 1)) * rng.normal(size=(n, 2, 3))


@pytest.mark.parametrize("n_threads", [2, 7])
def test_threads_do_not_matter(n_threads):
    photons = uneven(20_000)
    one, many = (
        pr.IrradianceField(photons, n_threads=n)(*places(300), footprint=varied())
        for n in (1, n_threads)
    )
    np.testing.assert_array_equal(one, many)


def test_other_footprints_of_a_call_do_not_matter():
    """Nor their order: searches start from the radius of the last."""
    field = pr.IrradianceField(uneven(20_000))
    points, normals = places(300)
    edges = varied()
    whole = field(points, normals, footprint=edges)
    for i in range(0, 300, 7):
        alone = field(points[i : i + 1], normals[:1], footprint=edges[i : i + 1])
        np.testing.assert_array_equal(alone[0], whole[i])


@simd_paths.each("path")
def test_instruction_sets_do_not_matter(path):
    with simd_paths.forced("portable"):
        expected = pr.IrradianceField(uneven(20_000))(*places(300), footprint=varied())
    with simd_paths.forced(path):
        found = pr.IrradianceField(uneven(20_000))(*places(300), footprint=varied())
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_irradiance_scales_with_lengths(scale):
    photons = uneven()
    larger = photons.replace(position=scale * photons.position)
    points, normals = places(300)
    found = pr.IrradianceField(larger)(scale * points, normals, footprint=scale * varied())
    expected = pr.IrradianceField(photons)(points, normals, footprint=varied())
    np.testing.assert_allclose(found * scale**2, expected, rtol=1e-8)


def test_rotation_does_not_matter():
    rotation, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    photons = uneven()
    turned = photons.replace(position=photons.position @ rotation, normal=photons.normal @ rotation)
    points, normals = places(300)
    found = pr.IrradianceField(turned)(
        points @ rotation, normals @ rotation, footprint=varied() @ rotation
    )
    expected = pr.IrradianceField(photons)(points, normals, footprint=varied())
    np.testing.assert_allclose(found, expected, rtol=1e-7)


def test_other_values_of_photons():
    """Densities of more columns than are summed together; each is that of the flux alone."""
    photons = uneven()
    field = pr.IrradianceField(photons)
    found = field.densities(np.tile(photons.flux, 5)[:, :14])(*places(300), footprint=varied())
    expected = field(*places(300), footprint=varied())
    np.testing.assert_array_equal(found, np.tile(expected, 5)[:, :14])


# Cost


def singles(n, side):
    """Photons looked at one by one for the mean over a square in the middle of the map."""
    xy = unit_square(n, "random")
    tree = KDTree(np.column_stack([xy, np.zeros(n)]), n_metric=3)
    values = to_soa_blocks(np.ones((n, 1)), np.asarray(tree.kernel.ids), 1)
    points, normals = plane(np.full((1, 2), 0.5))
    out = np.zeros((1, 1))
    where = tree.kernel, values, points, np.arange(1), out
    count = kernel.gather(
        *where,
        normals=normals,
        sums=node_sums(tree.kernel, values, 1),
        footprint=np.array([side]),
        integrals=kernel_integrals(),
        number=14.5,
        bias=(0.0, 0.0),
        radius=np.inf,
        range_radius=-1.0,
        n_threads=1,
    )
    assert out[0, 0] == pytest.approx(n, rel=0.1)
    return count


def test_photons_deep_inside_a_footprint_are_not_looked_at_one_by_one():
    """Only those near its edge are, whose number grows as √n."""
    few, many = singles(20_000, 0.5), singles(1_280_000, 0.5)
    assert few < 20_000
    assert many / few < 1.2 * 8


def test_sums_of_nodes_are_those_of_their_blocks():
    tree = KDTree(np.random.default_rng(0).random((100_000, 3)))
    values = to_soa_blocks(
        np.random.default_rng(1).random((100_000, 2)), np.asarray(tree.kernel.ids), 1
    )
    sums = node_sums(tree.kernel, values, 1)
    np.testing.assert_allclose(sums[0].sum(axis=1), values.sum(axis=(0, 2)))
    np.testing.assert_array_equal(sums, node_sums(tree.kernel, values, 7))


# What is refused


@pytest.mark.parametrize(
    "footprint",
    [
        0.1,
        np.ones(3),
        np.ones((4, 1)),
        np.ones((4, 2, 2)),
        np.ones((3, 2, 3)),
        np.full(4, -0.1),
        np.full(4, np.nan),
        np.full((4, 2, 3), np.inf),
    ],
)
def test_footprints_that_are_none(footprint):
    with pytest.raises(ValueError, match="footprint"):
        pr.IrradianceField(uneven(50))(*places(4), footprint=footprint)


def test_the_kernel_refuses_arrays_that_do_not_fit():
    tree = KDTree(np.random.default_rng(0).random((40, 3))).kernel
    blocks = to_soa_blocks(np.ones((40, 3)), np.asarray(tree.ids), 1)
    fitting = {
        "queries": np.zeros((5, 3)),
        "out": np.zeros((5, 3)),
        "normals": np.ones((5, 3)),
        "sums": node_sums(tree, blocks, 1),
        "footprint": np.ones(5),
        "integrals": kernel_integrals(),
    }
    odd = {
        "queries": np.zeros((5, 2)),
        "out": np.zeros((5, 2)),
        "normals": np.ones((4, 3)),
        "sums": np.zeros((1, 1, 16)),
        "footprint": np.ones((5, 2, 2)),
        "integrals": np.ones((3, 3)),
    }
    for name in odd:
        arrays = {**fitting, name: odd[name]}
        where = tree, blocks, arrays.pop("queries"), np.arange(5), arrays.pop("out")
        with pytest.raises(ValueError, match="do not fit one another"):
            kernel.gather(
                *where,
                **arrays,
                number=14.5,
                bias=(0.0, 0.0),
                radius=1.0,
                range_radius=-1.0,
                n_threads=1,
            )


def test_radii_have_to_fit():
    points, normals = places(4)
    where = flat_tree(uneven(50)).kernel, points, np.arange(4), np.empty(3)
    rule = {"number": 14.5, "radius": 1.0, "range_radius": -1.0, "n_threads": 1}
    with pytest.raises(ValueError, match="radii and queries do not fit"):
        kernel.write_radii(*where, normals=normals, footprint=np.ones(4), **rule)
    with pytest.raises(ValueError, match="normals and footprints do not fit"):
        kernel.rectangle_sides(normals, np.ones((3, 2, 3)))
