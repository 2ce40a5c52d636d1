"""k-d tree: exact k-nearest search on the metric axes, limited to a range on the others.

The tree is implicit. At level l there are 2**l nodes, and node j of them holds the points at
places [(j * n) >> l, ((j + 1) * n) >> l) of the reordered arrays; the last level are the leaves.
A median split fixes these counts whatever the coordinates are, so coincident points cannot
unbalance it. Every node has a bounding box on all axes, so ranges prune as distances do.
"""

from libc.math cimport INFINITY

from .heap cimport Candidate


cdef struct Limits:
    # What a query may find. `squared_range` < 0 means no ball over the range axes, and
    # `half_range` NULL no interval.
    double squared_radius
    double squared_range
    const double* half_range
    Py_ssize_t excluded


cdef inline void lift_limits(Limits* limits) noexcept nogil:
    limits.squared_radius = INFINITY
    limits.squared_range = -1.0
    limits.half_range = NULL
    limits.excluded = -1


cdef class Tree:
    cdef readonly Py_ssize_t n_points
    cdef readonly Py_ssize_t n_axes
    cdef readonly Py_ssize_t n_metric
    cdef readonly Py_ssize_t n_levels
    cdef readonly double[:, ::1] points
    cdef readonly Py_ssize_t[::1] ids
    cdef readonly double[:, ::1] low
    cdef readonly double[:, ::1] high
    cdef readonly Py_ssize_t[::1] lowest_id

    cdef unsigned char[:, ::1] scratch(self, Py_ssize_t k, int n_threads)
    cdef Py_ssize_t search(
        self, const double* query, const Limits* limits, Candidate* found, Py_ssize_t k
    ) noexcept nogil
