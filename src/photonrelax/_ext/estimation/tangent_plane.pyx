"""The photons and planes of tangent.pxd, and how far sites look around."""

from cython.parallel cimport prange, threadid
from libc.math cimport INFINITY, sqrt

import numpy as np

from ..spatial.batch cimport Batch, Query, allocate_batches, limit_radius, limit_range, open_query
from ..common.vec3 cimport orthonormal_frame
from ..spatial.tree cimport Tree
from ..spatial.simd.kernels cimport BLOCK
from ..spatial.knn cimport query_batch

from ..spatial.blocks import to_soa_blocks

# What the distance to the k-th photon is multiplied by: whether that photon itself, on the rim, is
# within must not hang on roundings, and an estimate from those within is unbiased without it.
cdef double WITHOUT_LAST = 1.0 - 1e-9


cdef class Sites:
    """Where something is estimated, and from how far around.

    Parameters
    ----------
    queries : (m, axes) float64 array
        On all axes of the tree, of which the first three are positions.
    normals : (m, 3) float64 array
        Unit normals.
    bandwidth : (m,) float64 array
        Positive; m.
    """

    def __init__(self, queries, normals, bandwidth):
        self.queries = queries
        self.normals = normals
        self.bandwidth = bandwidth
        if not (
            self.queries.shape[0] == self.normals.shape[0] == self.bandwidth.shape[0]
            and self.queries.shape[1] >= 3 and self.normals.shape[1] == 3
        ):
            raise ValueError("queries, normals and bandwidths do not fit one another")


cdef class Photons:
    """Photons of a tree, in its order.

    Parameters
    ----------
    tree : Tree
        Its first three axes are positions.
    rows : (n,) intp array
        Row of the photon at each place.
    towards : (m, 3) float64 array or None
        From the surface to where light came from; None projects along the normal of the plane.
    carried : (m, c) float64 array
        What is looked at of them: mean flux, and gradient (c = 4) if there is one yet.
    normal_range : float
        Radius of the ball over the tree's range axes; negative for none.
    unit : float
        Length, m, to the inverse cube of which, times that of flux, gradients are measured.
    """

    def __init__(self, tree, rows, towards, carried, *, normal_range, unit, n_threads):
        if len(rows) != tree.n_points or tree.n_metric != 3:
            raise ValueError("photons should have a row for each point of a tree in space")
        if towards is not None and towards.shape[1] != 3:
            raise ValueError(f"towards should have shape (m, 3), but has {towards.shape}")
        self.tree = tree
        self.towards = None if towards is None else to_soa_blocks(towards, rows, n_threads)
        self.carried = to_soa_blocks(carried, rows, n_threads)
        self.normal_range = normal_range
        self.unit = unit


cdef bint fit(Photons photons, Sites sites, Py_ssize_t n_columns):
    """Tell whether sites are on all axes of the photons' tree, and these carry enough."""
    return sites.queries.shape[1] >= photons.tree.n_axes and (
        photons.carried.shape[1] in (n_columns, 4)
    )


cdef void open_plane(Plane* plane, Photons photons, Sites sites, Py_ssize_t row) noexcept nogil:
    cdef double bandwidth = sites.bandwidth[row]
    cdef double wide = photons.normal_range
    cdef Py_ssize_t axis
    plane.at = &sites.queries[row, 0]
    orthonormal_frame(plane.frame, plane.frame + 3, &sites.normals[row, 0])
    for axis in range(3):
        plane.frame[6 + axis] = sites.normals[row, axis]
    plane.bandwidth = bandwidth
    plane.scale = 1.0 / bandwidth
    plane.towards = NULL if photons.towards is None else &photons.towards[0, 0, 0]
    plane.bounds.low = plane.bounds.high = plane.at
    plane.bounds.squared_limit = bandwidth * bandwidth
    plane.bounds.squared_range = wide * wide if wide >= 0.0 else -1.0
    plane.bounds.half_range = NULL
    plane.bounds.n_metric = photons.tree.n_metric
    plane.bounds.n_axes = photons.tree.n_axes


