"""A point has surface near it if the nearest point of a face of similar normal is."""

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

import photonrelax as pr
from photonrelax.surfaces.surface_proximity import SurfaceProximity
from tests.helpers.tracing_scenes import ball, box, sheet


def diffuse(mesh):
    return pr.SceneObject(mesh, pr.Diffuse())


def distances(mesh, points, normals):
    """Distance to the nearest face within 60° of each normal, of either side; trimesh's."""
    result = np.full(len(points), np.inf)
    for i, (point, normal) in enumerate(zip(points, normals, strict=True)):
        facing = np.abs(mesh.face_normals @ normal) >= 0.5
        for triangle in mesh.triangles[facing]:
            nearest = trimesh.triangles.closest_point(triangle[None], point[None])[0]
            result[i] = min(result[i], np.linalg.norm(point - nearest))
    return result


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.mark.parametrize("mesh", [sheet(0.5), box([1, 0.5, 0.2]), ball(0.6, [0, 0, 0], 1)])
def test_points_are_near_up_to_the_distance_of_a_face(mesh):
    rng = np.random.default_rng(0)
    points, normals = rng.normal(size=(60, 3)), unit(rng.normal(size=(60, 3)))
    distance = distances(mesh, points, normals)
    near = SurfaceProximity([diffuse(mesh)]).within
    assert not near(points, normals, np.minimum((1.0 - 1e-9) * distance, 1e9)).any()
    there = np.isfinite(distance)
    assert there.sum() > 5
    np.testing.assert_array_equal(
        near(points, normals, np.where(there, (1.0 + 1e-9) * distance, np.inf)), there
    )


corners = hnp.arrays(np.float64, (3, 3), elements=st.floats(-2, 2, width=16))


@settings(deadline=None)
@given(corners, hnp.arrays(np.float64, (3,), elements=st.floats(-3, 3, width=16)))
def test_the_distance_of_a_triangle_is_the_least_to_its_points(triangle, point):
    mesh = trimesh.Trimesh(triangle, [[0, 1, 2]], process=False)
    normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
    if np.linalg.norm(normal) < 1e-3:
        return
    u, v = np.meshgrid(*[np.linspace(0, 1, 41)] * 2)
    u, v = u[u + v <= 1.0], v[u + v <= 1.0]
    on_it = np.column_stack([1.0 - u - v, u, v]) @ triangle
    sampled = np.linalg.norm(on_it - point, axis=1).min()
    near = SurfaceProximity([diffuse(mesh)]).within
    assert near([point], [normal], sampled + 1e-12)[0]
    spacing = np.linalg.norm(np.diff(triangle[[0, 1, 2, 0]], axis=0), axis=1).max() / 40
    if sampled > 1.5 * spacing:
        assert not near([point], [normal], sampled - 1.5 * spacing)[0]


def test_only_what_stores_photons_counts():
    objects = [
        pr.SceneObject(sheet(1.0), pr.Mirror()),
        pr.SceneObject(ball(1.0, [0, 0, 0]), pr.Dielectric()),
        pr.SceneObject(sheet(1.0, z=2.0), pr.Sensor()),
    ]
    at, up = [[0.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]]
    assert not SurfaceProximity(objects).within(at, up, 1.9)[0]
    assert SurfaceProximity(objects).within(at, up, 2.0)[0]
    assert not SurfaceProximity(objects[:2]).within(at, up, np.inf)[0]


def test_the_result_does_not_depend_on_threads():
    rng = np.random.default_rng(1)
    near = SurfaceProximity([diffuse(ball(0.5, [0, 0, 0], 4))]).within
    points, normals = rng.normal(size=(5000, 3)), rng.normal(size=(5000, 3))
    one, two = (near(points, normals, 0.4, n_threads=n) for n in (1, 2))
    np.testing.assert_array_equal(one, two)
    assert 0 < one.sum() < 5000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([[0, 0]], [[0, 0, 1]], 1.0), "points should have shape"),
        (([[0, 0, 0]], [[0, 0, 0]], 1.0), "normals should hold directions"),
        (([[0, 0, 0]], [[0, 0, 1]], [1.0, 2.0]), "radius should be a number or broadcast"),
        (([[0, 0, 0]], [[0, 0, 1]], np.nan), "radius should hold no negative number and no NaN"),
    ],
)
def test_arguments_are_checked(arguments, message):
    with pytest.raises(ValueError, match=message):
        SurfaceProximity([diffuse(sheet(1.0))]).within(*arguments)
