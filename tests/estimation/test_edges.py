"""Estimates beside edges: the rule by definition, uniform light, points off all surfaces."""

import numpy as np
import pytest
import trimesh
from matplotlib.path import Path
from scipy.optimize import brentq

import photonrelax as pr
from photonrelax.estimation.kernels import KERNELS
from photonrelax.estimation.surface import Surface
from tests.helpers import clipped_kernels
from tests.helpers.footprint_rule import DEVIATION, profile
from tests.helpers.photon_maps import flat_map, plane, uniform_map

UP = np.array([0.0, 0.0, 1.0])
SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
# Convex, with an acute corner and edges in no special direction.
POLYGON = np.array([[0.0, 0.0], [1.0, 0.1], [1.2, 0.9], [0.3, 0.8]])


def flat(polygon, height=0.0):
    """A convex polygon (n, 2) as a mesh, seen from above."""
    vertices = np.column_stack([polygon, np.full(len(polygon), height)])
    faces = [[0, i, i + 1] for i in range(1, len(polygon) - 1)]
    return trimesh.Trimesh(vertices, faces, process=False)


def scene_of(*meshes, material=None):
    objects = [pr.SceneObject(mesh, material or pr.Diffuse(0.5)) for mesh in meshes]
    return pr.Scene(objects, [pr.PointEmitter((0.0, 0.0, 50.0), 1.0)])


def photons_on(polygon, n=3000, seed=0):
    """Photons of any flux on a polygon, denser towards a corner."""
    rng = np.random.default_rng(seed)
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    points = low + (high - low) * rng.random((4 * n, 2)) ** 1.3
    points = points[Path(polygon).contains_points(points)][:n]
    return flat_map(points, n).replace(flux=rng.random((len(points), 3)))


# The rule by definition


def area(polygon, sides, radius):
    return clipped_kernels.integral(polygon, sides, radius, is_area=True)


def radius_of(squared, polygon, sides, number, largest):
    """Radius of the rule, and whether it is that of a photon."""
    distance = np.sqrt(np.sort(squared))

    def excess(radius, n):
        disc, around = area(polygon, (0.0, 0.0), radius), area(polygon, sides, radius)
        return n * disc - number * around if disc > 0.0 else -1.0

    low, high = 0, len(distance)
    while low < high:
        middle = (low + high) // 2
        if excess(distance[middle], middle + 1) >= 0.0:
            high = middle
        else:
            low = middle + 1
    # `low` photons are too few at the distance of the last of them, one more enough at its own.
    above = largest if low == len(distance) else min(distance[low], largest)
    if excess(above, low) < 0.0:
        return above, above < largest
    below = distance[low - 1] if low else 0.0
    return brentq(excess, below, above, args=(low,), xtol=1e-15, rtol=1e-14), False


def by_definition(photons, polygon, point, edges, k):
    """Density over a footprint whose edges (2, 2) are those of a rectangle."""
    sides = np.linalg.norm(edges, axis=1)
    axes = edges / sides[:, np.newaxis] if sides.all() else np.eye(2)
    offset = (photons.position[:, :2] - point) @ axes.T
    beside = np.maximum(np.abs(offset) - 0.5 * sides, 0.0)
    squared = np.square(beside).sum(axis=1)
    seen = (polygon - point) @ axes.T
    radius, at_photon = radius_of(squared, seen, sides, k - 0.5, 10.0)
    weight = np.prod([profile(offset[:, i], sides[i], DEVIATION * radius) for i in (0, 1)], axis=0)
    weight[squared > (radius * (1 - 1e-12 if at_photon else 1 + 1e-12)) ** 2] = 0.0
    return weight @ photons.flux / clipped_kernels.integral(seen, sides, radius)


