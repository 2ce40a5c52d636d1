"""Media in media: index and absorption along the way of photons, camera rays and replayed paths.

Light falls straight through layers, so that each way has a closed form: Fresnel at every surface,
Beer–Lambert between them.
"""

from dataclasses import fields, replace

import numpy as np
import pytest
import trimesh
from photonrelax._ext.transport.materials import Materials

import photonrelax as pr
from photonrelax.scene.materials import MaterialTable
from photonrelax.transport.direct_light import direct_irradiance
from photonrelax.transport.emission import plan_emission
from photonrelax.transport.frequency.path_replay import PathEvents, PathReplayer
from photonrelax.transport.frequency.spectra import _Bundle
from photonrelax.transport.hit_points import trace_hit_points
from photonrelax.transport.media import MediaFinder
from photonrelax.transport.raycast import RayCaster
from tests.analytic.layers import layers_transmittance
from tests.helpers.tracing_scenes import DOWN, ball, sheet

RED, GREEN, BLUE = np.array([1.0, 0.2, 0.1]), np.array([0.3, 1.0, 0.2]), np.array([0.1, 0.4, 1.0])
AIR = (1.0, 0.0)
WATER = (1.33, RED)


def block(low, high, ior, absorption=0.0, *, half=4.0, **options):
    """A box of glass or the like between two heights."""
    mesh = trimesh.creation.box(bounds=[[-half, -half, low], [half, half, high]])
    return pr.SceneObject(mesh, pr.Dielectric(ior, absorption=absorption, **options))


def floor(z=0.0, size=3.0, albedo=0.0):
    return pr.SceneObject(sheet(size, z), pr.Diffuse(albedo))


def water(low=-1.0, high=2.0, half=5.0):
    return block(low, high, *WATER, half=half)


def hollow_block(low, high, wall, ior, absorption):
    """A closed box with a hollow inside; the walls of the hollow wind inwards."""
    outer = trimesh.creation.box(bounds=[[-4, -4, low], [4, 4, high]])
    inner = trimesh.creation.box(bounds=[[-3.9, -3.9, low + wall], [3.9, 3.9, high - wall]])
    inner.invert()
    return pr.SceneObject(
        trimesh.util.concatenate([outer, inner]), pr.Dielectric(ior, absorption=absorption)
    )


# Objects over the floor, which lies in water unless there is none, and the layers from air down to
# the floor at z = 0.
NESTED = {
    "no plate": ([water()], [(*AIR, 1), (*WATER, 2.0)]),
    "clear plate of the same index": (
        [water(), block(1.0, 1.1, 1.33)],
        [(*AIR, 1), (*WATER, 0.9), (1.33, 0.0, 0.1), (*WATER, 1.0)],
    ),
    "clear plate listed before the water": (
        [block(1.0, 1.1, 1.33), water()],
        [(*AIR, 1), (*WATER, 0.9), (1.33, 0.0, 0.1), (*WATER, 1.0)],
    ),
    "clear plate with an index outside of its own": (
        [water(), block(1.0, 1.1, 1.33, exterior_ior=1.33)],
        [(*AIR, 1), (*WATER, 0.9), (1.33, 0.0, 0.1), (*WATER, 1.0)],
    ),
    "green glass": (
        [water(), block(0.5, 1.5, 1.5, GREEN)],
        [(*AIR, 1), (*WATER, 0.5), (1.5, GREEN, 1.0), (*WATER, 0.5)],
    ),
    "bubble": (
        [water(), block(0.5, 1.5, 1.0)],
        [(*AIR, 1), (*WATER, 0.5), (1.0, 0.0, 1.0), (*WATER, 0.5)],
    ),
    "bubble in glass in water": (
        [block(0.8, 1.2, 1.0, half=2.5), water(), block(0.5, 1.5, 1.6, GREEN)],
        [
            *((*AIR, 1), (*WATER, 0.5), (1.6, GREEN, 0.3), (1.0, 0.0, 0.4)),
            *((1.6, GREEN, 0.3), (*WATER, 0.5)),
        ],
    ),
    "two plates, one of them blue": (
        [water(), block(0.3, 0.6, 1.5, BLUE), block(1.0, 1.6, 1.7)],
        [
            *((*AIR, 1), (*WATER, 0.4), (1.7, 0.0, 0.6), (*WATER, 0.4)),
            *((1.5, BLUE, 0.3), (*WATER, 0.3)),
        ],
    ),
    "hollow glass in water has water inside": (
        [water(), hollow_block(0.5, 1.5, 0.1, 1.5, GREEN)],
        [
            *((*AIR, 1), (*WATER, 0.5), (1.5, GREEN, 0.1), (*WATER, 0.8)),
            *((1.5, GREEN, 0.1), (*WATER, 0.5)),
        ],
    ),
    "hollow glass in air": (
        [hollow_block(0.5, 1.5, 0.1, 1.5, GREEN)],
        [(*AIR, 1), (1.5, GREEN, 0.1), (*AIR, 0.8), (1.5, GREEN, 0.1), (*AIR, 0.5)],
    ),
    # The one that was entered last rules; where it is left the other goes on.
    "plates that overlap": (
        [block(0.5, 1.2, 1.5, GREEN), block(0.8, 1.5, 1.33, RED)],
        [(*AIR, 1), (1.33, RED, 0.3), (1.5, GREEN, 0.7), (*AIR, 0.5)],
    ),
}

