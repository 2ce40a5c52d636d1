"""Rays that are followed together, from one cast to the next."""

from libc.stdint cimport uint64_t

from .materials cimport Faults, Materials
from .raycast cimport EmbreeFrame, EmbreeHits, Triangles


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
    cdef void to_embree(
        self, Py_ssize_t row, const double* origin, const double* direction, const double* offset
    ) noexcept nogil
