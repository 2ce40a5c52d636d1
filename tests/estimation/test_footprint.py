"""Means over footprints: the rule by definition, uniform fields, invariants, what is refused."""

import itertools
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from photonrelax._ext.spatial.blocks import to_soa_blocks
from photonrelax._ext.spatial.node_sums import node_sums
from scipy.integrate import dblquad
from scipy.special import ndtr

import photonrelax as pr
from photonrelax._ext.estimation import footprint as kernel
from photonrelax.estimation.footprint import kernel_integral, kernel_integrals
from photonrelax.spatial.kdtree import KDTree
from tests.helpers import simd_paths
from tests.helpers.photon_maps import flat_map, plane, uniform_map, unit_square

DEVIATION = 0.41
SLAB = 0.58


# The rule by definition, one footprint at a time


def tangent_frame(normal):
    """Two axes of the tangent plane and the normal, as rows."""
    u = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    u /= np.linalg.norm(u)
    return np.array([u, np.cross(normal, u), normal])


def rectangle(edges, normal):
    """Axes, as rows, and sides of the rectangle of two edge vectors."""
    frame = tangent_frame(normal)
    flat = edges @ frame[:2].T
    _, sides, axes = np.linalg.svd(flat)
    along = axes[0]
    if 0.0 < sides[0] <= 1.5 * sides[1]:
        lengths = np.linalg.norm(flat, axis=1)
        first, second = flat / lengths[:, np.newaxis]
        turn = np.array([[0, -1], [1, 0]]) * np.sign(np.linalg.det(flat))
        along = first + turn.T @ second
        along /= np.linalg.norm(along)
        sides = lengths * np.sqrt(abs(np.linalg.det(flat)) / lengths.prod())
    first = along @ frame[:2]
    return np.array([first, np.cross(normal, first), normal]), sides


@cache
def gauss(n):
    """Nodes and weights of Gauss's quadrature on [-1, 1]."""
    return np.polynomial.legendre.leggauss(n)


def profile(x, side, deviation):
    """Mean of the normal density over a side around x."""
    if side < 0.1 * deviation:
        nodes, weights = gauss(8)
        z = (np.abs(x)[..., np.newaxis] + 0.5 * side * nodes) / deviation
        return np.exp(-0.5 * z**2) @ weights / (2.0 * np.sqrt(2.0 * np.pi) * deviation)
    x = np.abs(x)
    return (ndtr((0.5 * side - x) / deviation) - ndtr((-0.5 * side - x) / deviation)) / side


def panels(edges, n=40):
    """Nodes and weights of Gauss's quadrature between each two edges and the next."""
    nodes, weights = gauss(n)
    half = 0.5 * np.diff(edges)[:, np.newaxis]
    return ((nodes + 1) * half + np.array(edges)[:-1, np.newaxis]).ravel(), (weights * half).ravel()


def integral_by_quadrature(sides, radius):
    """Integral of the cut kernel over the plane."""
    deviation = DEVIATION * radius
    halves = 0.5 * np.array(sides)
    angle, weight = panels(np.linspace(0, np.pi / 2, 4))
    depth = np.linspace(0, min(9 * deviation, halves[1]), 4)
    inner, inner_weight = panels(halves[1] - depth[::-1])
    y = np.concatenate([halves[1] + radius * np.sin(angle), inner])
    reach = np.concatenate([radius * np.cos(angle), np.full(len(inner), radius)])
    weight = np.concatenate([radius * np.cos(angle) * weight, inner_weight])
    weight = weight * profile(y, sides[1], deviation)

    def along(reach):
        x, dx = panels(halves[0] - np.linspace(0, min(9 * deviation, halves[0]), 4)[::-1])
        flat = profile(x, sides[0], deviation) @ dx
        flat += max(0.0, halves[0] - 9 * deviation) / max(sides[0], 1e-300)
        x, dx = panels([0.0, 1.0])
        beside = halves[0] + x * reach[:, np.newaxis]
        return 2 * (flat + profile(beside, sides[0], deviation) @ dx * reach)

    middle = 2 * max(0.0, halves[1] - 9 * deviation) / max(sides[1], 1e-300)
    return 2 * weight @ along(reach) + middle * along(np.array([radius]))[0]


def radius_of(squared, sides, k, gather_radius):
    """Radius of the rule, and whether it is that of a photon."""
    distance = np.concatenate([[0.0], np.sqrt(np.sort(squared))])
    excess = np.arange(len(distance)) - (k - 0.5)
    linear = (k - 0.5) * sum(sides)
    root = np.full(len(distance), np.inf)
    more = np.pi * excess[excess > 0]
    root[excess > 0] = linear + np.sqrt(linear**2 + more * (k - 0.5) * np.prod(sides))
    root[excess > 0] /= more
    radius = np.maximum(distance, root)
    least = np.argmin(radius)
    if not radius[least] <= gather_radius:
        return gather_radius, False
    return radius[least], distance[least] > root[least]


