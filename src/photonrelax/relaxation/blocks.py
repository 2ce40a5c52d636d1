"""Structure and relaxation of photon maps larger than memory, a block of space at a time.

A photon's structure, and each of its moves, depends on the photons within the distance that its
search reaches. A block is searched with a halo of the photons within that distance of its tiles;
what was reached says whether the halo was wide enough, else it is widened and the block done again.
Iterations of a stage move the photons of a block and those of layers around it. Each layer has the
photons within the searches of the last, and those that may come there meanwhile, and is right for
an iteration less. Searches and paths of all of them are checked. What depends on the whole map, as
whether all normals of a group are equal and its largest range over the emitter coordinates, follows
from the boxes of tiles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._ext.relaxation.projection import SURFACE_POSITION
from .._ext.relaxation.relax import Paths
from .._ext.spatial import kth_distance
from .._util.progress import Reporter
from .._util.validation import Floats
from .._util.workers import Workers
from ..photons.axes import MAX_NORMAL_CHORD
from ..photons.block_search import (
    ISOLATED,
    BlockSearch,
    Columns,
    Found,
    GroupTiles,
    Iterated,
    Layers,
    Neighbourhood,
)
from ..photons.blocks import LABEL, BlockedPhotons
from ..photons.neighbourhoods import Group, WholeGroup
from ..photons.photon_map import PhotonMap
from ..photons.streamed_groups import StreamedGroup
from ..scene.scene import Scene
from ..spatial.kdtree import KDTree
from ..transport.raycast import RayCaster
from .projection import SurfaceProjector
from .relax import Relaxation, RelaxSettings
from .rest_density import RestDensity
from .structure import (
    Structure,
    StructureDetection,
    StructureSettings,
    emitter_range,
    ranges_of,
)

# Faces that have the same normal but for rounding.
_ROUNDING = 1e-15
# Expected reach of a search, over that of the last one like it.
_GROWTH = 1.1
# The same of single iterations, over that again.
_SINGLE = 2.0
# How far isolated photons reach in space is found among those of their block and so many others,
# then among all that are as near.
_SAMPLE = 100_000
# Emitter density of photons of halos, whose range is next to nothing.
_DENSEST = 1e300
# Distance that photons go in an iteration, over that allowed: on surfaces they go round bends, and
# should some go farther, the stage is done again for so many times the distance.
_FLAT, _BENT, _FARTHER = 1.0 + 1e-9, 1.25, 2.0
# Columns that relaxing adds, until it is done.
_STRUCTURE = ("constraint", "direction", "radius", "n_found", "spacing", "nearest", "nearest_any")
_TEMPORARY = (*_STRUCTURE, "reach", "merged", "at", "slope", "limit", "travel")
# Columns that move, and what becomes of them in a stage.
_MOVED = ("position", "normal", "at")


@dataclass(frozen=True)
class BlockWork:
    """Photons to relax by blocks, settings, surfaces and threads; see `relax_parts`."""

    photons: BlockedPhotons
    structure: StructureSettings
    relax: RelaxSettings
    scene: Scene | None
    caster: RayCaster | None
    n_threads: int
    has_rest: bool = False


@dataclass(frozen=True)
class _GroupWork:
    """The search of a group in one pass, and what its tasks need besides.

    `now` are the names of columns where photons are now: positions, normals, and places on
    surfaces.
    """

    work: BlockWork
    search: BlockSearch
    group: StreamedGroup
    whole: WholeGroup
    now: tuple[str, str, str] = _MOVED
    constrained: bool = True
    n_iterations: int = 0

    def local_group(self, some: Neighbourhood) -> Group:
        """The group of the photons of a neighbourhood."""
        labels = some.read(LABEL)[:, np.newaxis] if self.group.labelled else None
        return Group(slice(None), self.group.mixed, self.group.at_rest, labels, self.whole)


class BlockRelaxation:
    """Structure and relaxation of blocked photons, pass by pass.

    Columns of the folder are added, and those of positions and normals replaced at the end.
    """

    def __init__(self, work: BlockWork, workers: Workers, report: Reporter) -> None:
        self._work, self._workers, self._report = work, workers, report
        self._columns = work.photons.columns
        self._has_coords = "emitter_coords" in self._columns
        self._n_moves = 0
        groups = work.photons.groups
        self.tiles = [GroupTiles(work.photons, number) for number in range(len(groups))]
        self._bound_all()

    # --- passes -----------------------------------------------------------------------------------

    def detect_structure(self) -> None:
        """Detect the structure around all photons, into columns."""
        columns = self._columns
        for name in ("constraint", "radius", "spacing", "nearest", "nearest_any"):
            columns.create(name, np.float64)
        columns.create("direction", np.float64, (3,))
        columns.create("n_found", np.int32)
        if self._has_coords:
            columns.create("reach", np.float64)
            columns.create("merged", np.bool_)
            self._pass(_reach, self._search_reach)
        self._pass(_structure, self._search_structure)

    def relax(self) -> None:
        """Relax all photons, and put their columns in place of those before."""
        now = _MOVED
        self._columns.create("travel", np.float64)
        if self._work.scene is not None:
            self._columns.create("at", SURFACE_POSITION)
            self._pass(_surface, self._search_reach)
        runs = _runs(self._work.relax, has_rest=self._work.has_rest)
        for number, (constrained, n) in enumerate(runs):
            if not constrained and (number == 0 or runs[number - 1][0]):
                self._pass(_in_space, partial(self._search_in_space, now=now, n=n))
            now = self._stage(now, n, constrained=constrained)
        for name, moved in zip(_MOVED, now, strict=True):
            if moved != name:
                self._columns.rename(moved, name)
        self._columns.remove(*_TEMPORARY)

    def _stage(
        self, before: tuple[str, str, str], n: int, *, constrained: bool
    ) -> tuple[str, str, str]:
        """Names of the columns of moved photons after a stage of iterations."""
        self._n_moves += 1
        number, (_, normal, at) = self._n_moves, before
        if self._work.scene is not None:
            normal, at = f"normal-{number}", f"at-{number}"
        after = f"position-{number}", normal, at
        for name, moved in zip(before, after, strict=True):
            if moved != name:
                self._columns.like(moved, name)
        slack, went_farther = _FLAT if self._work.scene is None else _BENT, True
        while went_farther:
            self._allow_travel(slack, n, constrained=constrained)
            build = partial(self._search_stage, now=before, n=n, constrained=constrained)
            went_farther = self._pass(_stage, build, after)
            slack *= _FARTHER
        for name in set(before) - set(after) - {"position"}:
            self._columns.remove(name)
        return after

    def _allow_travel(self, slack: float, n: int, *, constrained: bool) -> None:
        """Write how far photons may go in a stage, before the last of its iterations."""
        settings, columns = self._work.relax, self._columns
        steps = (n - 1) * min(settings.largest_step, 1.0)
        for tiles in self.tiles:
            for segment in range(tiles.n_segments):
                rows, spacings = tiles.rows(segment), np.array(steps)
                if self._work.has_rest:
                    # From where they were first, on opposite sides of which a stage may lie.
                    limit = (1.0 if constrained else 2.0) * columns.read("limit", *rows)
                    spacings = np.minimum(steps, limit)
                travel = slack * spacings * columns.read("spacing", *rows)
                columns.write("travel", rows[0], travel)
                tiles.bound(segment, "travel", travel)

    # --- searches ---------------------------------------------------------------------------------

    def _search_reach(self, number: int) -> _GroupWork:
        return self._group_work(number, None, constrained=False)

    def _search_structure(self, number: int) -> _GroupWork:
        expected = None
        if self._has_coords and np.isfinite(self._work.structure.reach_scale):
            # Where photons are of one sheet.
            expected = "reach", _GROWTH / self._work.structure.reach_scale
        work = self._group_work(number, expected, constrained=True)
        return replace(work, search=replace(work.search, merges=self._merges(number)))

    def _search_in_space(self, number: int, *, now: tuple[str, str, str], n: int) -> _GroupWork:
        return replace(
            self._group_work(number, None, now, constrained=False, turns=True), n_iterations=n
        )

    def _search_stage(
        self, number: int, *, now: tuple[str, str, str], n: int, constrained: bool
    ) -> _GroupWork:
        # In space photons are expected to reach so far already.
        expected = ("nearest", _widening(n)) if constrained else ("nearest_any", 1.0)
        work = self._group_work(number, expected, now, constrained=constrained, turns=True)
        search = replace(work.search, travel="travel", merges=self._merges(number))
        return replace(work, search=search, n_iterations=n)

    def _merges(self, number: int) -> bool:
        """Whether some photons of a group are at the same point."""
        tiles = self.tiles[number]
        return self._has_coords and any(
            self._columns.read("merged", *tiles.rows(segment)).any()
            for segment in range(tiles.n_segments)
        )

    def _group_work(
        self,
        number: int,
        expected: tuple[str, float] | None,
        now: tuple[str, str, str] = _MOVED,
        *,
        constrained: bool,
        turns: bool = False,
    ) -> _GroupWork:
        """The search of a group; while photons turn, they are not searched by normals."""
        tiles, group = self.tiles[number], self._work.photons.groups[number]
        position, normal, _ = now
        facing = bool((tiles.extent(normal) > _ROUNDING).any())
        in_emitter = constrained and self._has_coords and not group.mixed
        largest, range_radius = MAX_NORMAL_CHORD, np.full(len(tiles.first), MAX_NORMAL_CHORD)
        axes = [(position, 1.0)]
        if in_emitter:
            range_radius = tiles.largest("emitter_range")
            largest = range_radius.max()
            axes.append(("emitter_coords", 1.0))
        if group.labelled:
            axes.append((LABEL, 2.0 * largest))
        if facing and not turns:
            axes.append((normal, largest / MAX_NORMAL_CHORD))
        k = max(self._work.structure.k, self._work.relax.k)
        search = BlockSearch(self._columns, tiles, tuple(axes), expected, range_radius, k)
        whole = WholeGroup(facing, float(largest))
        return _GroupWork(self._work, search, group, whole, now, constrained=constrained)

    # --- running ----------------------------------------------------------------------------------

    def _pass(
        self,
        work: Callable[[_GroupWork, int], Columns],
        build: Callable[[int], _GroupWork],
        names: tuple[str, str, str] = _MOVED,
    ) -> bool:
        """Do one pass over all blocks of all groups, and write its results.

        `names` are those of the columns of what moves; true if photons went too far.
        """
        renamed, went_farther = dict(zip(_MOVED, names, strict=True)), False
        for number, tiles in enumerate(self.tiles):
            value, jobs = build(number), range(tiles.n_segments)
            for segment, found in enumerate(self._workers.map(work, value, jobs)):
                first, stop = tiles.rows(segment)
                went_farther |= bool(found.pop(_WENT_FARTHER, False))
                for name, column in found.items():
                    self._columns.write(renamed.get(name, name), first, column)
                    if name in _BOUND:
                        tiles.bound(segment, renamed.get(name, name), column)
                self._report.advance(stop - first)
        return went_farther

    def _bound_all(self) -> None:
        """Boxes of the columns that do not change."""
        names = ["position", "normal", LABEL]
        if self._has_coords:
            names.append("emitter_coords")
        for tiles in self.tiles:
            for segment in range(tiles.n_segments):
                rows = tiles.rows(segment)
                for name in names:
                    tiles.bound(segment, name, self._columns.read(name, *rows))
                if self._has_coords:
                    density = self._columns.read("emitter_density", *rows)
                    ranges = ranges_of(density, self._work.structure)
                    tiles.bound(segment, "emitter_range", ranges)


# Columns whose boxes are kept, and what tells that photons of a stage went too far.
_BOUND = ("position", "normal")
_WENT_FARTHER = "went_farther"


def n_passes(settings: RelaxSettings, *, has_coords: bool, has_scene: bool, has_rest: bool) -> int:
    """Passes over all photons of `BlockRelaxation`."""
    runs = _runs(settings, has_rest=has_rest)
    in_space = any(not constrained for constrained, _ in runs)
    return 1 + has_coords + has_scene + in_space + len(runs)


def _runs(settings: RelaxSettings, *, has_rest: bool) -> list[tuple[bool, int]]:
    """Iterations that are done in one pass: whether they are constrained, and their number.

    In space, without a density to rest in, nothing limits whence light may come in many of them but
    the extent of the map: layers would have most of it.
    """
    first, second = settings.n_iterations
    in_space = [(False, second)] if has_rest else second * [(False, 1)]
    return [(constrained, n) for constrained, n in [(True, first), *in_space] if n]


# --- tasks ----------------------------------------------------------------------------------------


def _reach(given: _GroupWork, segment: int) -> Columns:
    """The reach of the photons of a segment, and whether some are at the same point."""
    scale = given.work.structure.reach_scale

    def compute(some: Neighbourhood) -> Found:
        own, group = slice(0, some.n_own), given.local_group(some)
        detection = _detection(given, some, np.empty(len(some.rows)))
        merged = detection.fill_reach(group, of_fewer=False)
        reach = _present(detection.reach)[own]
        reached = reach / scale if np.isfinite(scale) else np.full(some.n_own, np.inf)
        if np.isinf(reach).any() and np.isfinite(scale):
            detection = _detection(given, some, np.empty(len(some.rows)))
            detection.fill_reach(group)
            reach = _present(detection.reach)[own]
        return Found({"reach": reach, "merged": np.full(some.n_own, merged)}, reached, merged)

    return given.search.run(segment, compute)


def _structure(given: _GroupWork, segment: int) -> Columns:
    """The structure around the photons of a segment."""
    k = 1 if given.group.at_rest else given.work.structure.k

    def compute(some: Neighbourhood) -> Found:
        own, reach = slice(0, some.n_own), None
        coincident, limit = False, np.full(some.n_own, np.inf)
        if "reach" in some.columns:
            reach = some.read_own("reach")
            coincident, limit = bool(some.read_own("merged").any()), reach[own]
        detection = _detection(given, some, reach, k_inner=given.work.relax.k)
        n_merged = detection.fill(given.local_group(some), coincident=coincident)
        found = {name: column[own] for name, column in detection.found.items()}
        found["direction"] = np.ascontiguousarray(found.pop("basis")[:, 0])
        del found["eigenvalues"]
        reached = np.where(found["n_found"] < k, limit, found["radius"])
        found |= _expected(given.work, found, limit)
        del found["inner"]
        return Found(found, reached, n_merged > 0)

    return given.search.run(segment, compute)


def _expected(work: BlockWork, found: Columns, limit: Floats) -> Columns:
    """Distances of moves, and those that their searches are expected to reach.

    `limit` (n,) is that of searches among photons in range.
    """
    k, n_found = work.relax.k, found["n_found"]
    nearest = np.where(n_found < k, limit, np.minimum(_GROWTH * found["inner"], limit))
    scale = work.structure.reach_scale
    # The limit is of photons of any sheet.
    of_any = _GROWTH * limit / scale if np.isfinite(scale) else limit
    return {
        "spacing": found["radius"] * np.sqrt(k / n_found),
        "nearest": nearest,
        "nearest_any": np.minimum(nearest, of_any),
    }


def _detection(
    given: _GroupWork, some: Neighbourhood, reach: Floats | None, *, k_inner: int = 0
) -> StructureDetection:
    """Detection around the photons of a neighbourhood."""
    report = Reporter(None, "structure", len(some.rows))
    photons = _local_map(
        some,
        some.read("position"),
        some.read("normal"),
        # Of infinite density, photons of the halo find none.
        partial(some.read_own, fill=_DENSEST),
    )
    return StructureDetection(
        *(photons, given.work.structure, given.work.n_threads, report, reach), k_inner=k_inner
    )


def _widening(n_iterations: int) -> float:
    """Factor of distances that photons reach: a single layer is best wide enough at once."""
    return 1.0 if n_iterations > 1 else _SINGLE


def _in_space(given: _GroupWork, segment: int) -> Columns:
    """Distances to which photons of a segment are expected to reach in space.

    Those expected before are of photons in range; around isolated ones they may have most of the
    map in them. These have few photons beside them, beyond which there may be many.
    """
    tiles, source = given.search.tiles, given.work.photons.columns
    first, stop = tiles.rows(segment)
    before = source.read("nearest_any", first, stop)
    wide, typical = _widening(given.n_iterations), ISOLATED * float(np.median(before))
    nearest, isolated = wide * before, np.flatnonzero(before > typical)
    if len(isolated):
        distance = _distances_in_space(given, segment, isolated)
        margin = (wide * _GROWTH - 1.0) * np.minimum(distance, typical)
        nearest[isolated] = np.minimum(nearest[isolated], distance + margin)
    return {"nearest_any": nearest}


def _distances_in_space(given: _GroupWork, segment: int, isolated: NDArray[np.intp]) -> Floats:
    """Distances (m,) to the k-th of the photons around some of a segment."""
    first, stop = given.search.tiles.rows(segment)
    others = given.search.tiles.sample(_SAMPLE)
    others = others[(others < first) | (others >= stop)]
    rows = np.concatenate([np.arange(first, stop), others])
    # No less than that of all photons.
    distance = _distances_among(given, rows, isolated)
    around = given.search.around(first + isolated, np.where(np.isfinite(distance), distance, 0.0))
    rows = np.concatenate([first + isolated, around])
    return np.minimum(distance, _distances_among(given, rows, np.arange(len(isolated))))


def _distances_among(
    given: _GroupWork, rows: NDArray[np.intp], queries: NDArray[np.intp]
) -> Floats:
    """Distances (m,) to the k-th of some photons around those at m places among them."""
    source = given.work.photons.columns
    points = np.hstack([source.take(name, rows) for name in given.now[:2]])
    tree = KDTree(points, n_threads=given.work.n_threads)
    distance: Floats = kth_distance.of_queries(
        *(tree.kernel, points, queries),
        k=min(given.work.relax.k + 1, len(points)),
        range_radius=MAX_NORMAL_CHORD,
        n_threads=given.work.n_threads,
    )
    return distance


def _surface(given: _GroupWork, segment: int) -> Columns:
    """The triangles that the photons of a segment lie on."""
    work, rows = given.work, given.search.tiles.rows(segment)
    assert work.scene is not None, "photons are projected on a scene"
    position, normal, object_id = (work.photons.columns.read(name, *rows) for name in _ON_SURFACES)
    flux = np.broadcast_to(0.0, position.shape)
    photons = PhotonMap(position, normal, flux, object_id=object_id)
    photons = photons.replace(sensor_ids=work.photons.shared["sensor_ids"])
    projector = SurfaceProjector(work.scene, photons, work.n_threads, work.caster)
    return {"at": projector.at}


_ON_SURFACES = ("position", "normal", "object_id")


def _stage(given: _GroupWork, segment: int) -> Columns:
    """Positions and normals of the photons of a segment after a stage of iterations."""
    if given.group.at_rest:
        return _at_rest(given, segment)

    def compute(some: Layers) -> Iterated:
        own = slice(0, some.n_own)
        paths = Paths(some.depth, some.isolated, given.n_iterations)
        before = some.read(given.now[0]), some.read(given.now[1])
        relaxation = _relaxation(given, some, before)
        position, normal = relaxation.staged(
            given.local_group(some),
            before,
            paths,
            given.n_iterations,
            constrained=given.constrained,
        )
        columns: Columns = {"position": position[own]}
        if not given.constrained and given.n_iterations == 1:
            # For the iteration that follows.
            moved = np.linalg.norm(position[own] - before[0][own], axis=1)
            columns["nearest_any"] = _expected_next(some, paths.searched[own], moved)
        if relaxation.projector is not None:
            columns |= {"normal": normal[own], "at": relaxation.projector.at[own]}
        allowed = given.search.allowed(some.read("travel"))
        columns[_WENT_FARTHER] = np.array([(paths.travelled > allowed).any()])
        return Iterated(columns, paths.searched, paths.tracks)

    return given.search.iterate(segment, given.n_iterations, compute)


def _expected_next(some: Layers, searched: Floats, moved: Floats) -> Floats:
    """Distances (n,) to which own photons are expected to reach in a single iteration more.

    `searched` and `moved` (n,) are how far they reached and went in the last one.
    """
    searched = np.where(np.isfinite(searched), searched, some.read_own("nearest_any")[: some.n_own])
    typical = ISOLATED * float(np.median(searched))
    return searched + moved + (_SINGLE - 1.0) * np.minimum(searched, typical)


def _at_rest(given: _GroupWork, segment: int) -> Columns:
    """Photons that stay where they are."""
    rows = given.search.tiles.rows(segment)
    names = _MOVED if given.work.scene is not None else _MOVED[:1]
    source = given.work.photons.columns
    return {name: source.read(now, *rows) for name, now in zip(names, given.now, strict=False)}


def _relaxation(given: _GroupWork, some: Layers, before: tuple[Floats, Floats]) -> Relaxation:
    """Relaxation of the photons of layers, whose positions and normals are now these."""
    work, (position, normal), rest, projector = given.work, before, None, None
    if work.has_rest:
        # The density is that of where photons were first.
        position, limit = some.read("position"), some.read("limit")
        rest = RestDensity(some.read("slope"), np.zeros(len(limit)), limit)
    photons = _local_map(some, position, normal, some.read)
    if work.scene is not None:
        photons = photons.replace(object_id=some.read("object_id"))
        projector = SurfaceProjector(
            work.scene, photons, work.n_threads, work.caster, some.read(given.now[2])
        )
    report = Reporter(None, "relax", len(photons) * max(work.relax.n_iterations))
    structure = _local_structure(some, photons, work.structure)
    return Relaxation(photons, structure, work.relax, rest, projector, work.n_threads, report)


def _local_structure(
    some: Neighbourhood, photons: PhotonMap, settings: StructureSettings
) -> Structure:
    n = len(some.rows)
    basis = np.zeros((n, 2, 3))
    basis[:, 0] = some.read("direction")
    return Structure(
        eigenvalues=np.zeros((n, 2)),
        constraint=some.read("constraint"),
        basis=basis,
        radius=some.read("radius"),
        n_found=some.read("n_found"),
        emitter_range=emitter_range(photons, settings),
        reach=some.read("reach") if "reach" in some.columns else None,
    )


def _local_map(
    some: Neighbourhood, position: Floats, normal: Floats, read: Callable[[str], NDArray]
) -> PhotonMap:
    """Photons of a neighbourhood, with what searches need; `read` reads densities."""
    n = len(some.rows)
    flux = np.broadcast_to(0.0, (n, 3))
    columns: dict[str, Any] = {"position": position, "normal": normal}
    if "emitter_coords" in some.columns:
        columns["emitter_coords"] = some.read("emitter_coords")
        columns["emitter_density"] = read("emitter_density")
    for column in columns.values():
        column.setflags(write=False)
    return PhotonMap(flux=flux, **columns)


def _present(array: NDArray | None) -> NDArray:
    assert array is not None, "the column is there"
    return array
