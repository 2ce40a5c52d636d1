"""Every task of the workbench, by photonrelax and by its peers."""

import pytest

from bench.speed import inputs, peers, stages
from bench.speed.workbench import OWN, TASKS

# Peers come first: photonrelax is compared with them.
ALTERNATIVES = [(task, who) for task, row in TASKS.items() for who in (*row.peers, OWN)]


@pytest.mark.parametrize(("task", "who"), ALTERNATIVES)
def test_task(timed, workbench, n, n_threads, *, task, who):
    try:
        case = workbench.case(task, who)
    except peers.UnavailableError as error:
        pytest.skip(str(error))
    size = f"{n} photons, {n_threads=}"
    with peers.threads(n_threads):
        timed(case, n, f"{task}: {size}", who, f"{TASKS[task].compared_with or task}: {size}")


def test_shading_compared_with_embree(benchmark, n):
    """On one thread; the time is that of both and of emission."""
    inputs.scene()
    parts = benchmark.pedantic(stages.tracing_parts, args=(n,))
    benchmark.extra_info |= {name: part.wall[0] for name, part in parts.items()}
    benchmark.extra_info["photons_per_second"] = n / sum(p.wall[0] for p in parts.values())
    benchmark.extra_info["shading_over_embree"] = parts["shading"].wall[0] / parts["embree"].wall[0]
    assert parts["embree"].wall[0] > 0.0