# Where two surfaces are one, the smaller object is moved, here by some 0.1 mm.
TOUCHING = {
    "plates that touch": (
        [block(0.5, 1.0, 1.5, GREEN), block(1.0, 1.5, 1.33, RED, half=3.8)],
        [(*AIR, 1), (1.33, RED, 0.5), (1.5, GREEN, 0.5), (*AIR, 0.5)],
    ),
    "water in a trough": (
        [
            hollow_block(0.2, 1.8, 0.2, 1.5, GREEN),
            block(0.4, 1.6, *WATER, half=3.9),
        ],
        [(*AIR, 1), (1.5, GREEN, 0.2), (*WATER, 1.2), (1.5, GREEN, 0.2), (*AIR, 0.2)],
    ),
    "hollow glass in water with a bubble that fills it": (
        [water(), hollow_block(0.5, 1.5, 0.1, 1.5, GREEN), block(0.6, 1.4, 1.0, half=3.9)],
        [
            *((*AIR, 1), (*WATER, 0.5), (1.5, GREEN, 0.1), (1.0, 0.0, 0.8)),
            *((1.5, GREEN, 0.1), (*WATER, 0.5)),
        ],
    ),
    # Up to a surface of the water; some of the water stays between glass and air.
    "ice at the surface": (
        [water(), block(1.5, 2.0, 1.31, BLUE, half=4.0)],
        [(*AIR, 1), (*WATER, 0.0), (1.31, BLUE, 0.5), (*WATER, 1.5)],
    ),
    "glass on the bottom of a tank": (
        [water(0.5), block(0.5, 1.0, 1.5, GREEN)],
        [(*AIR, 1), (*WATER, 1.0), (1.5, GREEN, 0.5), (*WATER, 0.0), (*AIR, 0.5)],
    ),
}
LAYERED = NESTED | TOUCHING
each_nesting = pytest.mark.parametrize("name", LAYERED)


def tolerance(name):
    return 1e-3 if name in TOUCHING else 1e-9


def scene_of(objects, emitter=DOWN):
    return pr.Scene([floor(), *objects], [emitter])


def from_above(points, half=2.4):
    """Photons or points on the upper side of the floor, far from its sides."""
    x, y, _ = points.position.T
    return (points.object_id == 0) & (np.maximum(abs(x), abs(y)) < half) & (points.normal[:, 2] > 0)


