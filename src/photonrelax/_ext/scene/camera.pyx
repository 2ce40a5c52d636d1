"""Points on the film of a camera, and unit vectors towards them."""

from libc.math cimport sqrt
from libc.stdint cimport int64_t

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


def film_samples(
    const int64_t[::1] rows, const int64_t[::1] columns, Py_ssize_t width, Py_ssize_t height, *,
    Py_ssize_t side, double right, double down,
):
    """Coordinates of samples on the film, x and y (m,), and their pixels, row · width + column.

    In half heights of the image from its centre. The side · side samples of each pixel of some rows
    and columns follow one another; `right` and `down` are their offsets in the cells of its grid.
    """
    cdef Py_ssize_t m = rows.shape[0] * columns.shape[0] * side * side
    cdef double[::1] x = np.empty(m), y = np.empty(m)
    cdef int64_t[::1] pixel = np.empty(m, np.int64)
    cdef Py_ssize_t row, column, i, j, at = 0
    with nogil:
        for row in range(rows.shape[0]):
            for column in range(columns.shape[0]):
                for i in range(side):
                    for j in range(side):
                        x[at] = (2.0 * (columns[column] + (j + right) / side) - width) / height
                        y[at] = 1.0 - 2.0 * (rows[row] + (i + down) / side) / height
                        pixel[at] = rows[row] * width + columns[column]
                        at += 1
    return x.base, y.base, pixel.base
