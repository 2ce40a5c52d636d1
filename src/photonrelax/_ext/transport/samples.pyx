"""Samples of pixels: those that lie on one piece of surface, and sums over them."""

from libc.stdint cimport int32_t, int64_t

import numpy as np

from ..common.vec3 cimport dot


cdef struct Piece:
    # Means over the samples of a pixel.
    double[3] position
    double[3] normal
    double[2][3] edges


cdef class Samples:
    """Hit points, in sequence by pixel and level where they are those of its samples."""

    cdef const int64_t[::1] pixel
    cdef const int32_t[::1] object_id, level
    cdef const double[:, ::1] position, normal
    cdef const double[:, :, ::1] footprint
    cdef Py_ssize_t side
    cdef double squared_tolerance, least_cosine

    cdef object check(self):
        """Raise ValueError if the columns do not fit one another."""
        cdef Py_ssize_t m = self.pixel.shape[0]
        if not (
            m == self.object_id.shape[0] == self.level.shape[0] == self.position.shape[0]
            == self.normal.shape[0] == self.footprint.shape[0]
            and 3 == self.position.shape[1] == self.normal.shape[1] == self.footprint.shape[2]
            and self.footprint.shape[1] == 2 and self.side > 0
        ):
            raise ValueError("columns of the hit points do not fit one another")

    cdef Py_ssize_t end_of(self, Py_ssize_t first) noexcept nogil:
        """End of the points from `first` on that are of one pixel and level."""
        cdef Py_ssize_t end = first + 1
        while (
            end < self.pixel.shape[0] and self.pixel[end] == self.pixel[first]
            and self.level[end] == self.level[first]
        ):
            end += 1
        return end

    cdef bint is_one_piece(self, Py_ssize_t first, Piece* piece) noexcept nogil:
        """Write the means over a pixel's samples; true if these are a grid on one surface."""
        cdef Py_ssize_t sample, n = self.side * self.side
        cdef double longest, squared
        cdef double right, down
        cdef int c, edge
        for c in range(3):
            piece.position[c] = piece.normal[c] = piece.edges[0][c] = piece.edges[1][c] = 0.0
        for sample in range(first, first + n):
            if self.object_id[sample] != self.object_id[first]:
                return False
            if dot(&self.normal[sample, 0], &self.normal[first, 0]) < self.least_cosine:
                return False
            for c in range(3):
                piece.position[c] += self.position[sample, c] / n
                piece.normal[c] += self.normal[sample, c] / n
                piece.edges[0][c] += self.footprint[sample, 0, c] / n
                piece.edges[1][c] += self.footprint[sample, 1, c] / n
        longest = max(dot(piece.edges[0], piece.edges[0]), dot(piece.edges[1], piece.edges[1]))
        longest *= self.squared_tolerance
        for sample in range(n):
            right = sample % self.side - 0.5 * (self.side - 1)
            down = sample // self.side - 0.5 * (self.side - 1)
            squared = 0.0
            for c in range(3):
                squared += (
                    self.position[first + sample, c] - piece.position[c]
                    - right * piece.edges[0][c] - down * piece.edges[1][c]
                ) ** 2
            if squared > longest:
                return False
            for edge in range(2):
                squared = 0.0
                for c in range(3):
                    squared += (
                        self.footprint[first + sample, edge, c] - piece.edges[edge][c]
                    ) ** 2
                if squared > longest:
                    return False
        return True


