"""Borders of torn images: found by bisection on the sides of elements, and cut."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..._util.validation import Floats
from ...transport.splitting import Arrivals
from .elements import PARTS, Elements, Patches, areas, six_places
from .lattice import Ids, Lattice, sheets_of

# Halvings of a side on which a sheet ends.
STEPS = 5


Columns = TypeVar("Columns", bound=tuple[Floats, ...])


class Ends(NamedTuple):
    """Last light of a sheet on sides of elements from which it is seen at one end only.

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
    """

    position: Floats
    normal: Floats
    flux: Floats


def joined(kind: Callable[..., Columns], parts: list[Columns]) -> Columns:
    """Columns of all parts of a kind, in their order."""
    return kind(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def cut(lattice: Lattice, leaves: Elements, torn: Patches) -> Pieces:
    """Pieces of images that are not seen from all nodes of their elements."""
    places = six_places(leaves.corners)[torn.element][:, PARTS].reshape(-1, 3, 2)
    arrival = torn.arrival[:, PARTS].reshape(-1, 3)
    sheet = np.repeat(torn.sheet, 4)
    seen = arrival >= 0
    some = seen.any(axis=1)
    places, arrival, sheet, seen = places[some], arrival[some], sheet[some], seen[some]
    n_seen = seen.sum(axis=1)
    pieces = [_whole(lattice, places[n_seen == 3], arrival[n_seen == 3])]
    for n in (1, 2):
        rows = np.flatnonzero(n_seen == n)
        # The corner that differs from the two others comes first.
        lone = np.argmax(seen[rows] == (n == 1), axis=1)
        turned = (lone[:, np.newaxis] + np.arange(3)) % 3
        at = rows[:, np.newaxis], turned
        pieces.append(_cut(lattice, places[at], arrival[at], sheet[rows], n))
    return joined(Pieces, pieces)


def _whole(lattice: Lattice, places: Floats, arrival: Ids) -> Pieces:
    return _pieces(
        lattice,
        places,
        lattice.arrivals.position[arrival],
        lattice.arrivals.normal[arrival],
        lattice.light[arrival],
    )


def _pieces(
    lattice: Lattice, places: Floats, position: Floats, normal: Floats, light: Floats
) -> Pieces:
    flux = areas(lattice, places)[:, np.newaxis] * light.mean(axis=1)
    return Pieces(position, normal.mean(axis=1), flux)


def _cut(
    lattice: Lattice, places: Floats, arrival: Ids, sheet: NDArray[np.uint64], n_seen: int
) -> Pieces:
    """Pieces of triangles of which the first corner is seen alone, or alone is not."""
    inside, outside = ([0, 0], [1, 2]) if n_seen == 1 else ([1, 2], [0, 0])
    ends = _ends(
        lattice,
        places[:, inside].reshape(-1, 2).astype(np.float64),
        places[:, outside].reshape(-1, 2).astype(np.float64),
        arrival[:, inside].reshape(-1),
        np.repeat(sheet, 2),
    )
    seen = [0] if n_seen == 1 else [1, 2]
    at = arrival[:, seen]
    columns = [
        np.concatenate([known, found.reshape(len(places), 2, -1)], axis=1)
        for known, found in (
            (places[:, seen].astype(np.float64), ends.place),
            (lattice.arrivals.position[at], ends.position),
            (lattice.arrivals.normal[at], ends.normal),
            (lattice.light[at], ends.light),
        )
    ]
    if n_seen == 1:
        return _pieces(lattice, *columns)
    # Corners 1 and 2, and the ends on the sides from them.
    halves = [_pieces(lattice, *(c[:, rows] for c in columns)) for rows in ([0, 1, 3], [0, 3, 2])]
    return joined(Pieces, halves)


def _ends(
    lattice: Lattice, inside: Floats, outside: Floats, arrival: Ids, sheet: NDArray[np.uint64]
) -> Ends:
    """Ends of sheets on sides from places (n, 2) where they are seen to places where not."""
    row = np.column_stack([inside, outside, sheet.astype(np.float64)])
    _, first, inverse = np.unique(row, axis=0, return_index=True, return_inverse=True)
    inside, outside, sheet = inside[first].copy(), outside[first].copy(), sheet[first]
    position = lattice.arrivals.position[arrival[first]]
    normal = lattice.arrivals.normal[arrival[first]]
    light = lattice.light[arrival[first]]
    for _ in range(STEPS if len(first) else 0):
        middle = 0.5 * (inside + outside)
        node, found, power = _traced(lattice, middle)
        rows, at = _seen(node, found, sheet)
        hit = np.zeros(len(middle), dtype=bool)
        hit[rows] = True
        inside[hit], outside[~hit] = middle[hit], middle[~hit]
        position[rows], normal[rows] = found.position[at], found.normal[at]
        light[rows] = found.throughput[at] * power[found.node[at]]
    ends = Ends(0.5 * (inside + outside), position, normal, light)
    inverse = inverse.ravel()
    return Ends(*(column[inverse] for column in ends))


def _traced(lattice: Lattice, places: Floats) -> tuple[Ids, Arrivals, Floats]:
    """Rays at places (n, 2), each once: the ray of each place, arrivals, and power."""
    unique, node = np.unique(places, axis=0, return_inverse=True)
    key = unique.view(np.uint64)
    found, power = lattice.trace(unique, key[:, 0] ^ (key[:, 1] << np.uint64(1)))
    return node.ravel(), found[~found.is_single], power


def _seen(node: Ids, found: Arrivals, sheet: NDArray[np.uint64]) -> tuple[Ids, Ids]:
    """Rows of the sheets (n,) seen from rays `node` (n,), and of their arrivals."""
    sheets, rank = np.unique(np.concatenate([sheet, sheets_of(found)]), return_inverse=True)
    wanted = node * len(sheets) + rank[: len(sheet)]
    there = found.node * len(sheets) + rank[len(sheet) :]
    order = np.argsort(there, kind="stable")
    at = np.minimum(np.searchsorted(there[order], wanted), max(len(there) - 1, 0))
    if not len(there):
        return np.empty(0, np.intp), np.empty(0, np.intp)
    match = there[order[at]] == wanted
    return np.flatnonzero(match), order[at[match]]
