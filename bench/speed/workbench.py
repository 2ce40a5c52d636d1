"""Table of tasks that are timed: each by photonrelax, some by peers too.

`bench_stages` gives them to pytest-benchmark one by one, `side_by_side` interleaves them, and
`versions` runs some with two builds of photonrelax; cases of public names alone work with any
build.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cached_property, partial
from inspect import signature
from typing import Any, NamedTuple

import numpy as np

import photonrelax as pr
from bench.speed import checks, inputs, peers, stages
from bench.speed.inputs import Floats
from bench.speed.timing import Case, Timing, interleave

OWN = "photonrelax"
# The ball recipe takes minutes for more photons than this.
_MOST_FOR_BALLS = 1_000_000
# An iteration takes what this many more take: they share the tree.
_ITERATIONS = 7
# Photons traced for each that is stored.
EMITTED = 3.2


class Workbench:
    """Cases of all tasks on the same photons.

    Parameters
    ----------
    photons : PhotonMap
        A caustic, in order of emission.
    n_threads : int
        Threads of photonrelax and of its peers.
    pixels : int
        Width and height of the image whose hit points are gathered at.
    """

    def __init__(self, photons: pr.PhotonMap, n_threads: int, pixels: int) -> None:
        self.photons, self.n_threads, self.pixels = photons, n_threads, pixels
        self.n = len(photons)
        self._trees: dict[str, peers.Ordered] = {}

    def case(self, task: str, who: str = OWN) -> Case:
        """Return a task of `TASKS` as done by photonrelax or a peer.

        Raises
        ------
        peers.UnavailableError
            If the peer is not installed, or takes too long.
        """
        row = TASKS[task]
        if who == OWN:
            return getattr(self, row.method)(*row.arguments)
        return getattr(self, f"{row.method}_by_peer")(who, *row.arguments)

    def cases(self, tasks: Iterable[str]) -> dict[str, Case]:
        """Return tasks by name, and those of the peers at hand by "peer: task"."""
        found = {}
        for task in tasks:
            found[task] = self.case(task)
            for who in TASKS[task].peers:
                with suppress(peers.UnavailableError):
                    found[f"{who}: {task}"] = self.case(task, who)
        return found

    def measured(self, tasks: Iterable[str], rounds: int) -> dict[str, Timing]:
        """Return times of tasks and of their peers; iterations of relaxation by one."""
        with peers.threads(self.n_threads):
            results = interleave(self.cases(tasks), rounds)
        for name in ("constrained", "collapsed"):
            if f"1 {name}" in results:
                more = results.pop(f"{1 + _ITERATIONS} {name}").minus(results.pop(f"1 {name}"))
                results[f"{name} iteration"] = more.scaled(1.0 / _ITERATIONS)
        return results

    # --- inputs, shared by cases ---

    @cached_property
    def ordered(self) -> pr.PhotonMap:
        return inputs.in_morton_order(self.photons)

    @cached_property
    def structure(self) -> pr.Structure:
        return pr.detect_structure(self.photons)

    @cached_property
    def rest(self) -> pr.RestDensity:
        return pr.rest_density(self.photons)

    @cached_property
    def hits(self) -> pr.HitPoints:
        return inputs.hit_points(self.pixels)

    @cached_property
    def field(self) -> pr.IrradianceField:
        return pr.IrradianceField(self.photons, n_threads=self.n_threads)

    @cached_property
    def _structure_alone(self) -> Callable[[], pr.Structure]:
        return stages.with_trees_built(self.ordered, self.n_threads)

    # --- trees and searches; those in Morton order give peers and photonrelax the same array ---

    def build(self) -> Case:
        points = self.photons.position
        return Case(lambda _: pr.KDTree(points, n_threads=self.n_threads))

    def build_ordered(self, n_axes: int) -> Case:
        points = inputs.ranged(self.ordered, max(n_axes, 5)).points[:, :n_axes]
        points = np.ascontiguousarray(points)
        return Case(lambda _: pr.KDTree(points, n_threads=self.n_threads))

    def build_ordered_by_peer(self, who: str, n_axes: int) -> Case:
        peer, points = peers.named(who), self.ordered.position
        return Case(lambda _: peer.build(points))

    def neighbours(self, k: int) -> Case:
        return self._search(self.ordered.position, k)

    def neighbours_by_peer(self, who: str, k: int) -> Case:
        if who not in self._trees:
            self._trees[who] = peers.Ordered(peers.named(who), self.ordered.position)
        return self._search_by_peer(self._trees[who], k)

    def neighbours_as_emitted(self, k: int) -> Case:
        return self._search(self.photons.position, k)

    def _search(self, points: Floats, k: int) -> Case:
        return Case(
            lambda tree: tree.query_self(k, n_threads=self.n_threads),
            prepare=lambda: pr.KDTree(points),
            check=partial(_check_neighbours, points),
        )

    def _search_by_peer(self, tree: peers.Ordered, k: int, limit: float = np.inf) -> Case:
        return Case(
            lambda _: tree.search(k, self.n_threads, limit),
            check=partial(checks.assert_nearest_by_peer, tree=tree, limit=limit),
            size=len(tree.queries),
        )

    def constrained(self, n_axes: int) -> Case:
        photons = inputs.ranged(self.ordered, n_axes)
        return Case(
            lambda tree: tree.query_self(50, range_radius=photons.radius, n_threads=self.n_threads),
            prepare=lambda: pr.KDTree(photons.points),
            check=partial(_check_constrained, photons),
        )

    def constrained_by_peer(self, who: str, n_axes: int) -> Case:
        if who == "ball recipe" and self.n > _MOST_FOR_BALLS:
            raise peers.UnavailableError(f"{who} is left out for over {_MOST_FOR_BALLS:,} photons")
        photons = inputs.ranged(self.ordered, n_axes)
        return Case(
            lambda _: peers.RECIPES[who](photons, 50, self.n_threads),
            check=partial(checks.assert_nearest_in_range, photons=photons, k=50),
            rounds=1,
        )

    # --- structure and relaxation ---

    def detection(self) -> Case:
        return Case(
            lambda _: pr.detect_structure(self.photons, n_threads=self.n_threads),
            check=lambda found: checks.assert_neighbourhoods(found, self.photons, 50),
        )

    def detection_with_trees_built(self) -> Case:
        return Case(
            lambda detect: detect(),
            prepare=lambda: self._structure_alone,
            check=lambda found: checks.assert_neighbourhoods(found, self.ordered, 50),
        )

    def relaxation(self, constrained: int, collapsed: int) -> Case:
        """Relax for so many iterations of each kind."""
        settings = pr.RelaxSettings((constrained, collapsed))
        return Case(
            lambda structure: pr.relax(self.photons, structure, settings, n_threads=self.n_threads),
            prepare=lambda: self.structure,
            check=partial(_check_moved, self.photons),
        )

    def prescription(self) -> Case:
        return Case(
            lambda _: pr.rest_density(self.photons, n_threads=self.n_threads),
            check=lambda rest: np.testing.assert_array_less(0.5, rest.has_map.mean()),
        )

    def relaxation_to_rest(self, constrained: int, collapsed: int) -> Case:
        """Relax for so many iterations of each kind to the density that the map prescribes."""
        settings = pr.RelaxSettings((constrained, collapsed), step=2.0)
        return Case(
            lambda inputs: pr.relax(
                self.photons, inputs[0], settings, rest=inputs[1], n_threads=self.n_threads
            ),
            prepare=lambda: (self.structure, self.rest),
            check=partial(_check_moved, self.photons),
        )

    def preparation(self, method: str) -> Case:
        """All stages of a method before estimates."""
        return Case(
            lambda _: pr.irradiance_field(self.photons, method=method, n_threads=self.n_threads)
        )

    # --- gathering ---

    def gather(self) -> Case:
        hits = self.hits
        return Case(
            lambda field: field(hits.position, hits.normal),
            prepare=lambda: self.field,
            check=self._check_gathered,
            size=len(hits),
        )

    def _check_gathered(self, irradiance: Floats) -> None:
        rows = checks.sample(len(self.hits))
        points, normals = self.hits.position[rows], self.hits.normal[rows]
        again = pr.estimate_irradiance(self.photons, points, normals)
        np.testing.assert_array_equal(irradiance[rows], again)
        assert (irradiance > 0.0).any(), "some hit points should be lit"

    def gather_by_peer(self, who: str) -> Case:
        """Search at the hit points up to the gather radius, in space alone."""
        tree = peers.Ordered(peers.named(who), self.photons.position, self.hits.position)
        return self._search_by_peer(tree, 15, self.field.settings.gather_radius)

    # --- tracing and whole images ---

    def emission(self) -> Case:
        n_emitted = int(EMITTED * self.n)
        emit = stages.emission(n_emitted, self.n_threads)
        return Case(lambda _: emit(), size=n_emitted)

    def misses(self) -> Case:
        """Trace rays of which few hit anything: emission and little else, by public names."""
        n_emitted = int(EMITTED * self.n)
        return Case(
            lambda scene: pr.trace_photons(scene, n_emitted, paths="all", n_threads=self.n_threads),
            prepare=inputs.nearly_empty_scene,
            size=n_emitted,
        )

    def trace(self) -> Case:
        n_emitted = int(EMITTED * self.n)
        return Case(
            lambda scene: pr.trace_photons(scene, n_emitted, n_threads=self.n_threads),
            prepare=inputs.scene,
            size=n_emitted,
        )

    def render(self, method: str) -> Case:
        """Render direct light and caustics: older builds, which may be compared, have no other."""
        given = {"photons": self.photons, "method": method, "n_threads": self.n_threads}
        if "n_global" in signature(pr.render).parameters:
            given["n_global"] = 0
        return Case(
            lambda scene: pr.render(scene, **given),
            prepare=lambda: inputs.scene(self.pixels),
            check=_check_lit,
        )


def _check_neighbours(points: Floats, found: pr.Neighbours) -> None:
    rows = checks.sample(len(points))
    checks.assert_nearest((found.ids[rows], found.distance[rows]), points, points[rows])


def _check_constrained(photons: inputs.RangedPhotons, found: pr.Neighbours) -> None:
    checks.assert_nearest_in_range((found.ids, found.distance), photons, 50)


def _check_moved(before: pr.PhotonMap, after: pr.PhotonMap) -> None:
    moved = (after.position != before.position).any(axis=1)
    assert moved.mean() > 0.9, "most photons should move"


def _check_lit(image: pr.Image) -> None:
    assert image.layers["caustic"].max() > 0.0, "the image should show a caustic"


class Task(NamedTuple):
    """A row of `TASKS`.

    Attributes
    ----------
    method : str
        Method of the workbench that returns the case; "…_by_peer" that of a peer.
    arguments : tuple
        Its arguments.
    peers : tuple of str
        Names of the peers.
    compared_with : str
        Task whose peers do the nearest thing to this one, if none does the same.
    """

    method: str
    arguments: tuple[Any, ...] = ()
    peers: tuple[str, ...] = ()
    compared_with: str = ""


_PEERS = tuple(peer.name for peer in peers.ALL)
_RECIPES = tuple(peers.RECIPES)
_MANY = 1 + _ITERATIONS
STAGES = {
    "build": Task("build"),
    "structure": Task("detection", compared_with="neighbours 50"),
    "relaxation": Task("relaxation", (7, 7), compared_with="neighbours 16"),
    "rest density": Task("prescription", compared_with="neighbours 16"),
    "relaxation to rest": Task("relaxation_to_rest", (5, 5), compared_with="neighbours 16"),
    "1 constrained": Task("relaxation", (1, 0), compared_with="neighbours 16"),
    "1 collapsed": Task("relaxation", (0, 1), compared_with="neighbours 16"),
    f"{_MANY} constrained": Task("relaxation", (_MANY, 0), compared_with="neighbours 16"),
    f"{_MANY} collapsed": Task("relaxation", (0, _MANY), compared_with="neighbours 16"),
    "gather": Task("gather", (), _PEERS),
    "emission": Task("emission"),
    "emission, rays that miss": Task("misses"),
    "trace": Task("trace"),
}
"""Stages of photonrelax, of photons in order of emission."""
TASKS = {
    "neighbours 50": Task("neighbours", (50,), _PEERS),
    "neighbours 16": Task("neighbours", (16,), _PEERS),
    "neighbours 15": Task("neighbours", (15,), _PEERS),
    "neighbours 50, order of emission": Task(
        "neighbours_as_emitted", (50,), compared_with="neighbours 50"
    ),
    "constrained 5": Task("constrained", (5,), _RECIPES),
    "constrained 6": Task("constrained", (6,), _RECIPES),
    "build, Morton order": Task("build_ordered", (3,), _PEERS),
    "build, 5 axes": Task("build_ordered", (5,)),
    "build, 6 axes": Task("build_ordered", (6,)),
    **STAGES,
    "structure, trees built": Task("detection_with_trees_built", compared_with="neighbours 50"),
    "prepare, parameterised": Task("preparation", ("parameterised",)),
    "prepare, mapped": Task("preparation", ("mapped",)),
    "render, standard": Task("render", ("standard",)),
    "render, parameterised": Task("render", ("parameterised",)),
}
"""Everything that is timed on a workbench; searches first, as others are compared with them."""


def degenerate_cases(photons: pr.PhotonMap) -> dict[str, Case]:
    """Return cases of degenerate photons, on one thread; searches build their tree."""
    points = photons.position
    ranged, structure = inputs.ranged(photons), pr.detect_structure(photons)
    settings = pr.RelaxSettings((1, 1))
    return {
        "neighbours": Case(
            lambda _: pr.KDTree(points, n_threads=1).query_self(50, n_threads=1),
            check=partial(_check_neighbours, points),
        ),
        "constrained neighbours": Case(
            lambda _: pr.KDTree(ranged.points, n_threads=1).query_self(
                50, range_radius=ranged.radius, n_threads=1
            ),
            check=partial(_check_constrained, ranged),
        ),
        "structure": Case(
            lambda _: pr.detect_structure(photons, n_threads=1),
            check=lambda found: checks.assert_neighbourhoods(found, photons, 50),
        ),
        "relaxation": Case(lambda _: pr.relax(photons, structure, settings, n_threads=1)),
        "gathering": Case(
            lambda _: pr.estimate_irradiance(photons, points, photons.normal, n_threads=1)
        ),
    }


DEGENERATE = ("neighbours", "constrained neighbours", "structure", "relaxation", "gathering")
"""Names of `degenerate_cases`."""
