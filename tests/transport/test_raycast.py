"""Ray casting against brute force in NumPy, at every size and place."""

import gc
import sys
import tracemalloc

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax.transport import raycast
from photonrelax.transport.raycast import RayCaster

OFFSETS = [(0.0, 0.0, 0.0), (1e5, -2e5, 3e5)]
SCALES = [1e-4, 1.0, 1e4]


@pytest.fixture
def rng():
    return np.random.default_rng(1)


def diffuse(mesh, **options):
    return pr.SceneObject(mesh, pr.Diffuse(), **options)


def triangle_soup(rng, n=60):
    """Random triangles of size about 1 in a box of size 4."""
    corners = rng.uniform(-2, 2, (n, 1, 3)) + rng.normal(0, 0.7, (n, 3, 3))
    return trimesh.Trimesh(corners.reshape(-1, 3), np.arange(3 * n).reshape(n, 3), process=False)


def rays(rng, n):
    return rng.uniform(-3, 3, (n, 3)), rng.normal(size=(n, 3)) * rng.uniform(0.1, 10, (n, 1))


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def brute_force(triangles, origins, directions):
    """Distance (n,) and id (n,) of the nearest hit, by solving o + t d = a + u ab + v ac."""
    a, ab, ac = triangles[:, 0], *(triangles[:, i] - triangles[:, 0] for i in (1, 2))
    shape = (len(origins), len(triangles), 3)
    columns = [np.broadcast_to(c, shape) for c in (-unit(directions)[:, None], ab[None], ac[None])]
    right = (origins[:, None] - a[None])[..., None]
    t, u, v = np.moveaxis(np.linalg.solve(np.stack(columns, axis=-1), right)[..., 0], -1, 0)
    t = np.where((t > 0) & (u >= 0) & (v >= 0) & (u + v <= 1), t, np.inf)
    return t.min(axis=1), np.where(np.isfinite(t.min(axis=1)), t.argmin(axis=1), -1)


@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.parametrize("scale", SCALES)
def test_hits_are_those_of_brute_force(rng, scale, offset):
    soup = triangle_soup(rng)
    origins, directions = rays(rng, 3000)
    distance, ids = brute_force(soup.triangles, origins, directions)

    offset = scale * np.array(offset)
    moved = trimesh.Trimesh(soup.vertices * scale + offset, soup.faces, process=False)
    hits = RayCaster([diffuse(moved)]).intersect(origins * scale + offset, directions)

    same = hits.face_id == ids
    assert (~same).sum() <= 1  # a ray through an edge may go either way
    near = same & (ids >= 0)
    assert near.sum() > 600
    # What is given at an offset is itself rounded, and grazing rays magnify that.
    rounding = 1e-11 * scale + 1e-13 * np.abs(offset).max()
    np.testing.assert_allclose(hits.distance[near], distance[near] * scale, atol=rounding, rtol=0)
    expected = (origins + unit(directions) * np.where(near, distance, 0)[:, None]) * scale + offset
    np.testing.assert_allclose(hits.position[near], expected[near], atol=rounding, rtol=0)


def test_misses_are_marked(rng):
    hits = RayCaster([diffuse(triangle_soup(rng))]).intersect([[50, 0, 0]], [[1, 0, 0]])
    assert hits.object_id[0] == hits.face_id[0] == -1
    assert hits.distance[0] == np.inf
    assert np.isnan([hits.position, hits.geometric_normal, hits.shading_normal]).all()
    assert not hits.hit[0]


def test_objects_and_faces_keep_their_numbers():
    slab = trimesh.creation.box(extents=(2, 2, 0.1))
    slab.apply_translation((0, 0, 1))
    floor = trimesh.Trimesh(
        # The first face has no area and the last vertex no face: neither shifts the numbers.
        [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [500, 0, 0]],
        [[0, 1, 0], [0, 1, 2], [0, 2, 3]],
        process=False,
    )
    caster = RayCaster([diffuse(slab), diffuse(floor)])
    up_down = caster.intersect([[0.3, -0.2, 0.5], [0.3, -0.2, 0.5]], [[0, 0, 1], [0, 0, -1]])
    np.testing.assert_array_equal(up_down.object_id, [0, 1])
    assert up_down.face_id[1] == 1
    np.testing.assert_allclose(up_down.distance, [0.45, 0.5])
    np.testing.assert_allclose(up_down.geometric_normal, [[0, 0, -1], [0, 0, 1]], atol=1e-15)


