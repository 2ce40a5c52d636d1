"""Parts of density estimates over footprints that other kernels need."""

from .rectangle cimport Footprint

cdef enum:
    # Points of the polynomials that interpolate the table of integrals.
    STENCIL = 6

# Length of a side, in deviations, below which its profile is a series.
cdef double NARROW

cdef void set_series(double side, double* series) noexcept nogil
cdef double kernel_integral(
    const double[:, ::1] table, const Footprint* footprint, double radius
) noexcept nogil
