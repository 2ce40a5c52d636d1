"""Shadow rays from lit points to an emitter, and the light of those that reach it."""

from collections import namedtuple

from libc.math cimport sqrt
from libc.stdint cimport int64_t, uint8_t, uint64_t

import numpy as np

from ..common.rng cimport hash_key, uniform
from ..common.vec3 cimport copy, dot, normalise
from .raycast cimport EmbreeFrame
from .sampling cimport radical_inverse_2, radical_inverse_3, wrapped

ShadowRays = namedtuple("ShadowRays", "row origin direction origin_offset distance irradiance")
ShadowRays.__doc__ = """Rays from n points to an emitter whose light falls on their lit side.

`row` (n,) are the indices of the points, `origin` (n, 3) their positions, `direction` (n, 3) and
`distance` (n,) those of the emitter, `origin_offset` (n, 3) the vectors by which rays are moved off
the surface, and `irradiance` (n, 3) that of unoccluded light.
"""


def shadow_rays(
    EmbreeFrame frame, const double[:, ::1] position, const double[:, ::1] normal, *,
    const double[:, ::1] direction, const double[::1] distance, const double[:, ::1] irradiance,
    bint aimed=False,
):
    """`ShadowRays` of points (m, 3) with normals, given the `DirectLight` there.

    If they are `aimed`, rays end where the light comes from although they start off the surface:
    on a surface that emits, the distance by which they do may matter.
    """
    cdef Py_ssize_t i, n = 0, m = position.shape[0]
    cdef Py_ssize_t[::1] row = np.empty(m, np.intp)
    cdef double[:, ::1] origin = np.empty((m, 3))
    cdef double[:, ::1] to_emitter = np.empty((m, 3))
    cdef double[:, ::1] offset = np.empty((m, 3))
    cdef double[::1] length = np.empty(m)
    cdef double[:, ::1] arriving = np.empty((m, 3))
    cdef double cosine, step
    cdef int c
    with nogil:
        for i in range(m):
            for c in range(3):
                to_emitter[n, c] = direction[i, c]
            cosine = max(dot(&to_emitter[n, 0], &normal[i, 0]), 0.0)
            for c in range(3):
                arriving[n, c] = irradiance[i, c] * cosine
            # True for NaN, which is an error of the ray.
            if arriving[n, 0] != 0.0 or arriving[n, 1] != 0.0 or arriving[n, 2] != 0.0:
                step = frame.resolution_at(&position[i, 0])
                for c in range(3):
                    offset[n, c] = step * normal[i, c]
                copy(&origin[n, 0], &position[i, 0])
                row[n], length[n] = i, distance[i]
                if aimed:
                    for c in range(3):
                        to_emitter[n, c] = distance[i] * direction[i, c] - offset[n, c]
                    length[n] = sqrt(dot(&to_emitter[n, 0], &to_emitter[n, 0]))
                    normalise(&to_emitter[n, 0])
                n += 1
    return ShadowRays(
        row.base[:n], origin.base[:n], to_emitter.base[:n], offset.base[:n], length.base[:n],
        arriving.base[:n],
    )


def emitter_samples(
    uint64_t seed, uint64_t stream, const int64_t[::1] pixel, const int64_t[::1] number
):
    """Points (m, 2) of the unit square: Halton points by their numbers, shifted by pixel."""
    cdef Py_ssize_t i, m = pixel.shape[0]
    cdef double[:, ::1] sample = np.empty((m, 2))
    cdef uint64_t key
    with nogil:
        for i in range(m):
            key = hash_key(seed, stream, pixel[i])
            sample[i, 0] = wrapped(radical_inverse_2(number[i]), uniform(key, 0))
            sample[i, 1] = wrapped(radical_inverse_3(number[i]), uniform(key, 1))
    return sample.base


def add_unoccluded(
    double[:, ::1] total, const Py_ssize_t[::1] row, const double[:, ::1] irradiance,
    const uint8_t[::1] occluded,
):
    """Add the irradiance (n, 3) of rays that are not occluded to the rows of their points."""
    cdef Py_ssize_t i
    cdef int c
    with nogil:
        for i in range(row.shape[0]):
            if not occluded[i]:
                for c in range(3):
                    total[row[i], c] += irradiance[i, c]