@pytest.mark.kernels_run_elsewhere
@each_nesting
def test_photons_are_refracted_and_absorbed_layer_by_layer(name):
    objects, layers = LAYERED[name]
    photons = pr.trace_photons(scene_of(objects), 200_000, paths="all")
    seen = photons.subset(from_above(photons))
    # Those that were never reflected; a contact takes two events.
    straight = np.isclose(seen.path_length, seen.path_length.min(), rtol=1e-9)
    irradiance = seen.flux[straight].sum(axis=0) / 4.8**2
    np.testing.assert_allclose(irradiance, layers_transmittance(*layers), rtol=0.04)
    assert photons.ledger.imbalance < 1e-9


def seen_through(objects, origin, target=(0.1, 0.2, 0.0)):
    """Weight of the floor in one pixel that looks straight at it, without reflections."""
    scene = scene_of(objects)
    up = (0, 1, 0) if origin[:2] == target[:2] else (0, 0, 1)
    camera = pr.Camera(origin, target, up=up, width=1, height=1)
    points, _ = trace_hit_points(
        scene, RayCaster(scene.objects), camera, range(1), max_depth=20, n_threads=1
    )
    return points.weight[points.weight.sum(axis=1).argmax()]


@each_nesting
def test_cameras_see_through_the_same_layers(name):
    objects, layers = LAYERED[name]
    radiance = layers_transmittance(*layers) * (layers[0][0] / layers[-1][0]) ** 2
    seen = seen_through(objects, (0.1, 0.2, 3.0))
    np.testing.assert_allclose(seen, radiance, rtol=tolerance(name))


@each_nesting
def test_replayed_paths_take_the_same_layers(name):
    objects, layers = LAYERED[name]
    scene = scene_of(objects)
    caster = RayCaster(scene.objects)
    hits = caster.intersect([[0.1, 0.2, 3.0]], [[0.0, 0.0, -1.0]])
    objects_met = [int(hits.object_id[0])]
    while objects_met[-1]:
        hits = caster.intersect(hits.position, [[0.0, 0.0, -1.0]], origin_offset=hits.offset)
        objects_met.append(int(hits.object_id[0]))
    replayed = replay(scene, objects_met, [False] * len(objects_met), [0.1, 0.2])
    np.testing.assert_allclose(
        replayed.throughput[0], layers_transmittance(*layers), rtol=tolerance(name)
    )


def replay(scene, objects, reflected, at=None, direction=None):
    """One ray of the first emitter, sent along a path."""
    caster = RayCaster(scene.objects)
    region = plan_emission(scene, 100, "all").regions[0]
    media = MediaFinder(scene, caster, Materials(scene.material_table())).at_emitters()[0]
    if region.is_plane:
        origin, towards = region.origin + np.array(at) @ region.frame[:2], region.frame[2]
        # The frame of light from above: x and y may be swapped or turned.
        origin[:2] = at
    else:
        towards = np.array(direction, dtype=float)
        origin = region.origin + region.start_distance * towards
    bundle = _Bundle(region, origin[None], towards[None], media)
    events = PathEvents(
        np.array([objects]), np.array([reflected]), np.array([len(objects)], dtype=np.intp)
    )
    return PathReplayer(scene, caster).replay(bundle.rays(), events)