def merge_samples(hits, Py_ssize_t side, *, double tolerance, double least_cosine):
    """Pieces of surface of hit points: one for all samples of a pixel that are on one.

    Parameters
    ----------
    hits : HitPoints
        With footprints, (m, …).
    side : int
        side · side samples a pixel, row by row.
    tolerance : float
        Distance of samples from a grid, and difference of their edges, over the longer edge.
    least_cosine : float
        Between normals.

    Returns
    -------
    position, normal, footprint : (p, 3), (p, 3), (p, 2, 3)
        Of the pieces; normals of any length.
    of_hit : (m,) intp
        The piece of each hit point.
    """
    cdef Samples samples = Samples()
    samples.pixel, samples.object_id = hits.pixel, hits.object_id
    samples.position, samples.normal = hits.position, hits.normal
    samples.footprint = hits.footprint
    samples.level = (
        np.zeros(len(hits.pixel), np.int32) if hits.n_specular is None else hits.n_specular
    )
    samples.side = side
    samples.squared_tolerance, samples.least_cosine = tolerance * tolerance, least_cosine
    samples.check()
    cdef Py_ssize_t m = samples.pixel.shape[0], n = side * side
    cdef double[:, ::1] position = np.empty((m, 3)), normal = np.empty((m, 3))
    cdef double[:, :, ::1] footprint = np.empty((m, 2, 3))
    cdef Py_ssize_t[::1] of_hit = np.empty(m, np.intp)
    cdef Py_ssize_t first = 0, end, i, c, p = 0
    cdef Piece piece
    with nogil:
        while first < m:
            end = samples.end_of(first)
            if end - first == n and n > 1 and samples.is_one_piece(first, &piece):
                of_hit[first:end] = p
                for c in range(3):
                    position[p, c] = piece.position[c]
                    normal[p, c] = piece.normal[c]
                    footprint[p, 0, c] = side * piece.edges[0][c]
                    footprint[p, 1, c] = side * piece.edges[1][c]
                p += 1
            else:
                for i in range(first, end):
                    of_hit[i] = p
                    for c in range(3):
                        position[p, c] = samples.position[i, c]
                        normal[p, c] = samples.normal[i, c]
                        footprint[p, 0, c] = samples.footprint[i, 0, c]
                        footprint[p, 1, c] = samples.footprint[i, 1, c]
                    p += 1
            first = end
    return position.base[:p], normal.base[:p], footprint.base[:p], of_hit.base


def add_by_pixel(
    double[:, ::1] sums, const int64_t[::1] pixel, values, const Py_ssize_t[::1] of_hit, weight,
):
    """Add values of hit points to the sums (n, c) of their pixels, in sequence.

    Parameters
    ----------
    sums : (n, c)
    pixel : (m,)
        Those of the hit points.
    values : (p, c) or (p, 1)
    of_hit : (m,) or None
        The row of `values` of each hit point; None for its own.
    weight : (m, c), (m, 1) or None
        Factors of the values.
    """
    cdef Py_ssize_t i, row, c, m = pixel.shape[0], n_channels = sums.shape[1]
    cdef const double[:, :] value = np.broadcast_to(values, (len(values), n_channels))
    cdef const double[:, :] factor
    cdef bint weighted = weight is not None, shared = of_hit is not None
    factor = np.broadcast_to(weight, (m, n_channels)) if weighted else value
    check_rows(sums, pixel, of_hit, len(values))
    with nogil:
        for i in range(m):
            row = of_hit[i] if shared else i
            for c in range(n_channels):
                sums[pixel[i], c] += (
                    factor[i, c] * value[row, c] if weighted else value[row, c]
                )


cdef check_rows(
    const double[:, ::1] sums, const int64_t[::1] pixel, const Py_ssize_t[::1] of_hit,
    Py_ssize_t n_values,
):
    """Raise ValueError if a pixel has no sum, or a hit point no value."""
    cdef Py_ssize_t i, m = pixel.shape[0]
    cdef bint fits = (n_values if of_hit is None else of_hit.shape[0]) == m
    cdef bint shared = of_hit is not None
    with nogil:
        for i in range(m if fits else 0):
            fits &= 0 <= pixel[i] < sums.shape[0]
            if shared:
                fits &= 0 <= of_hit[i] < n_values
    if not fits:
        raise ValueError(f"hit points should be of {sums.shape[0]} pixels and {n_values} values")
