"""Validated interface of the k-d tree: exact k nearest on some axes, within a range on others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._ext.spatial import kth_distance as _kth_distance
from .._ext.spatial import query as _neighbours
from .._ext.spatial import tree as _kdtree
from .._ext.spatial.blocks import bounds
from .._ext.spatial.morton import morton_order
from .._util import validation
from .._util.memory import check_memory
from .._util.parallel import thread_count
from .._util.validation import Floats

# Squared distances must stay finite.
_LARGEST_EXTENT = 1e150
# The tree is built with numbers of 32 bits.
_MOST_POINTS = 2**31 - 1
# Bytes of a neighbour's id and distance.
_FOUND_BYTES = 16


@dataclass(frozen=True)
class Neighbours:
    """Neighbours found by a query, nearest first, ties in the order of their ids.

    Attributes
    ----------
    ids : (m, k) intp array
        Row numbers of the tree's points; empty slots hold n, the number of points.
    distance : (m, k) float array
        Euclidean distance over the metric axes; empty slots hold infinity.
    """

    ids: NDArray[np.intp]
    distance: Floats


class KDTree:
    """k-d tree whose first axes carry the distance and whose other axes limit the search.

    Parameters
    ----------
    points : (n, d) array_like
        Coordinates, finite; n may be zero and points may coincide. Copied.
    n_metric : int
        The first `n_metric` axes carry the Euclidean metric; the rest are range axes, used
        only through `half_range` and `range_radius`.
    n_threads : int, optional
        Threads for building; all available by default. The tree does not depend on it.

    Raises
    ------
    TypeError, ValueError
        If `points` is not a finite (n, d) array with d >= n_metric >= 1, or spans more than
        1e150, where squared distances overflow.

    Attributes
    ----------
    n_points, n_axes, n_metric : int
        n, d and how many axes carry the metric.
    kernel
        The compiled tree, for the kernels that search it themselves.

    Notes
    -----
    Searching a high-dimensional tree in its lower axes while limiting the others to a range is
    the query of SJ13 §4.2. It is exact: the ids are those of a brute-force search.
    """

    def __init__(
        self, points: ArrayLike, n_metric: int = 3, *, n_threads: int | None = None
    ) -> None:
        array = validation.float_array(points, "points", (None, None))
        self.n_metric = validation.count(n_metric, "n_metric")
        self.n_points, self.n_axes = array.shape
        if self.n_axes < self.n_metric:
            raise ValueError(
                f"points should have at least n_metric = {self.n_metric} axes, "
                f"but have {self.n_axes}"
            )
        if self.n_points > _MOST_POINTS:
            raise ValueError(f"points should be at most {_MOST_POINTS}, but are {self.n_points}")
        threads = thread_count(n_threads)
        scale = _axis_scale(array, self.n_metric, threads)
        self.kernel = _kdtree.Tree(array, self.n_metric, scale, threads)

    def __len__(self) -> int:
        return self.n_points

    def __reduce__(self) -> tuple[type, tuple[Floats, int]]:
        lanes = np.asarray(self.kernel.coords)
        in_order = lanes.transpose(0, 2, 1).reshape(-1, self.n_axes)[: self.n_points]
        return type(self), (in_order[self._places()], self.n_metric)

    def query(
        self,
        queries: ArrayLike,
        k: int,
        *,
        half_range: ArrayLike | None = None,
        range_radius: ArrayLike | None = None,
        exclude_self: bool = False,
        n_threads: int | None = None,
    ) -> Neighbours:
        """Find the k nearest points of each query among those in its range.

        Parameters
        ----------
        queries : (m, d) array_like
            Where to search. With neither range given, (m, n_metric) will do.
        k : int
            Neighbours wanted; may exceed the number of points.
        half_range : scalar, (d - n_metric,) or (m, d - n_metric) array_like, optional
            Half-widths of the interval allowed on each range axis, bounds included. Infinite
            leaves an axis open.
        range_radius : scalar or (m,) array_like, optional
            Radius of the ball allowed over the range axes, bound included (SJ13 Eq. 1).
        exclude_self : bool
            Leave point i out of the neighbours of query i; there must be as many queries as
            points.
        n_threads : int, optional
            Threads; all available by default. The result does not depend on it.

        Returns
        -------
        Neighbours
            Ids and distances, each (m, k). Nothing is found at distances whose squares are beyond
            the largest float.

        Raises
        ------
        TypeError, ValueError
            If a shape is wrong, a value is NaN or a range negative, or a range is given to a
            tree that has no range axes.
        MemoryError
            If the result cannot fit in memory.
        """
        array = validation.float_array(queries, "queries", (None, None))
        array = self._check_queries(array, half_range is not None or range_radius is not None)
        if exclude_self and len(array) != self.n_points:
            raise ValueError(
                f"exclude_self leaves point i out of query i, so it needs {self.n_points} "
                f"queries, but there are {len(array)}"
            )
        ids, distance = _neighbours.query(
            self.kernel,
            array,
            morton_order(array, self.n_metric, thread_count(n_threads)),
            _neighbour_count(k, len(array)),
            ranges=self._ranges(len(array), half_range, range_radius),
            excluded=self._places() if exclude_self else None,
            n_threads=thread_count(n_threads),
        )
        return Neighbours(ids, distance)

    def query_self(
        self,
        k: int,
        *,
        half_range: ArrayLike | None = None,
        range_radius: ArrayLike | None = None,
        exclude_self: bool = False,
        n_threads: int | None = None,
    ) -> Neighbours:
        """Find the k nearest points of each of the tree's own points; see `query`."""
        ids, distance = _neighbours.query_self(
            self.kernel,
            _neighbour_count(k, self.n_points),
            ranges=self._ranges(self.n_points, half_range, range_radius),
            exclude_self=exclude_self,
            n_threads=thread_count(n_threads),
        )
        return Neighbours(ids, distance)

    def farthest(
        self,
        k: int,
        *,
        range_radius: ArrayLike | None = None,
        of_fewer: bool = True,
        n_threads: int | None = None,
    ) -> Floats:
        """Distance to the k-th nearest point from each of the tree's own points.

        Parameters
        ----------
        k : int
            Neighbours, each point among its own.
        of_fewer : bool
            Of fewer than k neighbours the farthest counts; else the distance is infinite.
        range_radius : scalar or (n,) array_like, optional
            As in `query`.
        n_threads : int, optional
            Threads; all available by default. The result does not depend on it.

        Returns
        -------
        (n,) float array
        """
        if range_radius is not None:
            self._check_range_axes()
        distance: Floats = _kth_distance.of_points(
            self.kernel,
            k=validation.count(k, "k", high=validation.MAX_NEIGHBOURS),
            range_radii=_ranges(range_radius, "range_radius", (self.n_points,)),
            of_fewer=of_fewer,
            n_threads=thread_count(n_threads),
        )
        return distance

    def sample(self, n: int) -> Floats:
        """Return the coordinates of about n of the points, spread evenly over the tree."""
        places = np.arange(0, self.n_points, -(-self.n_points // n) if self.n_points else 1)
        lanes = np.asarray(self.kernel.coords)
        block = lanes.shape[2]
        return lanes[places // block, :, places % block]

    def _places(self) -> NDArray[np.intp]:
        """Position in the tree of each point."""
        places = np.empty(self.n_points, dtype=np.intp)
        places[np.asarray(self.kernel.ids)] = np.arange(self.n_points)
        return places

    def _ranges(
        self, n_queries: int, half_range: ArrayLike | None, range_radius: ArrayLike | None
    ) -> _neighbours.Ranges:
        if half_range is not None or range_radius is not None:
            self._check_range_axes()
        shape = (n_queries, self.n_axes - self.n_metric)
        return _neighbours.Ranges(
            _ranges(half_range, "half_range", shape),
            _ranges(range_radius, "range_radius", shape[:1]),
        )

    def _check_range_axes(self) -> None:
        if self.n_axes == self.n_metric:
            raise ValueError(f"the tree has no range axes: all its {self.n_axes} carry the metric")

    def _check_queries(self, queries: Floats, ranged: bool) -> Floats:
        if ranged:
            self._check_range_axes()
        if queries.shape[1] == self.n_axes:
            return queries
        if queries.shape[1] == self.n_metric and not ranged:
            padded = np.zeros((len(queries), self.n_axes))
            padded[:, : self.n_metric] = queries
            return padded
        raise ValueError(
            f"queries should have the tree's {self.n_axes} axes, but have {queries.shape[1]}"
        )


def _neighbour_count(k: int, n_queries: int) -> int:
    """Neighbours of each query, whose ids and distances have to fit in memory."""
    k = validation.count(k, "k", high=validation.MAX_NEIGHBOURS)
    neighbours = f"the {k} neighbours of each of {n_queries} queries"
    check_memory(_FOUND_BYTES * k * n_queries, neighbours, "ask for fewer (k)")
    return k


def _ranges(value: ArrayLike | None, name: str, shape: tuple[int, ...]) -> Floats | None:
    return None if value is None else validation.distances(value, name, shape)


def _axis_scale(points: Floats, n_metric: int, n_threads: int) -> Floats:
    """Factors that make extents on the metric and on the range axes comparable.

    Photons are a sheet over the coordinates they left their emitter with. Splitting on both kinds
    of axes keeps leaves compact in both, and so prunes best.
    """
    low, high = bounds(points, points.shape[1], n_threads)
    with np.errstate(over="ignore"):
        extent = high - low if len(points) else np.zeros_like(low)
    if (extent > _LARGEST_EXTENT).any():
        raise ValueError(
            f"points should span at most {_LARGEST_EXTENT:g}, but span {extent.max():g}"
        )
    scale = np.zeros(points.shape[1])
    for axes in (slice(0, n_metric), slice(n_metric, None)):
        largest = extent[axes].max(initial=0.0)
        if largest > 0.0:
            # The inverse of the least of numbers would be infinite.
            scale[axes] = 1.0 / max(largest, 1e-300)
    return scale
