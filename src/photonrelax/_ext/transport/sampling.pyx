"""Sampling for arrays: each loop body writes only row i."""

from cython.parallel cimport prange
from libc.stdint cimport uint64_t

from ..common.rng cimport hash_key, uniform
from ..common.threads cimport ELEMENTS, team_size
from .sampling cimport disk_point, radical_inverse_2, radical_inverse_3, wrapped


def seed_shifts(uint64_t seed, uint64_t stream, int n):
    cdef uint64_t key = hash_key(seed, stream, 0)
    return [uniform(key, i) for i in range(n)]


def halton(uint64_t first, double shift_u, double shift_v, double[:, ::1] out, int n_threads):
    cdef Py_ssize_t i
    for i in prange(
        out.shape[0], nogil=True, schedule="static",
        num_threads=team_size(n_threads, out.shape[0], ELEMENTS)
    ):
        out[i, 0] = wrapped(radical_inverse_2(first + i), shift_u)
        out[i, 1] = wrapped(radical_inverse_3(first + i), shift_v)


def square_to_disk(const double[:, ::1] points, double[:, ::1] out, int n_threads):
    cdef Py_ssize_t i
    for i in prange(
        out.shape[0], nogil=True, schedule="static",
        num_threads=team_size(n_threads, out.shape[0], ELEMENTS)
    ):
        disk_point(&out[i, 0], points[i, 0], points[i, 1])
