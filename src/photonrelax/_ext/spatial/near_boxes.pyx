"""Boxes that may have points near those of others."""

from libc.math cimport INFINITY

import numpy as np

cdef enum:
    # Points whose box is compared before they are.
    TOGETHER = 32
    MAX_AXES = 16


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


def near_points(
    const double[:, ::1] low, const double[:, ::1] high, const double[::1] radius,
    const double[::1] range_radius, const Py_ssize_t[::1] hits, const Py_ssize_t[::1] first_hit,
    const double[:, ::1] points, const Py_ssize_t[::1] first_point, const double[::1] travel,
    Py_ssize_t n_metric
):
    """Points near boxes, and boxes near points, of runs of points and the boxes that each may have.

    Parameters
    ----------
    low, high, radius, range_radius
        Of boxes (t, d); see `near_boxes`.
    hits : (h,) intp array
        Boxes of all runs, those of run r from ``first_hit[r]`` on.
    first_hit, first_point : (r + 1,) intp arrays
    points : (n, d) float64 array
        Close ones in sequence.
    travel : (n,) float64 array or None
    n_metric : int

    Returns
    -------
    (n,) bool array, (t,) bool array
    """
    cdef Py_ssize_t run, first, end, n_runs = first_hit.shape[0] - 1, d = low.shape[1]
    if not (
        high.shape[0] == radius.shape[0] == range_radius.shape[0] == low.shape[0]
        and high.shape[1] == points.shape[1] == d >= n_metric and d <= MAX_AXES
        and (travel is None or travel.shape[0] == points.shape[0])
        and first_point.shape[0] == n_runs + 1 and first_point[n_runs] == points.shape[0]
        and first_hit[n_runs] == hits.shape[0]
    ):
        raise ValueError("points, boxes and radii do not fit one another")
    near_point, near_box = np.zeros(points.shape[0], bool), np.zeros(low.shape[0], bool)
    cdef Nearby work = Nearby()
    work.low, work.high, work.radius, work.range_radius = low, high, radius, range_radius
    work.points, work.travel, work.n_metric = points, travel, n_metric
    work.near_point, work.near_box = near_point.view(np.uint8), near_box.view(np.uint8)
    with nogil:
        for run in range(n_runs):
            first = first_point[run]
            while first < first_point[run + 1]:
                end = min(first + TOGETHER, first_point[run + 1])
                work.compare(first, end, hits, first_hit[run], first_hit[run + 1])
                first = end
    return near_point, near_box


cdef class Nearby:
    """Boxes and points that are compared; see `near_points`."""

    cdef const double[:, ::1] low
    cdef const double[:, ::1] high
    cdef const double[::1] radius
    cdef const double[::1] range_radius
    cdef const double[:, ::1] points
    cdef const double[::1] travel
    cdef Py_ssize_t n_metric
    cdef unsigned char[::1] near_point
    cdef unsigned char[::1] near_box

    cdef void compare(
        self, Py_ssize_t first, Py_ssize_t end, const Py_ssize_t[::1] hits, Py_ssize_t first_hit,
        Py_ssize_t end_hit
    ) noexcept nogil:
        """Compare some points with those boxes that are near the box of all of them."""
        cdef double[MAX_AXES] low, high
        cdef double travel = 0.0, travel_of_one
        cdef Py_ssize_t hit, i, axis
        for axis in range(self.points.shape[1]):
            low[axis], high[axis] = INFINITY, -INFINITY
        for i in range(first, end):
            for axis in range(self.points.shape[1]):
                low[axis] = min(low[axis], self.points[i, axis])
                high[axis] = max(high[axis], self.points[i, axis])
            if self.travel is not None:
                travel = max(travel, self.travel[i])
        for hit in range(first_hit, end_hit):
            if self.is_near(hits[hit], low, high, travel):
                for i in range(first, end):
                    travel_of_one = 0.0 if self.travel is None else self.travel[i]
                    if self.is_near(
                        hits[hit], &self.points[i, 0], &self.points[i, 0], travel_of_one
                    ):
                        self.near_point[i] = self.near_box[hits[hit]] = True

    cdef bint is_near(
        self, Py_ssize_t box, const double* low, const double* high, double travel
    ) noexcept nogil:
        cdef const double* low_of_box = &self.low[box, 0]
        cdef const double* high_of_box = &self.high[box, 0]
        cdef double farthest = self.radius[box] + travel, range_radius = self.range_radius[box]
        return is_near(
            low_of_box, high_of_box, low, high, 0, self.n_metric, farthest * farthest
        ) and is_near(
            low_of_box, high_of_box, low, high, self.n_metric, self.points.shape[1],
            range_radius * range_radius
        )
