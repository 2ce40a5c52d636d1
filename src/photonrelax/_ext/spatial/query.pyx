# distutils: language = c++
"""Neighbour tables: ids and distances of the k nearest; see `photonrelax.KDTree`."""

from cython cimport final
from libc.math cimport INFINITY
from libc.stdint cimport int64_t

import numpy as np

from ..common.prefetch cimport prefetch_row
from .batch cimport Batch, Query, gather_neighbours, limit_range
from .query_loop cimport BatchWork, search_points, search_queries
from .simd.kernels cimport KEY_CHUNK, LANES, Candidates, store_fence
from .tree cimport Tree

from .tree import aligned


cdef enum:
    # Rows ahead of the one written that are prefetched, as they are scattered over the table.
    PREFETCH_DISTANCE = 2
    # Size in bytes from which tables are written with streaming stores: they exceed the cache.
    STREAMING_BYTES = 1 << 26


cdef extern from "<algorithm>" namespace "std" nogil:
    void sort(Neighbour* first, Neighbour* last)


cdef extern from *:
    """
    struct Neighbour {
        double squared;
        int64_t id;
        bool operator<(const Neighbour& other) const {
            return squared < other.squared || (squared == other.squared && id < other.id);
        }
    };
    """
    cdef cppclass Neighbour:
        double squared
        int64_t id


cdef class Ranges:
    """Limits over the range axes, one row per query, or None; see `photonrelax.KDTree.query`."""

    cdef const double[:, ::1] half_range
    cdef const double[::1] range_radius

    def __init__(self, half_range, range_radius):
        self.half_range = half_range
        self.range_radius = range_radius


cdef class Table:
    """Ids and distances, one row per query, and memory to sort in, one row per thread."""

    cdef readonly object ids
    cdef readonly object distance
    cdef int64_t[:, ::1] id_rows
    cdef double[:, ::1] distance_rows
    cdef unsigned char[:, ::1] scratch
    cdef bint streaming

    def __init__(self, Py_ssize_t n_queries, Py_ssize_t k, int n_threads):
        self.ids = aligned((n_queries, k), np.int64)
        self.distance = aligned((n_queries, k))
        self.id_rows = self.ids
        self.distance_rows = self.distance
        self.streaming = 8 * n_queries * k >= STREAMING_BYTES and k % LANES == 0
        n_sorted = k if k > KEY_CHUNK else 0
        self.scratch = np.empty((n_threads, max(n_sorted * sizeof(Neighbour), 1)), dtype=np.uint8)


@final
cdef class TableQuery(BatchWork):
    """The search whose neighbours a table holds."""

    cdef Ranges ranges
    cdef Table table
    # Row of each query, in their order.
    cdef const int64_t[::1] rows
    # Place that is no neighbour of a query, by row; None for none.
    cdef const Py_ssize_t[::1] excluded
    # Queries are the tree's own points, and not among their neighbours.
    cdef bint exclude_self

    cdef void limit(self, Batch* batch, Query* query, Py_ssize_t i) noexcept nogil:
        cdef int64_t row = self.rows[i]
        if self.ranges.range_radius is not None:
            limit_range(query, self.ranges.range_radius[row])
        if self.ranges.half_range is not None:
            query.bounds.half_range = &self.ranges.half_range[row, 0]
        if self.excluded is not None:
            query.excluded = self.excluded[row]
        if self.exclude_self:
            query.excluded = i

    cdef void finish(self, Batch* batch, Py_ssize_t first, int thread) noexcept nogil:
        write_rows(self.tree, batch, &self.rows[first], self.table, thread)


cdef void write_rows(
    Tree tree, Batch* batch, const int64_t* rows, Table table, int thread
) noexcept nogil:
    """Write the neighbours of the queries of a batch to their rows of the table."""
    cdef Py_ssize_t i, j, count, k = table.id_rows.shape[1]
    for i in range(min(PREFETCH_DISTANCE, batch.n_queries)):
        prefetch_rows(table, rows[i])
    gather_neighbours(tree, batch)
    # Each step for all queries: reading what has just been written would stall.
    for i in range(batch.n_queries):
        sort_list(tree, batch, i, <Neighbour*> &table.scratch[thread, 0])
    for i in range(batch.n_queries):
        if i + PREFETCH_DISTANCE < batch.n_queries:
            prefetch_rows(table, rows[i + PREFETCH_DISTANCE])
        count = batch.queries[i].candidates.count
        tree.simd.write_neighbours(
            batch.sorted + i * batch.stride, batch.sorted_id + i * batch.stride, count,
            table.streaming and count == k,
            &table.distance_rows[rows[i], 0], &table.id_rows[rows[i], 0]
        )
        for j in range(count, k):
            table.id_rows[rows[i], j] = tree.n_points
            table.distance_rows[rows[i], j] = INFINITY
    if table.streaming:
        store_fence()


cdef inline void prefetch_rows(Table table, Py_ssize_t row) noexcept nogil:
    if table.streaming:
        return
    prefetch_row(&table.id_rows[row, 0], 8 * table.id_rows.shape[1])
    prefetch_row(&table.distance_rows[row, 0], 8 * table.id_rows.shape[1])


cdef void sort_list(Tree tree, Batch* batch, Py_ssize_t i, Neighbour* scratch) noexcept nogil:
    """Sort the neighbours of one query, nearest first."""
    cdef const Candidates* found = &batch.queries[i].candidates
    cdef const double* squared = batch.squared + i * batch.stride
    cdef const int64_t* ids = batch.id + i * batch.stride
    cdef double* sorted = batch.sorted + i * batch.stride
    cdef int64_t* sorted_id = batch.sorted_id + i * batch.stride
    cdef Py_ssize_t j
    if found.count <= KEY_CHUNK:
        tree.simd.sort_neighbours(
            squared, ids, found.count, found.squared_radius, sorted, sorted_id
        )
        return
    for j in range(found.count):
        scratch[j].squared = squared[j]
        scratch[j].id = ids[j]
    sort(scratch, scratch + found.count)
    for j in range(found.count):
        sorted[j] = scratch[j].squared
        sorted_id[j] = scratch[j].id


def query(
    Tree tree, const double[:, ::1] queries, const Py_ssize_t[::1] order, Py_ssize_t k, *,
    Ranges ranges, const Py_ssize_t[::1] excluded, int n_threads
):
    """Ids (m, k) and distances (m, k) of the k nearest of each query.

    Queries are answered in `order`, close ones in sequence. ``excluded[i]`` is the tree position
    of the point that is no neighbour of query i; None for none.
    """
    cdef Table table = Table(queries.shape[0], k, n_threads)
    cdef TableQuery work
    if tree.n_points == 0:
        table.ids[:] = 0
        table.distance[:] = np.inf
        return table.ids, table.distance
    work = TableQuery(tree, k=k, radius=INFINITY, range_radius=-1.0)
    work.ranges, work.table, work.excluded = ranges, table, excluded
    work.rows = np.asarray(order).view(np.int64)
    search_queries(work, queries, order, n_threads)
    return table.ids, table.distance


def query_self(
    Tree tree, Py_ssize_t k, *, Ranges ranges, bint exclude_self, int n_threads
):
    """Ids (n, k) and distances (n, k) of the k nearest of each of the tree's points."""
    cdef TableQuery work = TableQuery(tree, k=k, radius=INFINITY, range_radius=-1.0)
    cdef Table table = Table(tree.n_points, k, n_threads)
    work.ranges, work.table, work.excluded = ranges, table, None
    work.exclude_self = exclude_self
    work.rows = tree.ids
    search_points(work, 0, tree.n_points, n_threads)
    return table.ids, table.distance