def test_normals_follow_the_winding_not_the_ray():
    caster = RayCaster([diffuse(trimesh.creation.icosphere(subdivisions=3))])
    inside = caster.intersect(np.zeros((3, 3)), np.eye(3))
    outside = caster.intersect(3 * np.eye(3), -np.eye(3))
    for hits in (inside, outside):
        outward = (hits.geometric_normal * hits.position).sum(axis=1)
        np.testing.assert_allclose(outward, 1, atol=0.01)
        np.testing.assert_array_equal(hits.shading_normal, hits.geometric_normal)


@pytest.mark.parametrize("scale", [1e-6, 1.0])
def test_smooth_normals_of_a_sphere_are_radial(rng, scale):
    sphere = trimesh.creation.icosphere(subdivisions=4)
    sphere = trimesh.Trimesh(sphere.vertices * scale, sphere.faces, process=False)
    hits = RayCaster([diffuse(sphere, smooth=True)]).intersect(
        np.zeros((2000, 3)), rng.normal(size=(2000, 3))
    )
    radial = unit(hits.position)
    np.testing.assert_allclose(np.linalg.norm(hits.shading_normal, axis=1), 1)
    error = np.linalg.norm(hits.shading_normal - radial, axis=1).max()
    facet_error = np.linalg.norm(hits.geometric_normal - radial, axis=1).max()
    assert error < 0.006 < 0.03 < facet_error


def test_given_vertex_normals_are_interpolated():
    normals = unit(np.array([[0, 0, 1], [1, 0, 1], [0, 0, 1.0]]))
    mesh = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], vertex_normals=normals, process=False
    )
    hit = RayCaster([diffuse(mesh, smooth=True)]).intersect([[0.5, 0.25, 1]], [[0, 0, -1]])
    expected = 0.25 * normals[0] + 0.5 * normals[1] + 0.25 * normals[2]
    np.testing.assert_allclose(hit.shading_normal[0], expected / np.linalg.norm(expected))


@pytest.mark.parametrize("scale", [1e-6, 1.0])
def test_looking_at_the_normals_of_a_mesh_does_not_change_them(scale):
    sphere = trimesh.creation.icosphere(subdivisions=3)
    vertices = scale * np.add(sphere.vertices, [0, 0, 1])
    sphere = trimesh.Trimesh(vertices, sphere.faces, process=False)
    before = diffuse(sphere, smooth=True).shading_normals.normal.tobytes()
    assert sphere.vertex_normals.shape == sphere.vertices.shape
    assert diffuse(sphere, smooth=True).shading_normals.normal.tobytes() == before


def test_normals_that_point_behind_their_face_are_not_used():
    normals = unit(np.array([[0, 0, 1], [1, 0, -3], [0, 0, 1.0]]))
    mesh = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], vertex_normals=normals, process=False
    )
    origins = [[0.1, 0.1, 1], [0.8, 0.1, 1]]
    hits = RayCaster([diffuse(mesh, smooth=True)]).intersect(origins, [[0, 0, -1], [0, 0, -1]])
    expected = 0.8 * normals[0] + 0.1 * normals[1] + 0.1 * normals[2]
    expected = [expected / np.linalg.norm(expected), [0, 0, 1]]
    np.testing.assert_allclose(hits.shading_normal, expected, atol=1e-12)


def hits_on_sphere(rng, n, scale=1.0, offset=(0, 0, 0)):
    """A caster of a fine sphere, and hits on it from inside."""
    sphere = trimesh.creation.icosphere(subdivisions=5)
    centre = scale * np.array(offset, dtype=float)
    moved = trimesh.Trimesh(sphere.vertices * scale + centre, sphere.faces, process=False)
    caster = RayCaster([diffuse(moved)])
    hits = caster.intersect(np.tile(centre, (n, 1)), rng.normal(size=(n, 3)))
    assert hits.hit.all()
    return caster, hits


