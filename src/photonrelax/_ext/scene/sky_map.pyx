"""Directions to the texels of a latitude-longitude map: row 0 is at +z, columns turn from -x by +y.

Column j of w is at the azimuth π (1 - 2 (j + 1/2) / w) from +x to +y.
"""

cimport cython
from libc.math cimport M_PI, acos, atan2, cos, sin, sqrt
from libc.stdint cimport int64_t

import numpy as np


cdef Py_ssize_t first_above(const double* cumulative, Py_ssize_t n, double share) noexcept nogil:
    """Index of the first of n ascending numbers that is above a share; the last if none is."""
    cdef Py_ssize_t first = 0, last = n - 1, middle
    while first < last:
        middle = (first + last) // 2
        if cumulative[middle] <= share:
            first = middle + 1
        else:
            last = middle
    return first


cdef double place_within(
    const double* cumulative, Py_ssize_t i, double share
) noexcept nogil:
    """Place of a share, in [0, 1], between the cumulative number before and number i."""
    cdef double below = cumulative[i - 1] if i > 0 else 0.0
    cdef double width = cumulative[i] - below
    return min((share - below) / width, 1.0) if width > 0.0 else 0.0


@cython.final
cdef class SkyMap:
    """Cumulative shares of light over the rows (h,) of a map, and over the columns (h, w) of each.

    Each ends with 1.
    """

    def __init__(self, const double[::1] rows, const double[:, ::1] columns):
        if rows.shape[0] != columns.shape[0] or rows.shape[0] == 0 or columns.shape[1] == 0:
            raise ValueError("rows and columns do not fit one another")
        self.rows, self.columns = rows, columns

    cdef Py_ssize_t direction(self, double* out, double u, double v) noexcept nogil:
        """Write the direction to a point of the unit square's image; return its texel.

        Points that are uniform in the square are so by light over the texels, and by solid angle
        within each.
        """
        cdef Py_ssize_t h = self.rows.shape[0], w = self.columns.shape[1]
        cdef Py_ssize_t row = first_above(&self.rows[0], h, u)
        cdef Py_ssize_t column = first_above(&self.columns[row, 0], w, v)
        cdef double down = place_within(&self.rows[0], row, u)
        cdef double along = place_within(&self.columns[row, 0], column, v)
        cdef double top = cos(M_PI * row / h), bottom = cos(M_PI * (row + 1) / h)
        cdef double azimuth = M_PI * (1.0 - 2.0 * (column + along) / w)
        cdef double aside
        out[2] = top + down * (bottom - top)
        aside = sqrt(max((1.0 - out[2]) * (1.0 + out[2]), 0.0))
        out[0] = aside * cos(azimuth)
        out[1] = aside * sin(azimuth)
        return row * w + column

    def directions(self, const double[:, ::1] samples):
        """Directions (m, 3) to the points of samples (m, 2) of the unit square, and texels (m,)."""
        cdef Py_ssize_t i, m = samples.shape[0]
        cdef double[:, ::1] out = np.empty((m, 3))
        cdef Py_ssize_t[::1] texel = np.empty(m, np.intp)
        if samples.shape[1] != 2:
            raise ValueError(f"samples should have 2 columns, but have {samples.shape[1]}")
        with nogil:
            for i in range(m):
                texel[i] = self.direction(&out[i, 0], samples[i, 0], samples[i, 1])
        return out.base, texel.base

    def texels(self, const double[:, ::1] direction):
        """Texels (m,), row · w + column, that unit vectors (m, 3) point to."""
        cdef Py_ssize_t i, m = direction.shape[0]
        cdef Py_ssize_t[::1] out = np.empty(m, np.intp)
        if direction.shape[1] != 3:
            raise ValueError(f"directions should have 3 columns, but have {direction.shape[1]}")
        with nogil:
            for i in range(m):
                out[i] = self.texel(&direction[i, 0])
        return out.base

    cdef Py_ssize_t texel(self, const double* direction) noexcept nogil:
        """Texel that a unit vector points to."""
        cdef Py_ssize_t h = self.rows.shape[0], w = self.columns.shape[1], row, column
        cdef double azimuth = atan2(direction[1], direction[0])
        row = <Py_ssize_t> (h * acos(max(-1.0, min(1.0, direction[2]))) / M_PI)
        column = <Py_ssize_t> (0.5 * w * (1.0 - azimuth / M_PI))
        return max(min(row, h - 1), 0) * w + max(min(column, w - 1), 0)

    cdef Py_ssize_t texel_beside(
        self, const double* direction, const double* edges, double a, double b
    ) noexcept nogil:
        """Texel in the direction of a point of a parallelogram, by shares of its edges."""
        cdef double[3] at
        cdef double length
        cdef int c
        for c in range(3):
            at[c] = direction[c] + a * edges[c] + b * edges[3 + c]
        length = sqrt(at[0] * at[0] + at[1] * at[1] + at[2] * at[2])
        if not length > 0.0:
            return self.texel(direction)
        at[2] /= length
        return self.texel(at)

    def means(
        self, const double[:, ::1] texels, const double[:, ::1] direction,
        const double[:, :, ::1] edges, const int64_t[::1] n
    ):
        """Means (m, 3) of texels (h w, 3) over n x n points of parallelograms, n (m,) of each.

        The parallelograms are around unit vectors (m, 3) and have edges (m, 2, 3). Those of fewer
        than 16 x 16 points may lie in one texel: corners tell.
        """
        cdef Py_ssize_t i, row, column, texel, m = direction.shape[0]
        cdef double[:, ::1] out = np.zeros((m, 3))
        cdef double a, b
        cdef int c
        cdef const double* edge
        with nogil:
            for i in range(m):
                edge = &edges[i, 0, 0]
                texel = self.texel(&direction[i, 0])
                if n[i] < 16 and self.holds(texel, &direction[i, 0], edge):
                    for c in range(3):
                        out[i, c] = texels[texel, c]
                    continue
                for row in range(n[i]):
                    for column in range(n[i]):
                        a, b = (row + 0.5) / n[i] - 0.5, (column + 0.5) / n[i] - 0.5
                        texel = self.texel_beside(&direction[i, 0], edge, a, b)
                        for c in range(3):
                            out[i, c] += texels[texel, c]
                for c in range(3):
                    out[i, c] /= n[i] * n[i]
        return out.base

    cdef bint holds(
        self, Py_ssize_t texel, const double* direction, const double* edges
    ) noexcept nogil:
        """Whether all corners of a parallelogram are in a texel."""
        cdef int corner
        for corner in range(4):
            if texel != self.texel_beside(
                direction, edges, 0.5 - (corner & 1), 0.5 - (corner >> 1)
            ):
                return False
        return True
