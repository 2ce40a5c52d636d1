"""Tree of axis-aligned boxes; see box_tree.pxd."""

from cython.parallel cimport prange, threadid
from libc.stdint cimport int32_t, int64_t

import numpy as np

from ..common.threads cimport Watch, close_watch, goes_on, open_watch, team_size
from .radius cimport LOOK_EVERY, QUERY_GRAIN

from .morton import morton_order


cdef class BoxTree:
    """Boxes from `low` to `high`, (n, 3) both, in a tree; n < 2**31.

    The tree does not depend on the number of threads, which build it.
    """

    def __init__(self, low, high, int n_threads):
        if len(low) != len(high):
            raise ValueError("low and high should have equal rows")
        order = morton_order(0.5 * low + 0.5 * high, 3, n_threads)
        bounds = np.hstack([low, high])[order]
        levels = []
        self.n_boxes = len(low)
        self.root = -1
        self.first[0] = 0
        while len(bounds) > 0:
            levels.append(bounds)
            self.root += 1
            self.first[self.root + 1] = self.first[self.root] + len(bounds)
            bounds = bounds_above(bounds) if len(bounds) > 1 else bounds[:0]
        self.bounds = np.concatenate(levels) if levels else bounds
        self.ids = order.astype(np.int32)


def bounds_above(bounds):
    """Bounds (ceil(n / FAN), 6) of the nodes above those with `bounds` (n, 6)."""
    first = np.arange(0, len(bounds), FAN)
    return np.hstack([
        np.minimum.reduceat(bounds[:, :3], first), np.maximum.reduceat(bounds[:, 3:], first)
    ])


def pairs_within(
    BoxTree tree, const double[:, ::1] low, const double[:, ::1] high, const double[::1] radius,
    int n_threads
):
    """Rows of `low` and `high` (m, 3), and numbers of the boxes within `radius` (m,) of each.

    Returns (pairs,) intp and int32, sorted by row, then in the order of the tree.
    """
    cdef Py_ssize_t n = radius.shape[0]
    if not n == low.shape[0] == high.shape[0]:
        raise ValueError("queries and radii do not fit one another")
    end = np.zeros(n + 1, np.int64)
    visit_all(tree, low, high, radius, end[1:], None, n_threads)
    rows = np.repeat(np.arange(n), end[1:])
    np.cumsum(end, out=end)
    boxes = np.empty(end[n], np.int32)
    visit_all(tree, low, high, radius, end[:n], boxes, n_threads)
    return rows, boxes


cdef int visit_all(
    BoxTree tree, const double[:, ::1] low, const double[:, ::1] high, const double[::1] radius,
    int64_t[::1] places, int32_t[::1] out, int n_threads
) except -1:
    """Write the number of boxes of each query to `places`, or the boxes to `out` from there on."""
    cdef Watch watch = open_watch()
    cdef Py_ssize_t i
    for i in prange(
        radius.shape[0], nogil=True, schedule="dynamic", chunksize=QUERY_GRAIN,
        num_threads=team_size(n_threads, radius.shape[0], QUERY_GRAIN)
    ):
        if goes_on(&watch, threadid() == 0 and i % LOOK_EVERY == 0):
            visit_one(tree, open_visit(tree, &low[i, 0], &high[i, 0], radius[i]), &places[i], out)
    return close_watch(&watch)


cdef void visit_one(
    BoxTree tree, BoxVisit visit, int64_t* place, int32_t[::1] out
) noexcept nogil:
    cdef int32_t box = next_within(tree, &visit)
    cdef int64_t n = 0
    while box >= 0:
        if out is not None:
            out[place[0] + n] = box
        n += 1
        box = next_within(tree, &visit)
    if out is None:
        place[0] = n
