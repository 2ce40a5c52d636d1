"""Tiles: short runs of photons that are close to one another, and which are near other photons."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._ext.spatial.near_boxes import near_boxes
from .._util.validation import Floats

TILE = 1024
"""Photons of a tile, at most."""

Tiles = NDArray[np.intp]

# Photons of a search, and searches that are compared with tiles at once.
_RUN, _TOGETHER = 32, 2048
# Photons are isolated if they search so much farther than those around them, whose mean is of radii
# clipped to so many medians of all.
_ISOLATED, _CLIPPED = 3.0, 4.0


@dataclass(frozen=True)
class Boxes:
    """Bounding boxes (t, axes) of tiles: the first three or two axes carry the metric.

    The others are range axes, in units of the radius of the balls over them. `travel` (t,) is how
    far points may have gone from the boxes, None if they stay.
    """

    low: Floats
    high: Floats
    n_metric: int
    travel: Floats | None = None

    def take(self, tiles: Tiles | slice) -> Boxes:
        travel = None if self.travel is None else self.travel[tiles]
        return Boxes(self.low[tiles], self.high[tiles], self.n_metric, travel)

    def near(self, other: Boxes, radius: Floats, range_radius: Floats) -> NDArray[np.bool_]:
        """Matrix (t, u), true where boxes u of others may have points within t's radii of t's."""
        boxes = self.low, self.high, radius, range_radius, other.low, other.high
        near: NDArray[np.bool_] = near_boxes(*boxes, other.travel, self.n_metric)
        return near


class Balls(NamedTuple):
    """Searches of photons, of short runs of them together: boxes that are searched around.

    Attributes
    ----------
    boxes : Boxes
        Of q searches.
    radius, range_radius : (q,) float arrays
        Over the metric, and over the range axes.
    query_of : (n,) intp array
        The search that each photon is of.
    """

    boxes: Boxes
    radius: Floats
    range_radius: Floats
    query_of: NDArray[np.intp]

    def take(self, some: NDArray[np.intp]) -> Balls:
        """Some of the searches."""
        return Balls(
            self.boxes.take(some), self.radius[some], self.range_radius[some], self.query_of
        )


def balls(points: Floats, radius: Floats, range_radius: Floats, n_metric: int) -> Balls:
    """Searches around points (n, axes), each on its own."""
    return Balls(Boxes(points, points, n_metric), radius, range_radius, np.arange(len(points)))


def joined_balls(
    points: Floats, radius: Floats, range_radius: Floats, tile: Tiles, n_metric: int
) -> Balls:
    """Searches of photons (n, axes) of some tiles (n,), in their order.

    Isolated photons, which search much farther than those around them, are alone in theirs: the
    region within so far of all the others would have far more photons than any search finds.
    """
    n = len(points)
    # Photons of different tiles may be far from one another.
    begins = np.arange(n) % _RUN == 0
    begins[1:] |= tile[1:] != tile[:-1]
    run, starts = np.cumsum(begins) - 1, np.flatnonzero(begins)
    typical = np.add.reduceat(np.minimum(radius, _CLIPPED * np.median(radius)), starts)
    typical /= np.diff(np.append(starts, n))
    alone = radius > _ISOLATED * typical[run]
    n_runs, n_alone = len(starts), int(np.count_nonzero(alone))
    query_of = run.copy()
    query_of[alone] = n_runs + np.arange(n_alone)
    low, high = np.where(alone[:, np.newaxis], np.inf, points), points.copy()
    high[alone] = -np.inf
    together = np.where(alone, 0.0, radius)
    boxes = Boxes(
        np.concatenate([np.minimum.reduceat(low, starts, axis=0), points[alone]]),
        np.concatenate([np.maximum.reduceat(high, starts, axis=0), points[alone]]),
        n_metric,
    )
    largest = np.concatenate([np.maximum.reduceat(together, starts), radius[alone]])
    ranges = np.concatenate([np.maximum.reduceat(range_radius, starts), range_radius[alone]])
    return Balls(boxes, largest, ranges, query_of)


class Hits(NamedTuple):
    """Tiles of a segment, and searches that may find photons in them.

    Attributes
    ----------
    tiles : (t,) intp array
    searches : (h,) intp array
        Those of all tiles; those of tile i from ``first[i]`` on.
    first : (t + 1,) intp array
    """

    tiles: Tiles
    searches: NDArray[np.intp]
    first: NDArray[np.intp]


def near_tiles(
    queries: Balls,
    tiles: Boxes,
    segments: Boxes,
    first_tile: NDArray[np.intp],
    wanted: NDArray[np.bool_],
) -> Iterator[Hits]:
    """Yield those of the tiles wanted (t,) that searches may find photons in, by segments.

    `segments` are the boxes of runs of tiles, which start at `first_tile` (s,).
    """
    stops = np.append(first_tile[1:], len(tiles.low))
    for segment in range(len(first_tile)):
        those = np.arange(first_tile[segment], stops[segment])
        those = those[wanted[those]]
        if not len(those):
            continue
        one = segments.take(np.array([segment]))
        mine = np.flatnonzero(queries.boxes.near(one, queries.radius, queries.range_radius)[:, 0])
        for some in np.array_split(mine, -(-len(mine) // _TOGETHER)) if len(mine) else ():
            hit = queries.take(some)
            near = hit.boxes.near(tiles.take(those), hit.radius, hit.range_radius)
            tile, search = np.nonzero(near.T)
            if len(tile):
                first = np.flatnonzero(np.append(True, tile[1:] != tile[:-1]))
                yield Hits(those[tile[first]], some[search], np.append(first, len(tile)))
