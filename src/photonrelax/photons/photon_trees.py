"""Trees of the photons that points gather from: those on faces turned by no more than 60°."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .._ext.photons.normals import find_face_sets, group_normals
from .._ext.spatial import morton
from .._util import validation
from .._util.progress import Reporter
from .._util.validation import Floats, Rows
from ..spatial.kdtree import KDTree
from .neighbourhoods import MAX_NORMAL_CHORD, MOST_FACES, facing, hstack_rows, leaf_rows
from .photon_map import PhotonMap

Order = NDArray[np.intp]

# Trees without axes for normals are made as long as photons are in no more of them, on average.
_MOST_COPIES = 3


def morton_order(points: Floats, n_threads: int) -> Order:
    """Return an order (m,) of points (m, 3) in which near ones follow each other."""
    order: Order = morton.morton_order(points, 3, n_threads)
    return order


class PhotonTrees:
    """Photons for points that face one way or another.

    Where photons lie on few faces, every set of faces that points on one of them see has a tree
    in space alone, and a number. Points that see yet another set, and all points where faces are
    many, are served by one tree of all photons with their normals on range axes; its number is
    `n_sets`. The tree of a set finds what the tree of all photons would.
    """

    def __init__(self, photons: PhotonMap, n_threads: int) -> None:
        self._photons = photons
        self._n_threads = n_threads
        self._trees: dict[int, tuple[KDTree, Order]] = {}
        self._faces, face = group_normals(photons.normal, MOST_FACES)
        self._members = np.empty((0, 0), dtype=bool)
        if self._faces is not None:
            self._members = np.unique(facing(self._faces), axis=0)
            n_photons = np.bincount(face, minlength=len(self._faces))
            if (self._members @ n_photons).sum() > _MOST_COPIES * len(photons):
                self._faces, self._members = None, self._members[:0]
        # A single set has all faces, so that nobody asks which photon lies on which.
        self._face = face if self.n_sets > 1 else None

    @property
    def n_sets(self) -> int:
        """How many sets of faces have a tree of their own."""
        return len(self._members)

    def build(self) -> None:
        """Make the trees that points on the photons' own faces need, if not made yet."""
        for number in range(max(self.n_sets, 1)):
            self.tree(number)

    def whole(self) -> KDTree:
        """Return the tree of all photons, normals on range axes unless all lie on one face.

        Only where points can do with this one it is kept.
        """
        if self._faces is None or len(self._faces) == 1:
            return self.tree(0)[0]
        return self._built(self.n_sets)[0]

    def tree(self, number: int) -> tuple[KDTree, Order]:
        """Return a tree, made if need be, and the row of the photon at each of its places."""
        if number not in self._trees:
            self._trees[number] = self._built(number)
        return self._trees[number]

    def _built(self, number: int) -> tuple[KDTree, Order]:
        position, normal = self._photons.position, self._photons.normal
        columns: list[Floats] = [position]
        rows: Rows = slice(None)
        if number == self.n_sets:
            columns = [position, normal]
        elif self._face is not None:
            rows = np.flatnonzero(self._members[number][self._face])
        points = hstack_rows(columns, [1.0] * len(columns), rows, self._n_threads)
        tree = KDTree(points, n_metric=3, n_threads=self._n_threads)
        return tree, leaf_rows(tree, rows)

    def parts(
        self, points: Floats, normals: Floats, order: Order | None = None
    ) -> Iterator[tuple[int, Floats, Order]]:
        """Divide points (m, 3) by the tree that serves them; those that see no face are left out.

        Points that are asked about again and again may bring their `morton_order`. Yields the
        tree's number, queries of which some rows are to be searched for, and these rows in an
        order in which near points follow each other.

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

    def chunks(
        self, points: Floats, normals: Floats, report: Reporter
    ) -> Iterator[tuple[int, Floats, Order]]:
        """Divide points as `parts` does, and these into chunks whose end is reported."""
        left = len(points)
        for number, queries, rows in self.parts(points, normals):
            for first, end in report.chunks(len(rows)):
                yield number, queries, rows[first:end]
            left -= len(rows)
        if left:
            report.advance(left)

    def _numbers(self, normals: Floats) -> NDArray[np.int8]:
        """Return the number of each point's tree, -1 for none."""
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
    """Yield each number there is but -1, and the rows that have it in the order given."""
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
