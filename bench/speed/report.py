"""Tables of a comparison with peers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from statistics import median
from typing import Any, NamedTuple

from bench.markdown import markdown_table
from bench.speed import inputs
from bench.speed.timing import Timing

Results = dict[str, Timing]


@dataclass
class Report:
    """Results of a comparison.

    Attributes
    ----------
    n : int
        Photons of the tables.
    rounds : int
        Most rounds of each.
    description : str
        Machine and versions.
    by_threads : dict
        Results of the workbench by the number of threads.
    tracing, degenerate : Results
        On one thread.
    simd : dict
        Results of all-neighbours searches by path.
    sweep : dict
        Results on one thread by the number of photons.
    clock : {"wall", "cpu"}
        Time in the tables; that of two threads against one is always wall time.
    """

    n: int
    rounds: int
    description: str
    by_threads: dict[int, Results] = field(default_factory=dict)
    tracing: Results = field(default_factory=dict)
    degenerate: Results = field(default_factory=dict)
    simd: dict[str, Results] = field(default_factory=dict)
    sweep: dict[int, Results] = field(default_factory=dict)
    clock: str = "wall"

    def to_dict(self) -> dict[str, Any]:
        return {
            "photons": self.n,
            "rounds": self.rounds,
            "description": self.description,
            "threads": {str(n): _plain(results) for n, results in self.by_threads.items()},
            "tracing": _plain(self.tracing),
            "degenerate": _plain(self.degenerate),
            "simd": {path: _plain(results) for path, results in self.simd.items()},
            "sweep": {str(n): _plain(results) for n, results in self.sweep.items()},
        }

    def markdown(self) -> str:
        """Return all tables, and machine and versions."""
        parts = [
            _table(self._speed_titles(), self._speed_rows()),
            _table(self._cost_titles(), self._cost_rows()),
            _table(["time over a caustic's", *inputs.DEGENERATE[1:]], self._degenerate_rows()),
            _table(["", *self._thread_names(), "times as fast"], self._scaling_rows()),
            f"Medians of {self.rounds} interleaved rounds, {self._clock_name()}. "
            f"{self.description}.",
        ]
        return "\n\n".join(part for part in parts if part) + "\n"

    def seconds(self, results: Results, name: str) -> float | None:
        """Return the median of a result by the chosen clock; None if it was not measured."""
        return median(getattr(results[name], self.clock)) if name in results else None

    def fastest(self, results: Results, task: str) -> str | None:
        """Return the name of the fastest peer at a task."""
        names = [name for name in results if name.endswith(f": {task}")]
        return min(names, key=lambda name: median(getattr(results[name], self.clock)), default=None)

    def _clock_name(self) -> str:
        return {"wall": "wall time", "cpu": "CPU time"}[self.clock]

    def _thread_names(self) -> list[str]:
        return [_threads(n) for n in self.by_threads]

    def _speed_titles(self) -> list[str]:
        others = [f"times as fast, {_threads(n)}" for n in self.by_threads]
        return [f"{self.n:,} photons of a caustic", "time", "compared with", "its time", *others]

    def _speed_rows(self) -> Iterable[list[str]]:
        for row in SPEED:
            pairs = [self._pair(results, row) for results in self.by_threads.values()]
            if pairs and pairs[0]:
                yield [row.work, *_pair_cells(pairs[0]), *map(_times_faster, pairs)]
        for path, results in self.simd.items():
            pair = self._pair(results, SPEED[0])
            blank = [""] * (len(self.by_threads) - 1)
            if pair:
                work = f"{SPEED[0].work}, {SIMD[path]}"
                yield [work, *_pair_cells(pair), _times_faster(pair), *blank]

    def _pair(self, results: Results, row: Speed) -> tuple[float, str, float] | None:
        """Return our seconds, the name of the peer and its seconds."""
        peer = f"{row.peer}: {row.task}" if row.peer else self.fastest(results, row.task)
        mine = self.seconds(results, row.ours)
        theirs = None if peer is None else self.seconds(results, peer)
        if mine is None or theirs is None:
            return None
        return mine, peer.split(":")[0], theirs

    def _cost_titles(self) -> list[str]:
        return ["time over time", *self._thread_names()]

    def _cost_rows(self) -> Iterable[list[str]]:
        for name, top, bottom in COSTS:
            ratios = [self._ratio(results, top, bottom) for results in self.by_threads.values()]
            if any(ratios):
                yield [name, *ratios]
        blank = [""] * (len(self.by_threads) - 1)
        if self.tracing:
            ratio = self._ratio(self.tracing, "shading", "embree")
            yield ["tracing: shading over time inside embree", ratio, *blank]

    def _degenerate_rows(self) -> Iterable[list[str]]:
        generic, *kinds = inputs.DEGENERATE
        for name in self.degenerate:
            kind, call = name.split(": ")
            if kind == generic:
                pairs = [(f"{other}: {call}", name) for other in kinds]
                yield [call, *(self._ratio(self.degenerate, *pair) for pair in pairs)]

    def _ratio(self, results: Results, top: str, bottom: str) -> str:
        over, under = self.seconds(results, top), self.seconds(results, bottom)
        return "" if over is None or under is None else f"{over / under:.2f}"

    def _scaling_rows(self) -> Iterable[list[str]]:
        for stage, name in STAGES.items():
            seconds = [median(r[name].wall) for r in self.by_threads.values() if name in r]
            if seconds and len(seconds) == len(self.by_threads):
                gain = _times(seconds[0] / seconds[-1])
                yield [stage, *(f"{s:.3g} s" for s in seconds), gain]


class Speed(NamedTuple):
    """A row of the first table: description, own result, task of the peers, and the peer.

    Without a peer, the fastest at the task.
    """

    work: str
    ours: str
    task: str
    peer: str = ""


SPEED = (
    Speed("all neighbours, K = 50", "neighbours 50", "neighbours 50"),
    Speed("all neighbours, K = 16", "neighbours 16", "neighbours 16"),
    Speed(
        "structure detection, compared with the plain search for K = 50 alone",
        "structure",
        "neighbours 50",
    ),
    Speed("the same, its two trees built before", "structure, trees built", "neighbours 50"),
    Speed(
        "one iteration of relaxation, compared with the plain search for K = 16 alone",
        "collapsed iteration",
        "neighbours 16",
    ),
    Speed("constrained neighbours, K = 50, 5-D", "constrained 5", "constrained 5", "block recipe"),
    Speed("constrained neighbours, K = 50, 6-D", "constrained 6", "constrained 6", "block recipe"),
    Speed(
        "the same, compared with the usual recipe", "constrained 6", "constrained 6", "ball recipe"
    ),
    Speed(
        "irradiance at the hit points of a camera, K = 15, compared with the search alone",
        "gather",
        "gather",
    ),
)

COSTS = (
    ("constrained over plain search, 5-D", "constrained 5", "neighbours 50"),
    ("constrained over plain search, 6-D", "constrained 6", "neighbours 50"),
    (
        "all neighbours, K = 50, photons in order of emission over in Morton order",
        "neighbours 50, order of emission",
        "neighbours 50",
    ),
    (
        "`mapped` over `parameterised`, but for estimates",
        "prepare, mapped",
        "prepare, parameterised",
    ),
)

SIMD = {"avx2": "held to AVX2", "portable": "held to portable code"}

STAGES = {
    "emission": "emission",
    "tracing": "trace",
    "building a tree": "build",
    "all neighbours, K = 50": "neighbours 50",
    "constrained neighbours, K = 50, 6-D": "constrained 6",
    "structure detection": "structure",
    "one constrained iteration": "constrained iteration",
    "one iteration in space": "collapsed iteration",
    "relaxation, 7 + 7 iterations": "relaxation",
    "rest density": "rest density",
    "relaxation to it, 5 + 5 iterations": "relaxation to rest",
    "gathering": "gather",
}


def _plain(results: Results) -> dict[str, dict[str, Any]]:
    return {name: timing.to_dict() for name, timing in results.items()}


def _threads(n: int) -> str:
    return "1 thread" if n == 1 else f"{n} threads"


def _pair_cells(pair: tuple[float, str, float]) -> list[str]:
    return [f"{pair[0]:.3g} s", pair[1], f"{pair[2]:.3g} s"]


def _times_faster(pair: tuple[float, str, float] | None) -> str:
    return "" if pair is None else _times(pair[2] / pair[0])


def _times(ratio: float) -> str:
    return f"{ratio:.0f}×" if ratio >= 20.0 else f"{ratio:.2g}×"


def _table(column_titles: list[str], rows: Iterable[list[str]]) -> str:
    """Return a table in Markdown, an empty text if it has no rows."""
    rows = list(rows)
    return markdown_table(column_titles, rows) if rows else ""
