"""Distances to the k-th nearest point, around queries or around a tree's own points."""

from cython cimport final
from libc.math cimport INFINITY, sqrt

import numpy as np

from .batch cimport Batch, Query, limit_range
from .query_loop cimport BatchWork, search_points, search_queries
from .tree cimport Tree


@final
cdef class KthDistance(BatchWork):
    """Writes the distances, by the order of the queries.

    Where fewer than k neighbours are found it is the distance to the farthest of these, or
    infinite.
    """

    cdef double[::1] distance
    cdef bint of_fewer

    cdef void finish(self, Batch* batch, Py_ssize_t first, int thread) noexcept nogil:
        cdef Py_ssize_t i
        for i in range(batch.n_queries):
            if self.of_fewer or batch.queries[i].candidates.count == self.k:
                self.distance[first + i] = sqrt(batch.queries[i].candidates.squared_radius)
            else:
                self.distance[first + i] = INFINITY


def of_queries(
    Tree tree, const double[:, ::1] queries, const Py_ssize_t[::1] order, *, Py_ssize_t k,
    double radius=INFINITY, double range_radius=-1.0, bint of_fewer=False, int n_threads
):
    """Distances (r,) to the k-th neighbour within a radius, of the queries named by `order`.

    Close queries should be in sequence. A negative `range_radius` leaves the tree's range axes
    open. Where fewer than k are found a distance is infinite, or with `of_fewer` that of the
    farthest, and zero without any.
    """
    if queries.shape[1] < tree.n_axes:
        raise ValueError("queries do not fit the tree")
    distance = np.full(order.shape[0], INFINITY)
    if k > tree.n_points and not of_fewer:
        return distance
    cdef KthDistance work = KthDistance(tree, k=k, radius=radius, range_radius=range_radius)
    work.distance = distance
    work.of_fewer = of_fewer
    search_queries(work, queries, order, n_threads)
    return distance


@final
cdef class FarthestOfPoints(BatchWork):
    """Writes the distances to the farthest neighbours, by the ids of a tree's own points.

    Where fewer than k are found it is that to the farthest of these, or infinite.
    """

    cdef double[::1] distance
    cdef bint of_fewer
    # By id; None for no limit.
    cdef const double[::1] range_radii

    cdef void limit(self, Batch* batch, Query* query, Py_ssize_t i) noexcept nogil:
        if self.range_radii is not None:
            limit_range(query, self.range_radii[self.tree.ids[i]])

    cdef void finish(self, Batch* batch, Py_ssize_t first, int thread) noexcept nogil:
        cdef Py_ssize_t i
        cdef double squared
        for i in range(batch.n_queries):
            squared = batch.queries[i].candidates.squared_radius
            if batch.queries[i].candidates.count < self.k and not self.of_fewer:
                squared = INFINITY
            self.distance[self.tree.ids[first + i]] = sqrt(squared)


def of_points(
    Tree tree, *, Py_ssize_t k, const double[::1] range_radii, bint of_fewer=True, int n_threads
):
    """Distances (n,) to the farthest of the k nearest around each of the tree's own points.

    `range_radii` (n,) are radii of the balls over the range axes, None for no limit. Where fewer
    than k are found a distance is that of the farthest of these, or infinite without `of_fewer`.
    """
    cdef FarthestOfPoints work = FarthestOfPoints(tree, k=k, radius=INFINITY, range_radius=-1.0)
    distance = np.empty(tree.n_points)
    work.distance = distance
    work.range_radii = range_radii
    work.of_fewer = of_fewer
    search_points(work, 0, tree.n_points, n_threads)
    return distance
