"""Parts of density estimates over footprints that other kernels need."""

from .rectangle cimport Footprint

# Length of a side, in deviations, below which its profile is a series.
cdef double NARROW

cdef void set_series(double side, double* series) noexcept nogil
cdef double kernel_integral(
    const double[:, ::1] table, const Footprint* footprint, double radius
) noexcept nogil
