"""What is timed of photonrelax: a function a stage, of arguments that are made ready before."""

from __future__ import annotations

from time import perf_counter, process_time

import photonrelax as pr
from photonrelax.emit import EmissionPlan, emit, plan_emission

from . import inputs
from .embree_clock import embree_clock
from .inputs import Sheet
from .timing import Timing, stopwatch

# As `trace_photons` has them.
_BATCH = 16384


def tree(sheet: Sheet, constrained: bool) -> pr.KDTree:
    """Return a tree of positions, with the emitter coordinates as range axes or without."""
    return pr.KDTree(sheet.points if constrained else sheet.position)


def emission(plan: EmissionPlan, n_threads: int) -> None:
    """Emit photons a batch at a time, as tracing does."""
    n_emitted = int(plan.counts[0])
    for first in range(0, n_emitted, _BATCH):
        emit(plan, 0, range(first, min(first + _BATCH, n_emitted)), n_threads=n_threads)


def planned(n_emitted: int) -> EmissionPlan:
    """Return what `emission` needs for the prism."""
    return plan_emission(inputs.scene(), n_emitted, "caustic")


def trace(n_emitted: int, n_threads: int) -> pr.PhotonMap:
    """Trace the prism's photons."""
    return pr.trace_photons(inputs.scene(), n_emitted, n_threads=n_threads)


def relaxed(
    photons: pr.PhotonMap, structure: pr.Structure, iterations: tuple[int, int], n_threads: int
) -> pr.PhotonMap:
    """Relax photons for so many constrained and collapsed iterations."""
    settings = pr.RelaxSettings(iterations)
    return pr.relax(photons, structure, settings, n_threads=n_threads)


def traced_apart(n_emitted: int) -> dict[str, Timing]:
    """Trace on one thread and return how long embree, emission and the rest of it took.

    The rest, shading, is all between the first call of embree and the photon map but emission,
    which is timed by itself afterwards.
    """
    with embree_clock() as clock:
        trace(n_emitted, 1)
        wall, cpu = perf_counter() - clock.first_wall, process_time() - clock.first_cpu
    plan = planned(n_emitted)
    emission_wall, emission_cpu, _ = stopwatch(lambda: emission(plan, 1))
    # Of the first batch it is over when embree is first called.
    later = max(1.0 - _BATCH / n_emitted, 0.0)
    return {
        "embree": Timing([clock.wall], [clock.cpu]),
        "emission": Timing([emission_wall], [emission_cpu]),
        "shading": Timing(
            [wall - clock.wall - later * emission_wall], [cpu - clock.cpu - later * emission_cpu]
        ),
    }
