"""Deposits of a batch of paths, on their way into the columns of a photon map."""

from libc.stdint cimport int32_t, int64_t


cdef struct Deposit:
    # As the columns, but for `throughput`, which is relative to the flux of a photon. `path` counts
    # from the first of the batch, and `block` blocks of the ledger.
    double[3] position
    double[3] normal
    double[3] wi
    double[3] throughput
    double path_length
    # nm; 0 of white light.
    double wavelength
    int64_t path_signature
    int32_t path, block, n_bounces, object_id


cdef class Deposits:
    cdef Py_ssize_t n, n_paths, capacity
    # Bytes: buffers of structured arrays take long to describe.
    cdef unsigned char[::1] memory
    cdef Deposit* rows
    cdef double[:, ::1] coords
    cdef double[::1] density
    # Of the next deposit of each path, in the order of the paths.
    cdef int32_t[::1] next_row

    cdef void clear(self, Py_ssize_t n_paths)
    cdef void reserve(self, Py_ssize_t n)
    cdef Deposit* add(self) noexcept nogil
    cdef void find_rows(self) noexcept nogil
