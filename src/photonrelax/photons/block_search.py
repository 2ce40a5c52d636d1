"""Searches around the photons of a block, among its own and those of its halo."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._ext.spatial.near_boxes import near_points
from .._util.validation import Floats
from ..spatial.kdtree import KDTree
from .blocks import BlockedPhotons
from .columns import ColumnFolder
from .tiles import TILE, Boxes, Tiles, balls, joined_balls, near_tiles

Columns = dict[str, NDArray]

Rows = NDArray[np.intp]

# Factor of a radius that was too small by nobody knows how much, which is at least a share of the
# extent of a group; margin for rounding of one that is known.
_WIDER, _LEAST, _MARGIN = 4.0, 1e-3, 1e-9
# Photons that are searched for a halo one by one: those that are left of many are isolated, or of
# different sheets, and not joined with others.
_FEW = 1024
# Distance of rounding, in units of the extent of a group.
_ROUNDED = 1e-9
# Radius of layers over one that was too small.
_GREATER = 1.1
# Photons that are expected to search so many times as far as the median of a block are isolated.
# There may be very many photons a little farther from them than those that they find: they get so
# much more room at first, and so much where it was too little.
ISOLATED, _SPARE, _MORE_SPARE = 4.0, 0.08, 0.02


class GroupTiles:
    """Tiles of the photons of a group, and the segments (block by block) that they are in.

    Attributes
    ----------
    first, stop : (t,) intp arrays
        Rows of each tile.
    segments : (s,) intp array
        First tile of each segment.
    """

    def __init__(self, photons: BlockedPhotons, group: int, size: int = TILE) -> None:
        numbers = photons.segments.of_group(group)
        firsts, stops = photons.segments.first[numbers], photons.segments.stop[numbers]
        starts = [np.arange(a, b, size) for a, b in zip(firsts, stops, strict=True)]
        self.first = np.concatenate(starts)
        last = np.cumsum([len(each) for each in starts])
        self.stop = np.append(self.first[1:], 0)
        self.stop[last - 1] = stops
        self.segments = last - [len(each) for each in starts]
        self._boxes: dict[str, tuple[Floats, Floats]] = {}

    @property
    def n_segments(self) -> int:
        return len(self.segments)

    def of_segment(self, segment: int) -> Tiles:
        """Tiles of a segment."""
        end = self.segments[segment + 1] if segment + 1 < self.n_segments else len(self.first)
        return np.arange(self.segments[segment], end)

    def rows(self, segment: int) -> tuple[int, int]:
        """First row of a segment, and the one behind its last."""
        tiles = self.of_segment(segment)
        return int(self.first[tiles[0]]), int(self.stop[tiles[-1]])

    def sample(self, n: int) -> Rows:
        """Rows of about n photons of the group, or of all if they are fewer."""
        step = min(max(int((self.stop - self.first).sum()) // n, 1), TILE)
        rows = self.first[:, np.newaxis] + np.arange(0, TILE, step)
        return rows[rows < self.stop[:, np.newaxis]]

    def bound(self, segment: int, name: str, values: NDArray) -> None:
        """Set the boxes of a column whose rows in a segment have these values."""
        tiles = self.of_segment(segment)
        values = values.reshape(len(values), -1)
        if name not in self._boxes:
            shape = len(self.first), values.shape[1]
            self._boxes[name] = np.empty(shape), np.empty(shape)
        low, high = self._boxes[name]
        starts = self.first[tiles] - self.first[tiles[0]]
        low[tiles] = np.minimum.reduceat(values, starts, axis=0)
        high[tiles] = np.maximum.reduceat(values, starts, axis=0)

    def largest(self, name: str) -> Floats:
        """Largest value (t,) of a column of numbers in each tile."""
        return self._boxes[name][1][:, 0]

    def extent(self, name: str) -> Floats:
        """Extent of a column over the whole group."""
        low, high = self._boxes[name]
        return high.max(axis=0) - low.min(axis=0)

    def boxes(self, axes: tuple[tuple[str, float], ...]) -> Boxes:
        """Boxes over some columns, each times a factor; the first has the metric."""
        low = np.hstack([scale * self._boxes[name][0] for name, scale in axes])
        high = np.hstack([scale * self._boxes[name][1] for name, scale in axes])
        return Boxes(low, high, self._boxes[axes[0][0]][0].shape[1])


class Found(NamedTuple):
    """Results of a computation around the own photons of a neighbourhood.

    Attributes
    ----------
    columns : dict
        Results, a row each.
    reached : (n,) float array
        Distance to which each photon's neighbours were searched, which the halo has to have;
        infinite where there were too few.
    merged : bool
        Some photons are at the same point.
    """

    columns: Columns
    reached: Floats
    merged: bool = False


@dataclass(frozen=True)
class Neighbourhood:
    """Own photons and those of the halo, in this order.

    Attributes
    ----------
    rows : (n,) intp array
    n_own : int
    """

    columns: ColumnFolder
    rows: NDArray[np.intp]
    n_own: int

    def read(self, name: str) -> NDArray:
        """A column of all photons."""
        own = _of_rows(self.columns, name, self.rows[: self.n_own])
        if self.n_own == len(self.rows):
            return own
        return np.concatenate([own, self.columns.take(name, self.rows[self.n_own :])])

    def read_own(self, name: str, fill: float = 0.0) -> NDArray:
        """A column of the own photons; those of the halo have a value that is not used."""
        own = _of_rows(self.columns, name, self.rows[: self.n_own])
        column = np.zeros((len(self.rows), *own.shape[1:]), own.dtype)
        column[: self.n_own] = own
        if fill:
            column[self.n_own :] = fill
        return column


Compute = Callable[[Neighbourhood], Found]


@dataclass(frozen=True)
class Layers(Neighbourhood):
    """Own photons of a block, and those that they depend on in some iterations.

    Attributes
    ----------
    depth : (n,) intp array
        Iterations after which each photon is where it is in one piece, all of them for own ones:
        in each it depends on the photons around it as they are after the iteration before.
    isolated : (t,) intp array
        Places of photons of which all searches are to be told.
    """

    depth: NDArray[np.intp]
    isolated: NDArray[np.intp]

    def known(self, depth: int) -> Rows:
        """Photons (m,) of a depth and more, ascending."""
        return np.sort(self.rows[self.depth >= depth])


class Iterated(NamedTuple):
    """Results of some iterations of the photons of layers.

    Attributes
    ----------
    columns : dict
        Of the own ones.
    reached : (n,) float array
        Largest distance from where they started to which photons were searched, in as many
        iterations as they are deep.
    searches : (t, iterations, 4) float array
        Of the isolated ones, where they were and the distances that they searched, negative where
        there was none.
    """

    columns: Columns
    reached: Floats
    searches: Floats


Iterate = Callable[[Layers], Iterated]


@dataclass
class _Wider:
    """Photons that layers have beside those that were expected to do.

    Attributes
    ----------
    typical : float
        Median of the distances that the photons of the block are expected to search.
    rows, radius : (w,) arrays
        Photons, ascending, and their radii, which are wider.
    more : dict of int to (m,) intp array
        By depth, photons near isolated ones.
    """

    typical: float
    rows: Rows = field(default_factory=lambda: np.empty(0, np.intp))
    radius: Floats = field(default_factory=lambda: np.empty(0))
    more: dict[int, Rows] = field(default_factory=dict)

    def widen(self, rows: Rows, radius: Floats) -> None:
        """Add wider radii of some photons."""
        both = np.concatenate([self.rows, rows]), np.concatenate([self.radius, radius])
        self.rows, place = np.unique(both[0], return_inverse=True)
        self.radius = np.zeros(len(self.rows))
        np.maximum.at(self.radius, place, both[1])

    def apply(self, rows: Rows, radius: Floats) -> Floats:
        """Radii of photons, widened where they are to be."""
        if not len(self.rows):
            return radius
        place = np.minimum(np.searchsorted(self.rows, rows), len(self.rows) - 1)
        wider = np.where(self.rows[place] == rows, self.radius[place], 0.0)
        return np.maximum(radius, wider)

    def add(self, depth: int, rows: Rows) -> None:
        """Add photons of a depth."""
        self.more[depth] = np.union1d(self.more.get(depth, rows), rows)

    def without(self, depth: int, known: Rows) -> Rows:
        """Photons that were added of a depth, without those known, which ascend."""
        rows = self.more.get(depth, known[:0])
        return rows[~_contains(known, rows)]


class _Around(NamedTuple):
    """Balls to search, in place of those around where photons are first.

    Attributes
    ----------
    centres : (n, 3) float array
    radius : (n,) float array
    """

    centres: Floats
    radius: Floats


@dataclass(frozen=True)
class BlockSearch:
    """Search around the photons of a group, a segment at a time.

    Attributes
    ----------
    columns : ColumnFolder
    tiles : GroupTiles
    axes : tuple of (str, float)
        Columns that neighbours are searched by and their factors; the first has the metric.
    expected : (str, float) or None
        Column, and its factor, of the distances to which photons are expected to search; None if
        nothing is known of them, so that blocks are searched without a halo first.
    range_radius : (t,) float array
        Largest radius, in each tile, of the balls over the other axes.
    k : int
        Photons that a search finds at most. As many are searched at least, as long as a group has
        them: of trees with fewer, kernels take all for the neighbours asked for.
    travel : str or None
        Column of the distances that photons go at most between iterations; None if they stay.
    merges : bool
        Some photons stand for others at the same point, so that halos have all of these or none.
    """

    columns: ColumnFolder
    tiles: GroupTiles
    axes: tuple[tuple[str, float], ...]
    expected: tuple[str, float] | None
    range_radius: Floats
    k: int
    travel: str | None = None
    merges: bool = False

    @cached_property
    def _boxes(self) -> Boxes:
        boxes = self.tiles.boxes(self.axes)
        if self.travel is None:
            return boxes
        return replace(boxes, travel=self.allowed(self.tiles.largest(self.travel)))

    @cached_property
    def _segment_boxes(self) -> Boxes:
        boxes, segments = self._boxes, self.tiles.segments
        low = np.minimum.reduceat(boxes.low, segments, axis=0)
        high = np.maximum.reduceat(boxes.high, segments, axis=0)
        travel = None if boxes.travel is None else np.maximum.reduceat(boxes.travel, segments)
        return Boxes(low, high, boxes.n_metric, travel)

    @cached_property
    def _extent(self) -> float:
        """Distance that no search exceeds."""
        return float(np.linalg.norm(self.tiles.extent(self.axes[0][0]))) * (1.0 + 1e-9)

    def run(self, segment: int, compute: Compute) -> Columns:
        """Results of the photons of a segment, with halos as wide as they turn out to need.

        Photons whose searches went further than was expected are searched again, if there are
        photons in that distance that were left out.
        """
        first, stop = self.tiles.rows(segment)
        own = todo = np.arange(first, stop)
        radius = np.zeros(len(own))
        if self.expected is not None:
            name, factor = self.expected
            radius = np.minimum(factor * self.columns.read(name, first, stop), self._extent)
        halo, _ = self._halo(own, radius)
        results: Columns = {}
        while len(todo):
            halo = self._filled(todo, self._with_same_points(halo, todo))
            found = compute(Neighbourhood(self.columns, np.concatenate([todo, halo]), len(todo)))
            _place(results, todo - first, found.columns, len(own))
            wider = np.where(np.isinf(found.reached), self._widened(radius), found.reached)
            wider = np.minimum((1.0 + _MARGIN) * wider, self._extent)
            short = np.flatnonzero((found.reached > radius) & (radius < self._extent))
            if found.merged and len(short):
                # Photons at the same point are searched together.
                short = np.arange(len(todo))
            known = _merged(todo, halo)
            _, left_out = self._halo(todo[short], wider[short], known)
            # Of too few, who knows how far the others are.
            left_out |= np.isinf(found.reached[short]) & (radius[short] < self._extent)
            if found.merged and left_out.any():
                left_out[:] = True
            todo, radius = todo[short][left_out], wider[short][left_out]
            halo, _ = self._halo(todo, radius, apart=len(todo) <= _FEW)
        return results

    def around(self, rows: Rows, radius: Floats) -> Rows:
        """Photons, ascending, within the radii of isolated ones, whose rows ascend."""
        near, _ = self._halo(rows, np.minimum((1.0 + _MARGIN) * radius, self._extent), apart=True)
        return near

    def iterate(self, segment: int, n_iterations: int, compute: Iterate) -> Columns:
        """Results of the photons of a segment, with layers as wide as they turn out to need."""
        own = np.arange(*self.tiles.rows(segment))
        wider = _Wider(float(np.median(self._expected(own))))
        while True:
            layers = self._layers(own, n_iterations, wider)
            found = compute(layers)
            if not self._widen(wider, layers, found):
                return found.columns

    def _layers(self, own: Rows, n_iterations: int, wider: _Wider) -> Layers:
        """Photons that others depend on, a layer for each iteration."""
        known = front = own
        rows, depth = own, np.full(len(own), n_iterations)
        for left in range(n_iterations - 1, -1, -1):
            front, _ = self._halo(front, self._radius_of(front, wider), known)
            front = _merged(front, wider.without(left, _merged(known, front)))
            front = self._with_same_points(front, known)
            known = _merged(known, front)
            rows, depth = np.append(rows, front), np.append(depth, np.full(len(front), left))
        order = np.argsort(rows[len(own) :]) + len(own)
        rows[len(own) :], depth[len(own) :] = rows[order], depth[order]
        more = self._filled(own, rows[len(own) :])[len(rows) - len(own) :]
        rows, depth = np.append(rows, more), np.append(depth, np.zeros(len(more), np.intp))
        isolated = self._expected(rows) > ISOLATED * wider.typical
        return Layers(self.columns, rows, len(own), depth, np.flatnonzero(isolated & (depth > 0)))

    def _with_same_points(self, rows: Rows, known: Rows) -> Rows:
        """Photons, and those at the same points that are not known, if these are of interest."""
        if not self.merges:
            return rows
        search = replace(self, axes=self.axes[:1], travel=None)
        others, _ = search._halo(rows, np.zeros(len(rows)), _merged(known, rows))
        return _merged(rows, others)

    def _expected(self, rows: Rows) -> Floats:
        """Distances (n,) that photons are expected to search."""
        assert self.expected is not None, "iterations follow a search"
        name, factor = self.expected
        distance: Floats = factor * _of_rows(self.columns, name, rows)
        return distance

    def _radius_of(self, rows: Rows, wider: _Wider) -> Floats:
        """Distance (n,), from where some photons are first, in which others are in layers."""
        expected, travel = self._expected(rows), self._travel_of(rows)
        isolated = expected > ISOLATED * wider.typical
        travel[isolated] = np.minimum(travel, _SPARE * expected)[isolated]
        return np.minimum(wider.apply(rows, expected + travel), self._extent)

    def _travel_of(self, rows: Rows) -> Floats:
        """Distance (n,) that some photons go at most between iterations."""
        if self.travel is None:
            return np.zeros(len(rows))
        return self.allowed(self.columns.take(self.travel, rows))

    def allowed(self, values: Floats) -> Floats:
        """Distances that photons go at most, by their values of the column of these."""
        return values + _ROUNDED * self._extent

    def _widen(self, wider: _Wider, layers: Layers, found: Iterated) -> bool:
        """Widen layers where photons lacked others near them; true if any did."""
        radius = self._radius_of(layers.rows, wider)
        short = (layers.depth > 0) & (found.reached > radius) & (radius < self._extent)
        reached, widened = np.minimum(found.reached, self._extent), False
        lacking = self._lacking(layers, found, short)
        short[layers.isolated] = False
        for depth in np.unique(layers.depth[short]).tolist():
            mine = np.flatnonzero(short & (layers.depth == depth))
            order = mine[np.argsort(layers.rows[mine])]
            rows, needed = layers.rows[order], reached[order]
            known, apart = layers.known(depth - 1), len(rows) <= _FEW
            _, missed = self._halo(rows, needed, known, apart=apart)
            wider.widen(rows[missed], np.minimum(_GREATER * needed[missed], self._extent))
            widened |= bool(missed.any())
        for depth, rows in lacking:
            wider.add(depth, rows)
        return widened or bool(lacking)

    def _lacking(
        self, layers: Layers, found: Iterated, short: NDArray[np.bool_]
    ) -> list[tuple[int, Rows]]:
        """Photons that isolated ones did not find, and the depth that they are needed of."""
        lacking = []
        some = np.flatnonzero(short[layers.isolated])
        for depth in np.unique(layers.depth[layers.isolated[some]]).tolist():
            mine = some[layers.depth[layers.isolated[some]] == depth]
            mine = mine[np.argsort(layers.rows[layers.isolated[mine]])]
            known = layers.known(depth - 1)
            for searches in found.searches[mine, :depth].transpose(1, 0, 2):
                there = searches[:, 3] >= 0.0
                places, searches = layers.isolated[mine[there]], searches[there]
                farthest = np.minimum(_GREATER * found.reached[places], self._extent)
                around = _Around(searches[:, :3], np.minimum(searches[:, 3], self._extent))
                rows = layers.rows[places]
                _, missed = self._halo(rows, farthest, known, around)
                if missed.any():
                    around = _Around(around.centres[missed], around.radius[missed])
                    around = self._nearer(around, rows[missed], farthest[missed], known)
                    more, _ = self._halo(rows[missed], farthest[missed], known, around)
                    lacking.append((depth - 1, more))
        return lacking

    def _nearer(self, around: _Around, rows: Rows, farthest: Floats, known: Rows) -> _Around:
        """Balls that have no more than some of the photons that were not known.

        Searches went too far where these are nearer than those that were found.
        """
        near, _ = self._halo(rows, farthest, known, around)
        tree = KDTree(self.columns.take(self.axes[0][0], near), n_threads=1)
        distance = tree.query(around.centres, min(self.k, len(near)), n_threads=1).distance
        nearer = (1.0 + _MORE_SPARE) * np.minimum(around.radius, distance[:, -1])
        return _Around(around.centres, nearer)

    def _filled(self, todo: Rows, halo: Rows) -> Rows:
        """A halo with some more photons of the group, if there are fewer than k in all."""
        near, missing = np.concatenate([todo, halo]), self.k - len(todo) - len(halo)
        for first, stop in zip(self.tiles.first, self.tiles.stop, strict=True):
            if missing <= 0:
                break
            more = np.setdiff1d(np.arange(first, stop), near)[:missing]
            halo, missing = np.concatenate([halo, more]), missing - len(more)
        return halo

    def _widened(self, radius: Floats) -> Floats:
        """Radii beyond some that were too small by nobody knows how much."""
        return _WIDER * np.maximum(radius, _LEAST * self._extent)

    def _halo(
        self,
        rows: Rows,
        radius: Floats,
        known: Rows | None = None,
        around: _Around | None = None,
        *,
        apart: bool = False,
    ) -> tuple[Rows, NDArray[np.bool_]]:
        """Photons within the radii of some, ascending, and which of these have any.

        Photons of `rows`, which are ascending, do not count, nor do those of `known`. Balls
        `around` are within the radii. `apart` says that photons may be far from one another.
        """
        left_out, has_any = rows if known is None else known, np.zeros(len(rows), dtype=bool)
        is_open, tile = self._open(left_out), self._tiles_of(rows)
        mine = np.flatnonzero(self._may_reach(tile, radius, is_open))
        if not len(mine):
            return rows[:0], has_any
        columns = [(scale, self.columns.mapped(name)) for name, scale in self.axes]
        points, ranges = _points(columns, rows[mine]), self.range_radius[tile[mine]]
        n_metric = self._boxes.n_metric
        if around is not None:
            points[:, :n_metric] = around.centres[mine]
            queries = balls(points, around.radius[mine], ranges, n_metric)
        elif apart:
            queries = balls(points, radius[mine], ranges, n_metric)
        else:
            queries = joined_balls(points, radius[mine], ranges, tile[mine], n_metric)
        near, hit_any = [rows[:0]], np.zeros(len(queries.radius), dtype=bool)
        travel = None if self.travel is None else self.columns.mapped(self.travel)
        for hits in near_tiles(
            queries, self._boxes, self._segment_boxes, self.tiles.segments, is_open
        ):
            there, first = self._left_in(hits.tiles, left_out)
            close, hit = near_points(
                *(queries.boxes.low, queries.boxes.high, queries.radius, queries.range_radius),
                *(hits.searches, hits.first, _points(columns, there), first),
                None if travel is None else self.allowed(travel[there]),
                self._boxes.n_metric,
            )
            near.append(there[close])
            hit_any |= hit
        has_any[mine] = hit_any[queries.query_of]
        return _distinct(np.concatenate(near)), has_any

    def _tiles_of(self, rows: Rows) -> Rows:
        """Tiles (n,) of photons."""
        return np.searchsorted(self.tiles.first, rows, side="right") - 1

    def _may_reach(
        self, tile: Rows, radius: Floats, is_open: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Photons (n,) of tiles, in ascending order, that may reach segments with open tiles."""
        if not len(tile):
            return np.zeros(0, dtype=bool)
        starts = np.flatnonzero(np.append(True, tile[1:] != tile[:-1]))
        present, largest = tile[starts], np.maximum.reduceat(radius, starts)
        segments = np.flatnonzero(np.logical_or.reduceat(is_open, self.tiles.segments))
        near = self._boxes.take(present).near(
            self._segment_boxes.take(segments), largest, self.range_radius[present]
        )
        return np.repeat(near.any(axis=1), np.diff(np.append(starts, len(tile))))

    def _left_in(self, tiles: Rows, left_out: Rows) -> tuple[Rows, Rows]:
        """Photons of some tiles without those left out, and the first one of each and the end."""
        first, stop = self.tiles.first[tiles], self.tiles.stop[tiles]
        starts = np.cumsum(stop - first) - (stop - first)
        there = np.repeat(first - starts, stop - first) + np.arange((stop - first).sum())
        known = _contains(left_out, there)
        counts = np.add.reduceat(~known, starts, dtype=np.intp)
        return there[~known], np.append(0, np.cumsum(counts))

    def _open(self, known: Rows) -> NDArray[np.bool_]:
        """Tiles (t,) of which not all photons are known; these ascend."""
        first, stop = (np.searchsorted(known, rows) for rows in (self.tiles.first, self.tiles.stop))
        return stop - first < self.tiles.stop - self.tiles.first


