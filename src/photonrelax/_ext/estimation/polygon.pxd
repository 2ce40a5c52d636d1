"""Convex polygons of a plane, as inline functions for kernels."""

from libc.math cimport INFINITY, fabs, sqrt

from ..common.vec3 cimport cross, dot


cdef enum:
    # Corners of a triangle cut by the four sides of a square, at most, and one for rounding.
    MOST_CORNERS = 8


cdef struct Polygon:
    int n
    double[MOST_CORNERS][2] corner


cdef struct Box:
    double[2] low
    double[2] high


cdef struct PlaneFrame:
    # Origin, and rows that give coordinates from there, in edges of the area that they span.
    double[3] origin
    double[3] to_x
    double[3] to_y
    double[3] normal
    double area


cdef inline bint set_frame(
    PlaneFrame* out, const double* origin, const double* towards, const double* edges
) noexcept nogil:
    """Write the frame of two edges, its normal on the side of a vector; false without an area."""
    cdef double[3] normal
    cdef int c
    cross(normal, edges, edges + 3)
    out.area = sqrt(dot(normal, normal))
    if not out.area > 0.0:
        return False
    for c in range(3):
        out.origin[c] = origin[c]
        out.normal[c] = normal[c] / out.area
    # Coordinates x, y of p = x edge_x + y edge_y, by the dual basis.
    cross(out.to_x, edges + 3, out.normal)
    cross(out.to_y, out.normal, edges)
    for c in range(3):
        out.to_x[c] /= out.area
        out.to_y[c] /= out.area
    if dot(out.normal, towards) < 0.0:
        for c in range(3):
            out.normal[c] = -out.normal[c]
    return True


cdef inline bint project(
    const PlaneFrame* frame, const double* triangle, double slack, Polygon* out
) noexcept nogil:
    """Write the corners of a triangle in a frame; false if none is near its plane."""
    cdef double[3] offset
    cdef double nearest = INFINITY
    cdef int i, c
    out.n = 3
    for i in range(3):
        for c in range(3):
            offset[c] = triangle[3 * i + c] - frame.origin[c]
        out.corner[i][0] = dot(offset, frame.to_x)
        out.corner[i][1] = dot(offset, frame.to_y)
        nearest = min(nearest, fabs(dot(offset, frame.normal)))
    return nearest <= slack


cdef inline void set_box(Box* box, const Polygon* polygon) noexcept nogil:
    """Write the bounds of a polygon."""
    cdef int i, axis
    for axis in range(2):
        box.low[axis] = box.high[axis] = polygon.corner[0][axis]
        for i in range(1, polygon.n):
            box.low[axis] = min(box.low[axis], polygon.corner[i][axis])
            box.high[axis] = max(box.high[axis], polygon.corner[i][axis])


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
