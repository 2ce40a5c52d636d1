"""Prefetch of rows of memory that are read or written soon."""

from libc.stdint cimport int64_t

cdef extern from *:
    """
    /* The empty statement keeps GCC from dropping calls of functions that only prefetch, which it
     * takes for pure. */
    static inline void prefetch_row(const void *row, int64_t n_bytes)
    {
        for (int64_t i = 0; i < n_bytes - 1; i += 64) __builtin_prefetch((const char *)row + i, 1);
        __builtin_prefetch((const char *)row + n_bytes - 1, 1);
        __asm__ volatile("");
    }
    """
    void prefetch_row(const void* row, int64_t n_bytes) noexcept nogil
