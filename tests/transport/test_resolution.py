"""Light and images do not depend on how float32 rounds: wide floors, gaps, cameras on surfaces."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import photonrelax as pr
from photonrelax.scene.resolution import MAX_SPREAD, Resolution
from photonrelax.transport.raycast import RayCaster
from photonrelax.transport.split_triangles import split_triangles

LEVEL = Rotation.identity()
TURNED = Rotation.from_rotvec([0.3, 0.5, 0.2])


def sheet(half, height=0.0):
    corners = [[-half, -half, height], [half, -half, height], [half, half, height]]
    corners.append([-half, half, height])
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def moved(mesh, rotation, shift):
    vertices = rotation.apply(np.asarray(mesh.vertices)) + shift
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


def hollow_ball():
    """A glass ball of 10 cm with walls of 2 mm, 3 cm above the plane z = 0."""
    outer = trimesh.creation.icosphere(3, 0.05)
    inner = trimesh.creation.icosphere(3, 0.048)
    vertices = np.concatenate([outer.vertices, inner.vertices]) + np.array([0, 0, 0.08])
    faces = np.concatenate([outer.faces, inner.faces[:, ::-1] + len(outer.vertices)])
    return trimesh.Trimesh(vertices, faces, process=False)


CASTERS = {
    "glass": (hollow_ball, pr.Dielectric(1.5)),
    "mirror": (lambda: moved(trimesh.creation.icosphere(3, 0.05), TURNED, 0.05), pr.Mirror()),
}


def stored(half, caster, emitter, rotation=LEVEL, shift=0.0):
    """Flux, W, stored within 1 m, and the median distance, m."""
    mesh, material = CASTERS[caster]
    objects = [
        pr.SceneObject(moved(mesh(), rotation, shift), material),
        pr.SceneObject(moved(sheet(half), rotation, shift), pr.Diffuse(0.5)),
    ]
    photons = pr.trace_photons(pr.Scene(objects, [emitter]), 20_000, max_bounces=1000)
    distance = np.linalg.norm(rotation.inv().apply(photons.position - shift), axis=1)
    near = distance < 1.0
    return photons.flux[near, 0].sum(), np.median(distance[near])


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("caster", CASTERS)
@pytest.mark.parametrize("half", [1e3, 1e6])
@pytest.mark.parametrize("source", ["sun", "lamp"])
def test_light_does_not_depend_on_how_far_the_floor_reaches(caster, half, source):
    lamp = pr.PointEmitter((0.1, 0.05, 0.3))
    emitter = pr.CollimatedEmitter((0.2, 0, -1)) if source == "sun" else lamp
    np.testing.assert_allclose(
        stored(half, caster, emitter), stored(2.0, caster, emitter), rtol=2e-3
    )


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("shift", [0.0, 1e4])
@pytest.mark.parametrize("height", [0.0, 0.3])
def test_nor_does_that_of_lamps_over_or_on_tilted_floors(shift, height):
    emitter = pr.PointEmitter(TURNED.apply([0.1, 0.05, height]) + shift)
    small, wide = (stored(half, "glass", emitter, TURNED, shift) for half in (2.0, 1e6))
    np.testing.assert_allclose(wide, small, rtol=2e-3)


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("caster", CASTERS)
@pytest.mark.parametrize("half", [1e3, 1e5, 1e6])
@pytest.mark.parametrize("shift", [0.0, 1e4])
def test_nor_does_parallel_light_on_tilted_floors(caster, half, shift):
    emitter = pr.CollimatedEmitter(TURNED.apply([0.2, 0.0, -1.0]))
    small, wide = (stored(each, caster, emitter, TURNED, shift) for each in (2.0, half))
    np.testing.assert_allclose(wide, small, rtol=2e-3)


def test_far_blockers_before_the_fine_part_are_hit():
    """A shade far up the light on a wide, tilted floor keeps all light from the ball."""
    up = TURNED.apply([0.0, 0.0, 1.0])
    shade = pr.SceneObject(moved(sheet(1.0), TURNED, 3e5 * up), pr.Diffuse(0.0))
    ball = pr.SceneObject(moved(hollow_ball(), TURNED, 0.0), pr.Dielectric(1.5))
    floor = pr.SceneObject(moved(sheet(1e6), TURNED, 0.0), pr.Diffuse(0.5))
    sun = pr.CollimatedEmitter(-up)
    assert len(pr.trace_photons(pr.Scene([ball, floor], [sun]), 1000))
    with pytest.raises(ValueError, match="stand between the emitters and the specular ones"):
        pr.trace_photons(pr.Scene([ball, floor, shade], [sun]), 1000)


@pytest.mark.parametrize("half", [2.0, 10.0, 1e3, 1e5])
@pytest.mark.parametrize("distance", [2.0, 20.0, 1e4])
def test_near_blockers_before_the_fine_part_are_hit(half, distance):
    """A sheet over a ball of 1 cm: cubes around the ball reach beyond the box of a wide floor."""
    ball = pr.SceneObject(trimesh.creation.icosphere(2, 0.005), pr.Mirror())
    floor = pr.SceneObject(sheet(half, -0.01), pr.Diffuse(0.5))
    caster = RayCaster([floor, ball, pr.SceneObject(sheet(1.0, 0.25), pr.Mirror())])
    hits = caster.intersect([[0.001, 0.002, distance]], [[0.0, 0.0, -1.0]])
    assert hits.object_id.tolist() == [2]
    assert hits.distance[0] == pytest.approx(distance - 0.25, rel=1e-9)


def test_cameras_far_away_see_small_things_on_wide_tilted_floors():
    """The share of the pixels that see a ball, from 1 m and from 100 km."""
    objects = [
        pr.SceneObject(moved(hollow_ball(), TURNED, 0.0), pr.Mirror()),
        pr.SceneObject(moved(sheet(1e6), TURNED, 0.0), pr.Diffuse(0.5)),
    ]
    rays = np.random.default_rng(0).uniform(-0.1, 0.1, (20_000, 2))
    seen = []
    for distance in (1.0, 1e5):
        origin = TURNED.apply(np.column_stack([rays, np.full(len(rays), distance)]))
        down = np.broadcast_to(TURNED.apply([0.0, 0.0, -1.0]), origin.shape)
        seen.append(RayCaster(objects).intersect(origin, down).object_id == 0)
    assert np.count_nonzero(seen[0] != seen[1]) <= 5


def moved_share(half):
    """Share of the photons of a glass ball's caustic that relaxation moves."""
    objects = [
        pr.SceneObject(hollow_ball(), pr.Dielectric(1.5)),
        pr.SceneObject(sheet(half), pr.Diffuse(0.5)),
    ]
    scene = pr.Scene(objects, [pr.CollimatedEmitter((0.2, 0, -1))])
    photons = pr.trace_photons(scene, 20_000)
    relaxed = pr.relax(photons, pr.detect_structure(photons), scene=scene)
    return (relaxed.position != photons.position).any(axis=1).mean()


