"""The loop over k-nearest queries, in batches of up to 16 that are close to one another.

A `BatchWork` is searched with: it limits the queries, and does its work on their neighbours. Its
methods are called by several threads at once, without the GIL, and write only what belongs to the
queries of their batch, or to their thread.
"""

from .batch cimport Batch, Query
from .tree cimport Tree


cdef class BatchWork:
    cdef Tree tree
    cdef Py_ssize_t k
    cdef double squared_radius
    cdef double range_radius

    cdef bint skips(self, Py_ssize_t first) noexcept nogil
    cdef void limit(self, Batch* batch, Query* query, Py_ssize_t i) noexcept nogil
    cdef void finish(self, Batch* batch, Py_ssize_t first, int thread) noexcept nogil


cdef int search_queries(
    BatchWork work, const double[:, ::1] queries, const Py_ssize_t[::1] order, int n_threads
) except -1

cdef int search_points(
    BatchWork work, Py_ssize_t first, Py_ssize_t end, int n_threads
) except -1
