"""Putting photons back on their surfaces, against rays cast for every one of them."""

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax.relaxation import projection
from photonrelax.relaxation.projection import SurfaceProjector
from photonrelax.transport.raycast import RayCaster
from tests.helpers.tracing_scenes import scene_of


def square(z=0.0):
    corners = [[0, 0, z], [1, 0, z], [1, 1, z], [0, 1, z]]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def photons_on(mesh, n, side=1):
    position, face = trimesh.sample.sample_surface(mesh, n, seed=4)
    normal = side * mesh.face_normals[face]
    return pr.PhotonMap(position, normal, np.ones(n), object_id=np.zeros(n, dtype=int))


def steps_along(normal, length, rng):
    """Steps in tangent planes: most short, some much longer, some none."""
    steps = length * rng.normal(size=normal.shape)
    steps[::40] *= 30.0
    steps[::50] = 0.0
    return steps - (steps * normal).sum(axis=1, keepdims=True) * normal


def project_by_rays(caster, side, start, position, normal, *, moved):
    """The definition: a ray down the normal, and one up where that misses the own object."""
    length = np.linalg.norm(moved - position, axis=1)
    to, to_normal = position.copy(), normal.copy()
    answered = length == 0.0
    for way in (-normal, normal):
        hits = caster.intersect(moved - start[:, None] * way, way)
        own = (hits.object_id == 0) & (hits.distance <= 2.0 * (length + start)) & ~answered
        outward = side * hits.geometric_normal
        lands = own & ((outward * normal).sum(axis=1) >= 0.5)
        to[lands], to_normal[lands] = hits.position[lands], outward[lands]
        answered |= own
    return to, to_normal


CASES = {
    "two triangles": (scene_of(square()), 1),
    "a sphere": (scene_of(trimesh.creation.icosphere(subdivisions=4)), 1),
    "inside a sphere": (scene_of(trimesh.creation.icosphere(subdivisions=2)), -1),
    "a box": (scene_of(trimesh.creation.box((1, 2, 3))), 1),
    "a box through a floor": (scene_of(square(), trimesh.creation.box((1, 1, 1))), 1),
    "a sheet close above": (scene_of(square(), square(1e-4)), 1),
}
each_case = pytest.mark.parametrize(("scene", "side"), CASES.values(), ids=CASES.keys())


@each_case
def test_photons_end_where_rays_would_put_them(scene, side):
    photons = photons_on(scene.objects[0].mesh, 5000, side)
    projector = SurfaceProjector(scene, photons, n_threads=1)
    position, normal = photons.position, photons.normal
    caster = RayCaster(scene.objects)
    start = 2.0 * caster.resolution.at(position)
    rng = np.random.default_rng(0)
    n_moved = 0
    for _ in range(5):
        moved = position + steps_along(normal, 0.02, rng)
        expected = project_by_rays(caster, side, start, position, normal, moved=moved)
        found = projector.project(position, normal, moved, slice(None))
        # Rays of float32 may take the other face at an edge.
        differs = (found[0] != expected[0]).any(axis=1)
        assert differs.mean() < 2e-3
        assert np.abs(found[0] - expected[0]).max() < 1e-6 * scene.scale
        np.testing.assert_array_equal(found[1][~differs], expected[1][~differs])
        n_moved += (found[0] != position).any(axis=1).sum()
        position, normal = found
    assert n_moved > 0.8 * 5 * len(photons)


@pytest.fixture
def rays_cast(monkeypatch):
    """Numbers of rays in the calls of embree."""
    counts, find = [], RayCaster.find

    def counted(self, origins, directions):
        counts.append(len(origins))
        return find(self, origins, directions)

    monkeypatch.setattr(RayCaster, "find", counted)
    return counts


def triangle_of(position):
    """Which triangle of `square` points lie over, 0 or 1."""
    return position[:, 1] > position[:, 0]


def test_rays_are_cast_only_for_photons_that_leave_their_triangles(rays_cast):
    photons = photons_on(square(), 5000)
    projector = SurfaceProjector(scene_of(square()), photons, n_threads=1)
    position, normal = photons.position, photons.normal
    rng = np.random.default_rng(1)
    for _ in range(3):
        moved = position + steps_along(normal, 0.01, rng)
        outside = ((moved[:, :2] < 0.0) | (moved[:, :2] > 1.0)).any(axis=1)
        crossing = triangle_of(moved) != triangle_of(position)
        rays_cast.clear()
        position, normal = projector.project(position, normal, moved, slice(None))
        # Down for both, and up for those that found nothing below.
        assert rays_cast == [(crossing | outside).sum(), outside.sum()]


def test_photons_that_do_not_move_cost_no_ray(rays_cast):
    photons = photons_on(square(), 100)
    projector = SurfaceProjector(scene_of(square()), photons, n_threads=1)
    rays_cast.clear()
    position, normal = projector.project(
        photons.position, photons.normal, photons.position, slice(None)
    )
    assert not rays_cast
    np.testing.assert_array_equal(position, photons.position)
    np.testing.assert_array_equal(normal, photons.normal)


@each_case
def test_order_threads_and_chunks_change_no_bit(monkeypatch, scene, side):
    photons = photons_on(scene.objects[0].mesh, 2000, side)

    def run(n_threads, chunk, orders):
        monkeypatch.setattr(projection, "_CHUNK", chunk)
        projector = SurfaceProjector(scene, photons, n_threads)
        position, normal = photons.position.copy(), photons.normal.copy()
        steps = np.random.default_rng(3)
        for order in orders:
            moved = position + steps_along(normal, 0.05, steps)
            position[order], normal[order] = projector.project(
                position[order], normal[order], moved[order], order
            )
        return position.tobytes(), normal.tobytes()

    shuffled = [np.random.default_rng(i).permutation(2000) for i in range(4)]
    expected = run(1, 10**6, [slice(None)] * 4)
    assert run(2, 100, [slice(None)] * 4) == expected
    assert run(7, 333, shuffled) == expected


def test_some_photons_may_move_while_others_stay():
    scene = CASES["a box"][0]
    photons = photons_on(scene.objects[0].mesh, 1000)
    moved = photons.position + steps_along(photons.normal, 0.05, np.random.default_rng(5))
    whole = SurfaceProjector(scene, photons, 1).project(
        photons.position, photons.normal, moved, slice(None)
    )
    projector = SurfaceProjector(scene, photons, 1)
    for rows in (np.arange(0, 1000, 2), np.arange(1, 1000, 2)):
        part = projector.project(photons.position[rows], photons.normal[rows], moved[rows], rows)
        np.testing.assert_array_equal(part[0], whole[0][rows])
        np.testing.assert_array_equal(part[1], whole[1][rows])


def test_photons_off_every_surface_never_move():
    photons = photons_on(square(), 100)
    lifted = photons.replace(position=photons.position + np.array([0, 0, 0.5]))
    projector = SurfaceProjector(scene_of(square()), lifted, n_threads=1)
    moved = lifted.position + np.array([0.01, 0, 0])
    position, _ = projector.project(lifted.position, lifted.normal, moved, slice(None))
    np.testing.assert_array_equal(position, lifted.position)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_moves_to_nowhere_are_refused(value):
    photons = photons_on(square(), 10)
    projector = SurfaceProjector(scene_of(square()), photons, n_threads=1)
    moved = photons.position.copy()
    moved[3, 0] = value
    with pytest.raises(ValueError, match="finite positions"):
        projector.project(photons.position, photons.normal, moved, slice(None))