FOOTPRINTS = {
    "points": np.zeros((2, 2)),
    "of a photon": 0.02 * np.eye(2),
    "turned": 0.05 * np.array([[0.8, 0.6], [-0.6, 0.8]]),
    "of hundreds": 0.3 * np.eye(2),
    "ten to one": np.array([[0.16, 0.12], [-0.012, 0.016]]),
    "all of the surface": 3.0 * np.eye(2),
}
PLACES = np.array(
    [[0.02, 0.01], [0.5, 0.06], [1.0, 0.12], [1.15, 0.88], [0.31, 0.79], [0.16, 0.42], [0.6, 0.5]]
)


@pytest.mark.parametrize("edges", FOOTPRINTS.values(), ids=FOOTPRINTS)
@pytest.mark.parametrize("k", [8, 30])
def test_means_beside_edges_equal_their_definition(edges, k):
    photons = photons_on(POLYGON)
    gather = pr.GatherSettings(k=k, gather_radius=10.0)
    field = pr.irradiance_field(
        photons, method="standard", scene=scene_of(flat(POLYGON)), gather=gather
    )
    footprints = np.zeros((len(PLACES), 2, 3))
    footprints[:, :, :2] = edges
    found = field(*plane(PLACES), footprint=footprints)
    expected = [by_definition(photons, POLYGON, point, edges, k) for point in PLACES]
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@pytest.mark.parametrize("kernel", KERNELS)
def test_the_share_of_kernels_at_points_equals_quadrature(kernel):
    n = 400
    nodes = (np.arange(n) + 0.5) / n * 2.0 - 1.0
    ratio = np.add.outer(nodes**2, nodes**2)
    shape = {
        "constant": np.ones_like(ratio),
        "cone": 1.0 - np.sqrt(ratio),
        "epanechnikov": 1.0 - ratio,
        "gaussian": np.exp(-0.5 * ratio / DEVIATION**2),
    }[kernel]
    weight = np.where(ratio < 1.0, shape, 0.0).ravel()
    photons = photons_on(POLYGON)
    settings = {"method": "standard", "gather": pr.GatherSettings(40, kernel, gather_radius=9.0)}
    bare = pr.irradiance_field(photons, **settings)(*plane(PLACES))
    found = pr.irradiance_field(photons, scene=scene_of(flat(POLYGON)), **settings)(*plane(PLACES))
    distance = np.linalg.norm(photons.position[:, :2] - PLACES[:, np.newaxis], axis=2)
    radius = np.sort(distance, axis=1)[:, 39]
    disc = np.stack(np.meshgrid(nodes, nodes), -1).reshape(-1, 2)
    inside = [
        Path(POLYGON).contains_points(point + r * disc)
        for point, r in zip(PLACES, radius, strict=True)
    ]
    share = np.array(inside) @ weight / weight.sum()
    np.testing.assert_allclose(bare / found, np.tile(share, (3, 1)).T, atol=0.005)


def test_far_from_edges_nothing_changes():
    photons = photons_on(SQUARE)
    middle = plane(np.random.default_rng(1).uniform(0.4, 0.6, (50, 2)))
    for footprint in (None, np.full(50, 0.02)):
        bare = pr.irradiance_field(photons, method="standard")
        field = pr.irradiance_field(photons, method="standard", scene=scene_of(flat(SQUARE)))
        np.testing.assert_array_equal(
            field(*middle, footprint=footprint), bare(*middle, footprint=footprint)
        )


@pytest.mark.parametrize("n_threads", [1, 2, 7])
def test_threads_do_not_matter_beside_edges(n_threads):
    photons, where = photons_on(SQUARE), plane(np.random.default_rng(1).random((300, 2)))
    scene = scene_of(flat(SQUARE))
    for footprint in (None, np.full(300, 0.02)):
        one, other = (
            pr.irradiance_field(photons, method="standard", scene=scene, n_threads=n)(
                *where, footprint=footprint
            )
            for n in (1, n_threads)
        )
        np.testing.assert_array_equal(one, other)


# Uniform light: 1 W/m², in texels along edges and in the middle


N_PHOTONS, N_MAPS, N_TEXELS = 20_000, 30, 40


def along(x, y, n=N_TEXELS):
    return np.column_stack([np.broadcast_to(x, n), np.broadcast_to(y, n)])


