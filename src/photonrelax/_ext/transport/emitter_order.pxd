"""Order of paths along a curve over the emitter: Morton codes of emitter coordinates."""

from libc.math cimport INFINITY
from libc.stdint cimport int32_t, uint32_t

# Bits of a Morton code, from two axes, and number of codes.
cdef enum:
    AXIS_BITS = 7
    N_CODES = 1 << (2 * AXIS_BITS)


cdef inline uint32_t spread_bits(uint32_t cell) noexcept nogil:
    """Bits of a number below 256, with a zero above each."""
    cell = (cell | cell << 4) & 0x0F0F
    cell = (cell | cell << 2) & 0x3333
    return (cell | cell << 1) & 0x5555


cdef inline void write_codes(int32_t[::1] code, const double[:, ::1] coords) noexcept nogil:
    """Write Morton codes of coordinates (n, 3), over the two axes that they span most."""
    cdef double[3] low, high
    cdef double[2] scale
    cdef int[2] axes
    cdef Py_ssize_t i
    cdef int axis, k
    for axis in range(3):
        low[axis], high[axis] = INFINITY, -INFINITY
        for i in range(code.shape[0]):
            low[axis] = min(low[axis], coords[i, axis])
            high[axis] = max(high[axis], coords[i, axis])
        high[axis] -= low[axis]
    axis = 0 if high[0] <= min(high[1], high[2]) else 1 if high[1] <= high[2] else 2
    axes[0], axes[1] = (axis + 1) % 3, (axis + 2) % 3
    for k in range(2):
        scale[k] = ((1 << AXIS_BITS) - 0.5) / high[axes[k]] if high[axes[k]] > 0.0 else 0.0
    for i in range(code.shape[0]):
        code[i] = (
            spread_bits(<uint32_t> ((coords[i, axes[0]] - low[axes[0]]) * scale[0]))
            | spread_bits(<uint32_t> ((coords[i, axes[1]] - low[axes[1]]) * scale[1])) << 1
        )
