"""The k-d tree of a group of photons that may be neighbours."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._ext.photons.normals import all_nearly_equal
from .._util.validation import Floats, Rows
from ..spatial.kdtree import KDTree
from .axes import MAX_NORMAL_CHORD, hstack_rows, leaf_rows
from .coincidence import Distinct, distinct_photons
from .neighbourhoods import Group


class GroupTree(NamedTuple):
    """The tree of a group, and its photons.

    Attributes
    ----------
    tree : KDTree
    ranges : (n,) float array or None
        Radius of every photon's ball over the range axes, by row of the map.
    rows : (m,) intp array
        Rows of the photons, in tree order. Of photons at the same point the first is in the tree
        for all, unless they face different ways or left the emitter elsewhere.
    distinct : Distinct or None
        These and the photons that they stand for, if there are such.
    normal_axis : int
        First axis of the normals; the number of axes for a tree without.
    normal_scale : float
        Factor of the normals on their axes.
    """

    tree: KDTree
    ranges: Floats | None
    rows: NDArray[np.intp]
    distinct: Distinct | None
    normal_axis: int
    normal_scale: float

    @property
    def n_merged(self) -> int:
        """Number of photons that others stand for."""
        return 0 if self.distinct is None else len(self.distinct.merged)

    def repeat(self, *columns: NDArray) -> None:
        """Copy the rows of photons that stand for others, of some columns, to those."""
        if self.distinct is not None:
            self.distinct.repeat(*columns)


def group_tree(
    position: Floats,
    normal: Floats,
    coords: Floats | None = None,
    ranges: Floats | None = None,
    *,
    group: Group,
    coincident: bool = False,
    n_threads: int,
) -> GroupTree:
    """The tree of the photons of a group.

    `coincident` says that some are known to be at the same point: emitter coordinates that differ
    may keep the tree from noticing.

    Range axes are the emitter coordinates, if given with their ranges and of one emitter; the
    labels of the group, if it has any; and the normals, unless all are equal but for rounding:
    photons on the other side of a plate or round a corner are not neighbours. Labels and normals
    are scaled to the largest range: it is half of the distance between labels, and MAX_NORMAL_CHORD
    between normals.
    """
    rows = group.rows
    if group.whole is not None:
        facing = group.whole.facing
    else:
        facing = not all_nearly_equal(normal, None if isinstance(rows, slice) else rows)
    if coords is None or ranges is None or group.mixed:
        coords = ranges = None
        if facing or group.labels is not None:
            ranges = np.broadcast_to(MAX_NORMAL_CHORD, len(position))
    largest = 1.0 if ranges is None else ranges[rows].max(initial=0.0)
    if group.whole is not None and coords is not None:
        largest = group.whole.largest_range
    axes = [(position, 1.0)]
    if coords is not None:
        axes.append((coords, 1.0))
    if group.labels is not None:
        axes.append((group.labels, 2.0 * largest))
    if facing:
        axes.append((normal, largest / MAX_NORMAL_CHORD))
    tree, distinct = _tree_on(axes, rows, n_threads), None
    if coincident or tree.kernel.may_coincide:
        same = [position, *([] if coords is None else [np.floor(coords / largest)])]
        distinct = _distinct(same, group, normal if facing else None)
    if distinct is not None:
        rows = distinct.rows
        tree = _tree_on(axes, rows, n_threads)
    normal_axis = tree.n_axes - (3 if facing else 0)
    scale = largest / MAX_NORMAL_CHORD
    return GroupTree(tree, ranges, leaf_rows(tree, rows), distinct, normal_axis, scale)


def _tree_on(axes: list[tuple[Floats, float]], rows: Rows, n_threads: int) -> KDTree:
    columns, scales = (list(some) for some in zip(*axes, strict=True))
    return KDTree(hstack_rows(columns, scales, rows, n_threads), n_metric=3, n_threads=n_threads)


def _distinct(same: list[Floats], group: Group, normal: Floats | None) -> Distinct | None:
    """Photons of a group that differ in one of `same`, or in label, or face different ways."""
    if group.labels is not None:
        same.append(group.labels)
    return distinct_photons(
        np.arange(len(same[0]))[group.rows],
        [column[group.rows] for column in same],
        None if normal is None else normal[group.rows],
        max_chord=MAX_NORMAL_CHORD,
    )