def random_light(seed):
    return uniform_map(N_PHOTONS, "random", seed)


def estimates_at(places, sides, photons, **settings):
    """Estimates at places, functions of the side of footprints, by side and name, of one field."""
    field = pr.irradiance_field(photons, **settings)
    found = {}
    for side in sides:
        for name, points in places(side).items():
            footprint = None if side == 0.0 else np.full(len(points), side)
            found[side, name] = field(*plane(points), footprint=footprint)[:, 0]
    return found


def mean_and_deviation(scene, places, sides, k, *, lit=random_light):
    """Of estimates of uniform light, for each side by the name of places."""
    settings = {"method": "standard", "scene": scene, "gather": pr.GatherSettings(k=k)}
    maps = [estimates_at(places, sides, lit(seed), **settings) for seed in range(N_MAPS)]
    found = {side: {} for side in sides}
    for side, name in maps[0]:
        every = [each[side, name] for each in maps]
        found[side][name] = np.mean(every), np.std(every)
    return found.values()


def assert_uniform(found, interior="middle", n=N_MAPS * N_TEXELS):
    noise = found[interior][1]
    for name, (mean, deviation) in found.items():
        # Neighbouring texels share photons: as many independent ones as half of them.
        assert abs(mean - 1.0) < 0.02 + 3.0 * deviation / np.sqrt(n / 2), name
        assert deviation < 1.1 * noise + 3.0 * noise / np.sqrt(n), name


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("k", [8, 50])
def test_uniform_light_on_a_square(k):
    """At points, and over texels of a tenth of a photon, of a few, and of many."""

    def places(side):
        half, inner = 0.5 * side, np.linspace(0.1, 0.9, N_TEXELS)
        ends = [half, 1.0 - half]
        return {
            "middle": along(inner, 0.5),
            "edges": np.concatenate([along(inner[::4], y, 10) for y in ends])
            if side
            else along(inner, 0.0),
            "second texel": along(inner, 3.0 * half),
            "corners": np.array([[x, y] for x in ends for y in ends]),
        }

    sides = np.sqrt(np.array([0.0, 0.1, 2.5, 40.0]) / N_PHOTONS)
    for found in mean_and_deviation(scene_of(flat(SQUARE)), places, sides, k):
        assert_uniform(found, n=N_MAPS * 4)


def test_uniform_light_on_two_surfaces_that_abut():
    """Up to the seam, which is no edge, whether they share corners or not."""
    left, right = SQUARE * [0.5, 1.0], SQUARE * [0.5, 1.0] + [0.5, 0.0]
    shifted = np.roll(np.append(right, [[0.5, 0.6]], axis=0), -1, axis=0)
    places = {
        "middle": along(0.25, np.linspace(0.2, 0.8, N_TEXELS)),
        "left": along(0.495, np.linspace(0.2, 0.8, N_TEXELS)),
        "seam": along(0.5, np.linspace(0.2, 0.8, N_TEXELS)),
        "right": along(0.506, np.linspace(0.2, 0.8, N_TEXELS)),
    }
    for other in (right, shifted):
        scene = scene_of(flat(left), flat(other))
        for found in mean_and_deviation(scene, lambda side: places, (0.0, 0.01), 15):
            assert_uniform(found)


def wall(x, height=1.0):
    """A wall at x, lit from the left."""
    return trimesh.Trimesh(
        [[x, 0.0, 0.0], [x, 1.0, 0.0], [x, 1.0, height], [x, 0.0, height]],
        [[0, 2, 1], [0, 3, 2]],
        process=False,
    )


def test_uniform_light_on_a_floor_that_meets_a_wall():
    """On one mesh with a crease, and on two that meet."""
    places = {
        "middle": along(0.5, np.linspace(0.2, 0.8, N_TEXELS)),
        "beside the wall": along(0.995, np.linspace(0.2, 0.8, N_TEXELS)),
    }
    both = trimesh.util.concatenate([flat(SQUARE), wall(1.0)])
    both.merge_vertices()
    for scene in (scene_of(both), scene_of(flat(SQUARE), wall(1.0))):
        for found in mean_and_deviation(scene, lambda side: places, (0.0, 0.01), 15):
            assert_uniform(found)