CAMERAS = {
    "in water": ([water()], 1.5, [(*WATER, 1.5)]),
    "in clear glass in water": (
        [water(), block(0.5, 1.5, 1.5)],
        1.0,
        [(1.5, 0.0, 0.5), (*WATER, 0.5)],
    ),
    "in a bubble in water": (
        [water(), block(0.5, 1.5, 1.0)],
        1.2,
        [(1.0, 0.0, 0.7), (*WATER, 0.5)],
    ),
    "in water above glass": (
        [water(), block(0.5, 1.0, 1.5, GREEN)],
        1.5,
        [(*WATER, 0.5), (1.5, GREEN, 0.5), (*WATER, 0.5)],
    ),
    "in the hollow of green glass": (
        [hollow_block(0.5, 1.5, 0.1, 1.5, GREEN)],
        1.0,
        [(*AIR, 0.4), (1.5, GREEN, 0.1), (*AIR, 0.5)],
    ),
    "on the surface of the water": ([water()], 2.0, [(*WATER, 2.0)]),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_cameras_know_the_media_that_they_are_in(name):
    objects, height, layers = CAMERAS[name]
    radiance = layers_transmittance(*layers) * (layers[0][0] / layers[-1][0]) ** 2
    np.testing.assert_allclose(seen_through(objects, (0.1, 0.2, height)), radiance, rtol=1e-9)


def test_pixels_of_one_camera_may_lie_in_different_media():
    """Parallel rays, half of which start in green glass and half in air beside it."""
    half = trimesh.creation.box(bounds=[[0.0, -4, 0.5], [4, 4, 3]])
    objects = [pr.SceneObject(half, pr.Dielectric(1.5, absorption=GREEN))]
    scene = scene_of(objects)
    camera = pr.Camera(
        (0, 0, 1.5), (0, 0, 0), (0, 1, 0), width=8, height=1, orthographic_height=0.25
    )
    points, _ = trace_hit_points(scene, RayCaster(scene.objects), camera, range(1), max_depth=2)
    order = np.argsort(points.pixel)
    in_glass = layers_transmittance((1.5, GREEN, 1.0), (*AIR, 0.5)) * 1.5**2
    expected = np.where(points.position[order, :1] > 0.0, in_glass, 1.0)
    assert len(points) == 8
    np.testing.assert_allclose(points.weight[order], expected, rtol=1e-9)


# A mirror at 45° throws light from above sideways onto a wall; all may lie in a block of glass.
def mirror_scene(*around, emitter=DOWN, reflectance=0.9):
    corners = [[-0.5, -0.5, 0.5], [0.5, -0.5, 1.5], [0.5, 0.5, 1.5], [-0.5, 0.5, 0.5]]
    mesh = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    wall = trimesh.creation.box(bounds=[[-2.1, -2, -0.5], [-2.0, 2, 1.9]])
    mirror = pr.SceneObject(mesh, pr.Mirror(reflectance))
    return pr.Scene([pr.SceneObject(wall, pr.Diffuse(0.0)), mirror, *around], [emitter])


MIRRORS = {
    "in water": ([water()], [(*AIR, 1), (*WATER, 1.0 + 2.0)]),
    "in glass in water": (
        [water(), block(0.4, 1.6, 1.5, GREEN, half=2.5)],
        [(*AIR, 1), (*WATER, 0.4), (1.5, GREEN, 0.6 + 2.0)],
    ),
    "in a bubble in glass": (
        [
            block(-0.8, 2.0, 1.6, BLUE),
            pr.SceneObject(
                trimesh.creation.box(bounds=[[-0.6, -0.6, 0.3], [0.6, 0.6, 1.7]]),
                pr.Dielectric(1.0),
            ),
        ],
        [(*AIR, 1), (1.6, BLUE, 0.3), (1.0, 0.0, 0.7 + 0.6), (1.6, BLUE, 1.4)],
    ),
}


@pytest.mark.parametrize("name", MIRRORS)
def test_light_stays_in_its_media_at_a_mirror(name):
    around, layers = MIRRORS[name]
    scene = mirror_scene(*around)
    expected = 0.9 * layers_transmittance(*layers)

    photons = pr.trace_photons(scene, 600_000)
    turned = photons.subset((photons.wi[:, 0] > 0.999999) & (photons.normal[:, 0] > 0.9))
    straight = turned.subset(turned.n_bounces == len(layers))
    np.testing.assert_allclose(
        straight.flux.sum(axis=0), expected, rtol=5.0 / np.sqrt(len(straight))
    )
    assert len(straight) > 300

    met = {"in water": [2, 1, 0], "in glass in water": [2, 3, 1, 0]}.get(name, [2, 3, 1, 3, 0])
    reflected = [each == 1 for each in met]
    throughput = replay(scene, met, reflected, [0.0, 0.1]).throughput[0]
    # Replay leaves the reflectances of mirrors out.
    np.testing.assert_allclose(0.9 * throughput, expected, rtol=1e-9)

    camera = pr.Camera((0.0, 0.1, 3.0), (0.0, 0.1, 0.0), up=(0, 1, 0), width=1, height=1)
    points, _ = trace_hit_points(scene, RayCaster(scene.objects), camera, range(1))
    seen = points.weight[points.weight.sum(axis=1).argmax()]
    np.testing.assert_allclose(seen, expected / layers[-1][0] ** 2, rtol=1e-9)


# Lamps at the centre of balls within one another: all light meets their surfaces head-on.
def shell(radius, ior, absorption=0.0):
    return pr.SceneObject(
        ball(radius, [0, 0, 0], 5), pr.Dielectric(ior, absorption=absorption), smooth=True
    )


def room(half=4.0):
    return pr.SceneObject(trimesh.creation.box(extents=[2 * half] * 3), pr.Diffuse(0.0))


LAMPS = {
    "in red glass": ([shell(1.0, 1.5, RED)], [(1.5, RED, 1.0), (*AIR, 1)]),
    "in a bubble in water": (
        [shell(2.0, *WATER), shell(0.5, 1.0)],
        [(*AIR, 0.5), (*WATER, 1.5), (*AIR, 1)],
    ),
    "in glass in water": (
        [shell(0.5, 1.5, GREEN), shell(2.0, *WATER)],
        [(1.5, GREEN, 0.5), (*WATER, 1.5), (*AIR, 1)],
    ),
    "in a bulb in water": (
        [shell(2.0, *WATER), shell(0.6, 1.5, GREEN), shell(0.5, 1.0)],
        [(*AIR, 0.5), (1.5, GREEN, 0.1), (*WATER, 1.4), (*AIR, 1)],
    ),
}
POINT = pr.PointEmitter([0, 0, 0], 5.0)
EMITTERS = [POINT, pr.LambertianEmitter([0, 0, 0], [0.3, 0.2, 1.0], 5.0)]


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("emitter", EMITTERS)
@pytest.mark.parametrize("name", LAMPS)
def test_lamps_know_the_media_that_they_are_in(name, emitter):
    shells, layers = LAMPS[name]
    scene = pr.Scene([room(), *shells], [emitter])
    photons = pr.trace_photons(scene, 15_000)
    straight = photons.subset(photons.n_bounces == len(layers) - 1)
    expected = layers_transmittance(*layers)
    np.testing.assert_allclose(straight.flux.sum(axis=0), 5.0 * expected, rtol=0.02)
    ledger = photons.ledger
    assert ledger.imbalance < 1e-9
    assert ledger.escaped.sum() == ledger.discarded.sum() == 0.0

    ray = np.array([0.1, 0.2, 1.0]) / np.sqrt(1.05)
    met = sorted(range(1, len(scene.objects)), key=lambda i: scene.objects[i].mesh.volume)
    replayed = replay(scene, [*met, 0], [False] * len(layers), direction=ray)
    np.testing.assert_allclose(replayed.throughput[0], expected, rtol=1e-3)


@pytest.mark.parametrize("emitter", EMITTERS)
def test_light_between_a_lamp_and_objects_in_the_same_water_is_absorbed(emitter):
    inner = pr.SceneObject(ball(1.0, [0, 0, 0], 4), pr.Diffuse(0.0))
    scene = pr.Scene([inner, shell(2.0, *WATER)], [emitter])
    photons = pr.trace_photons(scene, 50_000, paths="all")
    expected = np.exp(-RED * 1.0)
    np.testing.assert_allclose(photons.flux.sum(axis=0), 5.0 * expected, rtol=0.01)

    axis = np.array([0.3, 0.2, 1.0]) / np.linalg.norm([0.3, 0.2, 1.0])
    position = np.outer([0.2, 0.5, 0.9], axis)
    normal = np.tile(-axis, (3, 1))
    arriving = direct_irradiance(scene, RayCaster(scene.objects), position, normal)
    solid_angle = 4.0 * np.pi if emitter is POINT else np.pi
    distance = np.array([[0.2], [0.5], [0.9]])
    np.testing.assert_allclose(
        arriving, 5.0 / solid_angle / distance**2 * np.exp(-RED * distance), rtol=1e-12
    )


def test_direct_light_and_photons_agree_in_water():
    """Rendered: a floor in water below a lamp in the same water."""
    emitter = pr.PointEmitter([0.1, 0.2, 1.0], 4.0 * np.pi)
    camera = pr.Camera((0.1, 0.2, 1.5), (0.1, 0.2, 0), (0, 1, 0), width=3, height=3)
    scene = pr.Scene([floor(albedo=1.0), water()], [emitter], camera)
    image = pr.render(scene, n_emitted=2000, method="standard", supersampling=1)
    expected = np.exp(-RED * 1.0) * np.exp(-RED * 1.5) / np.pi
    np.testing.assert_allclose(image.layers["direct"][1, 1], expected, rtol=1e-9)


def test_photons_in_nested_media_get_spectra():
    objects, _ = NESTED["green glass"]
    photons = pr.trace_photons(scene_of(objects), 300, frequency_share=1.0)
    assert np.isfinite(photons.spectrum).all(axis=1).mean() > 0.95


def media_of(scene):
    """Objects that each emitter lies in, the innermost first."""
    materials = Materials(scene.material_table())
    stacks = MediaFinder(scene, RayCaster(scene.objects), materials).at_emitters()
    entries = [[int(stack) >> shift & 255 for shift in range(0, 64, 8)] for stack in stacks]
    return [[int(materials.dielectrics[i - 1]) for i in stack if i] for stack in entries]


def test_media_of_emitters_are_found_from_the_innermost_on():
    glass, bubble = shell(1.0, 1.5), shell(0.5, 1.0)
    beside = pr.SceneObject(ball(0.5, [3, 0, 0]), pr.Dielectric())
    lamps = [
        pr.PointEmitter([0, 0, 0.1]),
        pr.PointEmitter([0, 0, 0.7]),
        pr.PointEmitter([0, 0, 1.5]),
        pr.PointEmitter([3, 0.1, 0.2]),
        pr.PointEmitter([0, 0, 30.0]),
        DOWN,
        pr.LambertianEmitter([0, 0, 0.5], [0, 0, 1]),
        pr.LambertianEmitter([0, 0, 0.5], [0, 0, -1]),
    ]
    sea = pr.SceneObject(ball(8.0, [0, 0, 0]), pr.Dielectric(1.33))
    scene = pr.Scene([bubble, room(9.0), beside, sea, glass], lamps)
    water_, glass_, bubble_, beside_ = 3, 4, 0, 2
    assert media_of(scene) == [
        [bubble_, glass_, water_],
        [glass_, water_],
        [water_],
        [beside_, water_],
        [],
        [],
        # On a surface: where the light goes.
        [glass_, water_],
        [bubble_, glass_, water_],
    ]


def test_lamps_in_hollows_and_outside_of_open_meshes_are_in_no_medium():
    bulb = ball(1.0, [0, 0, 0])
    inner = ball(0.9, [0, 0, 0])
    inner.invert()
    bulb = pr.SceneObject(trimesh.util.concatenate([bulb, inner]), pr.Dielectric())
    lamps = [pr.PointEmitter([0.1, 0, 0]), pr.PointEmitter([0.95, 0, 0])]
    assert media_of(pr.Scene([room(), bulb], lamps)) == [[], [1]]
    with pytest.warns(UserWarning, match="open edges"):
        pond = pr.Scene(
            [floor(-1.0), pr.SceneObject(sheet(50.0), pr.Dielectric(1.33))],
            [pr.PointEmitter([0, 0, 1.0])],
        )
    assert media_of(pond) == [[]]


class Submerged(pr.CollimatedEmitter):
    """Parallel light that starts in the scene, from the height 1 on."""

    def emission_region(self, target, scene, emitter_offset):
        region = super().emission_region(target, scene, emitter_offset)
        return replace(region, origin=np.array([0.0, 0.0, 1.0]))


def test_beams_are_in_the_media_at_their_middle():
    lamp = Submerged([0, 0, -1])
    sea = [floor(), block(-1.0, 2.0, 1.33, [1.0, 0.0, 0.5])]
    assert media_of(pr.Scene(sea, [lamp])) == [[1]]
    photons = pr.trace_photons(pr.Scene(sea, [lamp]), 50_000, paths="all")
    below = photons.subset(from_above(photons) & (photons.n_bounces == 0))
    expected = np.exp([-1.0, 0.0, -0.5])
    np.testing.assert_allclose(below.flux.sum(axis=0) / 4.8**2, expected, rtol=0.03)
    # Its direct light comes from infinitely far away.
    scene = pr.Scene(sea, [lamp])
    arriving = direct_irradiance(scene, RayCaster(sea), [[0.1, 0.2, 1.5]], [[0, 0, 1.0]])
    np.testing.assert_array_equal(arriving, 0.0)
    unlit = pr.Scene([floor()], [lamp])
    arriving = direct_irradiance(unlit, RayCaster(unlit.objects), [[0.1, 0.2, 0.0]], [[0, 0, 1.0]])
    np.testing.assert_array_equal(arriving, 1.0)


def nested_boxes(n):
    """Boxes within one another; those further in absorb, and all have an index of their own."""
    return [
        block(1.0 - 0.1 * (n - i), 1.0 + 0.1 * (n - i), 1.0 + 0.05 * i, 0.0, half=4.0 - 0.1 * i)
        for i in range(n)
    ]


def test_eight_media_at_once_are_kept_and_more_are_warned_of(recwarn):
    photons = pr.trace_photons(scene_of(nested_boxes(8)), 2000)
    seen_through(nested_boxes(8), (0.1, 0.2, 3.0))
    assert not recwarn
    with pytest.warns(UserWarning, match=r"more than 8 dielectrics at once \(objects\[9\] \d+\)"):
        deeper = pr.trace_photons(scene_of(nested_boxes(9)), 2000)
    assert photons.ledger.imbalance < 1e-9
    assert deeper.ledger.imbalance < 1e-9
    with pytest.warns(UserWarning, match="1 times a ray was in more than 8"):
        seen_through(nested_boxes(9), (0.1, 0.2, 3.0))
    with pytest.warns(UserWarning, match="in more than 8 dielectrics at once"):
        pr.trace_photons(
            scene_of(nested_boxes(9), pr.PointEmitter([0.1, 0.2, 1.0])), 2000, paths="all"
        )


@pytest.mark.parametrize(("n", "depth"), [(1, 8), (255, 8), (256, 4), (65_535, 4), (65_536, 2)])
def test_stacks_are_shallower_the_more_dielectrics_there_are(n, depth):
    table = MaterialTable.of([pr.Dielectric()])
    columns = {f.name: np.repeat(getattr(table, f.name), n, axis=0) for f in fields(table)}
    many = MaterialTable(**columns | {"kind": table.kind * n})
    assert Materials(many).max_depth == depth


def test_beads_beyond_the_first_255_absorb_as_well():
    plates = [block(0.5 + i / 1000, 0.5 + (i + 0.5) / 1000, 1.0, half=0.1) for i in range(300)]
    plates[270] = block(0.9, 1.4, 1.33, RED)
    with_many = pr.trace_photons(scene_of([water(), *plates]), 100_000)
    irradiance = with_many.flux[sel := from_above(with_many)].sum(axis=0) / 4.8**2
    assert sel.any()
    np.testing.assert_allclose(
        irradiance, layers_transmittance((*AIR, 1), (*WATER, 2.0)), rtol=0.03
    )
