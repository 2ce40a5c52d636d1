"""Points with the photons around them: which tree serves them, and how far each looks."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .._ext.estimation import nearest as _estimate
from .._ext.estimation import tangent_plane as _tangent
from .._util.parallel import thread_count
from .._util.validation import Floats
from ..photons.neighbourhoods import normal_range
from ..photons.photon_trees import PhotonTrees
from ..spatial.kdtree import KDTree

Rows = NDArray[np.intp]
# The largest bandwidth, m, and of how many photons the distance is it where that is less.
Scale = tuple[float, int | None]


def evaluation_points(
    trees: PhotonTrees, points: Floats, normals: Floats, *, scale: Scale, n_threads: int
) -> Iterator[tuple[int, _tangent.Sites, Rows]]:
    """Divide points by the tree that serves them, with the kernel bandwidth of each.

    Points are close to one another in sequence, and their normals are unit vectors.

    Yields
    ------
    int, Sites, (r,) intp array
        Number of the tree, evaluation points, and the rows of those it serves. No tree serves
        points that face no photon.
    """
    largest, k = scale
    bandwidth = np.full(len(points), largest)
    for number, queries, rows in trees.parts(points, normals, np.arange(len(points))):
        if k is not None:
            tree = trees.tree(number)[0]
            _tangent.bandwidths(
                *(tree.kernel, queries, rows, bandwidth),
                k=k,
                normal_range=normal_range(tree),
                n_threads=n_threads,
            )
        yield number, _tangent.Sites(queries, normals, bandwidth), rows


KERNELS = {
    "constant": _estimate.CONSTANT,
    "cone": _estimate.CONE,
    "epanechnikov": _estimate.EPANECHNIKOV,
}
WELL_SPACED_BIAS = {"constant": (0.43, -1.0), "cone": (0.45, -1.5), "epanechnikov": (0.57, -1.5)}
# What the automatic gather radius looks at: no more photons than this, these two quantiles.
_SAMPLE = 10_000
_SHARE_OF_PHOTONS = 0.95
_SHARE_OF_AREA = 0.05


def well_spaced_mean(k: int, kernel: str) -> float:
    """Return the mean k-nearest estimate of a uniform field from evenly spaced photons over truth.

    For independent photons it is one, whatever the kernel. Evenly spaced photons number k − 1/2,
    not k − 1, within the distance to the k-th, and are missing from its rim. The constants lie
    between those fitted to uniform fields of Halton and of relaxed photons, which they bring to
    within 0.3 % of the truth for k of 15 and more.
    """
    factor, exponent = WELL_SPACED_BIAS[kernel]
    return 1.0 - factor * k**exponent


def automatic_gather_radius(tree: KDTree, k: int, *, n_threads: int | None = None) -> float:
    """Return a radius, m, that reaches k photons nearly everywhere there is light.

    The larger of two quantiles of the distance to the k-th photon: within the first, 95 % of the
    photons have theirs; within the second, 5 % of the lit area has, a photon standing for an
    area that goes with the square of its distance. The second keeps a bright spot, which may
    hold nearly all photons, from setting the radius for the dim light around it.

    Parameters
    ----------
    tree : KDTree
        Photons in space; range axes, if any, are their normals.
    k : int
        Photons per estimate.
    n_threads : int, optional
        Threads; all available by default.

    Raises
    ------
    ValueError
        If all photons are at one point.
    """
    points = tree.sample(_SAMPLE)
    threads = thread_count(n_threads)
    distance = np.sort(
        _tangent.farthest(
            tree.kernel, points, k, normal_range=normal_range(tree), n_threads=threads
        )
    )
    area = np.cumsum(distance**2)
    lit = distance[np.searchsorted(area, _SHARE_OF_AREA * area[-1])]
    radius = float(max(np.quantile(distance, _SHARE_OF_PHOTONS), lit))
    if radius == 0.0:
        # Photons that each face another way have no neighbours; their extent must do.
        radius = float(np.linalg.norm(np.subtract(tree.kernel.high, tree.kernel.low)[:3]))
    if radius == 0.0:
        raise ValueError(
            f"the map's {len(tree)} photons are all at one point, from which no gather radius "
            "follows: give GatherSettings(gather_radius=…)"
        )
    return radius
