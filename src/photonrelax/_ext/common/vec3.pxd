"""3-vectors: inline helpers shared by the kernels.

Vectors are pointers to three doubles; where a function writes, the target comes first.
"""

from libc.math cimport sqrt


cdef inline double dot(const double* a, const double* b) noexcept nogil:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


cdef inline void copy(double* out, const double* a) noexcept nogil:
    out[0] = a[0]
    out[1] = a[1]
    out[2] = a[2]


cdef inline void cross(double* out, const double* a, const double* b) noexcept nogil:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


cdef inline void normalise(double* a) noexcept nogil:
    cdef double scale = 1.0 / sqrt(dot(a, a))
    a[0] *= scale
    a[1] *= scale
    a[2] *= scale


cdef inline void orthonormal_frame(double* u, double* v, const double* n) noexcept nogil:
    """Write u, v so that (u, v, n) is right-handed, for a unit n (Duff et al. 2017)."""
    cdef double sign = 1.0 if n[2] >= 0.0 else -1.0
    cdef double a = -1.0 / (sign + n[2])
    cdef double b = n[0] * n[1] * a
    u[0] = 1.0 + sign * n[0] * n[0] * a
    u[1] = sign * b
    u[2] = -sign * n[0]
    v[0] = b
    v[1] = sign + n[1] * n[1] * a
    v[2] = -n[1]
