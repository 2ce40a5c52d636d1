"""Vectors scaled to unit length."""

from libc.float cimport DBL_MAX
from libc.math cimport fabs, sqrt

cdef enum:
    # Vectors handled by one thread at a time.
    GRAIN_SIZE = 8192


cdef inline Py_ssize_t n_grains(Py_ssize_t n) noexcept nogil:
    return (n + GRAIN_SIZE - 1) // GRAIN_SIZE


cdef inline bint to_unit(double* unit, const double* vector) noexcept nogil:
    """Write a vector scaled to unit length; return False if it is zero or not finite."""
    cdef double x = fabs(vector[0])
    cdef double y = fabs(vector[1])
    cdef double z = fabs(vector[2])
    cdef double largest = max(x, max(y, z))
    cdef double length
    if not (largest > 0.0 and x <= DBL_MAX and y <= DBL_MAX and z <= DBL_MAX):
        return False
    # Scaling by the largest component first keeps tiny and huge vectors from under- or overflowing.
    x = vector[0] / largest
    y = vector[1] / largest
    z = vector[2] / largest
    length = sqrt(x * x + y * y + z * z)
    unit[0] = x / length
    unit[1] = y / length
    unit[2] = z / length
    return True
