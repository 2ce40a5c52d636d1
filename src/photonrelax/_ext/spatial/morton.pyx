# distutils: language = c++
"""Morton order (Z-order curve) of points.

A point's Morton code interleaves the bits of its cell's coordinates. Words of code and row number
are sorted by an LSD radix sort, which is stable.
"""

from cython.parallel cimport prange
from libc.float cimport DBL_MAX
from libc.stdint cimport UINT32_MAX, int64_t, uint32_t, uint64_t
from libc.string cimport memset

import numpy as np

from ..common.threads cimport Watch, check_signals, close_watch, open_watch, team_size

from .blocks import bounds

cdef enum:
    # Points of a thread, at least.
    GRAIN = 1 << 14
    KEY_BITS = 32
    DIGIT_BITS = 11
    N_DIGITS = 1 << DIGIT_BITS
    # Bits are spread by table, a byte at a time.
    BYTE = 256
    N_BYTES = 4

# Cell coordinates of smaller extents would overflow.
cdef double LEAST_EXTENT = 1e-290


cdef struct Axis:
    Py_ssize_t column
    double low
    # Cells per length.
    double scale
    int64_t last_cell
    int n_bytes
    uint32_t[N_BYTES * BYTE] spread


cdef struct Job:
    const double* points
    Py_ssize_t n_points
    Py_ssize_t n_columns
    Axis[KEY_BITS] axes
    int n_axes
    int n_threads


def morton_order(const double[:, ::1] points, int n_axes, int n_threads):
    """Rows of points in Morton order, in which consecutive points are close to each other.

    The grid of cells spans the bounding box of the points. The 32 bits of a code are divided among
    the axes: each next one halves the longest side of the cells, the first of equally long ones.
    Points of a cell keep their order.

    Parameters
    ----------
    points : (n, d) float array
        Coordinates, finite; n < 2**32.
    n_axes : int
        Number of axes of the grid, the first ones of `points`.
    n_threads : int
        Threads; the order does not depend on it.

    Returns
    -------
    (n,) intp array
        Rows of `points`.

    Raises
    ------
    ValueError
        If there are too many points, or fewer axes than `n_axes`.
    """
    cdef Py_ssize_t n = points.shape[0]
    if not 0 <= n_axes <= points.shape[1]:
        raise ValueError(f"n_axes should be from 0 to {points.shape[1]}, but is {n_axes}")
    if n > UINT32_MAX:
        raise ValueError(f"points should have at most {UINT32_MAX} rows, but have {n}")
    cdef Job job
    job.n_axes = 0
    job.n_points = n
    job.n_columns = points.shape[1]
    job.n_threads = team_size(n_threads, n, GRAIN)
    if n > 0 and n_axes > 0:
        job.points = &points[0, 0]
        low, high = bounds(points, n_axes, n_threads)
        assign_bits(&job, low, high)
    if job.n_axes == 0:
        return np.arange(n, dtype=np.intp)
    order = np.empty(n, np.intp)
    cdef Py_ssize_t[::1] words = order
    cdef uint64_t[::1] spare = np.empty(n, np.uint64)
    cdef Py_ssize_t[:, ::1] sizes = np.empty((job.n_threads, N_DIGITS), np.intp)
    cdef Watch watch = open_watch()
    with nogil:
        sort(&job, <uint64_t*> &words[0], &spare[0], &sizes[0, 0], &watch)
    close_watch(&watch)
    return order


# Cells

cdef Py_ssize_t range_start(const Job* job, int thread) noexcept nogil:
    return thread * job.n_points // job.n_threads


cdef object assign_bits(Job* job, low, high):
    """Divide the bits of the code among the axes."""
    with np.errstate(over="ignore"):
        extent = np.minimum(high - low, DBL_MAX)
    side = np.where(extent > LEAST_EXTENT, extent, 0.0)
    axis_of_bit = np.zeros(KEY_BITS, np.intp)
    if not side.any():
        return
    for bit in reversed(range(KEY_BITS)):
        axis_of_bit[bit] = np.argmax(side)
        side[axis_of_bit[bit]] /= 2.0
    for column in np.unique(axis_of_bit):
        write_axis(
            &job.axes[job.n_axes], column, np.flatnonzero(axis_of_bit == column), low[column],
            extent[column]
        )
        job.n_axes += 1


