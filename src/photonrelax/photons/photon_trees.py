"""One k-d tree for each set of face orientations that points gather photons from."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._ext.photons.normals import find_face_sets, group_normals
from .._ext.spatial import morton
from .._util import validation
from .._util.validation import Floats, Rows
from ..spatial.kdtree import KDTree
from .axes import MAX_FACES, MAX_NORMAL_CHORD, hstack_rows, leaf_rows, within_chord
from .coincidence import Distinct, distinct_photons
from .photon_map import PhotonMap

Order = NDArray[np.intp]

# Trees of face sets are built only while a photon is in no more of them, on average.
_MAX_COPIES = 3


def morton_order(points: Floats, n_threads: int) -> Order:
    """Return the rows (m,) of points (m, 3) in Morton order."""
    order: Order = morton.morton_order(points, 3, n_threads)
    return order


class _Tree(NamedTuple):
    tree: KDTree
    # Rows of its photons, in tree order.
    rows: Order
    # Where some of its photons stand for others.
    distinct: Distinct | None


class PhotonTrees:
    """Trees of photons by the orientation of the faces they lie on.

    A point gathers from faces whose normals are within 60° of its own. Where photons lie on few
    faces, each set of faces that points on one of them gather from has a number and a tree over
    positions. Points with another set, and all points where faces are many, use a tree of all
    photons with normals on range axes; its number is `n_sets`. Both trees find the same photons.

    Of photons at the same point, facing the same way, a tree has the first only, for which `sums`
    has the values of all: so k photons are at k places, however often one of them is repeated.
    """

    def __init__(self, photons: PhotonMap, n_threads: int) -> None:
        self._photons = photons
        self._n_threads = n_threads
        self._trees: dict[int, _Tree] = {}
        self._faces, face = group_normals(photons.normal, MAX_FACES)
        self._members = np.empty((0, 0), dtype=bool)
        if self._faces is not None:
            self._members = np.unique(within_chord(self._faces), axis=0)
            n_photons = np.bincount(face, minlength=len(self._faces))
            if (self._members @ n_photons).sum() > _MAX_COPIES * len(photons):
                self._faces, self._members = None, self._members[:0]
        # A single set has all faces: the faces of single photons are not needed.
        self._face = face if self.n_sets > 1 else None

    def __reduce__(self) -> tuple[type, tuple[PhotonMap, int]]:
        return type(self), (self._photons, self._n_threads)

    @property
    def n_sets(self) -> int:
        """Number of face sets with a tree of their own."""
        return len(self._members)

    def build(self) -> None:
        """Build the trees that points on the photons' own faces need."""
        for number in range(max(self.n_sets, 1)):
            self.tree(number)

    def whole(self) -> KDTree:
        """Return the tree of all photons, normals on range axes unless all lie on one face.

        It is kept only where points use it too.
        """
        if self._faces is None or len(self._faces) == 1:
            return self.tree(0)[0]
        return self._build_tree(self.n_sets).tree

    def tree(self, number: int) -> tuple[KDTree, Order]:
        """Return a tree, built at first use, and the rows of its photons in tree order."""
        tree = self._tree(number)
        return tree.tree, tree.rows

    def sums(self, values: Floats, number: int) -> Floats:
        """Values (n, c) with the sums over coincident photons at the rows of those in a tree."""
        return self._combined(values, number, np.add)

    def maxima(self, values: Floats, number: int) -> Floats:
        """Values (n, c) with the maxima over coincident photons at the rows of those in a tree."""
        return self._combined(values, number, np.maximum)

    def numbers(self, number: int) -> NDArray[np.int64] | None:
        """Number of photons that each of a tree's stands for, in its order; None if of itself."""
        tree = self._tree(number)
        if tree.distinct is None:
            return None
        return 1 + np.bincount(tree.distinct.first, minlength=len(self._photons))[tree.rows]

    def _combined(self, values: Floats, number: int, combine: np.ufunc) -> Floats:
        distinct = self._tree(number).distinct
        if distinct is None:
            return values
        combined = values.copy()
        combine.at(combined, distinct.first, values[distinct.merged])
        return combined

    def _tree(self, number: int) -> _Tree:
        if number not in self._trees:
            self._trees[number] = self._build_tree(number)
        return self._trees[number]

    def _build_tree(self, number: int) -> _Tree:
        rows: Rows = slice(None)
        if number < self.n_sets and self._face is not None:
            rows = np.flatnonzero(self._members[number][self._face])
        tree = self._tree_of(number, rows)
        distinct = self._distinct(number, rows) if tree.kernel.may_coincide else None
        if distinct is not None:
            rows = distinct.rows
            tree = self._tree_of(number, rows)
        return _Tree(tree, leaf_rows(tree, rows), distinct)

    def _distinct(self, number: int, rows: Rows) -> Distinct | None:
        position, normal = self._photons.position, self._photons.normal
        return distinct_photons(
            np.arange(len(position))[rows],
            [position[rows]],
            normal[rows] if number == self.n_sets else None,
            max_chord=MAX_NORMAL_CHORD,
        )

    def _tree_of(self, number: int, rows: Rows) -> KDTree:
        """Tree of photons, on the axes of a number."""
        columns: list[Floats] = [self._photons.position]
        if number == self.n_sets:
            columns.append(self._photons.normal)
        points = hstack_rows(columns, [1.0] * len(columns), rows, self._n_threads)
        return KDTree(points, n_metric=3, n_threads=self._n_threads)

    def parts(
        self, points: Floats, normals: Floats, order: Order | None = None
    ) -> Iterator[tuple[int, Floats, Order]]:
        """Divide points (m, 3) by the tree they gather from, without those that see no face.

        Yields the tree's number, queries for all points, and the rows of its own points in Morton
        order. Callers that query the same points repeatedly can pass their `morton_order`.

        Raises
        ------
        ValueError
            If a normal is zero or not finite.
        """
        number = self._numbers(normals)
        if order is None:
            order = morton_order(points, self._n_threads)
        for one, rows in _divided(number, order):
            yield one, self._queries(one, points, normals), rows

    def _numbers(self, normals: Floats) -> NDArray[np.int8]:
        """Return the number of each point's tree, -1 where it sees no face."""
        if self._faces is None:
            return np.zeros(len(normals), dtype=np.int8)
        bits = np.uint64(1) << np.arange(len(self._faces), dtype=np.uint64)
        sets = (self._members * bits).sum(axis=1, dtype=np.uint64)
        number = find_face_sets(normals, self._faces, sets, MAX_NORMAL_CHORD, self._n_threads)
        if number.min(initial=0) < -1:
            validation.unit_vectors(normals, "normals", normals.shape)
        return number

    def _queries(self, number: int, points: Floats, normals: Floats) -> Floats:
        if number < self.n_sets:
            return points
        normals = validation.unit_vectors(normals, "normals", normals.shape, self._n_threads)
        return hstack_rows([points, normals], [1.0, 1.0], slice(None), self._n_threads)


def _divided(number: NDArray[np.int8], order: Order) -> Iterator[tuple[int, Order]]:
    """Yield each number but -1 that occurs, and its rows in the given order."""
    if len(number) == 0:
        return
    low, high = int(number.min()), int(number.max())
    if low == high >= 0:
        yield low, order
        return
    ordered = number[order]
    for one in range(max(low, 0), high + 1):
        rows = order[ordered == one]
        if len(rows):
            yield one, rows
