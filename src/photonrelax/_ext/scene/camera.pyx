"""Points on the film of a camera, and unit vectors towards them."""

from libc.math cimport sqrt

import numpy as np

from ..common.vec3 cimport dot


def film_points(
    const double[::1] x, const double[::1] y, *, const double[::1] centre,
    const double[::1] right, const double[::1] up, double half_height, bint unit,
):
    """Points (m, 3) at x and y half heights from a centre, or unit vectors in their directions."""
    cdef Py_ssize_t i, m = x.shape[0]
    cdef double[:, ::1] points = np.empty((m, 3))
    cdef double length = 1.0
    cdef int c
    if not (y.shape[0] == m and centre.shape[0] == right.shape[0] == up.shape[0] == 3):
        raise ValueError("film coordinates and axes do not fit one another")
    with nogil:
        for i in range(m):
            for c in range(3):
                points[i, c] = centre[c] + half_height * (x[i] * right[c] + y[i] * up[c])
            if unit:
                length = sqrt(dot(&points[i, 0], &points[i, 0]))
                for c in range(3):
                    points[i, c] /= length
    return points.base
