"""Wall and CPU time of alternatives, measured in turns so that a busy machine slows all alike."""

from __future__ import annotations

import ctypes
import gc
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from statistics import median
from time import perf_counter, process_time
from typing import Any

# Options of glibc's mallopt.
_M_TRIM_THRESHOLD = -1
_M_MMAP_MAX = -4


def keep_memory() -> None:
    """Have freed memory kept for the next allocation, where glibc can.

    Fresh pages of results of hundreds of megabytes can take longer than what is measured, and
    more or less so by what ran before.
    """
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", lambda option, value: 0)
        mallopt(_M_MMAP_MAX, 0)
        # Never, not even of gigabytes.
        mallopt(_M_TRIM_THRESHOLD, -1)


@dataclass
class Timing:
    """Seconds of each round: on the clock, and of all threads' CPUs together."""

    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)

    def add(self, wall: float, cpu: float) -> None:
        self.wall.append(wall)
        self.cpu.append(cpu)

    def scaled(self, factor: float) -> Timing:
        """Return the time of a part of the work, or of work not measured apart."""
        return Timing([factor * s for s in self.wall], [factor * s for s in self.cpu])

    def minus(self, other: Timing) -> Timing:
        """Return the time of what this does, round by round, and the other does not."""
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
    """One alternative: what is timed, on what `prepare` returns, which is not.

    `check` looks at the first result; `rounds` limits how often something slow is run.
    """

    name: str
    work: Callable[[Any], Any]
    prepare: Callable[[], Any] = lambda: None
    check: Callable[[Any], None] = lambda result: None
    rounds: int | None = None


def stopwatch(work: Callable[[], Any]) -> tuple[float, float, Any]:
    """Return wall seconds, CPU seconds and the result of a call."""
    cpu, wall = process_time(), perf_counter()
    result = work()
    return perf_counter() - wall, process_time() - cpu, result


def interleave(cases: Iterable[Case], rounds: int) -> dict[str, Timing]:
    """Run all cases in turn, `rounds` times over, and return the times by name."""
    cases = list(cases)
    timings = {case.name: Timing() for case in cases}
    for turn in range(rounds):
        for case in cases:
            if case.rounds is None or turn < case.rounds:
                timings[case.name].add(*_timed(case, check=turn == 0))
    return timings


def _timed(case: Case, check: bool) -> tuple[float, float]:
    subject = case.prepare()
    gc.collect()
    wall, cpu, result = stopwatch(lambda: case.work(subject))
    if check:
        case.check(result)
    return wall, cpu