@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.parametrize("scale", SCALES)
def test_no_ray_hits_the_face_it_leaves(rng, scale, offset):
    n = 20_000
    caster, hits = hits_on_sphere(rng, n, scale, offset)
    away = rng.normal(size=(n, 3))
    grazing = np.arange(n) % 2 == 0
    height = (away * hits.geometric_normal).sum(axis=1, keepdims=True)
    away -= np.where(grazing, 1 - 1e-6, 0)[:, None] * height * hits.geometric_normal
    outward = height[:, 0] > 0
    again = caster.intersect(hits.position, away, origin_offset=hits.offset)
    assert (again.face_id != hits.face_id)[again.hit].all()
    assert not again.hit[outward].any()  # the sphere is convex
    assert again.hit[~outward & ~grazing].all()


def test_unstepped_rays_do_hit_where_they_start(rng):
    caster, hits = hits_on_sphere(rng, 20_000)
    again = caster.intersect(hits.position, hits.geometric_normal)
    assert again.hit.mean() > 0.1


def test_rows_of_nan_or_zero_leave_no_surface(rng):
    caster = RayCaster([diffuse(triangle_soup(rng))])
    origins, directions = rays(rng, 100)
    plain = caster.intersect(origins, directions)
    for origin_offset in (np.zeros((100, 3)), np.full((100, 3), np.nan)):
        marked = caster.intersect(origins, directions, origin_offset=origin_offset)
        np.testing.assert_array_equal(marked.distance, plain.distance)


def test_far_origins_hit_as_precisely_as_near_ones(rng):
    caster = RayCaster([diffuse(triangle_soup(rng))])
    targets = rng.uniform(-2, 2, (2000, 3))
    directions = unit(rng.normal(size=(2000, 3)))
    near = caster.intersect(targets - 10 * directions, directions)
    far = caster.intersect(targets - 1e6 * directions, directions)
    assert (near.face_id != far.face_id).sum() <= 2
    same = (near.face_id == far.face_id) & near.hit
    assert same.sum() > 500
    np.testing.assert_allclose(near.position[same], far.position[same], atol=1e-7)


@pytest.mark.parametrize("n_threads", [1, 2, 7])
def test_batches_and_threads_do_not_change_a_bit(rng, monkeypatch, n_threads):
    caster = RayCaster([diffuse(triangle_soup(rng))])
    origins, directions = rays(rng, 5000)
    whole = caster.intersect(origins, directions)
    blocked = caster.occluded(origins, directions, 1.5)
    monkeypatch.setattr(raycast, "_CHUNK", 333)
    split = caster.intersect(origins, directions, n_threads=n_threads)
    for name in ("object_id", "face_id", "distance", "position", "geometric_normal"):
        np.testing.assert_array_equal(getattr(split, name), getattr(whole, name))
    np.testing.assert_array_equal(
        caster.occluded(origins, directions, 1.5, n_threads=n_threads), blocked
    )


@pytest.mark.parametrize("scale", SCALES)
def test_occluded_means_hit_before_the_limit(rng, scale):
    soup = triangle_soup(rng)
    caster = RayCaster([diffuse(trimesh.Trimesh(soup.vertices * scale, soup.faces))])
    origins, directions = rays(rng, 4000)
    distance = brute_force(soup.triangles, origins, directions)[0] * scale
    limits = rng.uniform(0, 4 * scale, 4000)
    free = caster.occluded(origins * scale, directions, limits) != (distance < limits)
    assert free.sum() <= 1  # a ray through an edge may go either way
    endless = caster.occluded(origins * scale, directions, np.inf) != np.isfinite(distance)
    assert endless.sum() <= 1
    assert not caster.occluded(origins * scale, directions, 0.0).any()


def test_a_limit_counts_from_the_given_origin():
    caster = RayCaster([diffuse(trimesh.creation.box(extents=(2, 2, 2)))])
    origins, down = np.array([[0.1, 0, 1001.0]] * 2), np.array([[0, 0, -1.0]] * 2)
    np.testing.assert_array_equal(caster.occluded(origins, down, [999.9, 1000.1]), [False, True])


