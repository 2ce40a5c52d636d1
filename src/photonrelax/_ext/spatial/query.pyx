# distutils: language = c++
"""Neighbours for those who ask for them by name; see `photonrelax.KDTree`."""

from cython.parallel cimport prange, threadid
from libc.math cimport INFINITY, sqrt
from libc.stdint cimport int64_t

import numpy as np

from .batch cimport Batch, Query, limit_range, list_neighbours, open_block, open_query, scratch
from .tree cimport Tree
from .simd.kernels cimport BLOCK, KEYS, LANES, Found, finish_writing, prefetch_row
from .knn cimport find

from .tree import aligned


cdef enum:
    # Rows to be written are brought into the cache so many ahead: they are all over the table.
    AHEAD = 2
    # Tables of at least so many bytes are written past the cache, which would lose them anyway.
    LARGE = 1 << 26


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
    """Limits over the range axes, a row a query, None for none; see `photonrelax.KDTree.query`."""

    cdef const double[:, ::1] half_range
    cdef const double[::1] range_radius

    def __init__(self, half_range, range_radius):
        self.half_range = half_range
        self.range_radius = range_radius


cdef class Table:
    """What searches find: ids and distances, a row a query, and room to sort in, a row a thread."""

    cdef readonly object ids
    cdef readonly object distance
    cdef int64_t[:, ::1] id_rows
    cdef double[:, ::1] distance_rows
    cdef unsigned char[:, ::1] room
    cdef bint past_cache

    def __init__(self, Py_ssize_t n_queries, Py_ssize_t k, int n_threads):
        self.ids = aligned((n_queries, k), np.int64)
        self.distance = aligned((n_queries, k))
        self.id_rows = self.ids
        self.distance_rows = self.distance
        self.past_cache = 8 * n_queries * k >= LARGE and k % LANES == 0
        n_sorted = k if k > KEYS else 0
        self.room = np.empty((n_threads, max(n_sorted * sizeof(Neighbour), 1)), dtype=np.uint8)


cdef void limit_ranges(Tree tree, Query* query, Ranges ranges, Py_ssize_t row) noexcept nogil:
    if ranges.range_radius is not None:
        limit_range(query, ranges.range_radius[row])
    if ranges.half_range is not None:
        query.reach.half_range = &ranges.half_range[row, 0]


cdef void write_rows(
    Tree tree, Batch* batch, const int64_t* rows, Table table, int thread
) noexcept nogil:
    """Write what the queries of a batch found to their rows of the table."""
    cdef Py_ssize_t i, j, count, k = table.id_rows.shape[1]
    for i in range(min(AHEAD, batch.n_queries)):
        prefetch_rows(table, rows[i])
    list_neighbours(tree, batch)
    # One after the other for all queries: what is sorted is best not read at once.
    for i in range(batch.n_queries):
        sort_list(tree, batch, i, <Neighbour*> &table.room[thread, 0])
    for i in range(batch.n_queries):
        if i + AHEAD < batch.n_queries:
            prefetch_rows(table, rows[i + AHEAD])
        count = batch.queries[i].found.count
        tree.lanes.write(
            batch.sorted + i * batch.stride, batch.sorted_id + i * batch.stride, count,
            table.past_cache and count == k,
            &table.distance_rows[rows[i], 0], &table.id_rows[rows[i], 0]
        )
        for j in range(count, k):
            table.id_rows[rows[i], j] = tree.n_points
            table.distance_rows[rows[i], j] = INFINITY
    if table.past_cache:
        finish_writing()


cdef inline void prefetch_rows(Table table, Py_ssize_t row) noexcept nogil:
    if table.past_cache:
        return
    prefetch_row(&table.id_rows[row, 0], 8 * table.id_rows.shape[1])
    prefetch_row(&table.distance_rows[row, 0], 8 * table.id_rows.shape[1])


