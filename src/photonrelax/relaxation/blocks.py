"""Structure and relaxation of photon maps larger than memory, a block of space at a time.

A photon's structure, and each of its moves, depends on the photons within the distance that its
search reaches. A block is searched with a halo of the photons within that distance of its tiles;
what was reached says whether the halo was wide enough, else it is widened and the block done again.
Between two iterations blocks exchange the positions of their photons, so that halos are as wide as
a single search. What depends on the whole map, as whether all normals of a group are equal and its
largest range over the emitter coordinates, follows from the boxes of tiles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._ext.relaxation.projection import SURFACE_POSITION
from .._util.progress import Reporter
from .._util.validation import Floats
from .._util.workers import Workers
from ..photons.axes import MAX_NORMAL_CHORD
from ..photons.block_search import (
    BlockSearch,
    Columns,
    Found,
    GroupTiles,
    Neighbourhood,
)
from ..photons.blocks import LABEL, BlockedPhotons
from ..photons.neighbourhoods import Group, WholeGroup
from ..photons.photon_map import PhotonMap
from ..photons.streamed_groups import StreamedGroup
from ..scene.scene import Scene
from ..transport.raycast import RayCaster
from .projection import SurfaceProjector
from .relax import Begun, Relaxation, RelaxSettings
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
# Emitter density of photons of halos, whose range is next to nothing.
_DENSEST = 1e300
# Columns that relaxing adds, until it is done.
_STRUCTURE = ("constraint", "direction", "radius", "n_found")
_TEMPORARY = (*_STRUCTURE, "reach", "merged", "at", "searched", "too_few", "slope", "limit")


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

    `position` and `normal` are the names of columns where photons are now, `start` of where they
    were before the first iteration of the stage.
    """

    work: BlockWork
    search: BlockSearch
    group: StreamedGroup
    whole: WholeGroup
    position: str = "position"
    normal: str = "normal"
    start: str = "position"
    constrained: bool = True

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
        for name in ("constraint", "radius"):
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
        columns, settings = self._columns, self._work.relax
        columns.create("searched", np.float64)
        columns.create("too_few", np.bool_)
        position, normal = "position", "normal"
        if self._work.scene is not None:
            columns.create("at", SURFACE_POSITION)
            self._pass(_surface, self._search_reach)
        for constrained, n in zip((True, False), settings.n_iterations, strict=True):
            start = position
            for iteration in range(n):
                position, normal = self._iterate(
                    (position, normal), start, constrained=constrained, is_first=iteration == 0
                )
            if start not in ("position", position):
                columns.remove(start)
        self._finish(position, normal)

    def _iterate(
        self, before: tuple[str, str], start: str, *, constrained: bool, is_first: bool
    ) -> tuple[str, str]:
        """Names of the columns of positions and normals after one iteration."""
        self._n_moves += 1
        after = f"position-{self._n_moves}", before[1]
        self._columns.like(after[0], "position")
        if self._work.scene is not None:
            after = after[0], f"normal-{self._n_moves}"
            self._columns.like(after[1], "normal")
        build = partial(
            self._search_moves,
            before=before,
            start=start,
            constrained=constrained,
            is_first=is_first,
        )
        self._pass(partial(_move, is_first=is_first), build, after)
        for name, kept in zip(before, (("position", start), ("normal", after[1])), strict=True):
            if name not in kept:
                self._columns.remove(name)
        return after

    def _finish(self, position: str, normal: str) -> None:
        """Put the columns of moved photons in place of those before."""
        for name, now in (("position", position), ("normal", normal)):
            if now != name:
                self._columns.rename(now, name)
        self._columns.remove(*_TEMPORARY)

    # --- searches ---------------------------------------------------------------------------------

    def _search_reach(self, number: int) -> _GroupWork:
        return self._group_work(number, None, ("position", "normal"), constrained=False)

    def _search_structure(self, number: int) -> _GroupWork:
        expected = None
        if self._has_coords and np.isfinite(self._work.structure.reach_scale):
            # Where photons are of one sheet.
            expected = "reach", _GROWTH / self._work.structure.reach_scale
        return self._group_work(number, expected, ("position", "normal"), constrained=True)

    def _search_moves(
        self,
        number: int,
        *,
        before: tuple[str, str],
        start: str,
        constrained: bool,
        is_first: bool,
    ) -> _GroupWork:
        share = np.sqrt(self._work.relax.k / self._work.structure.k)
        expected = ("radius", _GROWTH * share) if is_first else ("searched", _GROWTH)
        work = self._group_work(number, expected, before, constrained=constrained)
        return replace(work, start=start)

    def _group_work(
        self,
        number: int,
        expected: tuple[str, float] | None,
        now: tuple[str, str],
        *,
        constrained: bool,
    ) -> _GroupWork:
        tiles, group = self.tiles[number], self._work.photons.groups[number]
        position, normal = now
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
        if facing:
            axes.append((normal, largest / MAX_NORMAL_CHORD))
        k = max(self._work.structure.k, self._work.relax.k)
        search = BlockSearch(self._columns, tiles, tuple(axes), expected, range_radius, k)
        whole = WholeGroup(facing, float(largest))
        return _GroupWork(
            self._work, search, group, whole, position, normal, constrained=constrained
        )

    # --- running ----------------------------------------------------------------------------------

    def _pass(
        self,
        work: Callable[[_GroupWork, int], Columns],
        build: Callable[[int], _GroupWork],
        names: tuple[str, str] = ("position", "normal"),
    ) -> None:
        """Do one pass over all blocks of all groups, and write its results.

        `names` are those of the columns of positions and normals.
        """
        renamed = dict(zip(("position", "normal"), names, strict=True))
        for number, tiles in enumerate(self.tiles):
            value, jobs = build(number), range(tiles.n_segments)
            for segment, found in enumerate(self._workers.map(work, value, jobs)):
                first, stop = tiles.rows(segment)
                for name, column in found.items():
                    self._columns.write(renamed.get(name, name), first, column)
                    if name in _BOUND:
                        tiles.bound(segment, renamed.get(name, name), column)
                self._report.advance(stop - first)

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


