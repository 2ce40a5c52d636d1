"""What is timed of photonrelax: a function a stage, of arguments that are made ready before."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter, process_time
from typing import Any
from unittest.mock import patch

import photonrelax as pr
from bench.speed import inputs
from bench.speed.embree_clock import embree_clock
from bench.speed.inputs import Sheet
from bench.speed.timing import Timing, stopwatch
from photonrelax.relaxation import structure as _structure
from photonrelax.transport.emission import EmissionPlan, emit, plan_emission

# As `trace_photons` has them.
_BATCH = 16384


def tree(sheet: Sheet, constrained: bool) -> pr.KDTree:
    """Return a tree of positions, with the emitter coordinates as range axes or without."""
    return pr.KDTree(sheet.points if constrained else sheet.position)


def with_trees_built(photons: pr.PhotonMap, n_threads: int) -> Callable[[], pr.Structure]:
    """Return a call that does all of structure detection but build its trees.

    What is left are its two searches, the principal components and what they are told of each
    photon.
    """
    trees: list[Any] = []
    build = _structure.photon_tree

    def kept(*args: Any, **options: Any) -> Any:
        trees.append(build(*args, **options))
        return trees[-1]

    def detected(photon_tree: Callable[..., Any]) -> pr.Structure:
        with patch.object(_structure, "photon_tree", photon_tree):
            return pr.detect_structure(photons, n_threads=n_threads)

    detected(kept)
    if not trees:
        raise RuntimeError("structure detection should have asked photon_tree for trees")

    def work() -> pr.Structure:
        built = iter(trees)
        return detected(lambda *_, **__: next(built))

    return work


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


def awkward_calls(photons: pr.PhotonMap) -> dict[str, Callable[[], Any]]:
    """Return what is timed of awkward photons, on one thread, by its name.

    Searches build their tree.
    """
    points, normals = photons.position, photons.normal
    sheet = inputs.sheet_of(photons)
    structure = pr.detect_structure(photons)
    return {
        "neighbours": lambda: pr.KDTree(points, n_threads=1).query_self(50, n_threads=1),
        "constrained neighbours": lambda: pr.KDTree(sheet.points, n_threads=1).query_self(
            50, range_radius=sheet.radius, n_threads=1
        ),
        "structure": lambda: pr.detect_structure(photons, n_threads=1),
        "relaxation": lambda: relaxed(photons, structure, (1, 1), 1),
        "gathering": lambda: pr.estimate_irradiance(photons, points, normals, n_threads=1),
    }


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