def test_photons_move_on_floors_of_any_width():
    assert moved_share(1e6) == pytest.approx(moved_share(2.0), abs=0.01)


def transmitted(gap, thickness=0.1, floor=20.0, rotation=LEVEL, soup=False):
    """Share of the light on a plate of glass of 2 m that is stored below it."""
    plate = trimesh.creation.box((2, 2, thickness)).apply_translation([0, 0, thickness / 2 + gap])
    if soup:
        plate.unmerge_vertices()
    objects = [
        pr.SceneObject(moved(plate, rotation, 0.0), pr.Dielectric(1.5)),
        pr.SceneObject(moved(sheet(floor), rotation, 0.0), pr.Diffuse(0.5)),
    ]
    light = pr.CollimatedEmitter(rotation.apply((0.0, 0.0, -1.0)))
    photons = pr.trace_photons(pr.Scene(objects, [light]), 20_000, max_bounces=1000)
    return photons.flux[:, 0].sum() / 4.0


TRANSMITTANCE = 0.96**2 / (1 - 0.04**2)
"""Of a plate of index 1.5, with all reflections inside."""


@pytest.mark.parametrize("gap", [1e-2, 1e-4, 1e-5, 1e-6, 1e-8, 0.0, -1e-7])
@pytest.mark.parametrize("rotation", [LEVEL, TURNED], ids=["level", "tilted"])
def test_light_leaves_glass_that_stands_on_its_table(gap, rotation):
    assert transmitted(gap, rotation=rotation) == pytest.approx(TRANSMITTANCE, rel=0.01)


