"""Validated interface of the tree of axis-aligned boxes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._ext.spatial import box_tree as _box_tree
from .._util import validation
from .._util.parallel import thread_count
from .._util.validation import Floats

# Boxes have numbers of 32 bits.
_MOST_BOXES = 2**31 - 1


class BoxPairs(NamedTuple):
    """Boxes near queries.

    Attributes
    ----------
    query, box : (pairs,)
        Rows of the queries and of the boxes of the tree, sorted by query; the boxes of a query are
        in the order of the tree, which depends on nothing but its boxes.
    """

    query: NDArray[np.intp]
    box: NDArray[np.int32]


class BoxTree:
    """Tree of axis-aligned boxes, of triangles or segments, say.

    Parameters
    ----------
    low, high : (n, 3) array_like
        Least and greatest coordinates; n may be zero and boxes may be flat.
    n_threads : int, optional
        Threads for building; all available by default. The tree does not depend on it.

    Raises
    ------
    TypeError, ValueError
        If `low` and `high` are not finite (n, 3) arrays of one shape, with numbers of at most
        1e150, or `low` exceeds `high` anywhere.

    Attributes
    ----------
    kernel
        The compiled tree, for the kernels that search it themselves.
    """

    def __init__(self, low: ArrayLike, high: ArrayLike, *, n_threads: int | None = None) -> None:
        low, high = _boxes(low, high)
        if len(low) > _MOST_BOXES:
            raise ValueError(f"low should have at most {_MOST_BOXES} rows, but has {len(low)}")
        self.kernel = _box_tree.BoxTree(low, high, thread_count(n_threads))

    def __len__(self) -> int:
        return int(self.kernel.n_boxes)

    def pairs_within(
        self,
        low: ArrayLike,
        high: ArrayLike,
        radius: ArrayLike = 0.0,
        *,
        n_threads: int | None = None,
    ) -> BoxPairs:
        """Find the boxes within a distance of others, which may be points.

        Parameters
        ----------
        low, high : (m, 3) array_like
            Least and greatest coordinates of the queries.
        radius : scalar or (m,) array_like
            Largest Euclidean distance from a query to a box, bound included; boxes that touch are
            at distance zero. It may be infinite.
        n_threads : int, optional
            Threads; all available by default. The result does not depend on it.

        Raises
        ------
        TypeError, ValueError
            As when a tree is built, and if a radius is negative or NaN.
        """
        low, high = _boxes(low, high)
        radii = validation.distances(radius, "radius", (len(low),))
        threads = thread_count(n_threads)
        return BoxPairs(*_box_tree.pairs_within(self.kernel, low, high, radii, threads))


def _boxes(low: ArrayLike, high: ArrayLike) -> tuple[Floats, Floats]:
    low = validation.float_array(low, "low", (None, 3))
    high = validation.float_array(high, "high", low.shape)
    for array, name in ((low, "low"), (high, "high")):
        validation.check_magnitude(array, name)
    if (low > high).any():
        bad = int(np.flatnonzero((low > high).any(axis=1))[0])
        raise ValueError(
            f"low should not exceed high, but does in row {bad}: {low[bad]} and {high[bad]}"
        )
    return low, high
