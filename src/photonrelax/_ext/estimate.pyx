"""Kernel estimates of densities on surfaces from the k nearest photons."""

from cython.parallel cimport prange, threadid
from libc.math cimport M_PI, sqrt
from libc.stdint cimport int64_t

from .batch cimport Batch, Query, limit_radius, limit_range, list_places, open_query, scratch
from .kdtree cimport Tree
from .lanes cimport BLOCK
from .search cimport find

cpdef enum:
    CONSTANT = 0
    CONE = 1
    EPANECHNIKOV = 2


cdef class Gather:
    """Photons to gather from and how.

    Parameters
    ----------
    tree : Tree
    values : (n, c) float64 array
        What is summed, in the tree's leaf order.
    k : int
    kernel : int
        CONSTANT, CONE or EPANECHNIKOV.
    radius : float
        Photons farther away are not gathered; may be infinite.
    normal_range : float
        Radius of the ball over the tree's range axes; negative for none.
    nearest_scale : float
        What estimates are multiplied by whose bandwidth is the distance to the k-th photon.
    """

    cdef Tree tree
    cdef const double[:, ::1] values
    cdef readonly Py_ssize_t k
    cdef readonly int kernel
    cdef double nearest_scale
    cdef double radius
    cdef double normal_range

    def __init__(self, tree, values, k, kernel, *, radius, normal_range, nearest_scale):
        self.tree = tree
        self.values = values
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
        cdef unsigned char[:, ::1] room = scratch(self.tree, self.k, n_threads)
        cdef Py_ssize_t i
        for i in prange(
            n_batches, nogil=True, schedule="dynamic", chunksize=16, num_threads=n_threads
        ):
            gather_batch(self, <Batch*> &room[threadid(), 0], queries, order, i, out)


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
    find(photons.tree, batch)
    list_places(photons.tree, batch)
    for i in range(batch.n_queries):
        gather_one(photons, batch, i, &out[order[BLOCK * number + i], 0])


cdef void gather_one(
    Gather photons, const Batch* batch, Py_ssize_t i, double* out
) noexcept nogil:
    """Estimate the densities at one query from its neighbours.

    With k photons in reach the bandwidth is the distance to the k-th, whose own weight is zero;
    that makes the estimate unbiased for independent photons, as the mean of 1/r² is π ρ/(k − 1).
    With fewer, or all of them at the query itself, the bandwidth is the gather radius and all
    count.
    """
    cdef const Query* query = &batch.queries[i]
    cdef const double* squared = batch.squared + i * batch.stride
    cdef const int64_t* place = batch.place + i * batch.stride
    cdef double squared_bandwidth = photons.radius * photons.radius
    cdef double scale = 1.0
    cdef double weight
    cdef int64_t j, channel, left_out = -1, n_channels = photons.values.shape[1]
    if query.found.count == photons.k and query.found.squared_radius > 0.0:
        left_out = farthest(photons.tree, query, squared, place)
        squared_bandwidth = query.found.squared_radius
        scale = photons.nearest_scale
    for channel in range(n_channels):
        out[channel] = 0.0
    for j in range(query.found.count):
        if j == left_out:
            continue
        weight = scale * kernel_weight(photons.kernel, squared[j] / squared_bandwidth)
        for channel in range(n_channels):
            out[channel] += weight * photons.values[place[j], channel]
    for channel in range(n_channels):
        out[channel] /= M_PI * squared_bandwidth


cdef int64_t farthest(
    Tree tree, const Query* query, const double* squared, const int64_t* place
) noexcept nogil:
    """Return which neighbour in the list is the k-th: the farthest, of several the highest id."""
    cdef int64_t j, last = -1
    for j in range(query.found.count):
        if squared[j] == query.found.squared_radius and (
            last < 0 or tree.ids[place[j]] > tree.ids[place[last]]
        ):
            last = j
    return last


cdef inline double kernel_weight(int kernel, double squared_ratio) noexcept nogil:
    """Return π h² times the kernel at (distance / bandwidth h)²; it integrates to one."""
    if kernel == EPANECHNIKOV:
        return 2.0 * (1.0 - squared_ratio)
    if kernel == CONE:
        return 3.0 * (1.0 - sqrt(squared_ratio))
    return 1.0
