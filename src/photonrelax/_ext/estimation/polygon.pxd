"""Convex polygons of a plane, as inline functions for kernels."""

from libc.math cimport fabs


cdef enum:
    # Corners of a triangle cut by the four sides of a square, at most, and one for rounding.
    MOST_CORNERS = 8


cdef struct Polygon:
    int n
    double[MOST_CORNERS][2] corner


cdef inline double squared_length(const double* a, const double* b) noexcept nogil:
    return (a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1])


cdef inline double area_of(const Polygon* polygon) noexcept nogil:
    """Signed area, by corners relative to the first: far ones keep their digits."""
    cdef double total = 0.0
    cdef const double* o = polygon.corner[0]
    cdef int i
    for i in range(1, polygon.n - 1):
        total += (
            (polygon.corner[i][0] - o[0]) * (polygon.corner[i + 1][1] - o[1])
            - (polygon.corner[i][1] - o[1]) * (polygon.corner[i + 1][0] - o[0])
        )
    return 0.5 * total


cdef inline int longest_side(const Polygon* triangle, double* squared) noexcept nogil:
    """Corner that the longest side of a triangle starts at, and the square of its length."""
    cdef double length
    cdef int i, longest = 0
    squared[0] = 0.0
    for i in range(3):
        length = squared_length(triangle.corner[i], triangle.corner[(i + 1) % 3])
        if length > squared[0]:
            longest, squared[0] = i, length
    return longest


cdef inline bint is_line(double area, double squared_longest) noexcept nogil:
    """True for triangles that are taken for their longest side."""
    return fabs(area) <= 1e-9 * squared_longest


cdef inline void split(
    const Polygon* polygon, int axis, double at, Polygon* below, Polygon* above
) noexcept nogil:
    """Write the parts of a convex polygon on both sides of a line across an axis."""
    cdef double here, there, t
    cdef int i, j
    below.n = above.n = 0
    for i in range(polygon.n):
        j = i + 1 if i + 1 < polygon.n else 0
        here = polygon.corner[i][axis] - at
        there = polygon.corner[j][axis] - at
        if here <= 0.0:
            append(below, polygon.corner[i])
        if here >= 0.0:
            append(above, polygon.corner[i])
        if (here < 0.0 and there > 0.0) or (here > 0.0 and there < 0.0):
            t = here / (here - there)
            append(below, polygon.corner[i])
            below.corner[below.n - 1][axis] = at
            below.corner[below.n - 1][1 - axis] += t * (
                polygon.corner[j][1 - axis] - polygon.corner[i][1 - axis]
            )
            append(above, below.corner[below.n - 1])


cdef inline void append(Polygon* polygon, const double* corner) noexcept nogil:
    if polygon.n < MOST_CORNERS:
        polygon.corner[polygon.n][0] = corner[0]
        polygon.corner[polygon.n][1] = corner[1]
        polygon.n += 1
