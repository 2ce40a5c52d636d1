"""Points with the photons around them: which tree serves them, and how far each looks."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ._arrays import Floats
from ._ext.estimation import tangent_plane as _tangent
from ._facing import FacingTrees
from ._progress import Reporter
from ._sheets import normal_range

Rows = NDArray[np.intp]
# The largest bandwidth, m, and of how many photons the distance is it where that is less.
Scale = tuple[float, int | None]


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
    largest, k = scale
    bandwidth = np.full(len(points), largest)
    for number, queries, rows in trees.chunks(points, normals, report):
        if k is not None:
            tree = trees.tree(number)[0]
            _tangent.bandwidths(
                tree.kernel,
                queries,
                rows,
                bandwidth,
                k=k,
                normal_range=normal_range(tree),
                n_threads=n_threads,
            )
        yield number, _tangent.Sites(queries, normals, bandwidth), rows
