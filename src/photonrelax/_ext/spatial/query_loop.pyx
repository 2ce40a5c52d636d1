"""The loop of query_loop.pxd."""

from cython.parallel cimport prange, threadid

from ..common.prefetch cimport prefetch_row
from ..common.threads cimport Watch, close_watch, goes_on, open_watch, team_size
from .batch cimport allocate_batches, limit_radius, limit_range, open_block, open_query
from .knn cimport query_batch
from .simd.kernels cimport BLOCK

cdef enum:
    # Batches that a thread takes at a time.
    GRAIN = 16


cdef class BatchWork:
    """Work on the k nearest points of each of many queries.

    Parameters
    ----------
    tree : Tree
    k : int
    radius : float
        Largest distance of a neighbour; may be infinite.
    range_radius : float
        Radius of the ball over the tree's range axes; negative for none.
    """

    def __init__(self, Tree tree, *, Py_ssize_t k, double radius, double range_radius):
        self.tree = tree
        self.k = k
        self.squared_radius = radius * radius
        self.range_radius = range_radius

    cdef bint skips(self, Py_ssize_t first) noexcept nogil:
        """True if the points of the tree from `first` on, of a block, are not searched around."""
        return False

    cdef void limit(self, Batch* batch, Query* query, Py_ssize_t i) noexcept nogil:
        """Limit query i, counted in their order, before its batch is searched."""
        limit_radius(query, self.squared_radius)
        if self.range_radius >= 0.0:
            limit_range(query, self.range_radius)

    cdef void finish(self, Batch* batch, Py_ssize_t first, int thread) noexcept nogil:
        """Work on the neighbours of a batch, whose queries are `first` and those that follow."""


cdef int search_queries(
    BatchWork work, const double[:, ::1] queries, const Py_ssize_t[::1] order, int n_threads
) except -1:
    """Search around the queries named by `order`, close ones in sequence."""
    cdef Py_ssize_t n_batches = (order.shape[0] + BLOCK - 1) // BLOCK
    cdef unsigned char[:, ::1] batches = allocate_batches(work.tree, work.k, n_threads)
    cdef Watch watch = open_watch()
    cdef Py_ssize_t i
    for i in prange(
        n_batches, nogil=True, schedule="dynamic", chunksize=GRAIN,
        num_threads=team_size(n_threads, n_batches, GRAIN)
    ):
        if goes_on(&watch, threadid() == 0):
            search_batch(
                work, <Batch*> &batches[threadid(), 0], queries, order, BLOCK * i, threadid()
            )
    return close_watch(&watch)


cdef void search_batch(
    BatchWork work, Batch* batch, const double[:, ::1] queries, const Py_ssize_t[::1] order,
    Py_ssize_t first, int thread
) noexcept nogil:
    """Search around `first` of the queries and those that follow, up to 16."""
    cdef Py_ssize_t i, end = min(first + BLOCK, order.shape[0])
    batch.n_queries = 0
    for i in range(first, end):
        open_query(work.tree, batch, &queries[order[i], 0])
        work.limit(batch, &batch.queries[i - first], i)
    # Those of the next batch.
    for i in range(end, min(end + BLOCK, order.shape[0])):
        prefetch_row(&queries[order[i], 0], 8 * queries.shape[1])
    query_batch(work.tree, batch)
    work.finish(batch, first, thread)


cdef int search_points(
    BatchWork work, Py_ssize_t first, Py_ssize_t end, int n_threads
) except -1:
    """Search around the tree's own points at tree positions first … end, whole blocks."""
    cdef unsigned char[:, ::1] batches = allocate_batches(work.tree, work.k, n_threads)
    cdef Watch watch = open_watch()
    cdef Py_ssize_t first_block = first // BLOCK
    cdef Py_ssize_t end_block = (end + BLOCK - 1) // BLOCK
    cdef Py_ssize_t block
    for block in prange(
        first_block, end_block, nogil=True, schedule="dynamic", chunksize=GRAIN,
        num_threads=team_size(n_threads, end_block - first_block, GRAIN)
    ):
        if goes_on(&watch, threadid() == 0):
            search_block(work, <Batch*> &batches[threadid(), 0], block, threadid())
    return close_watch(&watch)


cdef void search_block(
    BatchWork work, Batch* batch, Py_ssize_t block, int thread
) noexcept nogil:
    """Search around the points of a block."""
    cdef Py_ssize_t lane
    if work.skips(BLOCK * block):
        return
    open_block(work.tree, batch, block)
    for lane in range(batch.n_queries):
        work.limit(batch, &batch.queries[lane], BLOCK * block + lane)
    query_batch(work.tree, batch)
    work.finish(batch, BLOCK * block, thread)