@pytest.mark.parametrize("sunk", [0.0, 0.01], ids=["stands", "sunk"])
def test_uniform_light_beside_a_cube(sunk):
    """Light lands around its base, which no mesh has an edge along."""
    size = 0.3
    cube = trimesh.creation.box((size, size, size))
    cube.apply_translation((0.5, 0.5, 0.5 * size - sunk))

    def lit(seed):
        points = np.random.default_rng(seed).random((N_PHOTONS, 2))
        outside = (np.abs(points - 0.5) > 0.5 * size).any(axis=1)
        return flat_map(points[outside], N_PHOTONS)

    side, low = 0.01, 0.5 - 0.5 * size
    places = {
        "middle": along(0.15, np.linspace(0.2, 0.8, N_TEXELS)),
        "beside": along(low - 0.5 * side, np.linspace(low, 1.0 - low, N_TEXELS)),
        "corner": np.array([[low - 0.5 * side, low - 0.5 * side]]),
    }
    scene, sides = scene_of(flat(SQUARE), cube), (0.0, side)
    for found in mean_and_deviation(scene, lambda side: places, sides, 15, lit=lit):
        assert_uniform(found, n=N_MAPS)


def test_light_below_glass_on_a_floor_is_not_beside_an_edge():
    """Photons land below it, too."""
    glass = trimesh.creation.box((0.3, 0.3, 0.3))
    glass.apply_translation((0.5, 0.5, 0.15))
    objects = [
        pr.SceneObject(flat(SQUARE), pr.Diffuse(0.5)),
        pr.SceneObject(glass, pr.Dielectric(1.5)),
    ]
    scene = pr.Scene(objects, [pr.PointEmitter((0.0, 0.0, 50.0), 1.0)])
    photons, where = photons_on(SQUARE), plane(np.linspace(0.3, 0.7, 20)[:, np.newaxis] * [1, 1])
    with_glass = pr.irradiance_field(photons, method="standard", scene=scene)
    np.testing.assert_array_equal(
        with_glass(*where), pr.irradiance_field(photons, method="standard")(*where)
    )


# Where there is no surface


def test_off_all_surfaces_irradiance_is_unknown():
    photons = photons_on(SQUARE)
    gather = pr.GatherSettings(gather_radius=0.1)
    field = pr.irradiance_field(
        photons, method="standard", scene=scene_of(flat(SQUARE)), gather=gather
    )
    points = np.array([[0.5, 0.5, 0.0], [2.0, 0.5, 0.0], [0.5, 0.5, 0.4], [1.15, 0.5, 0.0]])
    normals = np.tile(UP, (4, 1))
    with pytest.warns(UserWarning, match=r"3 of 4 points have no surface .* within 0\.1 m"):
        found = field(points, normals)
    np.testing.assert_array_equal(np.isnan(found[:, 0]), [False, True, True, True])
    with pytest.warns(UserWarning, match="2 of 4 points"):
        # The last one's footprint reaches to within the gather radius.
        found = field(points, normals, footprint=np.full(4, 0.2))
    np.testing.assert_array_equal(np.isnan(found[:, 0]), [False, True, True, False])


def test_surfaces_that_face_another_way_do_not_count():
    photons = photons_on(SQUARE)
    field = pr.irradiance_field(
        photons,
        method="standard",
        scene=scene_of(flat(SQUARE)),
        gather=pr.GatherSettings(gather_radius=0.1),
    )
    with pytest.warns(UserWarning, match="1 of 1 points"):
        assert np.isnan(field([[0.5, 0.5, 0.0]], [[1.0, 0.0, 0.1]])).all()


def test_dark_surfaces_are_black():
    photons = photons_on(SQUARE * 0.2)
    field = pr.irradiance_field(
        photons,
        method="standard",
        scene=scene_of(flat(SQUARE)),
        gather=pr.GatherSettings(gather_radius=0.05),
    )
    np.testing.assert_array_equal(field([[0.8, 0.8, 0.0]], [UP]), np.zeros((1, 3)))


