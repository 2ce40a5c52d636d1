"""What is measured side by side, and how it is set up."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cached_property, partial
from typing import Any

import photonrelax as pr
from bench.speed import checks, inputs, peers, simd, stages
from bench.speed.inputs import Sheet
from bench.speed.morton import Floats
from bench.speed.report import Report, Results
from bench.speed.timing import Case, Timing, interleave
from photonrelax.estimation.nearest import IrradianceField

# The ball recipe takes minutes for more photons than this; in 5-D it does just as in 6-D.
_MOST_FOR_BALLS = 1_000_000
# An iteration takes what this many more take, so that the tree they share is not counted.
_ITERATIONS = 7
# Photons traced for each that is stored.
_EMITTED = 3.2
_N_DEGENERATE = 200_000


class Workbench:
    """Everything that can be timed on n photons of the caustic with some threads.

    Parameters
    ----------
    n : int
        Photons.
    n_threads : int
        Of photonrelax and of its peers.
    pixels : int
        Width and height of the picture whose hit points are gathered at.
    """

    def __init__(self, n: int, n_threads: int, pixels: int) -> None:
        self.n, self.n_threads, self.pixels = n, n_threads, pixels
        self.photons = inputs.caustic(n)

    @cached_property
    def structure(self) -> pr.Structure:
        return pr.detect_structure(self.photons)

    @cached_property
    def hits(self) -> Any:
        return inputs.hit_points(self.pixels)

    @cached_property
    def field(self) -> IrradianceField:
        return IrradianceField(self.photons, n_threads=self.n_threads)

    @cached_property
    def _trees(self) -> dict[str, peers.Ordered]:
        points = inputs.along_curve(self.n).position
        return {p.name: peers.Ordered(p, points) for p in peers.available()}

    def stages(self) -> Iterator[Case]:
        """Yield photonrelax's own stages, of photons in order of emission."""
        photons, n_threads = self.photons, self.n_threads
        n_emitted = int(_EMITTED * self.n)
        yield Case("build", lambda _: pr.KDTree(photons.position, n_threads=n_threads))
        yield Case("structure", lambda _: pr.detect_structure(photons, n_threads=n_threads))
        yield self._relaxation("relaxation", 7, 7)
        for n in (1, 1 + _ITERATIONS):
            yield self._relaxation(f"{n} constrained", n, 0)
            yield self._relaxation(f"{n} collapsed", 0, n)
        yield Case(
            "gather",
            lambda ready: ready[0](ready[1].position, ready[1].normal),
            prepare=lambda: (self.field, self.hits),
        )
        plan = stages.planned(n_emitted)
        yield Case("emission", lambda _: stages.emission(plan, n_threads))
        yield Case("trace", lambda _: stages.trace(n_emitted, n_threads))

    def _relaxation(self, name: str, constrained: int, collapsed: int) -> Case:
        return Case(
            name,
            lambda found: stages.relaxed(
                self.photons, found, (constrained, collapsed), self.n_threads
            ),
            prepare=lambda: self.structure,
        )

    def searches(self, k: int) -> Iterator[Case]:
        """Yield the all-neighbours search of photonrelax and of its peers, in Morton order."""
        points = inputs.along_curve(self.n).position
        rows = checks.sample(self.n)
        check = partial(checks.assert_nearest, points=points, queries=points[rows])
        yield self._search(f"neighbours {k}", points, k)
        for name, tree in self._trees.items():
            yield Case(
                f"{name}: neighbours {k}",
                lambda _, tree=tree: tree.search(k, self.n_threads),
                check=lambda found, tree=tree: check(tree.answers(found, rows)),
            )

    @cached_property
    def _structure_alone(self) -> Callable[[], pr.Structure]:
        return stages.with_trees_built(inputs.along_curve(self.n), self.n_threads)

    def _search(self, name: str, points: Floats, k: int) -> Case:
        rows = checks.sample(self.n)
        return Case(
            name,
            lambda tree: _pair(tree.query_self(k, n_threads=self.n_threads)),
            prepare=lambda: pr.KDTree(points),
            check=lambda found: checks.assert_nearest(
                (found[0][rows], found[1][rows]), points, points[rows]
            ),
        )

    def orders(self) -> Iterator[Case]:
        """Yield the search with photons in order of emission, and structure's in Morton order."""
        yield self._search("neighbours 50, order of emission", self.photons.position, 50)
        ordered = inputs.along_curve(self.n)
        yield Case(
            "structure, trees built",
            lambda work: work(),
            prepare=lambda: self._structure_alone,
            check=lambda found: checks.assert_neighbourhoods(found, ordered, 50),
        )

    def constrained(self, n_axes: int) -> Iterator[Case]:
        """Yield the constrained search of photonrelax and the recipes for it."""
        sheet = inputs.sheet(self.n, n_axes)
        check = partial(checks.assert_nearest_in_range, sheet=sheet, k=50)
        yield Case(
            f"constrained {n_axes}",
            lambda tree: _pair(
                tree.query_self(50, range_radius=sheet.radius, n_threads=self.n_threads)
            ),
            prepare=lambda: stages.tree(sheet, constrained=True),
            check=check,
        )
        for name, recipe in peers.RECIPES.items():
            if name != "ball recipe" or (n_axes == 6 and self.n <= _MOST_FOR_BALLS):
                work = partial(self._recipe, recipe, sheet)
                yield Case(f"{name}: constrained {n_axes}", work, check=check, rounds=1)

    def _recipe(self, recipe: Callable[..., peers.Found], sheet: Sheet, _: None) -> peers.Found:
        return recipe(sheet, 50, self.n_threads)

    def gather_peers(self) -> Iterator[Case]:
        """Yield the search of peers at the hit points, as far as photonrelax looks."""
        points, queries = self.photons.position, self.hits.position
        limit = self.field.settings.gather_radius
        rows = checks.sample(len(queries))
        for peer in peers.available():
            tree = peers.Ordered(peer, points, queries)
            yield Case(
                f"{peer.name}: gather",
                lambda _, tree=tree: tree.search(15, self.n_threads, limit),
                check=lambda found, tree=tree: checks.assert_nearest(
                    tree.answers(found, rows), points, queries[rows], limit
                ),
            )

    def all(self) -> list[Case]:
        """Return what the tables show."""
        return [
            *self.searches(50),
            *self.searches(16),
            *self.orders(),
            *self.constrained(5),
            *self.constrained(6),
            *self.stages(),
            *self.gather_peers(),
        ]

    def measured(self, cases: list[Case], rounds: int) -> Results:
        """Time cases with the threads of this bench."""
        with peers.threads(self.n_threads):
            results = interleave(cases, rounds)
        for name in ("constrained", "collapsed"):
            if f"1 {name}" in results:
                more = results.pop(f"{1 + _ITERATIONS} {name}").minus(results.pop(f"1 {name}"))
                results[f"{name} iteration"] = more.scaled(1.0 / _ITERATIONS)
        return results