def _distinct(rows: Rows) -> Rows:
    """Rows that are there, ascending."""
    rows = np.sort(rows)
    return rows[np.append(True, rows[1:] != rows[:-1])] if len(rows) else rows


def _merged(rows: Rows, others: Rows) -> Rows:
    """Rows of two sets that have none in common, ascending."""
    return np.sort(np.concatenate([rows, others]), kind="stable")


def _contains(ascending: Rows, rows: Rows) -> NDArray[np.bool_]:
    """Which of some rows are among ascending ones."""
    place = np.minimum(np.searchsorted(ascending, rows), len(ascending) - 1)
    return ascending[place] == rows


def _points(columns: list[tuple[float, NDArray]], rows: Rows) -> Floats:
    """Coordinates (n, axes) of some photons."""
    if rows[-1] - rows[0] == len(rows) - 1:
        some = [column[rows[0] : rows[-1] + 1] for _, column in columns]
    else:
        some = [np.take(column, rows, axis=0) for _, column in columns]
    scales = [scale for scale, _ in columns]
    return np.hstack(
        [scale * each.reshape(len(rows), -1) for scale, each in zip(scales, some, strict=True)]
    )


def _place(results: Columns, rows: Rows, columns: Columns, n: int) -> None:
    """Write the results of some rows among those of n."""
    if len(rows) == n:
        results.update(columns)
        return
    for name, column in columns.items():
        if not results[name].flags.writeable:
            results[name] = results[name].copy()
        results[name][rows] = column


def _of_rows(columns: ColumnFolder, name: str, rows: Rows) -> NDArray:
    """Some rows of a column; faster where they follow one another."""
    if len(rows) and rows[-1] - rows[0] == len(rows) - 1:
        return columns.read(name, int(rows[0]), int(rows[-1]) + 1)
    return columns.take(name, rows)