def by_definition(photons, point, normal, edges, gather):
    normal = normal / np.linalg.norm(normal)
    axes, sides = rectangle(edges, normal)
    seen = np.square(photons.normal - normal).sum(axis=1) <= 1.0
    offset = np.abs((photons.position[seen] - point) @ axes.T)
    halves = 0.5 * np.array([*sides, SLAB * np.hypot(*sides)])
    beside = np.maximum(offset - halves, 0.0)
    squared = np.square(beside).sum(axis=1)
    radius, at_photon = radius_of(squared, sides, gather.k, gather.gather_radius)
    if not np.isfinite(radius):
        return np.zeros(3)
    deviation = DEVIATION * radius
    weight = np.exp(-0.5 * (beside[:, 2] / deviation) ** 2)
    for i in range(2):
        weight = weight * profile(offset[:, i], sides[i], deviation)
    limit = radius * (1 - 1e-12 if at_photon else 1 + 1e-12)
    weight = np.where(squared <= limit**2, weight, 0.0)
    return weight @ photons.flux[seen] / integral_by_quadrature(sides, radius)


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


def square(side):
    return side * np.eye(3)[:2]


def uneven(n=4000, seed=0):
    """Photons of any flux, denser towards a corner."""
    rng = np.random.default_rng(seed)
    return flat_map(rng.random((n, 2)) ** 1.5, n).replace(flux=rng.random((n, 3)))


def places(n=40, seed=1):
    return plane(np.random.default_rng(seed).random((n, 2)))


TURN = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0]])
FOOTPRINTS = {
    "points": square(0.0),
    "far smaller than the spacing": square(1e-5),
    "smaller than the deviation": square(2e-3),
    "of a few photons": square(0.03),
    "of hundreds": square(0.3),
    "wider than the map": square(5.0),
    "turned": 0.05 * TURN,
    "ten to one": TURN * [[0.2], [0.02]],
    "a hundred to one": TURN * [[0.4], [0.004]],
    "a line": TURN * [[0.1], [0.0]],
    "a parallelogram": np.array([[0.1, 0.02, 0.0], [0.08, 0.1, 0.0]]),
    "a thin parallelogram": np.array([[0.2, 0.02, 0.0], [0.21, 0.01, 0.0]]),
    "nearly a square": np.array([[0.05, 0.01, 0.0], [0.0, -0.05, 0.0]]),
    "edges out of the plane": np.array([[0.05, 0.01, 0.3], [0.0, 0.07, -0.2]]),
}


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


@pytest.fixture(scope="module")
def uniform_maps():
    """Maps of 1 W/m²: several where chance or the shift of the sequence matters."""
    halton = [uniform_map(100_000, "halton", seed) for seed in range(8)]
    return {
        "random": [uniform_map(100_000, "random", seed) for seed in range(8)],
        "halton": halton,
        "relaxed": [pr.relax(one, pr.detect_structure(one)) for one in halton[:3]],
    }


SIZES = [0.0, 0.1, 0.6, 2.5, 10.0, 100.0]


@pytest.mark.parametrize("kind", ["random", "halton", "relaxed"])
@pytest.mark.parametrize("k", [8, 15, 50])
def test_a_uniform_field_returns_its_own_value(kind, k, uniform_maps):
    """At points and over 0.1 … 100 photons, squares and 10 : 1 and 100 : 1, turned at random."""
    rng = np.random.default_rng(99)
    points, normals = plane(rng.uniform(0.25, 0.75, (3000, 2)))
    angle = rng.uniform(0, 2 * np.pi, 3000)
    axes = np.zeros((3000, 2, 3))
    axes[:, 0, 0] = axes[:, 1, 1] = np.cos(angle)
    axes[:, 0, 1] = np.sin(angle)
    axes[:, 1, 0] = -axes[:, 0, 1]
    shapes = [(size, 1) for size in SIZES] + [(size, 10) for size in SIZES[2:]]
    shapes += [(size, 100) for size in SIZES[3:]]
    means = np.empty((len(uniform_maps[kind]), len(shapes)))
    for photons, row in zip(uniform_maps[kind], means, strict=True):
        inside = (np.abs(photons.position[:, :2] - 0.5) < 0.25).all(axis=1).mean() / 0.25
        field = pr.IrradianceField(photons, pr.GatherSettings(k=k))
        for i, (size, ratio) in enumerate(shapes):
            sides = np.sqrt([size * ratio / 100_000, size / ratio / 100_000])
            edges = sides[:, np.newaxis] * axes
            row[i] = field(points, normals, footprint=edges)[:, 0].mean() / inside
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
    """Densities of five columns, of which each is that of the flux alone."""
    photons = uneven()
    field = pr.IrradianceField(photons)
    columns = np.column_stack([photons.flux, photons.flux[:, :2]])
    found = field.densities(columns)(*places(300), footprint=varied())
    expected = field(*places(300), footprint=varied())
    np.testing.assert_array_equal(found, np.column_stack([expected, expected[:, :2]]))


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


@pytest.mark.parametrize("method", ["diffusion", "progressive"])
def test_methods_without_footprints_say_so(method):
    field = pr.irradiance_field(uneven(500), method=method)
    with pytest.raises(ValueError, match="estimates at points only, but a footprint was given"):
        field(*places(4), footprint=np.ones(4))


def test_refinements_have_no_footprints():
    gather = pr.GatherSettings(k=100, refinement="bias-compensation")
    with pytest.raises(ValueError, match="without refinement"):
        pr.IrradianceField(uneven(500), gather)(*places(4), footprint=np.ones(4))
    field = pr.IrradianceField(uneven(500), replace(gather, refinement="none"))
    assert field(*places(4), footprint=np.ones(4)).shape == (4, 3)


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
