"""Texels of textures: squares of one colour."""

from libc.math cimport floor
from libc.stdint cimport uint8_t


# Wrap modes.
cdef enum:
    REPEAT = 0
    MIRROR = 1
    CLAMP = 2


cdef struct TextureView:
    # Texels (height, width, 3), row 0 on top: bytes, with their meaning (256,), or floats where
    # there are none. `uv` (faces, 3, 2) are the texture coordinates of corners, v up.
    const uint8_t* bytes
    const float* floats
    const double* meaning
    const double* uv
    double[3] factor
    Py_ssize_t height, width
    int wrap_u, wrap_v


cdef inline Py_ssize_t wrapped(double i, Py_ssize_t n, int wrap) noexcept nogil:
    """Index of a texel below n, of one of any number i, a whole one."""
    cdef double period = n if wrap == REPEAT else 2.0 * n
    cdef Py_ssize_t rest
    if wrap == CLAMP:
        return <Py_ssize_t>min(max(i, 0.0), n - 1.0)
    rest = <Py_ssize_t>(i - period * floor(i / period))
    # Rounding may reach the period.
    if rest >= <Py_ssize_t>period:
        rest = 0
    return rest if rest < n else 2 * n - 1 - rest


cdef inline void add_texel(
    double* out, const TextureView* view, Py_ssize_t row, Py_ssize_t column, double weight
) noexcept nogil:
    """Add a texel, without the factor, times a weight."""
    cdef Py_ssize_t at = 3 * (row * view.width + column)
    cdef int c
    for c in range(3):
        if view.bytes:
            out[c] += weight * view.meaning[view.bytes[at + c]]
        else:
            out[c] += weight * view.floats[at + c]


cdef inline void colour_at(
    double* out, const TextureView* view, Py_ssize_t face, double a, double b
) noexcept nogil:
    """Colour at barycentric coordinates of the second and third corner of a face."""
    cdef const double* uv = view.uv + 6 * face
    cdef double u = uv[0] + a * (uv[2] - uv[0]) + b * (uv[4] - uv[0])
    cdef double v = uv[1] + a * (uv[3] - uv[1]) + b * (uv[5] - uv[1])
    cdef int c
    for c in range(3):
        out[c] = 0.0
    add_texel(
        out, view, wrapped(floor((1.0 - v) * view.height), view.height, view.wrap_v),
        wrapped(floor(u * view.width), view.width, view.wrap_u), 1.0,
    )
    for c in range(3):
        out[c] *= view.factor[c]
