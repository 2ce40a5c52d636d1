"""Straight triangles of the quadratic images of elements."""

from cython.parallel cimport prange, threadid

from ..common.threads cimport Watch, close_watch, goes_on, open_watch, team_size

cdef enum:
    # Parts that the sides of an image are divided into, at most, and corners of all parts.
    MOST_PARTS = 16
    MOST_CORNERS = 153
    LOOK_EVERY = 256
    GRAIN = 64

MOST = MOST_PARTS


def pieces(
    const double[:, :, ::1] position, const double[:, :, ::1] light,
    const double[:, :, ::1] place, const Py_ssize_t[::1] parts, const Py_ssize_t[::1] first, *,
    double[:, :, ::1] corners, double[:, ::1] flux, float[:, :, ::1] places, int n_threads,
):
    """Write parts[i]² triangles of each image i, from row first[i] on.

    Parameters
    ----------
    position, light : (p, 6, 3)
        Of the nodes: corners, then the middles of the sides opposite to them; m, and W of the
        image if all its light were as there.
    place : (p, 6, 2)
    parts, first : (p,) intp arrays
        Parts of the sides, from 1 to `MOST`.
    corners : (t, 3, 3), flux : (t, 3), places : (t, 3, 2) float32
        Of the triangles. Fluxes of an image sum to the mean of its light over the middles.
    """
    cdef Py_ssize_t i, p = position.shape[0], t = corners.shape[0]
    cdef Watch watch = open_watch()
    if not (
        p == light.shape[0] == place.shape[0] == parts.shape[0] == first.shape[0]
        and t == flux.shape[0] == places.shape[0]
        and position.shape[1] == light.shape[1] == place.shape[1] == 6
        and corners.shape[1] == places.shape[1] == 3 and place.shape[2] == places.shape[2] == 2
        and position.shape[2] == light.shape[2] == corners.shape[2] == flux.shape[1] == 3
    ):
        raise ValueError("images and triangles do not fit one another")
    for i in range(p):
        if not (1 <= parts[i] <= MOST_PARTS and 0 <= first[i] <= t - parts[i] * parts[i]):
            raise ValueError(f"image {i} should have 1 to {MOST_PARTS} parts and rows for them")
    for i in prange(
        p, nogil=True, schedule="static", chunksize=GRAIN,
        num_threads=team_size(n_threads, p, GRAIN)
    ):
        if goes_on(&watch, threadid() == 0 and i % LOOK_EVERY == 0):
            divide(
                &position[i, 0, 0], &light[i, 0, 0], &place[i, 0, 0], <int>parts[i],
                &corners[first[i], 0, 0], &flux[first[i], 0], &places[first[i], 0, 0],
            )
    close_watch(&watch)


cdef void divide(
    const double* position, const double* light, const double* place, int n, double* corners,
    double* flux, float* places,
) noexcept nogil:
    """Write the triangles of one image, row by row of its grid."""
    cdef double[3 * MOST_CORNERS] at
    cdef double[2 * MOST_CORNERS] from_place
    cdef double[6] weight
    cdef double[3] wanted, total
    cdef int i, j, c, row = 0, t = 0
    for i in range(n + 1):
        for j in range(n + 1 - i):
            set_weights(weight, <double>i / n, <double>j / n)
            for c in range(3):
                at[3 * row + c] = combined(weight, position + c, 3)
            for c in range(2):
                from_place[2 * row + c] = combined(weight, place + c, 2)
            row += 1
    for c in range(3):
        total[c] = 0.0
        wanted[c] = (light[9 + c] + light[12 + c] + light[15 + c]) / 3.0
    for i in range(n):
        for j in range(n - i):
            for row in range(2 if j < n - 1 - i else 1):
                set_triangle(at, from_place, n, i, j, row, corners + 9 * t, places + 6 * t)
                # At the centre of the part.
                set_weights(weight, (i + (row + 1) / 3.0) / n, (j + (row + 1) / 3.0) / n)
                for c in range(3):
                    flux[3 * t + c] = combined(weight, light + c, 3)
                    total[c] += flux[3 * t + c]
                t += 1
    for c in range(3):
        # The sum over the parts is the quadrature over the whole.
        wanted[c] = wanted[c] / total[c] if wanted[c] > 0.0 else 0.0
    for i in range(t):
        for c in range(3):
            flux[3 * i + c] *= wanted[c]


cdef void set_triangle(
    const double* at, const double* from_place, int n, int i, int j, int is_second,
    double* corners, float* places,
) noexcept nogil:
    """Write the first or second part of cell (i, j) of the grid of an image."""
    cdef int[3] row
    cdef int k, c, start = first_of(n, i), above = first_of(n, i + 1)
    row[0] = above + j if not is_second else above + j + 1
    row[1] = start + j + 1
    row[2] = start + j if not is_second else above + j
    for k in range(3):
        for c in range(3):
            corners[3 * k + c] = at[3 * row[k] + c]
        for c in range(2):
            places[2 * k + c] = <float>from_place[2 * row[k] + c]


cdef int first_of(int n, int i) noexcept nogil:
    """Row of corner (i, 0) of the grid of an image."""
    return i * (n + 1) - i * (i - 1) // 2


cdef void set_weights(double* weight, double y, double z) noexcept nogil:
    """Write the shape functions at barycentric coordinates 1 - y - z, y, z."""
    cdef double x = 1.0 - y - z
    weight[0] = x * (2.0 * x - 1.0)
    weight[1] = y * (2.0 * y - 1.0)
    weight[2] = z * (2.0 * z - 1.0)
    weight[3] = 4.0 * y * z
    weight[4] = 4.0 * x * z
    weight[5] = 4.0 * x * y


cdef double combined(const double* weight, const double* values, int stride) noexcept nogil:
    """Sum of six values, each times its weight."""
    cdef double total = 0.0
    cdef int k
    for k in range(6):
        total += weight[k] * values[k * stride]
    return total
