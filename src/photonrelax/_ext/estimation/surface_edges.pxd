"""Edges of the surface around footprints."""

from libc.stdint cimport int32_t

from ..spatial.box_tree cimport BoxTree
from ..spatial.simd.kernels cimport Rectangle
from .surface_integrals cimport NearEdges


cdef class SurfaceEdges:
    cdef BoxTree tree
    cdef const double[:, :, ::1] segments
    cdef const double[:, ::1] normals
    cdef const unsigned char[::1] one_sided


cdef class EdgeSearch:
    cdef SurfaceEdges edges
    cdef readonly int n_threads
    # Rows per thread.
    cdef int32_t[:, ::1] found
    cdef double[:, ::1] ends

    cdef void find(
        self, const Rectangle* rectangle, double radius, int thread, NearEdges* near
    ) noexcept nogil


cdef void transform(NearEdges* near, const double* matrix) noexcept nogil
