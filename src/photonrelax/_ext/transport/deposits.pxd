"""Deposits of a batch of paths, on their way into the columns of a photon map."""

from libc.stdint cimport int32_t, int64_t


cdef struct Deposit:
    # As the columns, but for `throughput`, which is relative to the flux of a photon. `path` counts
    # from the first of the batch.
    double[3] position
    double[3] normal
    double[3] wi
    double[3] throughput
    double path_length
    # nm; 0 of white light.
    double wavelength
    int64_t path_signature
    int32_t path, n_bounces, object_id


cdef class Deposits:
    cdef Py_ssize_t n
    cdef Deposit[::1] rows
    cdef double[:, ::1] coords
    cdef double[::1] density

    cdef void reserve(self, Py_ssize_t n)
    cdef Deposit* add(self) noexcept nogil
