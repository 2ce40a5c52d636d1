"""Photons on faces: what is gathered, by brute force, whichever tree serves a point."""

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.estimation.kernels import automatic_gather_radius
from photonrelax.estimation.methods import PHOTON_METHODS
from photonrelax.photons.photon_trees import PhotonTrees

SLANTED = np.array([1.0, 0.0, 1.0]) / np.sqrt(2.0)
N = 700


def on_face(rng, normal, n=N, height=0.0):
    """Return points on a square through (0, 0, height), and their normals."""
    normal = np.asarray(normal, dtype=float)
    across = np.cross(normal, [0.3, 1.0, -0.2])
    across /= np.linalg.norm(across)
    u, v = rng.uniform(-0.5, 0.5, (2, n, 1))
    points = u * across + v * np.cross(normal, across) + [0.0, 0.0, height]
    return points, np.tile(normal, (n, 1))


def scene_of_faces(rng):
    """A floor, a wall, a face between them that sees both, and a thin plate lit from both sides.

    One half of the wall's normals are a rounding off.
    """
    wall = on_face(rng, [1, 0, 0])
    wall[1][::2] = [1.0 - 1e-16, 1e-17, 0.0]
    return [
        on_face(rng, [0, 0, 1], height=0.01),
        wall,
        on_face(rng, SLANTED),
        on_face(rng, [0, 1, 0]),
        on_face(rng, [0, -1, 0]),
    ]


def drum(rng):
    """Twenty faces, of which each sees seven: too many for a tree each."""
    angles = 2.0 * np.pi * np.arange(20) / 20
    return [on_face(rng, [np.cos(a), np.sin(a), 0.0], 150) for a in angles]


def sphere(rng):
    normal = rng.normal(size=(2000, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return [(0.5 * normal, normal)]


SCENES = [scene_of_faces, drum, sphere]


def photons_of(faces, rng):
    position, normal = (np.concatenate(arrays) for arrays in zip(*faces, strict=True))
    some = rng.permutation(len(position))
    return pr.PhotonMap(position[some], normal[some], rng.random((len(position), 3)))


def points_on(faces, rng):
    """Return points on the faces, and others that face anywhere."""
    some = [(p[::9] + 0.01, 2.0 * n[::9]) for p, n in faces]
    points, normals = (np.concatenate(arrays) for arrays in zip(*some, strict=True))
    anywhere = rng.uniform(-0.5, 0.5, (300, 3)), rng.normal(size=(300, 3))
    return np.concatenate([points, anywhere[0]]), np.concatenate([normals, anywhere[1]])


def by_brute_force(photons, point, normal, k, radius):
    """The k nearest of the photons whose normals are within 60°, weighted by Epanechnikov."""
    normal = normal / np.linalg.norm(normal)
    seen = np.flatnonzero(((photons.normal - normal) ** 2).sum(axis=1) <= 1.0)
    squared = ((photons.position[seen] - point) ** 2).sum(axis=1)
    nearest = np.argsort(squared)[:k]
    nearest = nearest[squared[nearest] <= radius**2]
    bandwidth = squared[nearest[-1]] if len(nearest) == k else radius**2
    weight = 2.0 * (1.0 - squared[nearest] / bandwidth) / (np.pi * bandwidth)
    return weight @ photons.flux[seen[nearest]]


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("radius", [0.05, 0.3, np.inf])
def test_points_gather_photons_on_faces_turned_by_at_most_60_degrees(scene, radius):
    rng = np.random.default_rng(0)
    faces = scene(rng)
    photons, (points, normals) = photons_of(faces, rng), points_on(faces, rng)
    settings = pr.GatherSettings(k=15, gather_radius=radius)
    found = pr.estimate_irradiance(photons, points, normals, settings)
    expected = [
        by_brute_force(photons, point, normal, 15, radius)
        for point, normal in zip(points, normals, strict=True)
    ]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
    assert found.any()


@pytest.mark.parametrize("scene", SCENES)
def test_same_bytes_for_every_number_of_threads_and_in_parts(scene):
    rng = np.random.default_rng(1)
    faces = scene(rng)
    photons, (points, normals) = photons_of(faces, rng), points_on(faces, rng)
    one, *others = [pr.IrradianceField(photons, n_threads=t)(points, normals) for t in (1, 2, 7)]
    field = pr.IrradianceField(photons)
    halves = [field(points[half], normals[half]) for half in (slice(0, 99), slice(99, None))]
    for other in (*others, np.concatenate(halves)):
        assert other.tobytes() == one.tobytes()


@pytest.mark.parametrize("roundings", [4e-16, 1e-13])
@pytest.mark.parametrize("method", PHOTON_METHODS)
def test_one_normal_of_many_roundings_faces_one_way(method, roundings):
    rng = np.random.default_rng(6)
    position, normal = on_face(rng, SLANTED, 2000)
    normal += rng.uniform(-roundings, roundings, normal.shape)
    assert len(np.unique(normal, axis=0)) > 64
    photons = pr.PhotonMap(position, normal, np.full((2000, 3), 1 / 2000), n_emitted=2000)
    if method == "frequency":
        photons = photons.replace(spectrum=np.tile([1e4, 0.0, 0.0], (2000, 1)))
    field, normals = pr.irradiance_field(photons, method=method), np.tile(SLANTED, (50, 1))
    assert field(0.5 * position[:50], normals).min() > 0.0
    assert field(0.5 * position[:50], -normals).max() == 0.0


@pytest.mark.parametrize(("scene", "n_sets"), [(scene_of_faces, 5), (drum, 0), (sphere, 0)])
def test_few_faces_need_no_axes_for_normals(scene, n_sets):
    """Unless photons would be in many trees."""
    rng = np.random.default_rng(2)
    trees = PhotonTrees(photons_of(scene(rng), rng), 1)
    assert trees.n_sets == n_sets
    assert all(trees.tree(number)[0].n_axes == 3 for number in range(n_sets))
    assert trees.tree(n_sets)[0].n_axes == 6


@pytest.mark.parametrize("scene", SCENES)
def test_the_gather_radius_is_that_of_the_tree_of_all_photons(scene):
    rng = np.random.default_rng(3)
    photons = photons_of(scene(rng), rng)
    tree = pr.KDTree(np.hstack([photons.position, photons.normal]))
    radius = pr.IrradianceField(photons).settings.gather_radius
    assert radius == automatic_gather_radius(tree, 15)


@pytest.mark.parametrize("scene", SCENES)
def test_progress_counts_all_points(scene):
    rng = np.random.default_rng(4)
    faces = scene(rng)
    field, calls = pr.IrradianceField(photons_of(faces, rng)), []
    field(*points_on(faces, rng), progress=lambda *call: calls.append(call))
    assert calls[-1][1] == calls[-1][2]
    assert [done for _, done, _ in calls] == sorted({done for _, done, _ in calls})


@pytest.mark.parametrize("scene", SCENES)
def test_normals_without_a_direction_are_refused(scene):
    rng = np.random.default_rng(5)
    faces = scene(rng)
    photons, (points, normals) = photons_of(faces, rng), points_on(faces, rng)
    normals[5] = 0.0
    with pytest.raises(ValueError, match="normals should hold directions, but vector 5 is zero"):
        pr.estimate_irradiance(photons, points, normals)
    for value in (np.nan, np.inf):
        normals[7, 1] = value
        with pytest.raises(ValueError, match="normals should be finite, but flat element 22"):
            pr.estimate_irradiance(photons, points, normals)
    empty = photons.subset(slice(0, 0))
    with pytest.raises(ValueError, match="normals should be finite"):
        pr.estimate_irradiance(empty, points, normals)
