"""Copies of arrays into columns and into blocks of 16, and bounding boxes."""

from cython.parallel cimport prange

import numpy as np

from ..common.threads cimport team_size
from .simd.kernels cimport BLOCK

from .tree import aligned

cdef enum:
    # Rows of a column processed before those of the next; they fit the cache.
    GRAIN_SIZE = 1024
    # Rows, and blocks, of a thread, at least.
    ROWS_PER_THREAD = 1 << 14
    BLOCKS_PER_THREAD = ROWS_PER_THREAD // BLOCK


def copy_scaled_rows(
    double[:, ::1] target, Py_ssize_t first, const double[:, ::1] source,
    const Py_ssize_t[::1] rows, *, double scale, int n_threads
):
    """Copy `rows` of `source`, or all, times `scale` to columns of `target` from `first` on."""
    cdef Py_ssize_t i, row
    if target.shape[0] != (source.shape[0] if rows is None else rows.shape[0]):
        raise ValueError("rows do not fit the target")
    if first < 0 or first + source.shape[1] > target.shape[1]:
        raise ValueError("columns do not fit the target")
    for i in prange(
        target.shape[0], nogil=True, schedule="static",
        num_threads=team_size(n_threads, target.shape[0], ROWS_PER_THREAD)
    ):
        row = i if rows is None else rows[i]
        copy_row(&target[i, first], &source[row, 0], source.shape[1], scale)


cdef inline void copy_row(
    double* target, const double* source, Py_ssize_t n, double scale
) noexcept nogil:
    cdef Py_ssize_t column
    for column in range(n):
        target[column] = scale * source[column]


def bounds(const double[:, ::1] points, Py_ssize_t n_axes, int n_threads):
    """Bounding box of points on their first axes: lower and upper bounds (n_axes,).

    Infinity and minus infinity if there are no points.
    """
    if not 0 <= n_axes <= points.shape[1]:
        raise ValueError(f"n_axes should be from 0 to {points.shape[1]}, but is {n_axes}")
    cdef int thread, team = team_size(n_threads, points.shape[0], ROWS_PER_THREAD)
    cdef double[:, ::1] low = np.full((team, n_axes), np.inf)
    cdef double[:, ::1] high = np.full((team, n_axes), -np.inf)
    for thread in prange(team, nogil=True, num_threads=team):
        bound_range(points, n_axes, thread, team, low, high)
    return np.min(low, axis=0), np.max(high, axis=0)


cdef void bound_range(
    const double[:, ::1] points, Py_ssize_t n_axes, int thread, int n_threads,
    double[:, ::1] low, double[:, ::1] high
) noexcept nogil:
    """Bounding box of a thread's range of the points; writes its row only."""
    cdef Py_ssize_t first = thread * points.shape[0] // n_threads
    cdef Py_ssize_t end = (thread + 1) * points.shape[0] // n_threads
    cdef Py_ssize_t axis
    while first < end:
        for axis in range(n_axes):
            bound_grain(
                points, axis, first, min(first + GRAIN_SIZE, end), &low[thread, axis],
                &high[thread, axis]
            )
        first += GRAIN_SIZE


cdef inline void bound_grain(
    const double[:, ::1] points, Py_ssize_t axis, Py_ssize_t first, Py_ssize_t end, double* low,
    double* high
) noexcept nogil:
    """Widen bounds; stored once, as another thread's are on the same cache line."""
    cdef double least = low[0], greatest = high[0]
    cdef Py_ssize_t i
    for i in range(first, end):
        least = min(least, points[i, axis])
        greatest = max(greatest, points[i, axis])
    low[0] = least
    high[0] = greatest


def to_soa_blocks(const double[:, ::1] values, const Py_ssize_t[::1] rows, int n_threads):
    """Values (m, c) of rows (n,) in blocks, (ceil(n / 16), c, 16), zero where there are none."""
    cdef Py_ssize_t n_blocks = (rows.shape[0] + BLOCK - 1) // BLOCK
    cdef Py_ssize_t block
    out = aligned((n_blocks, values.shape[1], BLOCK))
    cdef double[:, :, ::1] blocks = out
    for block in prange(
        n_blocks, nogil=True, schedule="static",
        num_threads=team_size(n_threads, n_blocks, BLOCKS_PER_THREAD)
    ):
        fill_block(values, rows, block, blocks)
    return out


cdef void fill_block(
    const double[:, ::1] values, const Py_ssize_t[::1] rows, Py_ssize_t block,
    double[:, :, ::1] blocks
) noexcept nogil:
    cdef Py_ssize_t lane, channel
    cdef Py_ssize_t n = min(rows.shape[0] - BLOCK * block, <Py_ssize_t> BLOCK)
    for channel in range(values.shape[1]):
        for lane in range(n):
            blocks[block, channel, lane] = values[rows[BLOCK * block + lane], channel]
        for lane in range(n, BLOCK):
            blocks[block, channel, lane] = 0.0
