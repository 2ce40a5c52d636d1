"""Options and fixtures of the benchmarks.

``python -m pytest bench --photons 1e5,863e3 --threads 1`` chooses the sweep; with
``--benchmark-disable`` it is one small count, which checks that all runs and results agree.
"""

import pytest

from bench.arguments import numbers
from bench.speed import inputs, peers
from bench.speed.timing import keep_memory
from bench.speed.workbench import Workbench

SWEEP = "1e5,863e3,4e6"
SMALL = "2e4"
ROUNDS = 3


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
            metafunc.parametrize(name, numbers(values), scope="session")


def pytest_configure():
    keep_memory()


def pytest_terminal_summary(terminalreporter):
    for reason in peers.missing().values():
        terminalreporter.write_line(reason)


@pytest.fixture(scope="session")
def medians():
    """Seconds by task and by who did it."""
    return {}


@pytest.fixture
def timed(benchmark, medians):
    """Function that times and checks a case: ``timed(case, n, task, who, compared_with)``.

    A case has n photons. Alternatives for one task share its name; peers come before
    photonrelax. Extra information has photons per second, and how many times as long others took
    for the task `compared_with`, which is another one where peers do not do the same.
    """

    def run(case, n, task, who, compared_with=""):
        benchmark.group = task
        benchmark.extra_info["who"] = who
        rounds = ROUNDS if case.rounds is None else min(case.rounds, ROUNDS)
        result = benchmark.pedantic(
            case.work, setup=lambda: ((case.prepare(),), {}), rounds=rounds, warmup_rounds=0
        )
        case.check(result)
        if benchmark.enabled:
            seconds = benchmark.stats.stats.median
            benchmark.extra_info["photons_per_second"] = (case.size or n) / seconds
            for name, other in medians.get(compared_with or task, {}).items():
                benchmark.extra_info[f"times_as_fast_as_{name}"] = other / seconds
            medians.setdefault(task, {})[who] = seconds

    return run


@pytest.fixture(scope="session")
def workbench(n, n_threads, pixels):
    return Workbench(inputs.caustic(n), n_threads, pixels)


@pytest.fixture(scope="session")
def pixels(request):
    """Width and height of images: as in the paper, or small if they are not timed."""
    return 60 if request.config.getoption("benchmark_disable") else 600
