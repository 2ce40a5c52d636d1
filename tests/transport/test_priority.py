"""Dielectrics that overlap: that of the largest priority rules; surfaces inside it are not there.

Rays of cameras and photons are compared, path by path, with those of a tracer that knows no stack
and finds the medium at each point anew; then layers in closed form, and what has to hold for any.
"""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from photonrelax._ext.transport.materials import Materials
from scipy.spatial import cKDTree

import photonrelax as pr
from photonrelax.scene.camera import pixel_rays
from photonrelax.scene.digest import scene_digest
from photonrelax.transport import raycast
from photonrelax.transport.aim import LUMINANCE
from photonrelax.transport.direct_light import direct_irradiance
from photonrelax.transport.frequency.paraxial import emitted_rays
from photonrelax.transport.frequency.path_replay import PathEvents, PathReplayer
from photonrelax.transport.hit_points import trace_hit_points
from photonrelax.transport.media import MediaFinder
from photonrelax.transport.raycast import RayCaster
from tests.analytic.convex_bodies import Body, Path, paths_to_opaque
from tests.analytic.interface import fresnel_reflectance
from tests.helpers.tracing_scenes import ball

RED, GREEN, BLUE = np.array([1.0, 0.2, 0.1]), np.array([0.3, 1.0, 0.2]), np.array([0.1, 0.4, 1.0])
TURNED = trimesh.transformations.euler_matrix(0.3, 0.5, 0.2)
TILTED = trimesh.transformations.euler_matrix(-0.2, 0.1, 0.7)


def box(low, high, turn=None):
    """A box between two corners, turned around its middle."""
    mesh = trimesh.creation.box(bounds=[low, high])
    if turn is not None:
        middle = mesh.centroid
        mesh.apply_translation(-middle)
        mesh.apply_transform(turn)
        mesh.apply_translation(middle)
    return mesh


def floor(albedo=0.0):
    return pr.SceneObject(box([-6, -6, -2], [6, 6, 0]), pr.Diffuse(albedo), "floor")


def glass(mesh, ior, name="", **options):
    return pr.SceneObject(mesh, pr.Dielectric(ior, **options), name)


def body_of(item):
    """A convex object as half-spaces."""
    normals = item.mesh.face_normals
    _, first = np.unique(np.round(normals, 9), axis=0, return_index=True)
    heights = np.einsum("ij,ij->i", normals, item.mesh.triangles[:, 0])
    body, material = Body(normals[first], heights[first]), item.material
    if isinstance(material, pr.Diffuse):
        return body
    return replace(
        body,
        ior=material.ior,
        priority=material.priority,
        absorption=material.absorption,
        tint=material.tint,
    )


