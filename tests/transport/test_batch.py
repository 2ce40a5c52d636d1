"""A batch traced in another process is the batch traced here."""

import pickle
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context

import numpy as np
import pytest

import photonrelax as pr
from photonrelax._util.parallel import ordered_map
from photonrelax.transport.batch import TraceContext, TraceSettings, trace_batch
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
        batch.emitter_coords.tobytes(),
        batch.emitter_density.tobytes(),
        ledger.energy.tobytes(),
        ledger.ends.tobytes(),
        (ledger.region_id, ledger.n_paths, ledger.n_met_specular),
        batch.spectrum_photons.tobytes(),
        batch.spectrum_rows.tobytes(),
    )


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("paths", ["caustic", "all"])
def test_a_spawned_process_traces_the_same_bytes(paths):
    context = context_of(SCENES["tinted glass, mirror, three emitters"], paths, 0.3)
    work = partial(trace_batch, context)
    jobs = [(0, range(1000)), (1, range(1000)), (1, range(1000, 1300)), (2, range(2000))]
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
        there = [contents(batch) for batch in ordered_map(work, jobs, executor)]
    assert there == [contents(batch) for batch in map(work, jobs)]


@pytest.mark.filterwarnings("ignore:.*should be closed:UserWarning")
def test_vertex_normals_that_came_with_a_mesh_are_pickled():
    context = context_of(pr.Scene([floor(9.0), leaning(pr.Dielectric(), 0.5)], [DOWN]))
    again = pickle.loads(pickle.dumps(context))
    job = 0, range(1000)
    assert contents(trace_batch(again, job)) == contents(trace_batch(context, job))


def test_paths_are_used_again_and_batches_keep_their_arrays():
    context = context_of(GLASS_BALL)
    first = trace_batch(context, (0, range(1500)))
    paths, before = context.acquire_paths(), contents(first)
    context.release_paths(paths)
    trace_batch(context, (0, range(1500, 3000)))
    assert context.acquire_paths() is paths
    assert contents(first) == before


def test_spectra_are_for_the_first_deposits_of_selected_photons():
    batch = trace_batch(context_of(GLASS_BALL, "all", 0.25), (0, range(1000, 2000)))
    path = np.sort(batch.deposits["path"])
    assert 0.2 < len(batch.spectrum_rows) / len(np.unique(path)) < 0.3
    np.testing.assert_array_equal(1000 + path[batch.spectrum_rows], batch.spectrum_photons)
    assert (path[batch.spectrum_rows - 1] < path[batch.spectrum_rows])[1:].all()


def test_a_map_has_the_deposits_in_the_order_of_the_paths():
    photons = pr.trace_photons(GLASS_BALL, 4000, seed=3, paths="all")
    deposits = trace_batch(context_of(GLASS_BALL, "all"), (0, range(2000))).deposits
    order = np.argsort(deposits["path"], kind="stable")
    np.testing.assert_array_equal(photons.position[: len(order)], deposits["position"][order])
