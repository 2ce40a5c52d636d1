"""Hit points: how far they gather at first, and how passes of photons narrow that."""

from cython.parallel cimport prange, threadid
from libc.math cimport sqrt
from libc.stdint cimport int64_t

from ..spatial.batch cimport Batch, Query, allocate_batches, limit_radius, limit_range, open_query
from ..spatial.tree cimport Tree
from ..spatial.simd.kernels cimport BLOCK
from ..spatial.knn cimport query_batch


def kth_distance(
    Tree tree, const double[:, ::1] queries, const Py_ssize_t[::1] order, Py_ssize_t k, *,
    double radius, double normal_range, double[::1] out, int n_threads
):
    """Write the distance to the k-th point around the queries named by `order` to their rows.

    Where fewer are within `radius` it is that. Queries that follow each other in `order` should
    be near each other; a negative `normal_range` leaves the tree's range axes open.
    """
    cdef Py_ssize_t n_batches = (order.shape[0] + BLOCK - 1) // BLOCK
    if not (
        queries.shape[0] == out.shape[0] >= order.shape[0]
        and queries.shape[1] >= tree.n_metric
        and (normal_range < 0.0 or queries.shape[1] == tree.n_axes)
    ):
        raise ValueError("queries, their order and distances do not fit one another")
    cdef unsigned char[:, ::1] batches = allocate_batches(tree, k, n_threads)
    cdef Py_ssize_t i
    for i in prange(
        n_batches, nogil=True, schedule="dynamic", chunksize=16, num_threads=n_threads
    ):
        reach_batch(
            tree, <Batch*> &batches[threadid(), 0], queries, order, i, k, radius, normal_range, out
        )


cdef void reach_batch(
    Tree tree, Batch* batch, const double[:, ::1] queries, const Py_ssize_t[::1] order,
    Py_ssize_t number, Py_ssize_t k, double radius, double normal_range, double[::1] out
) noexcept nogil:
    """Search around 16 queries that follow each other; write their rows only."""
    cdef Py_ssize_t i
    cdef Query* query
    batch.n_queries = 0
    for i in range(BLOCK * number, min(BLOCK * number + BLOCK, order.shape[0])):
        query = &batch.queries[batch.n_queries]
        open_query(tree, batch, &queries[order[i], 0])
        limit_radius(query, radius * radius)
        if normal_range >= 0.0:
            limit_range(query, normal_range)
    query_batch(tree, batch)
    for i in range(batch.n_queries):
        query = &batch.queries[i]
        out[order[BLOCK * number + i]] = (
            sqrt(query.candidates.squared_radius) if query.candidates.count == k else radius
        )


def update(
    double[::1] n, double[:, ::1] tau, double[::1] radius, *,
    const int64_t[::1] counts, const double[:, ::1] sums, const double[::1] least,
    double alpha, double weight, int n_threads
):
    """Count in what a pass found within the radii, and narrow these, in place.

    A row a hit point: photons counted, sums not divided by numbers emitted, radii; numbers and
    sums found, the sums to be multiplied by `weight`; radii not to go below, None for zero.
    """
    cdef Py_ssize_t i
    if not (
        n.shape[0] == tau.shape[0] == radius.shape[0] == counts.shape[0] == sums.shape[0]
        and tau.shape[1] == sums.shape[1] and (least is None or least.shape[0] == n.shape[0])
    ):
        raise ValueError("numbers, sums and radii do not fit one another")
    for i in prange(n.shape[0], nogil=True, schedule="static", num_threads=n_threads):
        if counts[i] > 0:
            update_one(i, n, tau, radius, counts[i], sums, least, alpha, weight)


cdef void update_one(
    Py_ssize_t row, double[::1] n, double[:, ::1] tau, double[::1] radius, int64_t found,
    const double[:, ::1] sums, const double[::1] least, double alpha, double weight
) noexcept nogil:
    """Narrow the disc of one hit point; write its row only."""
    cdef double share = (n[row] + alpha * found) / (n[row] + found)
    cdef double floor
    cdef Py_ssize_t channel
    if least is not None:
        floor = least[row] / radius[row]
        share = max(share, min(floor * floor, 1.0))
    n[row] = (n[row] + found) * share
    for channel in range(tau.shape[1]):
        tau[row, channel] = (tau[row, channel] + weight * sums[row, channel]) * share
    radius[row] *= sqrt(share)
