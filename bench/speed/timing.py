"""Wall and CPU time of alternatives, interleaved so that a busy machine slows all alike."""

from __future__ import annotations

import ctypes
import gc
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from statistics import median
from time import perf_counter, process_time
from typing import Any

# Options of glibc's mallopt.
_M_TRIM_THRESHOLD = -1
_M_MMAP_MAX = -4


def keep_memory() -> None:
    """Make glibc keep freed memory for the next allocation.

    Fresh pages for results of hundreds of megabytes can take longer than the work that is
    measured, by an amount that depends on what ran before.
    """
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", lambda option, value: 0)
        mallopt(_M_MMAP_MAX, 0)
        # -1: no amount of free memory is returned to the system.
        mallopt(_M_TRIM_THRESHOLD, -1)


@dataclass
class Timing:
    """Seconds of each round: wall time, and CPU time summed over threads."""

    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)

    def add(self, wall: float, cpu: float) -> None:
        self.wall.append(wall)
        self.cpu.append(cpu)

    def scaled(self, factor: float) -> Timing:
        """Return the time of a share of the work."""
        return Timing([factor * s for s in self.wall], [factor * s for s in self.cpu])

    def minus(self, other: Timing) -> Timing:
        """Return the difference, round by round."""
        return Timing(
            [a - b for a, b in zip(self.wall, other.wall, strict=True)],
            [a - b for a, b in zip(self.cpu, other.cpu, strict=True)],
        )

    def to_dict(self) -> dict[str, Any]:
        values: dict[str, Any] = {"rounds": len(self.wall), "wall": self.wall, "cpu": self.cpu}
        for clock in ("wall", "cpu"):
            each = values[clock]
            values |= {f"{clock}_median": median(each), f"{clock}_min": min(each)}
        return values


@dataclass(frozen=True)
class Case:
    """One alternative of a comparison.

    Attributes
    ----------
    work : callable
        Timed; its argument is the result of `prepare`.
    prepare : callable
        Input of the work; not timed.
    check : callable
        Raises an AssertionError if the result of the first round is wrong.
    size : int, optional
        Photons emitted, or points, if the work is not done for each photon.
    rounds : int, optional
        Most rounds of slow work.
    """

    work: Callable[[Any], Any]
    prepare: Callable[[], Any] = lambda: None
    check: Callable[[Any], None] = lambda result: None
    size: int | None = None
    rounds: int | None = None


def stopwatch(work: Callable[[], Any]) -> tuple[float, float, Any]:
    """Return wall seconds, CPU seconds and the result of a call."""
    cpu, wall = process_time(), perf_counter()
    result = work()
    return perf_counter() - wall, process_time() - cpu, result


def interleave(cases: Mapping[str, Case], rounds: int) -> dict[str, Timing]:
    """Run all cases in turn, `rounds` times over, and return the times by name."""
    timings = {name: Timing() for name in cases}
    for turn in range(rounds):
        for name, case in cases.items():
            if case.rounds is None or turn < case.rounds:
                timings[name].add(*run_once(case, check=turn == 0))
    return timings


def run_once(case: Case, check: bool = False) -> tuple[float, float]:
    """Return wall seconds and CPU seconds of one round."""
    subject = case.prepare()
    gc.collect()
    wall, cpu, result = stopwatch(lambda: case.work(subject))
    if check:
        case.check(result)
    return wall, cpu