def test_leaving_rays_are_not_occluded_by_their_own_surface(rng):
    caster, hits = hits_on_sphere(rng, 5000)
    normal, offset = hits.geometric_normal, hits.offset
    assert not caster.occluded(hits.position, normal, np.inf, origin_offset=offset).any()
    assert caster.occluded(hits.position, -normal, np.inf, origin_offset=offset).all()


def test_no_rays_give_no_intersections(rng):
    caster = RayCaster([diffuse(triangle_soup(rng))])
    assert len(caster.intersect(np.empty((0, 3)), np.empty((0, 3)))) == 0
    assert len(caster.occluded(np.empty((0, 3)), np.empty((0, 3)), 1.0)) == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([[0, 0]], [[0, 0]]), "origins"),
        (([[0, 0, 0]], [[0, 0, 1], [0, 0, 1]]), "directions"),
        (([[0, 0, 0]] * 2, [[0, 0, 1], [0, 0, 0]]), "ray 1"),
        (([[0, 0, 0]] * 2, [[0, 0, 1], [0, np.nan, 0]]), "ray 1"),
        (([[0, np.inf, 0]] * 2, [[0, 0, 1]] * 2), "ray 0"),
    ],
)
def test_what_is_no_ray_is_refused(arguments, message):
    caster = RayCaster([diffuse(trimesh.creation.box())])
    with pytest.raises(ValueError, match=message):
        caster.intersect(*arguments)
    with pytest.raises(ValueError, match=message):
        caster.occluded(*arguments, 1.0)


@pytest.mark.parametrize(
    "directions",
    [np.ones((3, 3), np.float32), np.ones((4, 3)), np.ones((3, 4), np.float32).T],
    ids=["too few", "float64", "another layout"],
)
def test_embree_is_given_only_what_it_reads_within_bounds(directions):
    caster = RayCaster([diffuse(trimesh.creation.box())])
    origins = np.zeros((4, 3), np.float32)
    for rays in ((origins, directions), (directions, origins)):
        with pytest.raises(ValueError, match="C-contiguous float32"):
            caster.find(*rays)


@pytest.mark.parametrize("name", ["primID", "u", "v"])
def test_answers_of_embree_that_do_not_fit_the_rays_are_refused(monkeypatch, name):
    class Broken:
        def run(self, origins, directions, **_):
            n = len(origins)
            found = {"primID": np.zeros(n, np.int32)}
            found |= {"u": np.zeros(n, np.float32), "v": np.zeros(n, np.float32)}
            return found | {name: found[name][1:]}

    caster = RayCaster([diffuse(trimesh.creation.box())])
    monkeypatch.setattr(caster, "_scene", Broken())
    with pytest.raises(ValueError, match=f"its {name} has shape"):
        caster.intersect(np.zeros((5, 3)), np.ones((5, 3)))


@pytest.mark.parametrize("limit", [-1.0, np.nan, [1.0, 2.0]])
def test_bad_limits_are_refused(limit):
    caster = RayCaster([diffuse(trimesh.creation.box())])
    with pytest.raises(ValueError, match="max_distance"):
        caster.occluded([[0, 0, 0]], [[0, 0, 1]], limit)


def test_leaving_must_match_the_rays():
    caster = RayCaster([diffuse(trimesh.creation.box())])
    with pytest.raises(ValueError, match="origin_offset"):
        caster.intersect([[0, 0, 0]], [[0, 0, 1]], origin_offset=[[0, 0, 1], [0, 0, 1]])


def test_what_it_was_made_from_is_freed_with_it_not_later():
    """Meshes hold themselves: without care their arrays wait for the garbage collector."""
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=2.0)
    objects = [pr.SceneObject(mesh, pr.Mirror(), smooth=True)]
    RayCaster(objects)
    gc.collect()
    gc.disable()
    tracemalloc.start()
    try:
        RayCaster(objects)
        left, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
        gc.enable()
    assert left < mesh.vertices.nbytes / 4


def test_without_embree_the_error_says_what_to_do(monkeypatch):
    monkeypatch.setitem(sys.modules, "trimesh.ray.ray_pyembree", None)
    with pytest.raises(ImportError, match="pip install embreex"):
        RayCaster([diffuse(trimesh.creation.box())])
