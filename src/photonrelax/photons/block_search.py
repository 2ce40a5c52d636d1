"""Searches around the photons of a block, among its own and those of its halo."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats
from .blocks import BlockedPhotons
from .columns import ColumnFolder
from .tiles import TILE, Boxes, Tiles, guessed_radius, halo, within

Columns = dict[str, NDArray]

# Factor of a radius that was too small by nobody knows how much, and margin of one that is known.
_WIDER, _MARGIN = 4.0, 1.01


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

    def least(self, name: str) -> Floats:
        """Least value (t,) of a column of numbers in each tile."""
        return self._boxes[name][0][:, 0]

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
    """What was computed around the own photons of a neighbourhood.

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
class BlockSearch:
    """Search around the photons of a group, a segment at a time.

    Attributes
    ----------
    columns : ColumnFolder
    tiles : GroupTiles
    axes : tuple of (str, float)
        Columns that neighbours are searched by and their factors; the first has the metric.
    radius : (t,) float array
        Distance to which the photons of each tile are expected to search.
    range_radius : (t,) float array
        Largest radius of the balls over the other axes.
    """

    columns: ColumnFolder
    tiles: GroupTiles
    axes: tuple[tuple[str, float], ...]
    radius: Floats
    range_radius: Floats

    @cached_property
    def _boxes(self) -> Boxes:
        return self.tiles.boxes(self.axes)

    @cached_property
    def _extent(self) -> float:
        """Distance that no search exceeds."""
        boxes = self._boxes
        axes = slice(0, boxes.n_metric)
        low, high = boxes.low[:, axes].min(axis=0), boxes.high[:, axes].max(axis=0)
        return float(np.linalg.norm(high - low)) * (1.0 + 1e-9)

    def run(self, segment: int, compute: Compute) -> Columns:
        """Results of the photons of a segment, with halos as wide as they turn out to need."""
        todo = own = self.tiles.of_segment(segment)
        least = 1e-6 * self._extent
        radius = np.clip(self.radius[own], least, self._extent)
        results: Columns = {}
        while len(todo):
            found = compute(self._neighbourhood(todo, radius))
            n_rows = self.tiles.stop[todo] - self.tiles.first[todo]
            need = np.maximum.reduceat(found.reached, np.cumsum(n_rows) - n_rows)
            short = (need > radius) & (radius < self._extent)
            self._place(results, own, todo, found.columns)
            wider = np.where(np.isinf(need), _WIDER * radius, _MARGIN * need)
            if found.merged and short.any():
                # Photons at the same point may be of several tiles.
                todo, radius = own, np.where(short, wider, radius) if len(todo) == len(own) else (
                    np.full(len(own), wider[short].max())
                )
            else:
                todo, radius = todo[short], wider[short]
            radius = np.minimum(radius, self._extent)
        return results

    def _place(self, results: Columns, own: Tiles, todo: Tiles, columns: Columns) -> None:
        """Write the results of the photons of some tiles among those of all."""
        first, stop = self.tiles.first, self.tiles.stop
        if len(todo) == len(own):
            results.update(columns)
            return
        rows = _rows(first[todo], stop[todo]) - first[own[0]]
        for name, column in columns.items():
            results[name][rows] = column

    def _neighbourhood(self, todo: Tiles, radius: Floats) -> Neighbourhood:
        """The photons of some tiles and those within their radii."""
        range_radius = self.range_radius[todo]
        near = halo(self._boxes, todo, self.tiles.segments, radius, range_radius)
        own = _rows(self.tiles.first[todo], self.tiles.stop[todo])
        if not len(near.tile):
            return Neighbourhood(self.columns, own, len(own))
        some = self._boxes.take(todo)
        order = np.argsort(near.tile, kind="stable")
        tiles, starts = np.unique(near.tile[order], return_index=True)
        rows = [own]
        for tile, around in zip(tiles, np.split(near.around[order], starts[1:]), strict=True):
            first = int(self.tiles.first[tile])
            points = self._points(first, int(self.tiles.stop[tile]))
            close = within(points, some.take(around), radius[around], range_radius[around])
            rows.append(first + np.flatnonzero(close))
        return Neighbourhood(self.columns, np.concatenate(rows), len(own))

    def _points(self, first: int, stop: int) -> Floats:
        """Coordinates (n, axes) of the photons of a range of rows."""
        columns = [scale * self.columns.read(name, first, stop) for name, scale in self.axes]
        return np.hstack([column.reshape(stop - first, -1) for column in columns])


def first_radius(tiles: GroupTiles, name: str, k: int) -> Floats:
    """Radius (t,) that holds some more than k photons, by the extents of tiles."""
    return guessed_radius(tiles.boxes(((name, 1.0),)), tiles.stop - tiles.first, k)


def _rows(first: NDArray[np.intp], stop: NDArray[np.intp]) -> NDArray[np.intp]:
    """Rows of some ranges, one after the other."""
    n = stop - first
    return np.repeat(first - (np.cumsum(n) - n), n) + np.arange(n.sum())


def _of_rows(columns: ColumnFolder, name: str, rows: NDArray[np.intp]) -> NDArray:
    """Some rows of a column; faster where they follow one another."""
    if len(rows) and rows[-1] - rows[0] == len(rows) - 1:
        return columns.read(name, int(rows[0]), int(rows[-1]) + 1)
    return columns.take(name, rows)
