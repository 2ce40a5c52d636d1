"""The k nearest neighbours, from all distances."""

import numpy as np


def nearest(points, queries, k, n_metric=3, *, half_range=None, range_radius=None, excluded=None):
    """Ids and distances by definition: all points in range, sorted by squared distance, then id."""
    n, m = len(points), len(queries)
    offsets = points - queries[:, np.newaxis]
    # Sums in the order of the axes, as the kernel's, so that ties and bits agree.
    squared = np.add.accumulate(offsets[..., :n_metric] ** 2, axis=-1)[..., -1]
    allowed = np.ones((m, n), dtype=bool)
    if half_range is not None:
        widths = np.broadcast_to(half_range, (m, points.shape[1] - n_metric))
        allowed &= (np.abs(offsets[..., n_metric:]) <= widths[:, np.newaxis]).all(axis=-1)
    if range_radius is not None:
        radius = np.broadcast_to(range_radius, m)[:, np.newaxis]
        ball = np.add.accumulate(offsets[..., n_metric:] ** 2, axis=-1)[..., -1]
        allowed &= ball <= radius * radius
    if excluded is not None:
        allowed[np.arange(m), excluded] = False
    squared = np.where(allowed, squared, np.inf)
    order = np.argsort(squared, axis=1, kind="stable")[:, :k]
    distance = np.sqrt(np.take_along_axis(squared, order, axis=1))
    ids = np.where(np.isfinite(distance), order, n)
    empty = ((0, 0), (0, k - ids.shape[1]))
    return np.pad(ids, empty, constant_values=n), np.pad(distance, empty, constant_values=np.inf)
