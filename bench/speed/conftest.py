"""Options and fixtures of the benchmarks.

``python -m pytest bench --photons 1e5,863e3 --threads 1`` chooses the sweep; with
``--benchmark-disable`` it is one small count, to see that all runs and that results agree.
"""

import pytest

import photonrelax as pr
from bench.speed import inputs, peers
from bench.speed.timing import keep_memory

SWEEP = "1e5,863e3,4e6"
SMALL = "2e4"


def pytest_addoption(parser):
    parser.addoption("--photons", help=f"photon counts, default {SWEEP}; {SMALL} if not timed")
    parser.addoption("--threads", default="1,2", help="thread counts, default 1,2")


def pytest_generate_tests(metafunc):
    config = metafunc.config
    counts = config.getoption("photons") or (
        SMALL if config.getoption("benchmark_disable") else SWEEP
    )
    sweep = {"n": counts, "n_threads": config.getoption("threads")}
    for name, values in sweep.items():
        if name in metafunc.fixturenames:
            numbers = [int(float(value)) for value in values.split(",")]
            metafunc.parametrize(name, numbers, scope="session")


def pytest_configure():
    keep_memory()


def pytest_collection_modifyitems(items):
    """Put searches first: others are compared with them."""
    items.sort(key=lambda item: item.path.name != "bench_search.py")


def pytest_terminal_summary(terminalreporter):
    for reason in peers.missing().values():
        terminalreporter.write_line(reason)


@pytest.fixture(scope="session")
def medians():
    """Seconds of what peers were given to do, by what it was and by who did it."""
    return {}


@pytest.fixture
def timed(benchmark, medians):
    """Time a call, note photons per second and how many times as long others took.

    Called as ``timed(work, n, task, who, beside)``: alternatives for one task share its name, and
    peers come before photonrelax. Others are those who did the same, or the task `beside` where
    none does the same. Returns the result of the call.
    """

    def run(work, n, task, who="photonrelax", beside=None, rounds=3, prepare=None):
        benchmark.group = task
        benchmark.extra_info["who"] = who

        def setup():
            return ((), {}) if prepare is None else ((prepare(),), {})

        result = benchmark.pedantic(work, setup=setup, rounds=rounds, warmup_rounds=0)
        if benchmark.enabled:
            seconds = benchmark.stats.stats.median
            benchmark.extra_info["photons_per_second"] = n / seconds
            for name, other in medians.get(beside or task, {}).items():
                benchmark.extra_info[f"times_as_fast_as_{name}"] = other / seconds
            medians.setdefault(task, {})[who] = seconds
        return result

    return run


@pytest.fixture(scope="session")
def photons(n):
    return inputs.caustic(n)


@pytest.fixture(scope="session")
def structure(photons):
    return pr.detect_structure(photons)


@pytest.fixture(scope="session")
def pixels(request):
    """Width and height of pictures: as in the paper, or small if they are not timed."""
    return 60 if request.config.getoption("benchmark_disable") else 600


@pytest.fixture(scope="session")
def hit_points(pixels):
    """1.44 million of them from 600 x 600 pixels."""
    return inputs.hit_points(pixels)