POWER = np.array([3.0, 2.0, 1.0])
LIQUID = box([-1.02, -1.02, 0.28], [1.02, 1.02, 1.4])
CUP = box([-1.5, -1.4, 0.1], [1.6, 1.5, 0.3])
WALL = box([-1.45, -1.3, 0.2], [-1.0, 1.4, 1.6])
BODIES = {
    "liquid that reaches into its glass": [
        glass(LIQUID, 1.33, absorption=RED),
        glass(CUP, 1.5, priority=2, absorption=GREEN),
        glass(WALL, 1.6, priority=1, tint=(0.9, 0.8, 1.0)),
    ],
    "glass that reaches into its liquid": [
        glass(LIQUID, 1.33, priority=3, absorption=RED),
        glass(CUP, 1.5, priority=2, absorption=GREEN),
        glass(WALL, 1.6, priority=1, tint=(0.9, 0.8, 1.0)),
    ],
    "bubble in glass": [
        glass(box([-0.5, -0.4, 0.4], [0.5, 0.6, 1.2], TURNED), 1.0, priority=1),
        glass(box([-1.5, -1.5, 0.2], [1.5, 1.5, 1.5], TILTED), 1.5, absorption=GREEN),
    ],
    "bubble of low priority: glass throughout": [
        glass(box([-0.5, -0.4, 0.4], [0.5, 0.6, 1.2], TURNED), 1.0, priority=-1),
        glass(box([-1.5, -1.5, 0.2], [1.5, 1.5, 1.5], TILTED), 1.5, absorption=GREEN),
    ],
    "ice half out of the water": [
        glass(box([-0.5, -0.4, 0.7], [0.5, 0.6, 1.6], TURNED), 1.31, priority=1, absorption=BLUE),
        glass(box([-2.5, -2.5, 0.1], [2.5, 2.5, 1.1]), 1.33, absorption=RED),
    ],
    "ice that water rules: only what is out": [
        glass(box([-0.5, -0.4, 0.7], [0.5, 0.6, 1.6], TURNED), 1.31, priority=-1, absorption=BLUE),
        glass(box([-2.5, -2.5, 0.1], [2.5, 2.5, 1.1]), 1.33, absorption=RED),
    ],
    "three that overlap": [
        glass(box([-0.9, -0.7, 0.2], [0.5, 0.6, 1.2], TURNED), 1.7, priority=-5, absorption=RED),
        glass(box([-0.4, -0.8, 0.5], [1.0, 0.4, 1.5], TILTED), 1.2, priority=7, absorption=GREEN),
        glass(box([-0.6, -0.3, 0.3], [0.7, 0.9, 1.4], TILTED.T), 1.5, tint=0.8, absorption=BLUE),
    ],
}
each_nesting = pytest.mark.parametrize("name", BODIES)
# Outside of all, and where bodies overlap.
EYES = {"outside": (0.4, -2.6, 2.5), "inside": (0.1, 0.15, 0.95)}
each_eye = pytest.mark.parametrize("eye", EYES)


def scene_of(objects, emitter=None, camera=None):
    return pr.Scene([floor(), *objects], [emitter or pr.PointEmitter([0, 0, 5.0])], camera)


def looking_from(position, width=8):
    return pr.Camera(position, (0.05, 0.02, 0.01), width=width, height=width, vertical_fov=50.0)


STRAIGHT_DOWN = pr.Camera((0.1, 0.2, 3.0), (0.1, 0.2, 0.0), up=(0, 1, 0), width=1, height=1)


def camera_points(scene, camera, **options):
    caster = RayCaster(scene.objects)
    return trace_hit_points(scene, caster, camera, range(camera.height), **options)


@each_eye
@each_nesting
def test_cameras_see_by_the_medium_at_every_point(name, eye):
    """All points that 64 rays split to, by up to 7 events, and their weights."""
    camera = looking_from(EYES[eye])
    points, _ = camera_points(scene_of(BODIES[name]), camera, max_depth=7)
    bodies = [body_of(item) for item in scene_of(BODIES[name]).objects]
    origins, directions, _ = pixel_rays(camera, range(camera.height), 1)
    for pixel, (origin, direction) in enumerate(zip(origins, directions, strict=True)):
        start = Path(origin, direction, np.ones(3))
        expected = list(paths_to_opaque(bodies, start, 7, least=1e-3))
        mine = points.pixel == pixel
        assert_same_rows(
            np.hstack([points.position[mine], points.weight[mine]]),
            np.array([[*end.origin, *(end.radiance * end.flux)] for end in expected]),
        )
    assert len(points) > 60


def assert_same_rows(actual, expected):
    """Rows in any order, each near to one of the others."""
    assert len(actual) == len(expected)
    if len(actual):
        distance, nearest = cKDTree(expected).query(actual)
        assert len(np.unique(nearest)) == len(expected)
        assert distance.max() < 1e-9


