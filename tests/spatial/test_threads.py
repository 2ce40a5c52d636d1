"""Parallel loops that behave: beside other processes, after a fork, and on Ctrl-C."""

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax.spatial.box_tree import BoxTree
from photonrelax.surfaces.surface_proximity import SurfaceProximity
from tests.helpers.photon_maps import uniform_map
from tests.helpers.tracing_scenes import SCENES

WAIT_SETTINGS = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT", "KMP_BLOCKTIME")
# Prints what other libraries and child processes then see.
IMPORT_KERNELS = (
    "import os, photonrelax as pr; pr.KDTree; "
    "print(*map(os.environ.get, ('OMP_WAIT_POLICY', 'GOMP_SPINCOUNT')))"
)
N_THREADS = 2


def policy_shown(**chosen):
    """Settings that OpenMP reports, and the variables after kernels have been loaded."""
    environment = {name: value for name, value in os.environ.items() if name not in WAIT_SETTINGS}
    done = subprocess.run(
        [sys.executable, "-c", IMPORT_KERNELS],
        env=environment | {"OMP_DISPLAY_ENV": "TRUE"} | chosen,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stderr, done.stdout.strip()


def test_threads_that_wait_soon_sleep_and_the_environment_stays():
    shown, left = policy_shown()
    if "OPENMP DISPLAY ENVIRONMENT" not in shown:
        pytest.skip("kernels without OpenMP")
    assert "OMP_WAIT_POLICY = 'PASSIVE'" in shown
    assert left == "None None"


@pytest.mark.parametrize("chosen", ["ACTIVE", "PASSIVE"])
def test_a_users_choice_of_waiting_stays(chosen):
    shown, left = policy_shown(OMP_WAIT_POLICY=chosen)
    assert left == f"{chosen} None"
    if "OPENMP DISPLAY ENVIRONMENT" in shown:
        assert f"OMP_WAIT_POLICY = '{chosen}'" in shown


def search(_=None):
    points = np.random.default_rng(0).random((20_000, 3))
    found = pr.KDTree(points, n_threads=N_THREADS).query(points, 4, n_threads=N_THREADS)
    return found.ids, found.distance


def relax_map(_=None):
    photons = uniform_map(20_000, "random")
    structure = pr.detect_structure(photons, n_threads=N_THREADS)
    return (pr.relax(photons, structure, n_threads=N_THREADS).position,)


def trace(_=None):
    return (pr.trace_photons(SCENES["glass ball"], 20_000, n_threads=N_THREADS).position,)


def estimate(field):
    at = np.random.default_rng(1).random((5000, 3)) * [1.0, 1.0, 0.0]
    return (field(at, np.tile([0.0, 0.0, 1.0], (5000, 1))),)


def in_forked_children(work, argument=None):
    with multiprocessing.get_context("fork").Pool(2) as pool:
        return pool.map_async(work, [argument] * 2).get(60)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
@pytest.mark.parametrize("work", [search, relax_map, trace])
def test_forked_children_compute_what_their_parent_does(work):
    expected = work()
    for found in in_forked_children(work):
        np.testing.assert_equal(found, expected)


FIELDS = {}


def estimate_of(method):
    return estimate(FIELDS[method])


@pytest.mark.kernels_run_elsewhere
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
@pytest.mark.parametrize("method", ["standard", "diffusion", "progressive"])
def test_forked_children_evaluate_fields_of_their_parent(method):
    photons = uniform_map(20_000, "random")
    FIELDS[method] = pr.irradiance_field(photons, method=method, n_threads=N_THREADS)
    expected = estimate_of(method)
    for found in in_forked_children(estimate_of, method):
        np.testing.assert_equal(found, expected)


def grandchild(_):
    """A fork of a fork, which has searched in between."""
    search()
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=lambda: sender.send(search()[0].sum()))
    process.start()
    process.join()
    return receiver.recv()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_children_of_forked_children_do_as_well():
    expected = search()[0].sum()
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=lambda: sender.send(grandchild(None)))
    process.start()
    assert receiver.poll(60)
    assert receiver.recv() == expected
    process.join()


class SignalError(Exception):
    """Raised by the handler of a signal."""


N_LARGE = 400_000


@pytest.fixture(scope="module")
def large():
    """A map whose neighbourhoods take seconds."""
    return uniform_map(N_LARGE, "random")


@pytest.fixture(scope="module")
def large_tree(large):
    return pr.KDTree(large.position)


def structure_of(photons, _):
    pr.detect_structure(photons, pr.StructureSettings(k=2000), n_threads=N_THREADS)


def boxes_near(photons, _):
    at = photons.position
    BoxTree(at, at).pairs_within(at, at, 0.4, n_threads=N_THREADS)


def surface_near(photons, _):
    # All faces are in reach, and none faces as the points do.
    wall = trimesh.Trimesh([[0, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2]], process=False)
    for _ in range(7):
        wall = wall.subdivide()
    near = SurfaceProximity([pr.SceneObject(wall, pr.Diffuse())]).within
    near(photons.position, photons.normal, 9.0, n_threads=N_THREADS)


LONG = {
    "boxes": boxes_near,
    "surface": surface_near,
    "query": lambda photons, tree: tree.query(photons.position, 200, n_threads=1),
    "query_self": lambda photons, tree: tree.query_self(200, n_threads=1),
    "farthest": lambda photons, tree: tree.farthest(3000, n_threads=N_THREADS),
    "structure": structure_of,
    "gather": lambda photons, _: pr.irradiance_field(
        photons, method="standard", gather=pr.GatherSettings(k=3000)
    )(photons.position, photons.normal),
    "diffusion": lambda photons, _: pr.irradiance_field(
        photons, method="diffusion", diffusion=pr.DiffusionSettings(k=3000)
    )(photons.position, photons.normal),
}


@pytest.fixture
def alarm():
    """Call to have a signal handler raise after some seconds; returns the time of the signal."""
    sent = []

    def handler(number, frame):
        raise SignalError

    def set_alarm(seconds):
        sent.append(time.monotonic() + seconds)
        signal.setitimer(signal.ITIMER_REAL, seconds)
        return sent[-1]

    before = signal.signal(signal.SIGALRM, handler)
    yield set_alarm
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("name", LONG)
def test_signals_are_heard_while_kernels_run(name, large, large_tree, alarm):
    sent = alarm(0.4)
    with pytest.raises(SignalError):
        LONG[name](large, large_tree)
    # A quarter of a second, on a machine that others use too.
    assert time.monotonic() - sent < 1.0
    found = large_tree.query(large.position[:100], 4)
    assert (found.ids[:, 0] == np.arange(100)).all()


def test_building_a_tree_hears_signals(alarm):
    def build():
        for _ in range(100):
            pr.KDTree(points)

    points = np.random.default_rng(0).random((3_000_000, 3))
    sent = alarm(0.1)
    with pytest.raises(SignalError):
        build()
    assert time.monotonic() - sent < 1.0


def test_handlers_that_do_not_raise_leave_the_result(large_tree):
    heard = []
    before = signal.signal(signal.SIGALRM, lambda number, frame: heard.append(time.monotonic()))
    expected = large_tree.farthest(100)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.01, 0.01)
        found = large_tree.farthest(100)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert heard
    np.testing.assert_array_equal(found, expected)


def test_kernels_run_in_any_thread(large_tree):
    expected = large_tree.query_self(20).ids
    found = []
    threads = [
        threading.Thread(target=lambda: found.append(large_tree.query_self(20).ids))
        for _ in range(3)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 3
    assert all((ids == expected).all() for ids in found)