def test_sensors_are_surfaces():
    photons = photons_on(SQUARE)
    field = pr.irradiance_field(
        photons,
        method="standard",
        scene=scene_of(flat(SQUARE), flat(SQUARE, 1.0), material=pr.Sensor()),
        gather=pr.GatherSettings(gather_radius=0.1),
    )
    np.testing.assert_array_equal(field([[0.5, 0.5, 1.0]], [UP]), np.zeros((1, 3)))


# Progressive photon mapping


def test_uniform_light_in_passes():
    """Up to edges and corners of a square, at points and over texels."""

    def places(side):
        ends, inner = [0.5 * side, 1.0 - 0.5 * side], np.linspace(0.1, 0.9, N_TEXELS)
        return {
            "middle": along(inner, 0.5),
            "edge": along(inner, ends[0]),
            "corner": np.array([[x, y] for x in ends for y in ends]),
        }

    settings = {
        "method": "progressive",
        "scene": scene_of(flat(SQUARE)),
        "progressive": pr.ProgressiveSettings(k=15, n_passes=3),
    }
    maps = [
        estimates_at(places, (0.0, 0.01), random_light(seed), **settings) for seed in range(N_MAPS)
    ]
    for key in maps[0]:
        estimates = [each[key] for each in maps]
        n = np.size(estimates) / 4
        assert abs(np.mean(estimates) - 1.0) < 0.02 + 3.0 * np.std(estimates) / np.sqrt(n), key


# Diffusion


@pytest.mark.parametrize("method", ["diffusion", "isotropic-diffusion"])
def test_uniform_light_by_diffusion(method):
    """At points, over footprints smaller than kernels, and over wider ones, up to an edge."""

    def places(side):
        half = 0.5 * side
        return {"edge": along(np.linspace(0.2, 0.8, 10), half, 10), "corner": along(half, half, 1)}

    sides, settings = (0.0, 0.01, 0.3), {"method": method, "scene": scene_of(flat(SQUARE))}
    maps = [estimates_at(places, sides, random_light(seed), **settings) for seed in range(10)]
    for key in maps[0]:
        found = [each[key] for each in maps]
        noise = np.std(found, axis=0).mean() / np.sqrt(len(found))
        times = 3.0 if key[1] == "edge" else 4.0
        assert abs(np.mean(found) - 1.0) < 0.02 + times * noise, key


def test_kernels_of_any_shape_are_divided_by_their_surface():
    """By the part of their ellipses on the square, of light with an oblique edge."""
    rng = np.random.default_rng(3)
    points = rng.random((40_000, 2))
    points = points[(points @ [1.0, 0.5] < 0.8) | (rng.random(len(points)) < 0.05)]
    photons = flat_map(points, len(points))
    places = np.array([[0.75, 0.02], [0.7, 0.1], [0.3, 0.99], [0.31, 0.97]])
    settings = {"method": "diffusion", "diffusion": pr.DiffusionSettings(k=300)}
    bare = pr.irradiance_field(photons, **settings)
    field = pr.irradiance_field(photons, scene=scene_of(flat(SQUARE)), **settings)
    n = 400
    nodes = (np.arange(n) + 0.5) / n * 2.0 - 1.0
    disc = np.stack(np.meshgrid(nodes, nodes), -1).reshape(-1, 2)
    weight = np.maximum(1.0 - np.square(disc).sum(axis=1), 0.0)
    axes = bare.half_axes(*plane(places))[:, :, :2]
    assert (np.linalg.norm(axes[:, 0], axis=1) > 1.2 * np.linalg.norm(axes[:, 1], axis=1)).any()
    inside = [
        ((at + disc @ pair >= 0.0) & (at + disc @ pair <= 1.0)).all(axis=1)
        for at, pair in zip(places, axes, strict=True)
    ]
    share = np.array(inside) @ weight / weight.sum()
    ratio = bare(*plane(places)) / field(*plane(places))
    np.testing.assert_allclose(ratio, np.tile(share, (3, 1)).T, atol=0.005)