def _pair(found: Any) -> peers.Found:
    return found.ids, found.distance


def tracing_parts(n: int, rounds: int) -> Results:
    """Return how long embree, shading and emission take in tracing, on one thread."""
    total: Results = {}
    for _ in range(rounds):
        for name, part in stages.traced_apart(int(_EMITTED * n)).items():
            total.setdefault(name, Timing()).add(part.wall[0], part.cpu[0])
    return total


def degenerate(n: int, rounds: int) -> Results:
    """Return times of awkward inputs, on one thread."""
    cases = []
    for kind in inputs.DEGENERATE:
        calls = stages.awkward_calls(inputs.degenerate(kind, min(n, _N_DEGENERATE)))
        cases += [
            Case(f"{kind}: {name}", lambda _, work=work: work()) for name, work in calls.items()
        ]
    return interleave(cases, rounds)


def fill(report: Report, sweep: list[int], threads: list[int], pixels: int) -> Iterator[str]:
    """Measure everything for a report; yield what is next, all before being in the report."""
    n, rounds = report.n, report.rounds
    for n_threads in threads:
        yield f"{n:,} photons, threads: {n_threads}"
        bench = Workbench(n, n_threads, pixels)
        report.by_threads[n_threads] = bench.measured(bench.all(), rounds)
    yield "tracing, shading apart"
    report.tracing = tracing_parts(n, rounds)
    yield "awkward photons"
    report.degenerate = degenerate(n, rounds)
    for path in simd.PATHS:
        yield f"SIMD: {path}"
        report.simd[path] = simd.measured(path, n, 1, rounds)
    for count in sweep:
        if count == n and 1 in threads:
            report.sweep[n] = report.by_threads[1]
            continue
        yield f"{count:,} photons, threads: 1"
        bench = Workbench(count, 1, pixels)
        cases = [*bench.searches(50), *bench.constrained(6), *bench.stages()]
        report.sweep[count] = bench.measured(cases, min(rounds, 3))
