"""Directions and distances to point-like emitters."""

from libc.math cimport sqrt

import numpy as np

from ..common.vec3 cimport dot


def towards(const double[::1] emitter, const double[:, ::1] position, double emitter_offset):
    """Unit vectors (m, 3) from points to an emitter, distances (m,), and their inverses (m,).

    Vectors and inverses are zero where the distance is not above `emitter_offset`.
    """
    cdef Py_ssize_t i, m = position.shape[0]
    cdef double[:, ::1] direction = np.empty((m, 3))
    cdef double[::1] distance = np.empty(m)
    cdef double[::1] inverse = np.empty(m)
    cdef double[3] step
    cdef int axis
    with nogil:
        for i in range(m):
            for axis in range(3):
                step[axis] = emitter[axis] - position[i, axis]
            distance[i] = sqrt(dot(step, step))
            inverse[i] = 1.0 / distance[i] if distance[i] > emitter_offset else 0.0
            for axis in range(3):
                direction[i, axis] = step[axis] * inverse[i]
    return direction.base, distance.base, inverse.base
