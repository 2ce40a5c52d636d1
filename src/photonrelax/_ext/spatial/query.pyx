# distutils: language = c++
"""Neighbour tables: ids and distances of the k nearest; see `photonrelax.KDTree`."""

from cython.parallel cimport prange, threadid
from libc.math cimport INFINITY, sqrt
from libc.stdint cimport int64_t

import numpy as np

from .batch cimport (
    Batch, Query, allocate_batches, gather_neighbours, limit_range, open_block, open_query,
)
from .tree cimport Tree
from .simd.kernels cimport BLOCK, KEY_CHUNK, LANES, Candidates, prefetch_row, store_fence
from .knn cimport query_batch

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


cdef void limit_ranges(Tree tree, Query* query, Ranges ranges, Py_ssize_t row) noexcept nogil:
    if ranges.range_radius is not None:
        limit_range(query, ranges.range_radius[row])
    if ranges.half_range is not None:
        query.bounds.half_range = &ranges.half_range[row, 0]


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

    Queries are answered in `order`, close ones in sequence. ``excluded[i]`` is the place of the
    point that is no neighbour of query i; None for none.
    """
    cdef Py_ssize_t n_batches = (queries.shape[0] + BLOCK - 1) // BLOCK
    cdef Table table = Table(queries.shape[0], k, n_threads)
    cdef unsigned char[:, ::1] batches = allocate_batches(tree, k, n_threads)
    cdef Py_ssize_t i
    if tree.n_points == 0:
        table.ids[:] = 0
        table.distance[:] = np.inf
        return table.ids, table.distance
    for i in prange(
        n_batches, nogil=True, schedule="dynamic", chunksize=16, num_threads=n_threads
    ):
        query_rows(
            tree, <Batch*> &batches[threadid(), 0], queries, order, i, ranges, excluded, table,
            threadid()
        )
    return table.ids, table.distance


cdef void query_rows(
    Tree tree, Batch* batch, const double[:, ::1] queries, const Py_ssize_t[::1] order,
    Py_ssize_t number, Ranges ranges, const Py_ssize_t[::1] excluded, Table table, int thread
) noexcept nogil:
    """Answer 16 consecutive queries; write their rows only."""
    cdef Py_ssize_t i, row
    cdef Query* query
    batch.n_queries = 0
    for i in range(BLOCK * number, min(BLOCK * number + BLOCK, queries.shape[0])):
        row = order[i]
        query = &batch.queries[batch.n_queries]
        open_query(tree, batch, &queries[row, 0])
        limit_ranges(tree, query, ranges, row)
        if excluded is not None:
            query.excluded = excluded[row]
    query_batch(tree, batch)
    write_rows(tree, batch, <const int64_t*> &order[BLOCK * number], table, thread)


def query_self(
    Tree tree, Py_ssize_t k, *, Ranges ranges, bint exclude_self, int n_threads
):
    """Ids (n, k) and distances (n, k) of the k nearest of each of the tree's points."""
    cdef Table table = Table(tree.n_points, k, n_threads)
    cdef unsigned char[:, ::1] batches = allocate_batches(tree, k, n_threads)
    cdef Py_ssize_t block
    for block in prange(
        tree.n_blocks, nogil=True, schedule="dynamic", chunksize=16, num_threads=n_threads
    ):
        query_block(
            tree, <Batch*> &batches[threadid(), 0], block, ranges, exclude_self, table, threadid()
        )
    return table.ids, table.distance


cdef void query_block(
    Tree tree, Batch* batch, Py_ssize_t block, Ranges ranges, bint exclude_self, Table table,
    int thread
) noexcept nogil:
    """Answer the points of a block; write their rows only."""
    cdef Py_ssize_t lane
    open_block(tree, batch, block)
    for lane in range(batch.n_queries):
        limit_ranges(tree, &batch.queries[lane], ranges, tree.ids[BLOCK * block + lane])
        if exclude_self:
            batch.queries[lane].excluded = BLOCK * block + lane
    query_batch(tree, batch)
    write_rows(tree, batch, &tree.ids[BLOCK * block], table, thread)


def farthest(Tree tree, Py_ssize_t k, *, Ranges ranges, int n_threads):
    """Distance (n,) to the farthest of the k nearest of each of the tree's points."""
    distance = np.empty(tree.n_points)
    cdef double[::1] distance_view = distance
    cdef unsigned char[:, ::1] batches = allocate_batches(tree, k, n_threads)
    cdef Py_ssize_t block
    for block in prange(
        tree.n_blocks, nogil=True, schedule="dynamic", chunksize=16, num_threads=n_threads
    ):
        farthest_of_block(tree, <Batch*> &batches[threadid(), 0], block, ranges, distance_view)
    return distance


cdef void farthest_of_block(
    Tree tree, Batch* batch, Py_ssize_t block, Ranges ranges, double[::1] distance
) noexcept nogil:
    """Answer the points of a block; write their rows only."""
    cdef Py_ssize_t lane
    open_block(tree, batch, block)
    for lane in range(batch.n_queries):
        limit_ranges(tree, &batch.queries[lane], ranges, tree.ids[BLOCK * block + lane])
    query_batch(tree, batch)
    for lane in range(batch.n_queries):
        distance[tree.ids[BLOCK * block + lane]] = sqrt(
            batch.queries[lane].candidates.squared_radius
        )
