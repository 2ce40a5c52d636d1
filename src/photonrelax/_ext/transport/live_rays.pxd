"""Rays that are followed together, from one cast to the next."""

from libc.math cimport isfinite
from libc.stdint cimport uint64_t

from .materials cimport Faults, Materials
from .raycast cimport EmbreeFrame, EmbreeHits, Triangles, ray_to_embree


cdef struct Passage:
    # A ray that is taken on, by pointers into it: its media become those beyond.
    const double* origin
    const double* direction
    uint64_t* media


cdef class LiveRays:
    cdef Materials materials
    cdef EmbreeFrame frame
    cdef Triangles triangles
    cdef object origin_array, direction_array
    cdef float[:, ::1] origins, directions
    cdef bint finite
    cdef readonly Py_ssize_t n_live
    # False if rays meet all surfaces that they hit.
    cdef readonly bint has_hidden
    cdef readonly Faults faults

    cdef Passage passage(self, Py_ssize_t row) noexcept nogil
    cdef bint pass_one(self, EmbreeHits found, Py_ssize_t row, double* position) noexcept nogil


cdef inline void to_embree(
    LiveRays rays, Py_ssize_t row, const double* origin, const double* direction,
    const double* offset,
) noexcept nogil:
    """Write a ray in embree's frame, from an origin on; `offset` moves it off a surface."""
    cdef double skipped = ray_to_embree(
        rays.frame, origin, direction, offset, &rays.origins[row, 0], &rays.directions[row, 0]
    )
    if not isfinite(skipped):
        rays.finite = False