cdef void sort_list(Tree tree, Batch* batch, Py_ssize_t i, Neighbour* room) noexcept nogil:
    """Sort what one query found, nearest first."""
    cdef const Found* found = &batch.queries[i].found
    cdef const double* squared = batch.squared + i * batch.stride
    cdef const int64_t* ids = batch.id + i * batch.stride
    cdef double* to = batch.sorted + i * batch.stride
    cdef int64_t* to_id = batch.sorted_id + i * batch.stride
    cdef Py_ssize_t j
    if found.count <= KEYS:
        tree.lanes.sort(squared, ids, found.count, found.squared_radius, to, to_id)
        return
    for j in range(found.count):
        room[j].squared = squared[j]
        room[j].id = ids[j]
    sort(room, room + found.count)
    for j in range(found.count):
        to[j] = room[j].squared
        to_id[j] = room[j].id


def query(
    Tree tree, const double[:, ::1] queries, const Py_ssize_t[::1] order, Py_ssize_t k, *,
    Ranges ranges, const Py_ssize_t[::1] excluded, int n_threads
):
    """Return ids (m, k) and distances (m, k) of the k nearest of each query.

    Queries are answered in `order`, in which near ones should follow each other. ``excluded[i]``
    is the place that query i is not to find; None for no such thing.
    """
    cdef Py_ssize_t n_batches = (queries.shape[0] + BLOCK - 1) // BLOCK
    cdef Table table = Table(queries.shape[0], k, n_threads)
    cdef unsigned char[:, ::1] room = scratch(tree, k, n_threads)
    cdef Py_ssize_t i
    if tree.n_points == 0:
        table.ids[:] = 0
        table.distance[:] = np.inf
        return table.ids, table.distance
    for i in prange(
        n_batches, nogil=True, schedule="dynamic", chunksize=16, num_threads=n_threads
    ):
        query_batch(
            tree, <Batch*> &room[threadid(), 0], queries, order, i, ranges, excluded, table,
            threadid()
        )
    return table.ids, table.distance


cdef void query_batch(
    Tree tree, Batch* batch, const double[:, ::1] queries, const Py_ssize_t[::1] order,
    Py_ssize_t number, Ranges ranges, const Py_ssize_t[::1] excluded, Table table, int thread
) noexcept nogil:
    """Answer 16 queries that follow each other; write their rows only."""
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
    find(tree, batch)
    write_rows(tree, batch, <const int64_t*> &order[BLOCK * number], table, thread)


def query_self(
    Tree tree, Py_ssize_t k, *, Ranges ranges, bint exclude_self, int n_threads
):
    """Return ids (n, k) and distances (n, k) of the k nearest of each of the tree's points."""
    cdef Table table = Table(tree.n_points, k, n_threads)
    cdef unsigned char[:, ::1] room = scratch(tree, k, n_threads)
    cdef Py_ssize_t block
    for block in prange(
        tree.n_blocks, nogil=True, schedule="dynamic", chunksize=16, num_threads=n_threads
    ):
        query_block(
            tree, <Batch*> &room[threadid(), 0], block, ranges, exclude_self, table, threadid()
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
    find(tree, batch)
    write_rows(tree, batch, &tree.ids[BLOCK * block], table, thread)


def farthest(Tree tree, Py_ssize_t k, *, Ranges ranges, int n_threads):
    """Return (n,) distances to the farthest of the k nearest of each of the tree's points."""
    distance = np.empty(tree.n_points)
    cdef double[::1] distance_view = distance
    cdef unsigned char[:, ::1] room = scratch(tree, k, n_threads)
    cdef Py_ssize_t block
    for block in prange(
        tree.n_blocks, nogil=True, schedule="dynamic", chunksize=16, num_threads=n_threads
    ):
        farthest_of_block(tree, <Batch*> &room[threadid(), 0], block, ranges, distance_view)
    return distance


cdef void farthest_of_block(
    Tree tree, Batch* batch, Py_ssize_t block, Ranges ranges, double[::1] distance
) noexcept nogil:
    """Search for the points of a block; write their rows only."""
    cdef Py_ssize_t lane
    open_block(tree, batch, block)
    for lane in range(batch.n_queries):
        limit_ranges(tree, &batch.queries[lane], ranges, tree.ids[BLOCK * block + lane])
    find(tree, batch)
    for lane in range(batch.n_queries):
        distance[tree.ids[BLOCK * block + lane]] = sqrt(batch.queries[lane].found.squared_radius)
