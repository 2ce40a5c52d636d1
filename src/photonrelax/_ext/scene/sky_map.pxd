"""Directions by the radiance of a latitude-longitude map, for kernels that emit photons."""


cdef class SkyMap:
    # Shares of the light up to each row, and in each row up to each column.
    cdef const double[::1] rows
    cdef const double[:, ::1] columns

    cdef Py_ssize_t direction(self, double* out, double u, double v) noexcept nogil
    cdef Py_ssize_t texel(self, const double* direction) noexcept nogil
    cdef Py_ssize_t texel_beside(
        self, const double* direction, const double* edges, double a, double b
    ) noexcept nogil
    cdef bint holds(
        self, Py_ssize_t texel, const double* direction, const double* edges
    ) noexcept nogil
