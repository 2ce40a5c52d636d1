"""Time of the stages on a real caustic, beside what SciPy's tree takes for the same neighbours.

Run with ``python -m pytest bench``. `extra_info` of each result carries photons per second.
"""

import pytest
from scipy.spatial import cKDTree

import photonrelax as pr
from photonrelax import gallery

N_EMITTED = 1_000_000
THREADS = [1, None]


@pytest.fixture(scope="module")
def scene():
    return gallery.scene("prism")


@pytest.fixture(scope="module")
def photons(scene):
    return pr.trace_photons(scene, N_EMITTED)


@pytest.fixture(scope="module")
def structure(photons):
    return pr.detect_structure(photons)


@pytest.fixture
def timed(benchmark):
    """Run a stage three times and note how many photons a second it does."""

    def run(stage, n):
        benchmark.pedantic(stage, rounds=3)
        if benchmark.enabled:
            benchmark.extra_info["per_second"] = n / benchmark.stats.stats.median

    return run


@pytest.mark.parametrize("n_threads", THREADS)
def test_trace(timed, scene, n_threads):
    timed(lambda: pr.trace_photons(scene, N_EMITTED, n_threads=n_threads), N_EMITTED)


def test_build(timed, photons):
    timed(lambda: pr.KDTree(photons.position), len(photons))


@pytest.mark.parametrize("k", [16, 50])
@pytest.mark.parametrize("n_threads", THREADS)
def test_neighbours(timed, photons, k, n_threads):
    tree = pr.KDTree(photons.position)
    timed(lambda: tree.query_self(k, n_threads=n_threads), len(photons))


@pytest.mark.parametrize("k", [16, 50])
def test_neighbours_scipy(timed, photons, k):
    """One thread, queries in the tree's own order: the best SciPy can do."""
    tree = cKDTree(photons.position)
    queries = photons.position[tree.indices]
    timed(lambda: tree.query(queries, k, workers=1), len(photons))


@pytest.mark.parametrize("n_threads", THREADS)
def test_structure(timed, photons, n_threads):
    timed(lambda: pr.detect_structure(photons, n_threads=n_threads), len(photons))


@pytest.mark.parametrize("n_iterations", [(1, 0), (0, 1)], ids=["constrained", "collapsed"])
@pytest.mark.parametrize("n_threads", THREADS)
def test_relax(timed, photons, structure, n_iterations, n_threads):
    settings = pr.RelaxSettings(n_iterations)
    timed(lambda: pr.relax(photons, structure, settings, n_threads=n_threads), len(photons))


@pytest.mark.parametrize("method", ["standard", "parameterised"])
def test_render(timed, scene, photons, method):
    timed(lambda: pr.render(scene, photons=photons, method=method), len(photons))
