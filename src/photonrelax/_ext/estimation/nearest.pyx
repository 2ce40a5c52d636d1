"""Kernel estimates of densities on surfaces from the k nearest photons."""

from cython.parallel cimport prange, threadid
from libc.math cimport M_PI

from ..spatial.batch cimport Batch, Query, allocate_batches, limit_radius, limit_range, open_query
from ..spatial.tree cimport Tree
from ..spatial.simd.kernels cimport (
    BLOCK, CONE_WEIGHTS, CONSTANT_WEIGHTS, EPANECHNIKOV_WEIGHTS, OUTSIDE_KEY, Weights,
    farthest_candidate, prefetch_row,
)
from ..spatial.knn cimport query_batch

from ..spatial.blocks import to_soa_blocks

CONSTANT = CONSTANT_WEIGHTS
CONE = CONE_WEIGHTS
EPANECHNIKOV = EPANECHNIKOV_WEIGHTS


cdef class Gather:
    """Photons to gather from and how.

    Parameters
    ----------
    tree : Tree
    values : (m, c) float64 array
        What is summed.
    rows : (n,) intp array
        Row of the photon at each place of the tree.
    k : int
    kernel : int
        CONSTANT, CONE or EPANECHNIKOV.
    radius : float
        Photons farther away are not gathered; may be infinite.
    normal_range : float
        Radius of the ball over the tree's range axes; negative for none.
    nearest_scale : float
        What estimates are multiplied by whose bandwidth is the distance to the k-th photon.
    n_threads : int
        Threads that lay out the values.
    """

    cdef Tree tree
    # (n_blocks, c, 16), zero in lanes without a photon.
    cdef const double[:, :, ::1] values
    cdef readonly Py_ssize_t k
    cdef readonly int kernel
    cdef double nearest_scale
    cdef double radius
    cdef double normal_range

    def __init__(
        self, tree, values, rows, k, kernel, *, radius, normal_range, nearest_scale, n_threads
    ):
        if len(rows) != tree.n_points:
            raise ValueError("photons should have a row for each point of the tree")
        self.tree = tree
        self.values = to_soa_blocks(values, rows, n_threads)
        self.k = k
        self.kernel = kernel
        self.nearest_scale = nearest_scale
        self.radius = radius
        self.normal_range = normal_range

    def densities(
        self, const double[:, ::1] queries, const Py_ssize_t[::1] order, double[:, ::1] out,
        int n_threads
    ):
        """Write the values per area around the queries named by `order` to their rows of `out`.

        Queries that follow each other there should be near each other.
        """
        cdef Py_ssize_t n_batches = (order.shape[0] + BLOCK - 1) // BLOCK
        cdef unsigned char[:, ::1] batches = allocate_batches(self.tree, self.k, n_threads)
        cdef Py_ssize_t i
        if not (
            queries.shape[0] == out.shape[0] and queries.shape[1] >= self.tree.n_axes
            and out.shape[1] == self.values.shape[1]
        ):
            raise ValueError("queries, densities and what photons carry do not fit one another")
        for i in prange(
            n_batches, nogil=True, schedule="dynamic", chunksize=16, num_threads=n_threads
        ):
            gather_batch(self, <Batch*> &batches[threadid(), 0], queries, order, i, out)


cdef void gather_batch(
    Gather photons, Batch* batch, const double[:, ::1] queries, const Py_ssize_t[::1] order,
    Py_ssize_t number, double[:, ::1] out
) noexcept nogil:
    """Estimate the densities at 16 queries that follow each other; write their rows only."""
    cdef Py_ssize_t i
    cdef Query* query
    batch.n_queries = 0
    for i in range(BLOCK * number, min(BLOCK * number + BLOCK, order.shape[0])):
        query = &batch.queries[batch.n_queries]
        open_query(photons.tree, batch, &queries[order[i], 0])
        limit_radius(query, photons.radius * photons.radius)
        if photons.normal_range >= 0.0:
            limit_range(query, photons.normal_range)
    prefetch_queries(queries, order, BLOCK * number + BLOCK)
    query_batch(photons.tree, batch)
    for i in range(batch.n_queries):
        prefetch_row(&out[order[BLOCK * number + i], 0], 8 * out.shape[1])
    for i in range(batch.n_queries):
        gather_one(photons, &batch.queries[i], &out[order[BLOCK * number + i], 0])


cdef inline void prefetch_queries(
    const double[:, ::1] queries, const Py_ssize_t[::1] order, Py_ssize_t first
) noexcept nogil:
    """Have the queries of the next batch brought into the cache."""
    cdef Py_ssize_t i
    for i in range(first, min(first + BLOCK, order.shape[0])):
        prefetch_row(&queries[order[i], 0], 8 * queries.shape[1])


cdef void gather_one(Gather photons, Query* query, double* out) noexcept nogil:
    """Estimate the densities at one query from its neighbours.

    With k photons in reach the bandwidth is the distance to the k-th, whose own weight is zero;
    that makes the estimate unbiased for independent photons, as the mean of 1/r² is π ρ/(k − 1).
    With fewer, or k at the query itself, the bandwidth is the gather radius and all found count:
    of photons that share a place more are not looked for, as there may be any number.
    """
    cdef Py_ssize_t farthest, channel, n_channels = photons.values.shape[1]
    cdef double scale = 1.0
    cdef Weights weights
    weights.shape = photons.kernel
    weights.squared_bandwidth = photons.radius * photons.radius
    if query.candidates.count == photons.k and query.candidates.squared_radius > 0.0:
        farthest = farthest_candidate(&query.candidates, &photons.tree.ids[0])
        query.candidates.rank_keys[farthest] = OUTSIDE_KEY
        weights.squared_bandwidth = query.candidates.squared_radius
        scale = photons.nearest_scale
    photons.tree.simd.weighted_sum(
        &photons.tree.coords[0, 0, 0], &query.bounds, &query.candidates, &weights,
        &photons.values[0, 0, 0], n_channels, out
    )
    for channel in range(n_channels):
        out[channel] *= scale / (M_PI * weights.squared_bandwidth)