_BOUND = ("position", "normal")


def n_passes(settings: RelaxSettings, *, has_coords: bool, has_scene: bool) -> int:
    """Passes over all photons of `BlockRelaxation`."""
    return 1 + has_coords + has_scene + sum(settings.n_iterations)


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
        detection = _detection(given, some, reach)
        n_merged = detection.fill(given.local_group(some), coincident=coincident)
        found = {name: column[own] for name, column in detection.found.items()}
        found["direction"] = np.ascontiguousarray(found.pop("basis")[:, 0])
        del found["eigenvalues"]
        reached = np.where(found["n_found"] < k, limit, found["radius"])
        return Found(found, reached, n_merged > 0)

    return given.search.run(segment, compute)


def _detection(given: _GroupWork, some: Neighbourhood, reach: Floats | None) -> StructureDetection:
    """Detection around the photons of a neighbourhood."""
    report = Reporter(None, "structure", len(some.rows))
    photons = _local_map(some, some.read(given.position), some.read(given.normal))
    return StructureDetection(photons, given.work.structure, given.work.n_threads, report, reach)


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


def _move(given: _GroupWork, segment: int, *, is_first: bool) -> Columns:
    """Positions and normals of the photons of a segment after an iteration."""

    def compute(some: Neighbourhood) -> Found:
        if given.group.at_rest:
            return _at_rest(given, some)
        own = slice(0, some.n_own)
        before = some.read(given.position), some.read(given.normal)
        relaxation = _relaxation(given, some, before)
        begun = None
        if not is_first:
            start = some.read_own(given.start)
            begun = Begun(start, some.read_own("searched"), some.read_own("too_few"))
        position, normal, after = relaxation.moved(
            given.local_group(some), before, begun, constrained=given.constrained
        )
        limit, reach = np.full(some.n_own, np.inf), relaxation.structure.reach
        if given.constrained and reach is not None:
            limit = reach[own]
        few = after.too_few[own]
        reached = np.where(few, limit, after.radius[own])
        columns = {
            "position": position[own],
            "searched": np.where(np.isfinite(reached), reached, after.radius[own]),
            "too_few": few,
        }
        if relaxation.projector is not None:
            columns |= {"normal": normal[own], "at": relaxation.projector.at[own]}
        return Found(columns, reached, after.n_merged > 0)

    return given.search.run(segment, compute)


def _at_rest(given: _GroupWork, some: Neighbourhood) -> Found:
    """Photons that stay where they are."""
    own = slice(0, some.n_own)
    columns = {"position": some.read(given.position)[own]}
    if given.work.scene is not None:
        columns["normal"] = some.read(given.normal)[own]
    return Found(columns, np.zeros(some.n_own))


def _relaxation(
    given: _GroupWork, some: Neighbourhood, before: tuple[Floats, Floats]
) -> Relaxation:
    """Relaxation of the photons of a neighbourhood, whose positions and normals are now these."""
    work, (position, normal), rest, projector = given.work, before, None, None
    if work.has_rest:
        # The density is that of where photons were first.
        position = some.read_own("position")
        limit = some.read_own("limit", np.inf)
        rest = RestDensity(some.read_own("slope"), np.zeros(len(limit)), limit)
    photons = _local_map(some, position, normal)
    if work.scene is not None:
        photons = photons.replace(object_id=some.read("object_id"))
        projector = SurfaceProjector(
            work.scene, photons, work.n_threads, work.caster, some.read_own("at")
        )
    report = Reporter(None, "relax", len(photons))
    structure = _local_structure(some, photons, work.structure)
    return Relaxation(photons, structure, work.relax, rest, projector, work.n_threads, report)


def _local_structure(
    some: Neighbourhood, photons: PhotonMap, settings: StructureSettings
) -> Structure:
    n = len(some.rows)
    basis = np.zeros((n, 2, 3))
    basis[:, 0] = some.read_own("direction")
    return Structure(
        eigenvalues=np.zeros((n, 2)),
        constraint=some.read_own("constraint"),
        basis=basis,
        radius=some.read_own("radius"),
        n_found=some.read_own("n_found", 1),
        emitter_range=emitter_range(photons, settings),
        reach=some.read_own("reach") if "reach" in some.columns else None,
    )


def _local_map(some: Neighbourhood, position: Floats, normal: Floats) -> PhotonMap:
    """Photons of a neighbourhood, with what searches need."""
    n = len(some.rows)
    flux = np.broadcast_to(0.0, (n, 3))
    columns: dict[str, Any] = {"position": position, "normal": normal}
    if "emitter_coords" in some.columns:
        columns["emitter_coords"] = some.read("emitter_coords")
        # Of infinite density, photons of the halo find none.
        columns["emitter_density"] = some.read_own("emitter_density", _DENSEST)
    for column in columns.values():
        column.setflags(write=False)
    return PhotonMap(flux=flux, **columns)


def _present(array: NDArray | None) -> NDArray:
    assert array is not None, "the column is there"
    return array
