"""Tiles: short runs of photons that are close to one another, and which of them are near others.

A block's photons are searched for among its own and those of a halo: the photons within the search
radius of any of its tiles. What a search has reached says whether the halo was wide enough.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats

TILE = 1024
"""Photons of a tile, at most."""

Tiles = NDArray[np.intp]


@dataclass(frozen=True)
class Boxes:
    """Bounding boxes (t, axes) of tiles: the first three or two axes carry the metric.

    The others are range axes, in units of the radius of the balls over them.
    """

    low: Floats
    high: Floats
    n_metric: int

    def take(self, tiles: Tiles | slice) -> Boxes:
        return Boxes(self.low[tiles], self.high[tiles], self.n_metric)

    def near(self, other: Boxes, radius: Floats, range_radius: Floats) -> NDArray[np.bool_]:
        """Matrix (t, u), true where boxes u of others may have points within t's radii of t's."""
        metric, ranged = slice(0, self.n_metric), slice(self.n_metric, None)
        near = _squared_gaps(self, other, metric) <= np.square(radius)[:, np.newaxis]
        return near & (_squared_gaps(self, other, ranged) <= np.square(range_radius)[:, np.newaxis])


def boxes_of(points: Floats, first: NDArray[np.intp], n_metric: int) -> Boxes:
    """Boxes of points (n, axes) in runs that start at `first` (t,)."""
    low = np.minimum.reduceat(points, first, axis=0)
    return Boxes(low, np.maximum.reduceat(points, first, axis=0), n_metric)


def _squared_gaps(boxes: Boxes, other: Boxes, axes: slice) -> Floats:
    squared = np.zeros((len(boxes.low), len(other.low)))
    for low, high, low_there, high_there in zip(
        boxes.low[:, axes].T, boxes.high[:, axes].T, other.low[:, axes].T, other.high[:, axes].T,
        strict=True,
    ):
        gap = np.maximum(low_there - high[:, np.newaxis], low[:, np.newaxis] - high_there)
        squared += np.square(np.maximum(gap, 0.0))
    return squared


class Halo(NamedTuple):
    """Tiles `tile` (p,) that may have photons within the radii of tiles `around` (p,)."""

    tile: Tiles
    around: Tiles


def halo(
    boxes: Boxes, todo: Tiles, segments: NDArray[np.intp], radius: Floats, range_radius: Floats
) -> Halo:
    """Tiles near some tiles, themselves left out.

    Parameters
    ----------
    boxes : Boxes
        Of all tiles of a group.
    todo : (d,) intp array
        Tiles whose photons search.
    segments : (s,) intp array
        First tiles of runs of tiles that are close to one another.
    radius, range_radius : (d,) float arrays
        Of the searches of photons of `todo`, over the metric and over the range axes.
    """
    some = boxes.take(todo)
    coarse = Boxes(
        np.minimum.reduceat(boxes.low, segments, axis=0),
        np.maximum.reduceat(boxes.high, segments, axis=0),
        boxes.n_metric,
    )
    stops = np.append(segments[1:], len(boxes.low))
    is_todo = np.zeros(len(boxes.low), dtype=bool)
    is_todo[todo] = True
    tiles, around = [np.empty(0, dtype=np.intp)], [np.empty(0, dtype=np.intp)]
    close = some.near(coarse, radius, range_radius)
    for segment in np.flatnonzero(close.any(axis=0)):
        those = np.arange(segments[segment], stops[segment])
        those = those[~is_todo[those]]
        mine = np.flatnonzero(close[:, segment])
        if len(those):
            near = some.take(mine).near(boxes.take(those), radius[mine], range_radius[mine])
            one, other = np.nonzero(near.T)
            tiles.append(those[one])
            around.append(mine[other])
    return Halo(np.concatenate(tiles), np.concatenate(around))


def within(
    points: Floats, some: Boxes, radius: Floats, range_radius: Floats
) -> NDArray[np.bool_]:
    """Mask (n,) of the points (n, axes) within the radii of any of some boxes."""
    own = Boxes(points, points, some.n_metric)
    return some.near(own, radius, range_radius).any(axis=0)


def guessed_radius(boxes: Boxes, n_points: NDArray[np.intp], k: int) -> Floats:
    """Radius (t,) that holds some more than k points of tiles of even sheets."""
    extent = np.sort((boxes.high - boxes.low)[:, : boxes.n_metric], axis=1)
    area = extent[:, -1] * np.maximum(extent[:, -2], 1e-3 * extent[:, -1])
    return 1.5 * np.sqrt(k * area / (np.pi * np.maximum(n_points, 1)))


def tile_starts(n: int, size: int = TILE) -> NDArray[np.intp]:
    """First rows of the tiles of n rows."""
    return np.arange(0, n, size)
