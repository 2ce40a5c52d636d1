"""All light in a room, component by component, against particles counted by another tracer."""

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax.estimation.indirect import IndirectField
from photonrelax.transport.direct_light import direct_irradiance
from photonrelax.transport.raycast import RayCaster
from tests.analytic.particle_tracer import COMPONENTS, Room, Shell, caustics, irradiance
from tests.helpers.tracing_scenes import ball, coloured_walls

FLOOR = 4
GLASS = Room(
    albedos=np.array([[0.8, 0.2, 0.2], [0.2, 0.8, 0.2], *4 * [[0.7, 0.7, 0.7]]]),
    lamps=[((-0.4, -0.3, 0.7), (10.0, 6.0, 3.0)), ((0.5, 0.4, 0.6), (2.0, 4.0, 8.0))],
    centre=np.array([0.35, 0.3, -0.55]),
    shells=[Shell(0.4, 1.5)],
)
# A ball of glass whose hollow is full of a tinted liquid.
LIQUID = GLASS._replace(shells=[Shell(0.4, 1.5), Shell(0.3, 1.33, (0.1, 0.5, 1.5))])
# Points of a wall along a side.
N_POINTS = 40


def glass_ball(room):
    shell = room.shells[0]
    return [(ball(shell.radius, room.centre, 5), pr.Dielectric(shell.ior))]


def liquid_in_glass(room):
    """The liquid is larger than the hollow, and the glass of larger priority."""
    outer, inner = room.shells
    hollow = ball(inner.radius, room.centre, 5)
    hollow.invert()
    glass = trimesh.util.concatenate([ball(outer.radius, room.centre, 5), hollow])
    liquid = ball(1.02 * inner.radius, room.centre, 5)
    return [
        (glass, pr.Dielectric(outer.ior, priority=1)),
        (liquid, pr.Dielectric(inner.ior, absorption=inner.absorption)),
    ]


ROOMS = {"glass": (GLASS, glass_ball), "liquid in glass": (LIQUID, liquid_in_glass)}


@pytest.fixture(scope="module", params=ROOMS)
def room(request):
    return ROOMS[request.param]


@pytest.fixture(scope="module")
def scene(room):
    room, parts = room
    objects = [pr.SceneObject(*part, smooth=True) for part in parts(room)]
    lamps = [pr.PointEmitter(*lamp) for lamp in room.lamps]
    return pr.Scene([*coloured_walls(room.albedos), *objects], lamps)


@pytest.fixture(scope="module")
def counted(room):
    """Irradiance (6, 3) of the walls by component, and its standard error over it."""
    batches = irradiance(room[0], 500_000, 20, seed=1)
    mean, deviation = batches.mean(axis=0), batches.std(axis=0, ddof=1)
    doubt = deviation / np.sqrt(len(batches)) / mean
    return dict(zip(COMPONENTS, zip(mean, doubt, strict=True), strict=True))


def points_of_wall(wall):
    """Points on a grid, and inward normals."""
    axis, at = wall // 2, (np.arange(N_POINTS) + 0.5) * 2.0 / N_POINTS - 1.0
    points, normals = np.zeros((N_POINTS**2, 3)), np.zeros((N_POINTS**2, 3))
    points[:, axis], normals[:, axis] = (-1.0, 1.0)[wall % 2], (1.0, -1.0)[wall % 2]
    u, v = np.meshgrid(at, at, indexing="ij")
    points[:, (axis + 1) % 3], points[:, (axis + 2) % 3] = u.ravel(), v.ravel()
    return points, normals


@pytest.fixture
def sides():
    """Footprints that cover a wall."""
    return np.full(N_POINTS**2, 2.0 / N_POINTS)


def test_direct_light(scene, counted):
    exact, doubt = counted["direct"]
    caster = RayCaster(scene.objects)
    assert doubt.max() <= 0.007
    for wall in range(6):
        found = direct_irradiance(scene, caster, *points_of_wall(wall), n_threads=2)
        np.testing.assert_allclose(found.mean(axis=0), exact[wall], rtol=0.02)


def test_caustics_on_the_floor(scene, counted, sides):
    exact, doubt = counted["caustic"]
    photons = pr.trace_photons(scene, 60_000)
    found = pr.irradiance_field(photons, scene=scene)(*points_of_wall(FLOOR), footprint=sides)
    assert doubt[FLOOR].max() <= 0.007
    np.testing.assert_allclose(found.mean(axis=0), exact[FLOOR], rtol=0.02)


def test_caustics_on_all_walls(room, scene, sides):
    """Each but the floor gets some fiftieth of the light of the ball, so that many are counted."""
    batches = caustics(room[0], 2_000_000, 20, seed=1)
    exact = batches.mean(axis=0)
    doubt = batches.std(axis=0, ddof=1) / np.sqrt(len(batches)) / exact
    photons = pr.trace_photons(scene, 1_000_000)
    field = pr.irradiance_field(photons, method="standard", scene=scene)
    assert doubt.max() <= 0.007
    for wall in range(6):
        found = field(*points_of_wall(wall), footprint=sides)
        np.testing.assert_allclose(found.mean(axis=0), exact[wall], rtol=0.02)


def test_indirect_light(scene, counted, sides):
    exact, doubt = counted["indirect"]
    field = IndirectField(pr.trace_photons(scene, 300_000, paths="global"), scene=scene)
    assert doubt.max() <= 0.007
    for wall in range(6):
        found = field(*points_of_wall(wall), footprint=sides)
        np.testing.assert_allclose(found.mean(axis=0), exact[wall], rtol=0.02)