# Seams and edges in any direction


def turned(polygon):
    """A polygon in a plane in no special direction."""
    return polygon @ np.array([[0.6, 0.8], [-0.8, 0.6]]) + [0.1, 0.3]


BESIDE = np.add(SQUARE, [1.0, 0.0])
SEAMS = {
    "whole": [SQUARE, BESIDE],
    "with a T": [SQUARE, np.roll(np.append(BESIDE, [[1.0, 0.5]], axis=0), -1, axis=0)],
}


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("seam", SEAMS.values(), ids=SEAMS)
def test_seams_have_no_edge_wherever_points_are(seam, kernel):
    """On the seam, beside it on regular grids, at its ends, and beside the vertex of a T."""
    y = np.linspace(0.2, 0.8, 31)
    points = np.concatenate([along(x, y, 31) for x in (0.8, 0.9, 0.95, 0.999, 1.0, 1.0 + 1e-9)])
    scene = scene_of(*(flat(turned(part)) for part in seam))
    where = plane(turned(points))
    field = Surface(scene, 1)
    radius = np.full(len(points), 0.1)
    shares = field.shares(*where, radius, KERNELS[kernel])
    np.testing.assert_allclose(shares, 1.0, atol=1e-5)
    ends = plane(turned(np.array([[1.0, 0.0], [1.0, 1.0], [0.5, 0.0], [1.0 + 1e-12, 0.0]])))
    np.testing.assert_allclose(
        field.shares(*ends, np.full(4, 0.1), KERNELS[kernel]), 0.5, atol=1e-3
    )


@pytest.mark.parametrize("off", [0.0, 1e-12, 1e-8, 3e-8])
def test_points_just_off_an_edge_are_on_it(off):
    """As positions are that were rounded to float32."""
    points = turned(along(np.linspace(0.2, 0.8, 31), -off, 31))
    shares = Surface(scene_of(flat(turned(SQUARE))), 1).shares(
        *plane(points), np.full(31, 0.02), KERNELS["epanechnikov"]
    )
    np.testing.assert_allclose(shares, 0.5, atol=1e-3)


def test_estimates_are_divided_by_no_less_than_a_sixteenth():
    """Where next to nothing of a kernel is on surface."""
    where = plane(np.array([[-0.0999, 0.5], [-0.2, 0.5]]))
    shares = Surface(scene_of(flat(SQUARE)), 1).shares(*where, np.full(2, 0.1), KERNELS["constant"])
    np.testing.assert_array_equal(shares, [1 / 16, 1.0])


def test_a_footprint_far_beyond_its_surface_is_its_mean():
    """As of walls seen at grazing angles, where the edges of others may leave nothing of it."""
    rng = np.random.default_rng(0)
    on_wall = np.column_stack([np.full(4000, 0.9), rng.random((4000, 2)) * [3.0, 2.2] - [1.8, 0.0]])
    normals = np.tile([-1.0, 0.0, 0.0], (4000, 1))
    photons = pr.PhotonMap(on_wall, normals, np.full(4000, 1 / 4000), n_emitted=4000)
    boxes = [trimesh.creation.box(size) for size in ((0.5, 3.0, 2.2), (1.76, 0.5, 2.2))]
    boxes[0].apply_translation((1.15, -0.3, 1.101))
    boxes[1].apply_translation((0.0, 1.05, 1.101))
    field = pr.irradiance_field(photons, method="standard", scene=scene_of(*boxes))
    edges = np.tile([[0.0, 6.8, 0.0], [0.0, 0.0, 0.0092]], (2, 1, 1))
    points = [[0.9, 0.865, 0.0236], [0.9, 0.0, 1.0]]
    # Those of the parallel face 2 cm away are none of the wall.
    found = field(points, normals[:2], footprint=edges)
    np.testing.assert_allclose(found, 1 / (3.0 * 2.2), rtol=0.1)