def test_faces_without_common_vertices_move_together():
    assert transmitted(0.0, soup=True) == transmitted(0.0)


@pytest.mark.parametrize("thickness", [1e-1, 1e-2, 1e-3, 1e-4])
def test_light_passes_thin_plates(thickness):
    assert transmitted(0.5, thickness, 2.0) == pytest.approx(TRANSMITTANCE, rel=0.01)


def test_plates_thinner_than_rays_resolve_are_named():
    with pytest.warns(UserWarning, match=r"objects\[0\] is about 1e-06 m thick"):
        transmitted(0.5, 1e-6, 2.0)


def depth(camera_height):
    """Depths seen by a camera that looks up from a floor, to a ceiling and a mirror."""
    objects = [
        pr.SceneObject(sheet(10.0), pr.Diffuse(0.8)),
        pr.SceneObject(sheet(10.0, 5.0), pr.Diffuse(0.8)),
        pr.SceneObject(sheet(1.0, 3.0), pr.Mirror()),
    ]
    camera = pr.Camera((1, 1, camera_height), (5, 5, 5.0), width=16, height=16)
    scene = pr.Scene(objects, [pr.PointEmitter((0, 0, 1))], camera)
    return pr.render(scene, n_emitted=2000, method="standard").layers["Z"]


def test_a_camera_on_a_floor_sees_what_one_just_above_sees():
    on, above = depth(0.0), depth(1e-3)
    seen = np.isfinite(above)
    np.testing.assert_array_equal(np.isfinite(on), seen)
    assert (np.abs(on[seen] - above[seen]) > 0.01).mean() < 0.05


def test_pieces_of_triangles_cover_them_and_reach_no_farther_than_allowed():
    vertices = np.array([[-1e6, -9e5, -3.0], [1.1e6, -1e6, 5.0], [2e5, 1e6, 2.0]])
    radius = 0.1
    pieces = split_triangles(vertices, np.array([[0, 1, 2]]), radius)
    corners = pieces.corners(vertices, np.array([[0, 1, 2]]))
    edges = pieces.uv[:, 1:] - pieces.uv[:, :1]
    area = np.abs(np.linalg.det(edges)).sum()
    assert area == pytest.approx(1.0, rel=1e-12)
    nearest = np.maximum(corners.min(axis=1), -corners.max(axis=1)).max(axis=1)
    assert (np.abs(corners).max(axis=(1, 2)) <= MAX_SPREAD * np.maximum(nearest, radius)).all()
    assert len(pieces) < 5000


def test_small_triangles_are_not_split():
    sphere = trimesh.creation.icosphere(3, 1.0)
    resolution = Resolution.of(np.asarray(sphere.vertices), sphere.faces)
    vertices = np.asarray(sphere.vertices) - resolution.origin
    assert len(split_triangles(vertices, sphere.faces, resolution.radius)) == 0


def test_resolution_is_finest_where_the_triangles_are():
    ball, floor = trimesh.creation.icosphere(3, 0.1), sheet(1e5)
    shift = np.array([300.0, 20.0, 5.0])
    whole = trimesh.util.concatenate(moved(ball, LEVEL, shift), floor)
    resolution = Resolution.of(np.asarray(whole.vertices), whole.faces)
    np.testing.assert_allclose(resolution.origin, shift, atol=0.01)
    assert resolution.at(shift) < 1e-5 < resolution.at(np.zeros(3))
