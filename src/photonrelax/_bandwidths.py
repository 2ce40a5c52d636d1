"""Points with the photons around them: which tree serves them, and how far each looks."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ._arrays import Floats
from ._ext import tangent as _tangent
from ._facing import FacingTrees
from ._progress import Reporter
from ._sheets import NORMAL_RANGE
from .kdtree import KDTree

Rows = NDArray[np.intp]
# The largest bandwidth, m, and of how many photons the distance is it where that is less.
Scale = tuple[float, int | None]


def normal_range(tree: KDTree) -> float:
    """Return the radius of the ball over the normals of a tree, -1 if it has no axes for them."""
    return NORMAL_RANGE if tree.n_axes > tree.n_metric else -1.0


def sites_in_chunks(
    trees: FacingTrees,
    points: Floats,
    normals: Floats,
    *,
    scale: Scale,
    report: Reporter,
    n_threads: int,
) -> Iterator[tuple[int, _tangent.Sites, Rows]]:
    """Divide points by the tree that serves them and into chunks; find their bandwidths.

    Yields the number of the tree, the sites, and the rows of those whose turn it is. No tree
    serves points that face no photon.
    """
    left, (largest, k) = len(points), scale
    for number, queries, rows in trees.parts(points, normals):
        bandwidth = np.full(len(points), largest)
        sites = _tangent.Sites(queries, normals, bandwidth)
        tree = trees.tree(number)[0]
        for first, end in report.chunks(len(rows)):
            if k is not None:
                _tangent.bandwidths(
                    tree.kernel,
                    queries,
                    rows[first:end],
                    bandwidth,
                    k=k,
                    normal_range=normal_range(tree),
                    n_threads=n_threads,
                )
            yield number, sites, rows[first:end]
        left -= len(rows)
    if left:
        report.advance(left)
