"""Triangles of a chart with six nodes each, and their images sheet by sheet."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..._util.validation import Floats
from ...transport.aim import LUMINANCE
from .lattice import UNIT, Ids, Lattice, Places

# Corners, then the nodes in the middle of the sides opposite to them.
_SIDES = ((1, 2), (0, 2), (0, 1))
# Barycentric coordinates of the six nodes.
_NODES = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 1, 1], [1, 0, 1], [1, 1, 0]]) / [
    [1],
    [1],
    [1],
    [2],
    [2],
    [2],
]
# Nodes of an element that are the corners of its four parts.
PARTS = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2], [3, 4, 5]])


def shape_functions(at: Floats) -> Floats:
    """Weights (n, 6) of the six nodes at barycentric coordinates (n, 3)."""
    of_corners = at * (2.0 * at - 1.0)
    of_sides = np.column_stack([4.0 * at[:, i] * at[:, j] for i, j in _SIDES])
    return np.hstack([of_corners, of_sides])


# Weights (4, 3, 6) of the nodes of an element at the new nodes of its parts.
NEW_NODES = np.array(
    [
        shape_functions(np.array([_NODES[part[list(side)]].mean(axis=0) for side in _SIDES]))
        for part in PARTS
    ]
)


@dataclass(frozen=True, eq=False)
class Patches:
    """Images of elements, one for each sheet seen from any of its nodes.

    Attributes
    ----------
    element : (p,) intp
        Rows of the elements, ascending.
    sheet : (p,) uint64
        Ascending within an element.
    arrival : (p, 6) intp
        Rows of the arrivals of the nodes, -1 where the node has none.
    """

    element: Ids
    sheet: NDArray[np.uint64]
    arrival: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.element)

    def __getitem__(self, rows: NDArray) -> Patches:
        return Patches(self.element[rows], self.sheet[rows], self.arrival[rows])

    @classmethod
    def none(cls) -> Patches:
        """No images."""
        none = np.empty(0, np.intp)
        return cls(none, np.empty(0, np.uint64), np.empty((0, 6), np.intp))

    @cached_property
    def is_whole(self) -> NDArray[np.bool_]:
        """(p,) true where all nodes are seen."""
        whole: NDArray[np.bool_] = np.all(self.arrival >= 0, axis=1)
        return whole


@dataclass(frozen=True, eq=False)
class Elements:
    """Leaves of the triangulation of a chart.

    Attributes
    ----------
    corners : (n, 3, 2) int64
        Places of the corners.
    nodes : (n, 6) intp
        Corners, then the nodes in the middle of the sides opposite to them.
    level : (n,) int8
        Number of divisions.
    """

    corners: Places
    nodes: Ids
    level: NDArray[np.int8]

    def __len__(self) -> int:
        return len(self.level)

    def __getitem__(self, rows: NDArray) -> Elements:
        return Elements(self.corners[rows], self.nodes[rows], self.level[rows])

    def joined(self, others: Elements) -> Elements:
        """These, then others."""
        return Elements(
            np.concatenate([self.corners, others.corners]),
            np.concatenate([self.nodes, others.nodes]),
            np.concatenate([self.level, others.level]),
        )

    def parts(self) -> tuple[Places, NDArray[np.int8]]:
        """Corners (4n, 3, 2) and levels of the four parts of each."""
        six = six_places(self.corners)
        return six[:, PARTS].reshape(-1, 3, 2), np.repeat(self.level + 1, 4).astype(np.int8)


def first_corners(lattice: Lattice) -> Places:
    """Corners (n, 3, 2) of the two triangles of each cell of the first grid."""
    nx, ny = lattice.cells
    i, j = (grid.ravel() * UNIT for grid in np.meshgrid(np.arange(nx), np.arange(ny)))
    square = np.stack(
        [np.column_stack([i + a, j + b]) for a, b in ((0, 0), (UNIT, 0), (UNIT, UNIT), (0, UNIT))],
        axis=1,
    )
    return square[:, [[0, 1, 3], [2, 3, 1]]].reshape(-1, 3, 2)


def first_elements_at(lattice: Lattice, places: Floats) -> Ids:
    """Rows (n,) of the elements of the first grid that places (n, 2) are in."""
    inside = places / UNIT
    cell = np.clip(np.floor(inside), 0.0, lattice.cells - 1.0)
    is_second = (inside - cell).sum(axis=1) > 1.0
    column, row = cell.T
    found: Ids = (2.0 * (row * lattice.cells[0] + column) + is_second).astype(np.intp)
    return found


def parts_at(corners: Places, places: Floats) -> Ids:
    """Which (n,) of the four parts of elements (n, 3, 2) the places (n, 2) in them are in."""
    a, b = (corners[:, i] - corners[:, 0] for i in (1, 2))
    at = places - corners[:, 0]
    area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    v = (at[:, 0] * b[:, 1] - at[:, 1] * b[:, 0]) / area
    w = (a[:, 0] * at[:, 1] - a[:, 1] * at[:, 0]) / area
    weights = np.column_stack([1.0 - v - w, v, w])
    parts: Ids = np.where(weights.max(axis=1) > 0.5, weights.argmax(axis=1), 3)
    return parts


def six_places(corners: Places) -> Places:
    """Places (n, 6, 2) of the nodes of elements."""
    middle = [(corners[:, i] + corners[:, j]) // 2 for i, j in _SIDES]
    return np.concatenate([corners, np.stack(middle, axis=1)], axis=1)


def nodes_of_neighbours(lattice: Lattice, corners: Places) -> tuple[Ids, Ids]:
    """Rows of elements, and nodes on their sides that are those of finer neighbours alone."""
    six = six_places(corners)
    halves = [(six[:, k], six[:, 3 + i]) for i, side in enumerate(_SIDES) for k in side]
    start, end = (np.concatenate(each) for each in zip(*halves, strict=True))
    row = np.tile(np.arange(len(corners)), len(halves))
    found = []
    while len(row):
        node = lattice.known_nodes((start + end) // 2)
        is_node = (node >= 0) & ((start + end) % 2 == 0).all(axis=1)
        start, end, row, node = start[is_node], end[is_node], row[is_node], node[is_node]
        found.append((row, node))
        middle = (start + end) // 2
        start, end = np.concatenate([start, middle]), np.concatenate([middle, end])
        row = np.tile(row, 2)
    rows, nodes = (np.concatenate(each) for each in zip(*found, strict=True))
    return rows, nodes


def areas(lattice: Lattice, corners: Places | Floats) -> Floats:
    """Areas (n,) of triangles (n, 3, 2) of places, of the chart's 1."""
    a, b = (lattice.in_unit(corners[:, i] - corners[:, 0]) for i in (1, 2))
    area: Floats = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    return area


