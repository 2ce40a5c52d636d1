"""The k nearest neighbours, from all distances."""

import numpy as np


def nearest(points, queries, k, n_metric=3, *, half_range=None, range_radius=None, excluded=None):
    """Ids and distances by definition: all points in range, sorted by squared distance, then id."""
    n, m = len(points), len(queries)
    squared = squared_distances(points[:, :n_metric], queries[:, :n_metric])
    allowed = np.ones((m, n), dtype=bool)
    others, own = points[:, n_metric:], queries[:, n_metric:]
    if half_range is not None:
        widths = np.broadcast_to(half_range, own.shape)
        for axis in range(own.shape[1]):
            allowed &= np.abs(others[:, axis] - own[:, axis, None]) <= widths[:, axis, None]
    if range_radius is not None:
        radius = np.broadcast_to(range_radius, m)[:, np.newaxis]
        allowed &= squared_distances(others, own) <= radius * radius
    if excluded is not None:
        allowed[np.arange(m), excluded] = False
    squared[~allowed] = np.inf
    distance, ids = np.full((m, k), np.inf), np.full((m, k), n)
    last = min(k, n)
    for query, row in enumerate(squared if last else ()):
        # Sorted are those alone that are no farther than the k-th.
        near = np.flatnonzero(row <= np.partition(row, last - 1)[last - 1])
        first = near[np.argsort(row[near], kind="stable")[:last]]
        distance[query, :last], ids[query, :last] = np.sqrt(row[first]), first
    return np.where(np.isfinite(distance), ids, n), distance


def squared_distances(points, queries):
    """All (m, n); sums in the order of the axes, as the kernel's, so that ties and bits agree."""
    squared = np.zeros((len(queries), len(points)))
    for axis in range(points.shape[1]):
        squared += (points[:, axis] - queries[:, axis, np.newaxis]) ** 2
    return squared