cdef class Search:
    """Queries of a tree, those of them named by `order`, and how far each looks.

    Queries that follow each other there should be near each other.
    """

    cdef Tree tree
    cdef const double[:, ::1] queries
    cdef const Py_ssize_t[::1] order
    cdef double[::1] radius
    cdef double normal_range

    def __init__(self, Tree tree, queries, order, radius, *, normal_range):
        self.tree = tree
        self.queries = queries
        self.order = order
        self.radius = radius
        self.normal_range = normal_range
        if self.queries.shape[0] != self.radius.shape[0] or self.queries.shape[1] < tree.n_axes:
            raise ValueError("queries do not fit the tree and the radii")


def bandwidths(
    Tree tree, const double[:, ::1] queries, const Py_ssize_t[::1] order, double[::1] radius, *,
    Py_ssize_t k, double normal_range, int n_threads
):
    """Lower radii to the distance of the k-th nearest photon, of the queries named by `order`.

    Where fewer than k are within the radius, or all are at the query, it stays.
    """
    cdef Py_ssize_t n_batches = (order.shape[0] + BLOCK - 1) // BLOCK
    cdef Search search = Search(tree, queries, order, radius, normal_range=normal_range)
    cdef unsigned char[:, ::1] batches
    cdef Py_ssize_t i
    if k > tree.n_points:
        return
    batches = allocate_batches(tree, k, n_threads)
    for i in prange(
        n_batches, nogil=True, schedule="dynamic", chunksize=16, num_threads=n_threads
    ):
        search_batch(search, <Batch*> &batches[threadid(), 0], BLOCK * i)
        lower_radii(search, <Batch*> &batches[threadid(), 0], BLOCK * i)


def farthest(
    Tree tree, const double[:, ::1] queries, Py_ssize_t k, *, double normal_range, int n_threads
):
    """Return the distance (m,) from each query to the farthest of its k nearest points.

    Of fewer where the tree has, or the ball over its range axes holds, no more; zero without any.
    Queries that follow each other should be near each other.
    """
    cdef Py_ssize_t i, n = queries.shape[0]
    cdef Py_ssize_t n_batches = (n + BLOCK - 1) // BLOCK
    cdef unsigned char[:, ::1] batches = allocate_batches(tree, k, n_threads)
    cdef double[::1] distance = np.full(n, INFINITY)
    cdef Search search = Search(tree, queries, np.arange(n), distance, normal_range=normal_range)
    for i in prange(
        n_batches, nogil=True, schedule="dynamic", chunksize=16, num_threads=n_threads
    ):
        search_batch(search, <Batch*> &batches[threadid(), 0], BLOCK * i)
        write_farthest(search, <Batch*> &batches[threadid(), 0], BLOCK * i)
    return distance.base


cdef void write_farthest(Search search, Batch* batch, Py_ssize_t first) noexcept nogil:
    """Write how far the farthest found are; write their rows only."""
    cdef Py_ssize_t i
    for i in range(batch.n_queries):
        search.radius[search.order[first + i]] = sqrt(batch.queries[i].candidates.squared_radius)


cdef void search_batch(Search search, Batch* batch, Py_ssize_t first) noexcept nogil:
    """Find the neighbours of 16 queries that follow each other, from `first` on."""
    cdef Py_ssize_t i, row
    cdef Query* query
    batch.n_queries = 0
    for i in range(first, min(first + BLOCK, search.order.shape[0])):
        row = search.order[i]
        query = &batch.queries[batch.n_queries]
        open_query(search.tree, batch, &search.queries[row, 0])
        limit_radius(query, search.radius[row] * search.radius[row])
        if search.normal_range >= 0.0:
            limit_range(query, search.normal_range)
    query_batch(search.tree, batch)


cdef void lower_radii(Search search, Batch* batch, Py_ssize_t first) noexcept nogil:
    """Lower the radii of queries that have found k, to the distance of the k-th."""
    cdef Py_ssize_t i
    cdef const Query* query
    for i in range(batch.n_queries):
        query = &batch.queries[i]
        if query.candidates.count == batch.k and query.candidates.squared_radius > 0.0:
            search.radius[search.order[first + i]] = WITHOUT_LAST * sqrt(
                query.candidates.squared_radius
            )