def patches_of(lattice: Lattice, nodes: Ids) -> Patches:
    """Images of elements of nodes (n, 6)."""
    flat = nodes.ravel()
    count = lattice.count[flat]
    slot = np.repeat(np.arange(len(flat)), count)
    arrival = np.repeat(lattice.first[flat] - (np.cumsum(count) - count), count)
    arrival += np.arange(len(slot))
    element, node = slot // 6, slot % 6
    sheet = lattice.arrivals.sheet[arrival]
    order = np.lexsort((sheet, element))
    element, sheet = element[order], sheet[order]
    new = np.ones(len(order), dtype=bool)
    new[1:] = (element[1:] != element[:-1]) | (sheet[1:] != sheet[:-1])
    table = np.full((np.count_nonzero(new), 6), -1, dtype=np.intp)
    table[np.cumsum(new) - 1, node[order]] = arrival[order]
    return Patches(element[new], sheet[new], table)


def sags(position: Floats) -> Floats:
    """Distances (p, 3) of the middle nodes from the middles of straight sides."""
    corners = position[:, :3]
    middle = np.stack([corners[:, i] + corners[:, j] for i, j in _SIDES], axis=1) / 2.0
    distances: Floats = np.linalg.norm(position[:, 3:] - middle, axis=2)
    return distances


def luminances(flux: Floats) -> Floats:
    """Luminance (n,) of fluxes (n, 3)."""
    luminance: Floats = flux @ LUMINANCE
    return luminance
