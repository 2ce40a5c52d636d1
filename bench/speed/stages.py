"""Parts of stages: structure detection without its trees, emission, tracing by its parts.

They reach behind public names of photonrelax, which each function imports by itself: what
`versions` measures does without.
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter, process_time
from typing import Any
from unittest.mock import patch

import photonrelax as pr
from bench.speed import inputs
from bench.speed.timing import Timing, stopwatch

# As in `trace_photons`.
_BATCH = 16384


def with_trees_built(photons: pr.PhotonMap, n_threads: int) -> Callable[[], pr.Structure]:
    """Return a call that detects structure with trees that were built before."""
    from photonrelax.relaxation import structure

    trees: list[Any] = []
    build = structure.group_tree

    def kept(*args: Any, **options: Any) -> Any:
        trees.append(build(*args, **options))
        return trees[-1]

    def detected(group_tree: Callable[..., Any]) -> pr.Structure:
        with patch.object(structure, "group_tree", group_tree):
            return pr.detect_structure(photons, n_threads=n_threads)

    detected(kept)
    if not trees:
        raise RuntimeError("structure detection should have asked group_tree for trees")

    def work() -> pr.Structure:
        built = iter(trees)
        return detected(lambda *_, **__: next(built))

    return work


def emission(n_emitted: int, n_threads: int) -> Callable[[], None]:
    """Return a call that emits the prism's photons by batches, as tracing does."""
    from photonrelax.transport.emission import emit, plan_emission

    plan = plan_emission(inputs.scene(), n_emitted, "caustic")
    counts = int(plan.counts[0])
    batches = [range(i, min(i + _BATCH, counts)) for i in range(0, counts, _BATCH)]

    def work() -> None:
        for batch in batches:
            emit(plan, 0, batch, n_threads=n_threads)

    return work


def tracing_parts(n_emitted: int) -> dict[str, Timing]:
    """Trace on one thread and return the times of embree, emission and shading.

    Shading is all from the first call of embree to the photon map but for embree and emission;
    emission is timed by itself afterwards.
    """
    from bench.speed.embree_clock import embree_clock

    scene = inputs.scene()
    with embree_clock() as clock:
        pr.trace_photons(scene, n_emitted, n_threads=1)
        wall, cpu = perf_counter() - clock.first_wall, process_time() - clock.first_cpu
    emission_wall, emission_cpu, _ = stopwatch(emission(n_emitted, 1))
    # The first batch is emitted before the first call of embree.
    later = max(1.0 - _BATCH / n_emitted, 0.0)
    return {
        "embree": Timing([clock.wall], [clock.cpu]),
        "emission": Timing([emission_wall], [emission_cpu]),
        "shading": Timing(
            [wall - clock.wall - later * emission_wall], [cpu - clock.cpu - later * emission_cpu]
        ),
    }
