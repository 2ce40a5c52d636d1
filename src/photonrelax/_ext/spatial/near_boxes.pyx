"""Boxes that may have points near those of others."""

import numpy as np


def near_boxes(
    const double[:, ::1] low, const double[:, ::1] high, const double[::1] radius,
    const double[::1] range_radius, const double[:, ::1] other_low,
    const double[:, ::1] other_high, const double[::1] travel, Py_ssize_t n_metric
):
    """Matrix (t, u) of bool, true where boxes u of others may have points near those of boxes t.

    Parameters
    ----------
    low, high : (t, d) float64 arrays
        Boxes; the first `n_metric` axes have the metric, the others limit it.
    radius, range_radius : (t,) float64 arrays
        Of each box, over the metric, and over the other axes.
    other_low, other_high : (u, d) float64 arrays
        Other boxes; may be the same array.
    travel : (u,) float64 array or None
        Distances over the metric that points of other boxes may be off.
    n_metric : int
    """
    cdef Py_ssize_t n = low.shape[0], m = other_low.shape[0], d = low.shape[1]
    if not (
        high.shape[0] == radius.shape[0] == range_radius.shape[0] == n
        and other_high.shape[0] == m and (travel is None or travel.shape[0] == m)
        and high.shape[1] == other_low.shape[1] == other_high.shape[1] == d >= n_metric
    ):
        raise ValueError("boxes and radii do not fit one another")
    near = np.empty((n, m), dtype=bool)
    cdef unsigned char[:, ::1] view = near.view(np.uint8)
    cdef Py_ssize_t t, u
    cdef double farthest
    with nogil:
        for t in range(n):
            for u in range(m):
                farthest = radius[t] + (0.0 if travel is None else travel[u])
                view[t, u] = is_near(
                    &low[t, 0], &high[t, 0], &other_low[u, 0], &other_high[u, 0], 0, n_metric,
                    farthest * farthest
                ) and is_near(
                    &low[t, 0], &high[t, 0], &other_low[u, 0], &other_high[u, 0], n_metric, d,
                    range_radius[t] * range_radius[t]
                )
    return near


cdef inline bint is_near(
    const double* low, const double* high, const double* other_low, const double* other_high,
    Py_ssize_t first, Py_ssize_t end, double most
) noexcept nogil:
    """True if the squared gap between two boxes, over some axes, is at most some number."""
    cdef double gap, squared = 0.0
    cdef Py_ssize_t axis
    for axis in range(first, end):
        gap = max(max(other_low[axis] - high[axis], low[axis] - other_high[axis]), 0.0)
        squared += gap * gap
    return squared <= most