cdef object write_axis(
    Axis* axis, Py_ssize_t column, const Py_ssize_t[::1] bits, double low, double extent
):
    """Set up the table that spreads a coordinate's bits to the given bits of the code."""
    cdef int n_bits = <int> bits.shape[0]
    cdef int bit, byte, value
    axis.column = column
    axis.low = low
    axis.scale = <double> (<int64_t> 1 << n_bits) / extent
    axis.last_cell = (<int64_t> 1 << n_bits) - 1
    axis.n_bytes = (n_bits + 7) // 8
    memset(axis.spread, 0, sizeof(axis.spread))
    for bit in range(n_bits):
        byte = bit // 8
        for value in range(BYTE):
            if value >> (bit % 8) & 1:
                axis.spread[byte * BYTE + value] |= <uint32_t> 1 << bits[bit]


cdef void write_words(const Job* job, int thread, uint64_t* words) noexcept nogil:
    cdef Py_ssize_t i
    for i in range(range_start(job, thread), range_start(job, thread + 1)):
        words[i] = <uint64_t> key_of(job, job.points + i * job.n_columns) << 32 | <uint64_t> i


cdef inline uint32_t key_of(const Job* job, const double* point) noexcept nogil:
    cdef uint32_t key = 0
    cdef const Axis* axis
    cdef double position
    cdef int64_t cell
    cdef int number, byte
    for number in range(job.n_axes):
        axis = &job.axes[number]
        # The upper bound maps to one cell too far, or to infinity.
        position = (point[axis.column] - axis.low) * axis.scale
        cell = <int64_t> min(position, <double> axis.last_cell)
        for byte in range(axis.n_bytes):
            key |= axis.spread[byte * BYTE + (cell >> 8 * byte & BYTE - 1)]
    return key


# Sorting

cdef void sort(
    const Job* job, uint64_t* words, uint64_t* spare, Py_ssize_t* sizes, Watch* watch
) noexcept nogil:
    """Write the order to `words`; `sizes` has N_DIGITS counts per thread."""
    cdef uint64_t* source = spare
    cdef uint64_t* target = words
    cdef int thread, shift = 32
    for thread in prange(job.n_threads, num_threads=job.n_threads):
        write_words(job, thread, spare)
    while shift < 64 and check_signals(watch):
        for thread in prange(job.n_threads, num_threads=job.n_threads):
            count_digits(job, thread, source, shift, sizes + thread * N_DIGITS)
        if find_places(job, sizes):
            for thread in prange(job.n_threads, num_threads=job.n_threads):
                move_words(job, thread, source, shift, sizes + thread * N_DIGITS, target)
            source, target = target, source
        shift += DIGIT_BITS
    if watch.raised:
        return
    for thread in prange(job.n_threads, num_threads=job.n_threads):
        write_rows(job, thread, source, words)


cdef void count_digits(
    const Job* job, int thread, const uint64_t* words, int shift, Py_ssize_t* sizes
) noexcept nogil:
    cdef Py_ssize_t i
    memset(sizes, 0, N_DIGITS * sizeof(Py_ssize_t))
    for i in range(range_start(job, thread), range_start(job, thread + 1)):
        sizes[words[i] >> shift & N_DIGITS - 1] += 1


cdef bint find_places(const Job* job, Py_ssize_t* sizes) noexcept nogil:
    """Turn counts into each thread's first places; return False if all digits are equal."""
    cdef Py_ssize_t first, size, digit, place = 0
    cdef int thread
    for digit in range(N_DIGITS):
        first = place
        for thread in range(job.n_threads):
            size = sizes[thread * N_DIGITS + digit]
            sizes[thread * N_DIGITS + digit] = place
            place += size
        if place - first == job.n_points:
            return False
    return True


cdef void move_words(
    const Job* job, int thread, const uint64_t* words, int shift, Py_ssize_t* places,
    uint64_t* target
) noexcept nogil:
    cdef Py_ssize_t i, digit
    for i in range(range_start(job, thread), range_start(job, thread + 1)):
        digit = words[i] >> shift & N_DIGITS - 1
        target[places[digit]] = words[i]
        places[digit] += 1


cdef void write_rows(
    const Job* job, int thread, const uint64_t* words, uint64_t* rows
) noexcept nogil:
    cdef Py_ssize_t i
    for i in range(range_start(job, thread), range_start(job, thread + 1)):
        rows[i] = words[i] & UINT32_MAX
