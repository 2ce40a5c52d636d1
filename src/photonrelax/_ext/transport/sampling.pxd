"""Halton numbers and area-preserving maps, as inline functions for kernels.

Every map of the unit square, or of the unit disk, to its target has constant density (cosine
density for the hemisphere) and little distortion, so evenly spaced points stay evenly spaced.
"""

from libc.math cimport M_PI, M_PI_2, M_PI_4, cos, fabs, sin, sqrt
from libc.stdint cimport uint64_t

cdef extern from *:
    """
    /* Three ternary digits in reverse. */
    static const unsigned char mirrored_digits[27] = {
        0, 9, 18, 3, 12, 21, 6, 15, 24, 1, 10, 19, 4, 13, 22, 7, 16, 25, 2, 11, 20, 5, 14, 23, 8,
        17, 26
    };
    """
    const unsigned char[27] mirrored_digits


cdef inline double radical_inverse_2(uint64_t index) noexcept nogil:
    """Van der Corput number in base 2: the bits of the index mirrored at the binary point."""
    cdef uint64_t z = index
    z = ((z >> 1) & <uint64_t>0x5555555555555555) | ((z & <uint64_t>0x5555555555555555) << 1)
    z = ((z >> 2) & <uint64_t>0x3333333333333333) | ((z & <uint64_t>0x3333333333333333) << 2)
    z = ((z >> 4) & <uint64_t>0x0F0F0F0F0F0F0F0F) | ((z & <uint64_t>0x0F0F0F0F0F0F0F0F) << 4)
    z = ((z >> 8) & <uint64_t>0x00FF00FF00FF00FF) | ((z & <uint64_t>0x00FF00FF00FF00FF) << 8)
    z = ((z >> 16) & <uint64_t>0x0000FFFF0000FFFF) | ((z & <uint64_t>0x0000FFFF0000FFFF) << 16)
    z = (z >> 32) | (z << 32)
    return (z >> 11) * (1.0 / 9007199254740992.0)


cdef inline double radical_inverse_3(uint64_t index) noexcept nogil:
    """Van der Corput number in base 3; exact for indices below 3^33."""
    cdef uint64_t mirrored = 0, scale = 1, rest
    while index >= 27:
        rest = index // 27
        mirrored = 27 * mirrored + mirrored_digits[index - 27 * rest]
        scale *= 27
        index = rest
    while index > 0:
        rest = index // 3
        mirrored = 3 * mirrored + (index - 3 * rest)
        scale *= 3
        index = rest
    return <double>mirrored / <double>scale


cdef inline double radical_inverse(uint64_t index, int base) noexcept nogil:
    """Van der Corput number in a base; exact for indices below 2^53 over the base."""
    cdef uint64_t mirrored = 0, scale = 1
    while index > 0:
        mirrored = base * mirrored + index % base
        scale *= base
        index //= base
    return <double>mirrored / <double>scale


cdef inline double wrapped(double x, double shift) noexcept nogil:
    """Sum of two numbers in [0, 1), modulo one."""
    x += shift
    return x - 1.0 if x >= 1.0 else x


cdef inline void disk_point(double* out, double u, double v) noexcept nogil:
    """Concentric map of the unit square to the unit disk (Shirley & Chiu 1997)."""
    cdef double a = 2.0 * u - 1.0, b = 2.0 * v - 1.0, angle
    if fabs(a) > fabs(b):
        angle = M_PI_4 * (b / a)
    elif b != 0.0:
        angle = M_PI_2 - M_PI_4 * (a / b)
        a = b
    else:
        angle = 0.0
    out[0] = a * cos(angle)
    out[1] = a * sin(angle)


cdef inline void cap_direction(double* out, const double* p, double one_minus_cos) noexcept nogil:
    """Equal-area map of the unit disk to the directions around z (Lambert's azimuthal)."""
    cdef double drop = one_minus_cos * (p[0] * p[0] + p[1] * p[1])
    cdef double stretch = sqrt(one_minus_cos * (2.0 - drop)) if drop < 2.0 else 0.0
    out[0] = stretch * p[0]
    out[1] = stretch * p[1]
    out[2] = 1.0 - drop


cdef inline void hemisphere_direction(double* out, const double* p) noexcept nogil:
    """Lift a point of the unit disk to the hemisphere: uniform there, cosine density here."""
    cdef double rest = 1.0 - p[0] * p[0] - p[1] * p[1]
    out[0] = p[0]
    out[1] = p[1]
    out[2] = sqrt(rest) if rest > 0.0 else 0.0


cdef inline void sphere_direction(double* out, double u, double v) noexcept nogil:
    """Equal-area octahedral map (Clarberg 2008): the inner diamond is the upper hemisphere."""
    cdef double a = 2.0 * u - 1.0, b = 2.0 * v - 1.0
    cdef double x = fabs(a), y = fabs(b)
    cdef double above = 1.0 - (x + y)
    cdef double r = 1.0 - fabs(above)
    cdef double angle = M_PI_4 * ((y - x) / r + 1.0) if r > 0.0 else 0.0
    cdef double stretch = r * sqrt(2.0 - r * r)
    out[0] = stretch * cos(angle) * (1.0 if a >= 0.0 else -1.0)
    out[1] = stretch * sin(angle) * (1.0 if b >= 0.0 else -1.0)
    out[2] = (1.0 - r * r) * (1.0 if above >= 0.0 else -1.0)
