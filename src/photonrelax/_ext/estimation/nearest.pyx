"""Density estimates from the k nearest photons (Jensen; SJ13 §5)."""

from cython cimport final
from libc.math cimport M_PI

from ..common.prefetch cimport prefetch_row
from ..spatial.batch cimport Batch, Query
from ..spatial.query_loop cimport BatchWork, search_queries
from ..spatial.simd.kernels cimport (
    CONE_WEIGHTS, CONSTANT_WEIGHTS, EPANECHNIKOV_WEIGHTS, GAUSSIAN_WEIGHTS, OUTSIDE_KEY, Weights,
    farthest_candidate,
)
from ..spatial.tree cimport Tree

CONSTANT = CONSTANT_WEIGHTS
CONE = CONE_WEIGHTS
EPANECHNIKOV = EPANECHNIKOV_WEIGHTS
GAUSSIAN = GAUSSIAN_WEIGHTS


@final
cdef class NearestGather(BatchWork):
    """Weighted sums over the k nearest photons of each query."""

    # (n_blocks, c, 16), zero in lanes without a photon.
    cdef const double[:, :, ::1] values
    cdef int kernel
    cdef double kth_scale
    cdef const Py_ssize_t[::1] rows
    cdef double[:, ::1] out

    cdef void finish(self, Batch* batch, Py_ssize_t first, int thread) noexcept nogil:
        """Write the densities at the queries of a batch."""
        cdef Py_ssize_t i
        for i in range(first, first + batch.n_queries):
            prefetch_row(&self.out[self.rows[i], 0], 8 * self.out.shape[1])
        for i in range(batch.n_queries):
            self.write_densities(&batch.queries[i], &self.out[self.rows[first + i], 0])

    cdef void write_densities(self, Query* query, double* out) noexcept nogil:
        """Write the densities at one query from its neighbours.

        With k photons within the radius the bandwidth is the distance to the k-th, which does not
        count itself: the estimate is unbiased for independent photons, as the mean of 1/r² is
        π ρ/(k − 1). With fewer, or k at the query itself, the bandwidth is the radius and all
        neighbours count: of coincident photons no more than k are found, however many there are.
        """
        cdef Py_ssize_t farthest, channel, n_channels = self.values.shape[1]
        cdef double scale = 1.0
        cdef Weights weights
        weights.shape = self.kernel
        weights.squared_bandwidth = self.squared_radius
        if query.candidates.count == self.k and query.candidates.squared_radius > 0.0:
            farthest = farthest_candidate(&query.candidates, &self.tree.ids[0])
            query.candidates.rank_keys[farthest] = OUTSIDE_KEY
            weights.squared_bandwidth = query.candidates.squared_radius
            scale = self.kth_scale
        self.tree.simd.weighted_sum(
            &self.tree.coords[0, 0, 0], &query.bounds, &query.candidates, &weights,
            &self.values[0, 0, 0], n_channels, out
        )
        for channel in range(n_channels):
            out[channel] *= scale / (M_PI * weights.squared_bandwidth)


def gather(
    Tree tree, const double[:, :, ::1] values, const double[:, ::1] queries,
    const Py_ssize_t[::1] rows, double[:, ::1] out, *, Py_ssize_t k, int kernel, double radius,
    double range_radius, double kth_scale, int n_threads
):
    """Write densities around the queries named by `rows`, close ones in sequence, to `out`.

    Parameters
    ----------
    tree : Tree
    values : (n_blocks, c, 16) float64 array
        Values of the photons in tree order, zero in lanes without a photon.
    queries : (m, axes) float64 array
    rows : (r,) intp array
    out : (m, c) float64 array
        Rows of these queries are written.
    k : int
    kernel : int
        CONSTANT, CONE, EPANECHNIKOV or GAUSSIAN.
    radius : float
        Largest distance of a photon; may be infinite.
    range_radius : float
        Radius of the ball over the tree's range axes; negative for none.
    kth_scale : float
        Factor of estimates whose bandwidth is the distance to the k-th photon.
    """
    if not (
        queries.shape[0] == out.shape[0] and queries.shape[1] >= tree.n_axes
        and values.shape[0] == tree.n_blocks and values.shape[1] == out.shape[1]
    ):
        raise ValueError("queries, densities and photon values do not fit one another")
    cdef NearestGather work = NearestGather(tree, k=k, radius=radius, range_radius=range_radius)
    work.values = values
    work.kernel = kernel
    work.kth_scale = kth_scale
    work.rows = rows
    work.out = out
    search_queries(work, queries, rows, n_threads)