@each_eye
@each_nesting
def test_photons_go_by_the_medium_at_every_point(name, eye):
    """Position, direction, length and colour of each is that of a path with as many bounces."""
    scene = scene_of(BODIES[name], pr.PointEmitter(EYES[eye], POWER))
    photons = pr.trace_photons(scene, 200, paths="all", max_bounces=6)
    bodies = [body_of(item) for item in scene.objects]
    # Rays of lamps start off the surface that they may lie on.
    offset = scene.emitter_offset(scene.emitters[0])
    for i in range(len(photons)):
        direction = photons.emitter_coords[i]
        start = Path(EYES[eye] + offset * direction, direction, POWER, length=offset)
        ends = paths_to_opaque(bodies, start, int(photons.n_bounces[i]))
        ends = [end for end in ends if end.bounces == photons.n_bounces[i]]
        expected = np.array([[*end.origin, *end.direction, end.length] for end in ends])
        actual = [*photons.position[i], *-photons.wi[i], photons.path_length[i]]
        nearest = np.abs(expected - actual).max(axis=1).argmin()
        np.testing.assert_allclose(actual, expected[nearest], rtol=0, atol=1e-9)
        colour, flux = ends[nearest].flux, photons.flux[i]
        np.testing.assert_allclose(
            flux / (flux @ LUMINANCE), colour / (colour @ LUMINANCE), rtol=1e-9
        )
    assert len(photons) > 20
    assert photons.ledger.imbalance < 1e-9


