"""Borders of torn images: found by bisection on the sides of elements, and cut."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..._util.validation import Floats
from ...transport.splitting import Arrivals, Signatures
from .elements import PARTS, Elements, Patches, areas, luminances, six_places
from .lattice import Ids, Lattice, Places

# Halvings of a side on which a sheet ends: on average, if all lost as much light; and of one at
# least and at most.
STEPS, _LEAST_STEPS, _MOST_STEPS = 5, 0, 8

Columns = TypeVar("Columns", bound=tuple[NDArray, ...])


class Pieces(NamedTuple):
    """Images of triangles of a chart that are straight.

    Attributes
    ----------
    position : (n, 3, 3) float64
        Corners, m.
    normal : (n, 3) float64
        Of the surface, of any length.
    flux : (n, 3) float64
        W.
    place : (n, 3, 2) float64
        Corners in the chart's unit square.
    sheet : (n,) uint64
    """

    position: Floats
    normal: Floats
    flux: Floats
    place: Floats
    sheet: Signatures


class _Corners(NamedTuple):
    """Corners of triangles: places (n, 3, 2), arrivals (n, 3), -1 for none; sheets (n,)."""

    place: Places
    arrival: Ids
    sheet: Signatures

    def of(self, rows: NDArray[np.bool_]) -> _Corners:
        """Those of some rows."""
        return _Corners(self.place[rows], self.arrival[rows], self.sheet[rows])

    def sides(self, seen: list[int], unseen: list[int]) -> _Sides:
        """Two sides of each, from corners that are seen to corners that are not."""
        return _Sides(
            self.place[:, seen].reshape(-1, 2).astype(np.float64),
            self.place[:, unseen].reshape(-1, 2).astype(np.float64),
            self.arrival[:, seen].reshape(-1),
            np.repeat(self.sheet, 2),
        )


class _Sides(NamedTuple):
    """Sides that sheets (n,) end on: places (n, 2), and arrivals (n,) at the ends that are seen."""

    seen: Floats
    unseen: Floats
    arrival: Ids
    sheet: Signatures


class Ends(NamedTuple):
    """Last light of a sheet on sides from elements of which it is seen at one end only.

    Attributes
    ----------
    place : (n, 2)
        Where the sheet ends, in places of the lattice.
    position, normal, light : (n, 3)
        Of the last light that is seen, m and W per area of the chart.
    """

    place: Floats
    position: Floats
    normal: Floats
    light: Floats


def joined(kind: Callable[..., Columns], parts: Sequence[Columns]) -> Columns:
    """Columns of all parts of a kind, in their order."""
    return kind(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def cut(lattice: Lattice, leaves: Elements, torn: Patches, n_rays: float) -> Pieces:
    """Pieces of images that are not seen from all nodes of their elements.

    Their borders are found by at most so many rays.
    """
    corners = _Corners(
        six_places(leaves.corners)[torn.element][:, PARTS].reshape(-1, 3, 2),
        torn.arrival[:, PARTS].reshape(-1, 3),
        np.repeat(torn.sheet, 4),
    )
    n_seen = np.count_nonzero(corners.arrival >= 0, axis=1)
    one = _lone_first(corners.of(n_seen == 1), is_seen=True)
    two = _lone_first(corners.of(n_seen == 2), is_seen=False)
    # Triangles of both kinds share sides.
    sides = joined(_Sides, [one.sides([0, 0], [1, 2]), two.sides([1, 2], [0, 0])])
    ends = _ends(lattice, sides, lattice.n_traced + n_rays)
    n = 2 * len(one.sheet)
    pieces = [
        _whole(lattice, corners.of(n_seen == 3)),
        _cut(lattice, one, [0], Ends(*(column[:n] for column in ends))),
        _cut(lattice, two, [1, 2], Ends(*(column[n:] for column in ends))),
    ]
    return joined(Pieces, pieces)


def _lone_first(corners: _Corners, *, is_seen: bool) -> _Corners:
    """Corners turned so that the only one that is seen, or is not, comes first."""
    lone = np.argmax((corners.arrival >= 0) == is_seen, axis=1)
    turned = (lone[:, np.newaxis] + np.arange(3)) % 3
    at = np.arange(len(lone))[:, np.newaxis], turned
    return _Corners(corners.place[at], corners.arrival[at], corners.sheet)


def _whole(lattice: Lattice, corners: _Corners) -> Pieces:
    return _pieces(
        lattice,
        corners.sheet,
        corners.place,
        lattice.arrivals.position[corners.arrival],
        lattice.arrivals.normal[corners.arrival],
        lattice.light[corners.arrival],
    )


def _pieces(
    lattice: Lattice, sheet: Signatures, places: Floats | Places, *columns: Floats
) -> Pieces:
    """Pieces between places (n, 3, 2), of the positions, normals and light (n, 3, 3) there."""
    position, normal, light = columns
    flux = areas(lattice, places)[:, np.newaxis] * light.mean(axis=1)
    return Pieces(position, normal.mean(axis=1), flux, lattice.in_unit(places), sheet)


def _cut(lattice: Lattice, corners: _Corners, seen: list[int], ends: Ends) -> Pieces:
    """Pieces of triangles between the corners seen and the ends on two sides from there."""
    n, at = len(corners.sheet), corners.arrival[:, seen]
    columns = [
        np.concatenate([known, found.reshape(n, 2, found.shape[1])], axis=1)
        for known, found in (
            (corners.place[:, seen].astype(np.float64), ends.place),
            (lattice.arrivals.position[at], ends.position),
            (lattice.arrivals.normal[at], ends.normal),
            (lattice.light[at], ends.light),
        )
    ]
    if len(seen) == 1:
        return _pieces(lattice, corners.sheet, *columns)
    # Corners 1 and 2, and the ends on the sides from them.
    halves = [
        _pieces(lattice, corners.sheet, *(column[:, rows] for column in columns))
        for rows in ([0, 1, 3], [0, 3, 2])
    ]
    return joined(Pieces, halves)


def _ends(lattice: Lattice, sides: _Sides, most: float) -> Ends:
    """Ends of sheets on sides, which are halved as long as at most `most` rays are traced."""
    first, inverse = _unique(_keys(sides.unseen), sides.arrival)
    inside, outside = sides.seen[first], sides.unseen[first]
    arrival, sheet = sides.arrival[first], sides.sheet[first]
    position = lattice.arrivals.position[arrival]
    normal, light = lattice.arrivals.normal[arrival], lattice.light[arrival]
    steps = _steps(inside - outside, light)
    for step in range(steps.max(initial=0)):
        rows = np.flatnonzero(steps > step)
        middle = 0.5 * (inside[rows] + outside[rows])
        each, node = _unique(_keys(middle))
        if lattice.n_traced + len(each) > most:
            break
        found, power = lattice.trace(middle[each])
        seen, at = _seen(node, found, sheet[rows])
        hit = np.zeros(len(rows), dtype=bool)
        hit[seen] = True
        inside[rows[hit]], outside[rows[~hit]] = middle[hit], middle[~hit]
        seen = rows[seen]
        position[seen], normal[seen] = found.position[at], found.normal[at]
        light[seen] = found.throughput[at] * power[found.node[at]]
    return Ends(
        0.5 * (inside + outside)[inverse], position[inverse], normal[inverse], light[inverse]
    )


def _steps(side: Floats, light: Floats) -> NDArray[np.intp]:
    """Halvings (n,) of sides (n, 2) by the light (n, 3) that triangles beside them have.

    So many that all of them lose as much, and together what they do if all are halved as often.
    """
    lost = np.maximum(luminances(light) * np.square(side).sum(axis=1), 1e-300)
    wanted = STEPS + np.log2(lost / lost.mean()) if len(lost) else lost
    steps: NDArray[np.intp] = np.clip(np.rint(wanted), _LEAST_STEPS, _MOST_STEPS).astype(np.intp)
    return steps


def _keys(places: Floats) -> NDArray[np.int64]:
    """Numbers (n,) that tell places (n, 2) between nodes."""
    whole = np.rint(places * (1 << _MOST_STEPS)).astype(np.int64)
    keys: NDArray[np.int64] = (whole[:, 0] << 32) | whole[:, 1]
    return keys


def _unique(*columns: NDArray) -> tuple[Ids, Ids]:
    """First rows of each distinct one in columns (n,), and which (n,) of these all are."""
    order = np.lexsort(columns)
    is_new = np.zeros(len(order), dtype=bool)
    is_new[:1] = True
    for column in columns:
        is_new[1:] |= np.diff(column[order]) != 0
    number = np.empty(len(order), dtype=np.intp)
    number[order] = np.cumsum(is_new) - 1
    return order[is_new], number


def _seen(node: Ids, found: Arrivals, sheet: Signatures) -> tuple[Ids, Ids]:
    """Rows of the sheets (n,) seen from rays `node` (n,), and of their arrivals."""
    sheets, rank = np.unique(np.concatenate([sheet, found.sheet]), return_inverse=True)
    wanted = node * len(sheets) + rank[: len(sheet)]
    there = found.node * len(sheets) + rank[len(sheet) :]
    order = np.argsort(there, kind="stable")
    at = np.minimum(np.searchsorted(there[order], wanted), max(len(there) - 1, 0))
    if not len(there):
        return np.empty(0, np.intp), np.empty(0, np.intp)
    match = there[order[at]] == wanted
    return np.flatnonzero(match), order[at[match]]
