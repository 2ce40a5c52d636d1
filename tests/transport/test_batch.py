"""A batch traced in another process is the batch traced here."""

import pickle
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context

import numpy as np
import pytest

import photonrelax as pr
from photonrelax._util.parallel import ordered_map
from photonrelax.photons.energy_ledger import PATH_OUTCOMES
from photonrelax.transport.batch import TraceContext, TraceSettings, batch_jobs, trace_batch
from photonrelax.transport.emission import plan_emission
from tests.helpers.tracing_scenes import DOWN, SCENES, floor, leaning

GLASS_BALL = SCENES["glass ball"]


def context_of(scene, paths="caustic", share=0.0):
    settings = TraceSettings(paths, 32, share)
    return TraceContext(scene, plan_emission(scene, 4000, paths, seed=3), settings, 2048)


def contents(batch):
    """The bytes of all arrays; structured ones by field, for padding is arbitrary."""
    deposits = [batch.deposits[name].tobytes() for name in batch.deposits.dtype.names]
    ledger = batch.ledger
    return (
        *deposits,
        batch.rows.tobytes(),
        batch.emitter_coords.tobytes(),
        batch.emitter_density.tobytes(),
        ledger.energy.tobytes(),
        ledger.ends.tobytes(),
        (ledger.region_id.tobytes(), ledger.n_paths, ledger.n_met_specular),
        batch.counts.tobytes(),
        batch.spectrum_regions.tobytes(),
        batch.spectrum_photons.tobytes(),
        batch.spectrum_rows.tobytes(),
    )


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("paths", ["caustic", "all"])
def test_a_spawned_process_traces_the_same_bytes(paths):
    context = context_of(SCENES["tinted glass, mirror, three emitters"], paths, 0.3)
    work = partial(trace_batch, context)
    jobs = [((0, range(1000)), (1, range(1000))), ((1, range(1000, 1300)), (2, range(1500)))]
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
        there = [contents(batch) for batch in ordered_map(work, jobs, executor)]
    assert there == [contents(batch) for batch in map(work, jobs)]


@pytest.mark.filterwarnings("ignore:.*should be closed:UserWarning")
def test_vertex_normals_that_came_with_a_mesh_are_pickled():
    context = context_of(pr.Scene([floor(9.0), leaning(pr.Dielectric(), 0.5)], [DOWN]))
    again = pickle.loads(pickle.dumps(context))
    job = ((0, range(1000)),)
    assert contents(trace_batch(again, job)) == contents(trace_batch(context, job))


def test_paths_are_used_again_and_batches_keep_their_arrays():
    context = context_of(GLASS_BALL)
    first = trace_batch(context, ((0, range(1500)),))
    paths, before = context.acquire_paths(), contents(first)
    context.release_paths(paths)
    trace_batch(context, ((0, range(1500, 3000)),))
    assert context.acquire_paths() is paths
    assert contents(first) == before


def test_spectra_are_for_the_first_deposits_of_selected_photons():
    batch = trace_batch(context_of(GLASS_BALL, "all", 0.25), ((0, range(1000, 2000)),))
    path = np.sort(batch.deposits["path"])
    assert 0.2 < len(batch.spectrum_rows) / len(np.unique(path)) < 0.3
    np.testing.assert_array_equal(1000 + path[batch.spectrum_rows], batch.spectrum_photons)
    assert (path[batch.spectrum_rows - 1] < path[batch.spectrum_rows])[1:].all()


def test_a_map_has_the_deposits_in_the_order_of_the_paths():
    photons = pr.trace_photons(GLASS_BALL, 4000, seed=3, paths="all")
    batch = trace_batch(context_of(GLASS_BALL, "all"), ((0, range(2000)),))
    order = np.argsort(batch.deposits["path"], kind="stable")
    np.testing.assert_array_equal(batch.rows[order], np.arange(len(order)))
    position = batch.deposits["position"][order]
    np.testing.assert_array_equal(photons.position[: len(order)], position)
    coords = batch.emitter_coords[order]
    np.testing.assert_array_equal(photons.emitter_coords[: len(order)], coords[:, :2])


def lamps_in_a_ring(n):
    """A ball of glass and lamps of unequal power and kind around it: spots are thinned."""
    scene = SCENES["glass ball"]
    angle = 2.0 * np.pi * np.arange(n) / n
    at = np.column_stack([2.0 * np.cos(angle), 2.0 * np.sin(angle), np.full(n, 3.0)])
    emitters = [
        pr.SpotEmitter(place, -place, power, 20.0, 30.0)
        if power % 3 == 0
        else pr.PointEmitter(place, power)
        for power, place in enumerate(at, start=1)
    ]
    return pr.Scene(scene.objects, emitters)


def test_batches_of_many_emitters_are_those_of_each():
    plan = plan_emission(lamps_in_a_ring(12), 15_000)
    jobs = list(batch_jobs(plan, range(100, 14_000), 2048))
    assert max(len(job) for job in jobs) > 2
    assert all(sum(len(photons) for _, photons in job) <= 2048 for job in jobs)
    wanted, taken = dict(plan.parts(range(100, 14_000))), {}
    for region_id, photons in (part for job in jobs for part in job):
        # Blocks of the ledger, of 1024 paths, are whole.
        assert (photons.start - wanted[region_id].start) % 1024 == 0
        taken.setdefault(region_id, []).extend(photons)
    assert taken == {region_id: list(photons) for region_id, photons in wanted.items()}


@pytest.mark.parametrize("paths", ["caustic", "all"])
def test_photons_of_many_emitters_do_not_depend_on_batches(paths):
    scene = lamps_in_a_ring(12)
    one, other = (
        pr.trace_photons(scene, 15_000, paths=paths, frequency_share=share, batch_size=size)
        for size, share in ((1024, 0.01), (16_384, 0.01))
    )
    for name in ("position", "flux", "emitter_coords", "emitter_id", "spectrum"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for name in PATH_OUTCOMES:
        np.testing.assert_array_equal(getattr(one.ledger, name), getattr(other.ledger, name))
        np.testing.assert_array_equal(one.ledger.ends[name], other.ledger.ends[name])
    assert one.ledger.imbalance < 1e-12