@pytest.mark.kernels_run_elsewhere
@each_nesting
def test_flux_through_overlaps_is_that_of_all_paths(name):
    """Means over photons against sums over paths of the shares that arrive."""
    scene = scene_of(BODIES[name], pr.PointEmitter(EYES["inside"], POWER))
    photons = pr.trace_photons(scene, 40_000, paths="all", max_bounces=6)
    bodies = [body_of(item) for item in scene.objects]
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(400, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    starts = [Path(np.array(EYES["inside"]), direction, POWER) for direction in directions]
    arriving = [
        sum((end.flux for end in paths_to_opaque(bodies, start, 6, least=1e-4)), np.zeros(3))
        for start in starts
    ]
    doubt = 4.0 * np.std(arriving, axis=0) / np.sqrt(len(arriving))
    np.testing.assert_array_less(
        np.abs(photons.flux.sum(axis=0) - np.mean(arriving, axis=0)), doubt
    )


WATER = glass(box([-3, -3, 0.1], [3, 3, 2.0]), 1.33, "water", absorption=RED)
PEBBLE = ball(0.4, [0.1, 0.2, 1.0])
HIDDEN = glass(PEBBLE, 1.7, "pebble", priority=-1, absorption=5.0, tint=0.1)


# Straight from above to the floor, and media with their depths; surfaces in one plane are moved.
ICE = {"absorption": BLUE, "priority": 1}
TOUCHING = {
    "liquid on the bottom of its glass": (
        [
            glass(box([-3, -3, 0.5], [3, 3, 1.0]), 1.5, absorption=GREEN, priority=2),
            glass(box([-2, -2, 1.0], [2, 2, 2.0]), 1.33, absorption=RED),
        ],
        [(1.33, RED * 1.0), (1.5, GREEN * 0.5), (1.0, 0.0)],
    ),
    "ice at the surface of the water": (
        [
            glass(box([-3, -3, 0.5], [3, 3, 2.0]), 1.33, absorption=RED),
            glass(box([-2, -2, 1.5], [2, 2, 2.0]), 1.31, **ICE),
        ],
        [(1.31, BLUE * 0.5), (1.33, RED * 1.0), (1.0, 0.0)],
    ),
    "a lid of ice that water rules": (
        [
            glass(box([-3, -3, 0.5], [3, 3, 2.0]), 1.33, absorption=RED, priority=2),
            glass(box([-2, -2, 1.5], [2, 2, 2.0]), 1.31, **ICE),
        ],
        [(1.33, RED * 1.5), (1.0, 0.0)],
    ),
}


@pytest.mark.parametrize("name", TOUCHING)
def test_surfaces_in_one_plane_are_those_of_the_body_that_rules(name):
    objects, media = TOUCHING[name]
    points, _ = camera_points(scene_of(objects), STRAIGHT_DOWN)
    seen = points.weight[points.weight[:, 0].argmax()]
    np.testing.assert_allclose(seen, through_layers(media), rtol=1e-3)


def through_layers(media):
    """Share of light straight from the air through layers, each an index and its optical depth."""
    share, outside = np.ones(3), 1.0
    for ior, depth in media:
        share *= (1.0 - fresnel_reflectance(0.0, ior / outside)) * np.exp(-np.multiply(depth, 1))
        outside = ior
    return share


def test_rays_from_afar_pass_bodies_that_are_not_there():
    """Over a floor so wide that rays are moved to where triangles are fine."""
    wide = pr.SceneObject(box([-1e5, -1e5, -2], [1e5, 1e5, 0]), pr.Diffuse(0.0))
    camera = pr.Camera((300.0, 200.0, 4e4), (0.0, 0.0, 1.0), width=8, height=8, vertical_fov=4e-3)
    seen = []
    for objects in ([WATER], [WATER, HIDDEN]):
        scene = pr.Scene([wide, *objects], [pr.PointEmitter([0, 0, 9.0])])
        seen.append(camera_points(scene, camera)[0])
    np.testing.assert_allclose(seen[1].weight, seen[0].weight, rtol=1e-6)
    np.testing.assert_allclose(seen[1].position, seen[0].position, atol=1e-6)


@pytest.mark.parametrize("paths", ["caustic", "all"])
def test_a_body_inside_of_one_of_larger_priority_is_not_there(paths):
    """Photons, their bounces and signatures, and spectra."""
    lamp = pr.PointEmitter([0.5, 0.2, 4.0], (3.0, 2.0, 1.0))
    without, with_body = (
        pr.trace_photons(scene_of(objects, lamp), 3000, paths=paths, frequency_share=0.02)
        for objects in ([WATER], [WATER, HIDDEN])
    )
    assert len(without) == len(with_body)
    for name in ("n_bounces", "path_signature", "object_id"):
        np.testing.assert_array_equal(getattr(with_body, name), getattr(without, name))
    for name in ("position", "wi", "flux", "path_length"):
        np.testing.assert_allclose(
            getattr(with_body, name), getattr(without, name), rtol=1e-9, atol=1e-9
        )
    seen = np.isfinite(without.spectrum[:, 0])
    np.testing.assert_array_equal(np.isfinite(with_body.spectrum[:, 0]), seen)
    assert seen.any()
    np.testing.assert_allclose(with_body.spectrum[seen], without.spectrum[seen], rtol=1e-4)


@pytest.mark.parametrize("position", [(0.4, -2.6, 4.0), (0.1, 0.2, 1.1), (0.5, -0.5, 1.8)])
def test_cameras_look_through_a_body_that_is_not_there(position):
    """From above the water, in the body, and beside it: points, footprints, first surfaces."""
    camera = looking_from(position)
    (without, first), (with_body, first_with) = (
        camera_points(scene_of(objects), camera, supersampling=2)
        for objects in ([WATER], [WATER, HIDDEN])
    )
    for name in ("position", "weight", "footprint", "normal"):
        np.testing.assert_allclose(
            getattr(with_body, name), getattr(without, name), rtol=1e-9, atol=1e-9, err_msg=name
        )
    np.testing.assert_array_equal(with_body.pixel, without.pixel)
    np.testing.assert_allclose(first_with.depth, first.depth, rtol=1e-9)
    np.testing.assert_allclose(first_with.normal, first.normal, atol=1e-9)


def test_direct_light_passes_a_body_that_is_not_there():
    """From a lamp in the water; a body that is there casts a shadow, as it refracts light."""
    lamp = pr.PointEmitter([0.1, 0.2, 1.7], 4.0 * np.pi)
    x = np.linspace(-1.0, 1.0, 21)
    points = np.column_stack([x, np.zeros_like(x), np.zeros_like(x)])
    up = np.tile([0.0, 0.0, 1.0], (len(x), 1))

    def light(*objects):
        scene = scene_of(objects, lamp)
        return direct_irradiance(scene, RayCaster(scene.objects), points, up)

    water = glass(box([-3, -3, -0.5], [3, 3, 2.0]), 1.33, absorption=RED)
    np.testing.assert_array_equal(light(water, HIDDEN), light(water))
    assert light(water, HIDDEN).min() > 0.0
    there = replace(HIDDEN, material=pr.Dielectric(1.7, priority=1))
    assert (light(water, there) == 0.0).any()
    wall = pr.SceneObject(box([-0.3, -0.3, 0.3], [0.3, 0.3, 0.4]), pr.Diffuse(0.5))
    np.testing.assert_array_equal(light(water, HIDDEN, wall), light(water, wall))
    assert (light(water, wall) == 0.0).any()


def test_photons_without_bounces_and_direct_light_agree():
    """A body that is not there neither blocks direct light nor makes it a caustic."""
    lamp = pr.PointEmitter([0.1, 0.2, 1.7], 4.0 * np.pi)
    water = glass(box([-3, -3, -0.5], [3, 3, 2.0]), 1.33, absorption=RED)
    scene = scene_of([water, HIDDEN], lamp)
    photons = pr.trace_photons(scene, 400_000, paths="all")
    near = np.linalg.norm(photons.position[:, :2] - [0.1, 0.2], axis=1) < 0.2
    direct = photons.subset(near & (photons.n_bounces == 0) & (photons.object_id == 0))
    expected = direct_irradiance(
        scene, RayCaster(scene.objects), [[0.1, 0.2, 0.0]], [[0.0, 0.0, 1.0]]
    )
    density = direct.flux.sum(axis=0) / (np.pi * 0.2**2)
    np.testing.assert_allclose(density, expected[0], rtol=0.05)


def test_replayed_paths_skip_surfaces_that_are_not_there():
    """Straight down through water that reaches into a plate: water, plate, air, floor."""
    plate = pr.Dielectric(1.5, absorption=GREEN, priority=1)
    water = glass(box([-3, -3, 0.7], [3, 3, 2.0]), 1.33, absorption=RED)
    scene = scene_of([water, pr.SceneObject(box([-3, -3, 0.5], [3, 3, 1.0]), plate), HIDDEN])
    across = np.eye(3)[None, :2]
    rays = emitted_rays(
        np.array([[0.1, 0.2, 3.0]]), np.array([[0.0, 0.0, -1.0]]), across, travelled=0.0, media=0
    )
    events = PathEvents(np.array([[1, 2, 2, 0]]), np.zeros((1, 4), dtype=bool), np.array([4]))
    hits = PathReplayer(scene, RayCaster(scene.objects)).replay(rays, events)
    share = np.prod([1.0 - fresnel_reflectance(0.0, ior) for ior in (1.33, 1.5 / 1.33, 1.5)])
    depths = RED * 1.0 + GREEN * 0.5
    np.testing.assert_allclose(hits.throughput[0], share * np.exp(-depths), rtol=1e-9)
    np.testing.assert_allclose(hits.position[0], [0.1, 0.2, 0.0], atol=1e-12)


def test_sensors_in_overlaps_store_light_once():
    """Light through a sensor inside of a body that is not there, absorbed up to it."""
    lamp = pr.CollimatedEmitter([0, 0, -1])
    sensor = pr.SceneObject(box([-2, -2, 1.0], [2, 2, 1.0 + 1e-3]), pr.Sensor(), "sensor")
    photons = pr.trace_photons(scene_of([WATER, HIDDEN, sensor], lamp), 100_000, paths="caustic")
    crossed = photons.subset((photons.object_id == 3) & (photons.normal[:, 2] > 0))
    once = crossed.subset((crossed.n_bounces == 1) & (crossed.position[:, 2] > 1.0))
    expected = (1.0 - fresnel_reflectance(0.0, 1.33)) * np.exp(-RED * 1.0)
    np.testing.assert_allclose(once.flux.sum(axis=0) / 16.0, expected, rtol=0.04)


def test_equal_priorities_are_none():
    """To the bit; of overlapping bodies that entered last rules."""
    plain = [
        glass(box([-1, -1, 0.2], [1, 1, 1.0], TURNED), 1.5, absorption=GREEN),
        glass(box([-1, -1, 0.6], [1, 1, 1.4], TILTED), 1.33, absorption=RED),
    ]
    equal = [replace(item, material=replace(item.material, priority=7)) for item in plain]
    first, second = (pr.trace_photons(scene_of(objects), 3000) for objects in (plain, equal))
    for name in ("position", "flux", "n_bounces", "path_signature", "path_length"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    points, again = (
        camera_points(scene_of(objects), looking_from(EYES["inside"]))[0]
        for objects in (plain, equal)
    )
    np.testing.assert_array_equal(points.weight, again.weight)


def test_ties_go_to_the_body_entered_last_below_those_of_larger_priority():
    """Straight down through a plate that rules over two equal ones that overlap it."""
    objects = [
        glass(box([-3, -3, 0.5], [3, 3, 2.0]), 1.33, absorption=RED),
        glass(box([-3, -3, 1.0], [3, 3, 1.6]), 1.6, priority=1, absorption=BLUE),
        glass(box([-3, -3, 0.7], [3, 3, 1.8]), 1.5, absorption=GREEN),
    ]
    points, _ = camera_points(scene_of(objects), STRAIGHT_DOWN)
    # Lengths in the media from above: the inner plate entered last rules in its half of the tie.
    media = [(1.33, RED * 0.2), (1.5, GREEN * 0.2), (1.6, BLUE * 0.6), (1.5, GREEN * 0.3)]
    media += [(1.33, RED * 0.2), (1.0, 0.0)]
    seen = points.weight[points.weight[:, 0].argmax()]
    np.testing.assert_allclose(seen, through_layers(media), rtol=1e-9)


def stacks_at(objects, *positions):
    """Objects that lamps at positions lie in, that which rules first."""
    scene = pr.Scene([floor(), *objects], [pr.PointEmitter(p) for p in positions])
    materials = Materials(scene.material_table())
    media = MediaFinder(scene, RayCaster(scene.objects), materials).at_emitters()
    entries = [[int(stack) >> shift & 255 for shift in range(0, 64, 8)] for stack in media]
    return [[int(materials.dielectrics[i - 1]) for i in stack if i] for stack in entries]


def test_media_of_lamps_are_ranked_by_priority_then_from_the_innermost_on():
    nested = [
        glass(ball(1.0, [0, 0, 2.0]), 1.5),
        glass(ball(0.5, [0, 0, 2.0]), 1.4, priority=-2),
        glass(ball(1.8, [0, 0, 2.0]), 1.3, priority=3),
        glass(ball(1.4, [0, 0, 2.0]), 1.2),
    ]
    assert stacks_at(nested, [0.1, 0, 2.0], [0.7, 0, 2.0], [1.2, 0, 2.0], [1.6, 0, 2.0]) == [
        [3, 1, 4, 2],
        [3, 1, 4],
        [3, 4],
        [3],
    ]


def test_results_do_not_depend_on_threads():
    scene = scene_of(BODIES["three that overlap"], pr.PointEmitter(EYES["inside"]))
    camera = looking_from(EYES["inside"], 24)
    photons, points = (
        [function(n) for n in (1, 2, 7)]
        for function in (
            lambda n: pr.trace_photons(scene, 20_000, paths="all", n_threads=n, batch_size=2048),
            lambda n: camera_points(scene, camera, n_threads=n)[0],
        )
    )
    for other in photons[1:]:
        np.testing.assert_array_equal(other.position, photons[0].position)
        np.testing.assert_array_equal(other.flux, photons[0].flux)
        np.testing.assert_array_equal(other.ledger.absorbed, photons[0].ledger.absorbed)
    for other in points[1:]:
        np.testing.assert_array_equal(other.weight, points[0].weight)


@pytest.mark.parametrize(
    ("position", "index"),
    [((-2.5, 0.3, 0.2), 1.0), ((0.1, 0.1, 0.4), 1.5), ((0.1, 0.1, 1.5), 1.33)],
)
def test_a_room_of_radiance_1_is_seen_as_the_square_of_the_index(position, index):
    """A white furnace: clear bodies that overlap, in a room whose walls all look the same."""
    room = box([-4, -4, -4], [4, 4, 4])
    bodies = [
        glass(ball(1.0, [0, 0, 0], 4), 1.5, priority=1),
        glass(ball(1.0, [0, 0, 0.8], 4), 1.33),
    ]
    scene = pr.Scene([pr.SceneObject(room, pr.Diffuse(0.5)), *bodies], [pr.PointEmitter([3, 3, 3])])
    camera = pr.Camera(position, (0.0, 0.0, 3.0), width=12, height=12, vertical_fov=30.0)
    points, _ = camera_points(scene, camera, max_depth=40)
    seen = np.bincount(points.pixel, points.weight[:, 0], minlength=144)
    # Rays of little weight are not followed.
    np.testing.assert_allclose(seen / index**2, 1.0, atol=0.02)


# A plate with a tint.
PLATE = glass(box([-3, -3, 1.0], [3, 3, 1.5]), 1.5, tint=(0.9, 0.5, 0.0))


def test_tint_is_a_factor_on_refracted_light_at_each_surface():
    """Twice through a plate; what is reflected has none."""
    lamp = pr.CollimatedEmitter([0, 0, -1])
    scene = scene_of([PLATE], lamp)
    photons = pr.trace_photons(scene, 50_000)
    below = photons.subset((np.abs(photons.position) < 2.9).all(axis=1) & (photons.n_bounces == 2))
    share = 1.0 - fresnel_reflectance(0.0, 1.5)
    tint = PLATE.material.tint
    np.testing.assert_allclose(
        below.flux.sum(axis=0) / 5.8**2, share**2 * tint**2, rtol=0.03, atol=1e-12
    )
    assert photons.ledger.imbalance < 1e-9
    ceiling = pr.SceneObject(box([-6, -6, 4], [6, 6, 5]), pr.Diffuse())
    points, _ = camera_points(scene_of([PLATE, ceiling]), STRAIGHT_DOWN, max_depth=2)
    above = points.position[:, 2] > 3.9
    np.testing.assert_allclose(points.weight[above], [[1.0 - share] * 3], rtol=1e-12)
    np.testing.assert_allclose(points.weight[~above], [share**2 * tint**2], rtol=1e-12)


def test_spectra_do_not_depend_on_tints():
    """Nor on channels of which nothing is left; tints end paths, so that photons are fewer."""
    lamp = pr.PointEmitter([0.1, 0.2, 4.0])
    clear = replace(PLATE, material=pr.Dielectric(1.5))
    tinted, plain = (
        pr.trace_photons(scene_of([plate], lamp), 400, frequency_share=1.0)
        for plate in (PLATE, clear)
    )
    distance, row = cKDTree(plain.emitter_coords).query(tinted.emitter_coords)
    same = (distance == 0.0) & (plain.path_signature[row] == tinted.path_signature)
    assert same.sum() > 20
    np.testing.assert_array_equal(tinted.spectrum[same], plain.spectrum[row[same]])


def test_a_white_tint_changes_no_bit():
    untinted, white = (
        pr.trace_photons(scene_of([replace(PLATE, material=pr.Dielectric(1.5, **tint))]), 2000)
        for tint in ({}, {"tint": 1.0})
    )
    np.testing.assert_array_equal(untinted.flux, white.flux)


def test_an_index_outside_of_its_own_makes_a_surface_in_any_medium():
    """At 1.2 to 1.7 twice, inside of water of larger priority, which alone absorbs."""
    water = glass(box([-3, -3, 0.0], [3, 3, 2.0]), 1.33, priority=9, absorption=RED)
    plate = glass(box([-2, -2, 0.8], [2, 2, 1.2]), 1.7, exterior_ior=1.2, absorption=GREEN)
    points, _ = camera_points(scene_of([water, plate]), STRAIGHT_DOWN)
    share = (1.0 - fresnel_reflectance(0.0, 1.7 / 1.2)) ** 2
    share *= (1.0 - fresnel_reflectance(0.0, 1.33)) ** 2
    # Contact with the floor moves the water off it by some micrometres.
    seen = points.weight[points.weight[:, 0].argmax()]
    np.testing.assert_allclose(seen, share * np.exp(-RED * 2.0), rtol=1e-3)


def test_surfaces_that_are_not_there_beyond_a_limit_are_events_without_effect(monkeypatch):
    """So that no ray goes on for ever; the light arrives where it would."""
    plates = [box([-2, -2, 0.3 + 0.1 * i], [2, 2, 0.35 + 0.1 * i]) for i in range(8)]
    comb = glass(trimesh.util.concatenate(plates), 1.7, priority=-1)
    water = glass(box([-3, -3, -0.5], [3, 3, 2.0]), 1.33)
    lamp = pr.PointEmitter([0.1, 0.2, 1.9])

    def below():
        photons = pr.trace_photons(scene_of([water, comb], lamp), 20_000, paths="all")
        assert photons.ledger.imbalance < 1e-9
        return photons.subset(np.abs(photons.position[:, :2]).max(axis=1) < 0.3)

    free = below()
    straight = free.n_bounces == 0
    monkeypatch.setattr(raycast, "MAX_HIDDEN", 3)
    limited = below()
    # Of 16 surfaces every fourth.
    assert (limited.n_bounces[straight] == 4).all()
    np.testing.assert_allclose(limited.position[straight], free.position[straight], atol=1e-9)
    assert straight.sum() > 100


@pytest.mark.filterwarnings("ignore:.*open edges")
def test_rays_that_nesting_contradicts_are_warned_of_once_with_names_and_counts():
    """Light that comes up to the back of a sheet without sides."""
    corners = [[-3, -3, 1], [3, -3, 1], [3, 3, 1], [-3, 3, 1]]
    sheet = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]])
    below = pr.PointEmitter([0.0, 0.0, 0.05])
    scene = pr.Scene([floor(), glass(sheet, 1.33, "pond")], [below], looking_from((0.3, 0.2, 3.0)))
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        photons = pr.trace_photons(scene, 2000, paths="all")
        pr.trace_photons(scene, 2000, paths="all", seed=1)
        pr.render(scene, photons=photons, method="standard")
    (text,) = [str(warning.message) for warning in warned]
    n_left = int(re.match(r"(\d+) times a ray left a dielectric that it had not entered", text)[1])
    assert f"(objects[1] ('pond') {n_left})" in text
    assert n_left > 100
    assert photons.ledger.imbalance < 1e-9


@pytest.mark.parametrize(
    ("wrong", "error", "message"),
    [
        ({"priority": 1.5}, TypeError, "priority should be an integer, but is 1.5"),
        ({"priority": "high"}, TypeError, "priority should be an integer"),
        ({"priority": 2**31}, ValueError, "priority should be at most 2147483647"),
        ({"priority": -(2**31)}, ValueError, "priority should be at least -2147483647"),
        ({"tint": 1.1}, ValueError, r"tint should lie in \[0.0, 1.0\]"),
        ({"tint": (0.5, -0.1, 0.5)}, ValueError, r"tint should lie in \[0.0, 1.0\]"),
        ({"tint": (0.5, 0.5)}, ValueError, "tint should be one number or three"),
    ],
)
def test_priorities_are_integers_and_tints_colours(wrong, error, message):
    with pytest.raises(error, match=message):
        pr.Dielectric(**wrong)


def test_digests_of_scenes_depend_on_priority_and_tint():
    digests = {
        scene_digest(scene_of([glass(PEBBLE, 1.5, **options)]))
        for options in ({}, {"priority": 1}, {"tint": 0.5})
    }
    assert len(digests) == 3
    assert pr.Dielectric(priority=np.int16(3)).priority == 3
