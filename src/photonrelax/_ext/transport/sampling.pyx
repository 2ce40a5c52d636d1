"""Sampling for arrays: each loop body writes only row i."""

from cython.parallel cimport prange
from libc.math cimport M_PI, M_PI_2, M_PI_4, atan2, fabs, hypot, sqrt
from libc.stdint cimport uint64_t

from ..common.rng cimport hash_key, uniform
from .sampling cimport (
    cap_direction, disk_point, hemisphere_direction, radical_inverse_2, radical_inverse_3,
    sphere_direction, wrapped,
)


def seed_shift(uint64_t seed, uint64_t stream):
    cdef uint64_t key = hash_key(seed, stream, 0)
    return uniform(key, 0), uniform(key, 1)


def halton(uint64_t first, double shift_u, double shift_v, double[:, ::1] out, int n_threads):
    cdef Py_ssize_t i
    for i in prange(out.shape[0], nogil=True, num_threads=n_threads, schedule="static"):
        out[i, 0] = wrapped(radical_inverse_2(first + i), shift_u)
        out[i, 1] = wrapped(radical_inverse_3(first + i), shift_v)


def square_to_disk(const double[:, ::1] points, double[:, ::1] out, int n_threads):
    cdef Py_ssize_t i
    for i in prange(out.shape[0], nogil=True, num_threads=n_threads, schedule="static"):
        disk_point(&out[i, 0], points[i, 0], points[i, 1])


cdef void _square_to_cap_row(
    double* out, const double* point, double one_minus_cos
) noexcept nogil:
    cdef double[2] disk
    disk_point(disk, point[0], point[1])
    cap_direction(out, disk, one_minus_cos)


def square_to_cap(
    const double[:, ::1] points, double one_minus_cos, double[:, ::1] out, int n_threads
):
    cdef Py_ssize_t i
    for i in prange(out.shape[0], nogil=True, num_threads=n_threads, schedule="static"):
        _square_to_cap_row(&out[i, 0], &points[i, 0], one_minus_cos)


cdef void _square_to_hemisphere_row(double* out, const double* point) noexcept nogil:
    cdef double[2] disk
    disk_point(disk, point[0], point[1])
    hemisphere_direction(out, disk)


def square_to_hemisphere(const double[:, ::1] points, double[:, ::1] out, int n_threads):
    cdef Py_ssize_t i
    for i in prange(out.shape[0], nogil=True, num_threads=n_threads, schedule="static"):
        _square_to_hemisphere_row(&out[i, 0], &points[i, 0])


def square_to_sphere(const double[:, ::1] points, double[:, ::1] out, int n_threads):
    cdef Py_ssize_t i
    for i in prange(out.shape[0], nogil=True, num_threads=n_threads, schedule="static"):
        sphere_direction(&out[i, 0], points[i, 0], points[i, 1])


cdef void _disk_to_square_row(double* out, double x, double y) noexcept nogil:
    """Each quarter of the square, turned to face +x, is a sector of the disk."""
    cdef double r = hypot(x, y), angle = atan2(y, x), a, b
    if angle < -M_PI_4:
        angle += 2.0 * M_PI
    if angle < M_PI_4:
        a, b = r, r * angle / M_PI_4
    elif angle < M_PI_2 + M_PI_4:
        a, b = -r * (angle - M_PI_2) / M_PI_4, r
    elif angle < M_PI + M_PI_4:
        a, b = -r, -r * (angle - M_PI) / M_PI_4
    else:
        a, b = r * (angle - M_PI - M_PI_2) / M_PI_4, -r
    out[0] = 0.5 * (a + 1.0)
    out[1] = 0.5 * (b + 1.0)


def disk_to_square(const double[:, ::1] points, double[:, ::1] out, int n_threads):
    cdef Py_ssize_t i
    for i in prange(out.shape[0], nogil=True, num_threads=n_threads, schedule="static"):
        _disk_to_square_row(&out[i, 0], points[i, 0], points[i, 1])


cdef void _cap_to_square_row(
    double* out, const double* direction, double one_minus_cos
) noexcept nogil:
    """Divides by the stretch of `cap_direction`, which depends on 2 - drop = 1 + z alone."""
    cdef double stretch = sqrt(one_minus_cos * (1.0 + direction[2]))
    if stretch > 0.0:
        _disk_to_square_row(out, direction[0] / stretch, direction[1] / stretch)
    else:
        _disk_to_square_row(out, 1.0, 0.0)


def cap_to_square(
    const double[:, ::1] directions, double one_minus_cos, double[:, ::1] out, int n_threads
):
    cdef Py_ssize_t i
    for i in prange(out.shape[0], nogil=True, num_threads=n_threads, schedule="static"):
        _cap_to_square_row(&out[i, 0], &directions[i, 0], one_minus_cos)


cdef void _sphere_to_square_row(double* out, const double* direction) noexcept nogil:
    cdef double x = fabs(direction[0]), y = fabs(direction[1]), z = fabs(direction[2])
    # 1 - z without its cancellation near the poles.
    cdef double r = sqrt((x * x + y * y) / (1.0 + z))
    cdef double b = r * (atan2(y, x) / M_PI_2)
    cdef double a = r - b
    if direction[2] < 0.0:
        a, b = 1.0 - b, 1.0 - a
    out[0] = 0.5 * (1.0 + (a if direction[0] >= 0.0 else -a))
    out[1] = 0.5 * (1.0 + (b if direction[1] >= 0.0 else -b))


def sphere_to_square(const double[:, ::1] directions, double[:, ::1] out, int n_threads):
    cdef Py_ssize_t i
    for i in prange(out.shape[0], nogil=True, num_threads=n_threads, schedule="static"):
        _sphere_to_square_row(&out[i, 0], &directions[i, 0])
