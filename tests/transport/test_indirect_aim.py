"""Indirect light that comes by way of small glass: photons are aimed at it, light is the same."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.scene.emission_region import Sphere
from photonrelax.transport.aim import nested_spheres
from photonrelax.transport.batch import TraceContext, TraceSettings, trace_batch
from photonrelax.transport.emission import emit, nested_aim, plan_emission, plan_through
from tests.helpers.tracing_scenes import ball, enclosure, floor

N = 40_000
LAMP = pr.PointEmitter((1.0, 0.5, 3.0), (3.0, 2.0, 1.0))
EMITTERS = {
    "parallel": pr.CollimatedEmitter((0.3, 0, -1)),
    "sun": pr.CollimatedEmitter((0.3, 0, -1), angular_radius=5.0),
    "point": LAMP,
    "lambertian": pr.LambertianEmitter((0, 0, 4), (0, 0, -1)),
    "spot": pr.SpotEmitter((0, 0, 4), (0, 0, -1), outer_angle=60.0),
    "area": pr.AreaEmitter(pr.Rectangle((0, 0, 4), (0.2, 0, 0), (0, -0.2, 0)), power=1.0),
    "environment": pr.EnvironmentEmitter(1.0),
}


def on_a_table(*emitters, size=15.0, height=0.7):
    """A small glass ball above a large table."""
    glass = pr.SceneObject(ball(0.5, [1.0, 0, height]), pr.Dielectric(), smooth=True)
    return pr.Scene([floor(size), glass], emitters)


def unaimed(scene):
    """The same scene with emitters that aim at all objects together."""
    return replace(scene, aim=scene.targets)


def global_photons(scene, n=N, **options):
    return pr.trace_photons(scene, n, paths="global", **options)


def effective(photons):
    """Number of photons of equal flux with the noise of these."""
    flux = photons.flux.sum(axis=1)
    return flux.sum() ** 2 / (flux @ flux)


@pytest.fixture(scope="module")
def aimed_and_plain():
    scene = on_a_table(LAMP)
    return global_photons(scene), global_photons(unaimed(scene), 8 * N)


def test_more_photons_are_stored_of_as_much_light(aimed_and_plain):
    aimed, plain = aimed_and_plain
    assert effective(aimed) > 20.0 * effective(plain) / 8.0
    noise = 3.0 * np.sqrt(1.0 / effective(aimed) + 1.0 / effective(plain))
    np.testing.assert_allclose(aimed.flux.sum(axis=0), plain.flux.sum(axis=0), rtol=noise)
    assert noise < 0.25


def test_light_is_where_it_was(aimed_and_plain):
    """Mean of the logarithm of the distance from the ball, by flux."""
    means, errors = [], []
    for photons in aimed_and_plain:
        flux = photons.flux.sum(axis=1)
        distance = np.log(np.hypot(photons.position[:, 0] - 1.0, photons.position[:, 1]))
        means.append(np.average(distance, weights=flux))
        errors.append(distance.std() / np.sqrt(effective(photons)))
    assert abs(means[0] - means[1]) < 3.0 * np.hypot(*errors)


def test_guided_light_in_a_closed_room_is_that_of_its_furnace():
    """Glass without absorption leaves Φ a / (1 - a) for the walls, wherever it is looked for."""
    glass = pr.SceneObject(ball(0.3, [0.5, 0.4, -0.6]), pr.Dielectric(), smooth=True)
    room = pr.Scene([enclosure(0.5), glass], [pr.PointEmitter((0, 0, 0))])
    plan = plan_through(nested_aim(room), N, guide=room.targets.around_casters)
    context = TraceContext(room, plan, TraceSettings("global", 10_000, 0.0), N)
    stored, squares, lost = np.zeros(3)
    for region_id, n in enumerate(plan.counts.tolist()):
        batch = trace_batch(context, ((region_id, range(n)),))
        flux = plan.flux_per_photon[region_id, 0]
        light = flux * np.bincount(
            batch.deposits["path"], batch.deposits["throughput"][:, 0], minlength=n
        )
        stored, squares = stored + light.sum(), squares + n * light.var()
        lost += flux * batch.ledger.energy[..., 0].sum()
    assert abs(stored - 1.0) < 3.0 * np.sqrt(squares) < 0.05
    np.testing.assert_allclose(lost, plan.flux[0, 0], rtol=1e-9)


def test_rooms_where_most_light_is_stored_are_left_alone():
    glass = pr.SceneObject(ball(0.3, [0.5, 0.4, -0.6]), pr.Dielectric(), smooth=True)
    room = pr.Scene([enclosure(0.5), glass], [pr.PointEmitter((0, 0, 0))])
    aimed, plain = global_photons(room), global_photons(unaimed(room))
    np.testing.assert_array_equal(aimed.position, plain.position)


def test_energy_is_kept_and_threads_do_not_matter():
    scene = on_a_table(LAMP, EMITTERS["environment"])
    one, two = (global_photons(scene, N // 4, n_threads=n) for n in (1, 2))
    np.testing.assert_array_equal(one.position, two.position)
    np.testing.assert_array_equal(one.flux, two.flux)
    ledger = one.ledger
    ends = ledger.stored + ledger.absorbed + ledger.escaped + ledger.cut + ledger.discarded
    np.testing.assert_allclose(ends, ledger.emitted, rtol=1e-9)


@pytest.mark.parametrize("emitter", EMITTERS.values(), ids=EMITTERS)
def test_shells_share_the_flux_of_the_whole(emitter):
    scene = on_a_table(emitter)
    aimed = nested_aim(scene)
    assert len(aimed) > 2
    plan = plan_through(aimed, N)
    np.testing.assert_allclose(plan.counts, N / len(aimed), atol=1.0)
    np.testing.assert_allclose(plan.flux, plan_emission(scene, N, "global").flux, rtol=0.02)


@pytest.mark.parametrize("name", ["parallel", "point"])
def test_photons_of_a_shell_lie_in_no_smaller_one(name):
    aimed = nested_aim(on_a_table(EMITTERS[name]))
    plan = plan_through(aimed, 3000)
    for number in range(len(aimed)):
        coords = emit(plan, number, range(int(plan.counts[number]))).emitter_coords
        for region in plan.regions[:number]:
            centre, radius = region.outline
            assert (np.linalg.norm(coords - centre, axis=1) >= radius).all()


def test_spheres_are_nested_and_half_as_large_each():
    inner, outer = Sphere(np.array([1.0, 2.0, 3.0]), 0.4), Sphere(np.zeros(3), 10.0)
    spheres = nested_spheres(inner, outer)
    np.testing.assert_allclose([each.radius for each in spheres], [0.4, 0.8, 1.6, 3.2, 6.4, 10.0])
    for small, large in pairwise(spheres):
        between = np.linalg.norm(small.centre - large.centre)
        assert between + small.radius <= large.radius * (1.0 + 1e-12)


def test_a_scene_of_glass_alone_has_no_shells():
    around = Sphere(np.zeros(3), 1.0)
    assert nested_spheres(around, around) == [around]
