"""Optics for arrays: each loop body writes only row i."""

from cython.parallel cimport prange
from libc.math cimport NAN, exp
from libc.stdint cimport uint8_t

from ..common.threads cimport ELEMENTS, team_size
from .optics cimport fresnel_reflectance, reflect_into, refract_into


def fresnel(
    const double[::1] cos_i, const double[::1] n1, const double[::1] n2, double[::1] out,
    int n_threads,
):
    cdef Py_ssize_t i
    for i in prange(
        out.shape[0], nogil=True, schedule="static",
        num_threads=team_size(n_threads, out.shape[0], ELEMENTS)
    ):
        out[i] = fresnel_reflectance(cos_i[i], n1[i], n2[i])


def reflect(
    const double[:, ::1] direction, const double[:, ::1] normal, double[:, ::1] out, int n_threads
):
    cdef Py_ssize_t i
    for i in prange(
        out.shape[0], nogil=True, schedule="static",
        num_threads=team_size(n_threads, out.shape[0], ELEMENTS)
    ):
        reflect_into(&out[i, 0], &direction[i, 0], &normal[i, 0])


cdef void _refract_row(
    double[:, ::1] out, uint8_t[::1] ok, Py_ssize_t i, const double* direction,
    const double* normal, double n1, double n2,
) noexcept nogil:
    ok[i] = refract_into(&out[i, 0], direction, normal, n1, n2)
    if not ok[i]:
        out[i, 0] = out[i, 1] = out[i, 2] = NAN


def refract(
    const double[:, ::1] direction, const double[:, ::1] normal, const double[::1] n1,
    const double[::1] n2, *, double[:, ::1] out, uint8_t[::1] ok, int n_threads,
):
    cdef Py_ssize_t i
    for i in prange(
        out.shape[0], nogil=True, schedule="static",
        num_threads=team_size(n_threads, out.shape[0], ELEMENTS)
    ):
        _refract_row(out, ok, i, &direction[i, 0], &normal[i, 0], n1[i], n2[i])


def beer_lambert(
    const double[:, ::1] absorption, const double[::1] distance, double[:, ::1] out, int n_threads
):
    cdef Py_ssize_t i
    for i in prange(
        out.shape[0], nogil=True, schedule="static",
        num_threads=team_size(n_threads, out.shape[0], ELEMENTS)
    ):
        out[i, 0] = exp(-absorption[i, 0] * distance[i])
        out[i, 1] = exp(-absorption[i, 1] * distance[i])
        out[i, 2] = exp(-absorption[i, 2] * distance[i])
