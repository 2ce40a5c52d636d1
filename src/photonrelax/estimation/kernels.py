"""Kernels of density estimates: their shapes, and the bandwidth at each point."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from .._ext.estimation import nearest as _nearest
from .._ext.spatial import kth_distance as _kth_distance
from .._util.parallel import thread_count
from .._util.validation import Floats
from ..photons.axes import normal_range
from ..spatial.kdtree import KDTree

Rows = NDArray[np.intp]
# One for all points, or one for each.
Number = TypeVar("Number", float, Floats)
# The largest bandwidth, m; the number of photons whose distance it is elsewhere, None for a fixed
# bandwidth.
Scale = tuple[float, int | None]
# Factor of the distance to the k-th photon: whether that photon itself, on the rim, lies within the
# bandwidth must not depend on rounding, and an estimate of those within is unbiased without it.
JUST_SHORT = 1.0 - 1e-9


KERNELS = {
    "constant": _nearest.CONSTANT,
    "cone": _nearest.CONE,
    "epanechnikov": _nearest.EPANECHNIKOV,
    "gaussian": _nearest.GAUSSIAN,
}
WELL_SPACED_BIAS = {
    "constant": (0.43, -1.0),
    "cone": (0.45, -1.5),
    "epanechnikov": (0.57, -1.5),
    "gaussian": (0.32, -1.35),
}
# Largest number of photons, and two quantiles, that the automatic gather radius is taken from.
SAMPLE = 10_000
_SHARE_OF_PHOTONS = 0.95
_SHARE_OF_AREA = 0.05


def well_spaced_mean(k: Number, kernel: str) -> Number:
    """Mean k-nearest estimate of a uniform field from evenly spaced photons, over its value.

    It is one for independent photons and any kernel. Evenly spaced photons number k − 1/2, not
    k − 1, within the distance to the k-th, and are missing from its rim. The constants lie between
    those fitted to uniform fields of Halton and of relaxed photons, which they bring to within
    0.5 % of the value for k of 15 and more.
    """
    factor, exponent = WELL_SPACED_BIAS[kernel]
    return 1.0 - factor * k**exponent


def automatic_gather_radius(tree: KDTree, k: int, *, n_threads: int | None = None) -> float:
    """Radius, m, that holds k photons nearly everywhere there is light.

    The larger of two quantiles of the distance to the k-th photon: the 95 % quantile over photons,
    and the 5 % quantile over the lit area, of which a photon has a share proportional to the
    square of its distance. The second keeps a bright spot, which may hold nearly all photons, from
    setting the radius for the dim light around it.

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
    points = tree.sample(SAMPLE)
    threads = thread_count(n_threads)
    distance = _kth_distance.of_queries(
        *(tree.kernel, points, np.arange(len(points))),
        k=k,
        range_radius=normal_range(tree),
        of_fewer=True,
        n_threads=threads,
    )
    extent = float(np.linalg.norm(np.subtract(tree.kernel.high, tree.kernel.low)[:3]))
    return gather_radius_of(distance, extent)


def gather_radius_of(distance: Floats, extent: float) -> float:
    """Radius of `automatic_gather_radius`, by distances (s,) of a sample, and the map's extent, m.

    Raises
    ------
    ValueError
        If all photons are at one point.
    """
    # Photons that all face different ways have no neighbours: the extent of the map.
    radius = _larger_quantile(np.sort(distance)) or extent
    if radius == 0.0:
        raise ValueError(
            "the photons are all at one point, from which no gather radius follows: "
            "give GatherSettings(gather_radius=…)"
        )
    return radius


def _larger_quantile(distance: Floats) -> float:
    """The larger quantile of distances, ascending; zero without any."""
    if not len(distance):
        return 0.0
    area = np.cumsum(distance**2)
    lit = distance[np.searchsorted(area, _SHARE_OF_AREA * area[-1])]
    return float(max(np.quantile(distance, _SHARE_OF_PHOTONS), lit))


def kth_distance(
    tree: KDTree, queries: Floats, rows: Rows, k: int, *, radius: float, n_threads: int
) -> Floats:
    """Distances (r,) to the k-th photon around the queries named by `rows`, m.

    Infinite where fewer than k photons, on faces turned by no more than 60°, are within `radius`.
    """
    distance: Floats = _kth_distance.of_queries(
        *(tree.kernel, queries, rows),
        k=k,
        radius=radius,
        range_radius=normal_range(tree),
        n_threads=n_threads,
    )
    return distance


def bandwidths(
    tree: KDTree, queries: Floats, rows: Rows, scale: Scale, *, n_threads: int
) -> Floats:
    """Kernel bandwidths (r,) of the queries named by `rows`, m, just short of their k-th photon.

    The largest where fewer than k photons are within that, or all of them are at the query.
    """
    largest, k = scale
    if k is None:
        return np.full(len(rows), largest)
    distance = kth_distance(tree, queries, rows, k, radius=largest, n_threads=n_threads)
    unknown = (distance == 0.0) | (distance == np.inf)
    distance *= JUST_SHORT
    distance[unknown] = largest
    return distance
