"""Means of textures over parallelograms: each texel counts by its area inside.

Every loop body writes only row i.
"""

from libc.math cimport fabs, floor
from libc.stdint cimport uint8_t

import numpy as np

WRAPS = {"repeat": REPEAT, "mirror": MIRROR, "clamp": CLAMP}

# Corners of a parallelogram that is clipped by four lines, at most.
cdef enum:
    MAX_CORNERS = 12

# Area of a parallelogram over that of a square of its edges' length, below which it is a point.
cdef double THIN = 1e-12


cdef struct Polygon:
    int n
    double[MAX_CORNERS] x
    double[MAX_CORNERS] y


def means(
    const uint8_t[:, :, ::1] bytes, const float[:, :, ::1] floats, const double[::1] meaning,
    const double[:, ::1] centre, const double[:, :, ::1] edges, int wrap_u, int wrap_v,
):
    """Means (m, 3) of texels over parallelograms.

    Parameters
    ----------
    bytes, floats : (height, width, 3)
        Texels, row 0 on top; one of both is None.
    meaning : (256,)
        Of bytes.
    centre : (m, 2)
        Of the parallelograms, to the right and down from the top left corner, in texels.
    edges : (m, 2, 2)
        Their edges, in texels; where they span no area the texel at the centre counts.
    wrap_u, wrap_v : int
        Wrap modes to the right and down.
    """
    cdef Py_ssize_t i, m = centre.shape[0]
    cdef double[:, ::1] out = np.zeros((m, 3))
    cdef TextureView view
    cdef Polygon polygon
    cdef double left, top
    if not (centre.shape[1] == edges.shape[1] == edges.shape[2] == 2 and edges.shape[0] == m):
        raise ValueError("centres and edges do not fit one another")
    view.wrap_u, view.wrap_v = wrap_u, wrap_v
    view.bytes, view.floats, view.meaning = NULL, NULL, &meaning[0]
    if bytes is None:
        view.floats = &floats[0, 0, 0]
        view.height, view.width = floats.shape[0], floats.shape[1]
    else:
        view.bytes = &bytes[0, 0, 0]
        view.height, view.width = bytes.shape[0], bytes.shape[1]
    with nogil:
        for i in range(m):
            left, top = floor(centre[i, 0]), floor(centre[i, 1])
            set_corners(&polygon, centre[i, 0] - left, centre[i, 1] - top, &edges[i, 0, 0])
            mean_over(&out[i, 0], &view, &polygon, left, top)
    return out.base


cdef void set_corners(Polygon* out, double x, double y, const double* edges) noexcept nogil:
    """Write the corners of a parallelogram around a centre, in order."""
    cdef double[4] along = [-0.5, 0.5, 0.5, -0.5]
    cdef double[4] across = [-0.5, -0.5, 0.5, 0.5]
    cdef int k
    out.n = 4
    for k in range(4):
        out.x[k] = x + along[k] * edges[0] + across[k] * edges[2]
        out.y[k] = y + along[k] * edges[1] + across[k] * edges[3]


cdef void mean_over(
    double* out, const TextureView* view, const Polygon* polygon, double left, double top
) noexcept nogil:
    """Write the mean over a polygon, relative to the corner of a texel."""
    cdef Polygon below, strip
    cdef double row, low = polygon.y[0], high = polygon.y[0], width = polygon.x[0]
    cdef double narrow = polygon.x[0], total = area(polygon), extent
    cdef int k, c
    for k in range(polygon.n):
        low, high = min(low, polygon.y[k]), max(high, polygon.y[k])
        narrow, width = min(narrow, polygon.x[k]), max(width, polygon.x[k])
    extent = max(high - low, width - narrow)
    if not total > THIN * extent * extent:
        add_at(out, view, left, top, 1.0)
        return
    row = floor(low)
    while row < high:
        clip(&below, polygon, 1, row, 1.0)
        clip(&strip, &below, 1, row + 1.0, -1.0)
        add_strip(out, view, &strip, left, top + row)
        row += 1.0
    for c in range(3):
        out[c] /= total


cdef void add_strip(
    double* out, const TextureView* view, const Polygon* strip, double left, double row
) noexcept nogil:
    """Add the texels of one row times their areas in a polygon that lies in it."""
    cdef Polygon beyond, part
    cdef double column, end
    cdef int k
    if strip.n < 3:
        return
    column = end = strip.x[0]
    for k in range(strip.n):
        column, end = min(column, strip.x[k]), max(end, strip.x[k])
    column = floor(column)
    clip(&beyond, strip, 0, column, 1.0)
    while column < end:
        clip(&part, &beyond, 0, column + 1.0, -1.0)
        add_at(out, view, left + column, row, area(&part))
        column += 1.0
        if column < end:
            clip(&part, &beyond, 0, column, 1.0)
            beyond = part


cdef void add_at(
    double* out, const TextureView* view, double column, double row, double weight
) noexcept nogil:
    add_texel(
        out, view, wrapped(row, view.height, view.wrap_v),
        wrapped(column, view.width, view.wrap_u), weight,
    )


cdef void clip(
    Polygon* out, const Polygon* polygon, int axis, double at, double side
) noexcept nogil:
    """Write the part of a convex polygon beyond a line across an axis, on one side of it."""
    cdef double x0, y0, x1, y1, d0, d1, t
    cdef int k, j
    out.n = 0
    for k in range(polygon.n):
        j = k + 1 if k + 1 < polygon.n else 0
        x0, y0, x1, y1 = polygon.x[k], polygon.y[k], polygon.x[j], polygon.y[j]
        d0 = side * ((y0 if axis else x0) - at)
        d1 = side * ((y1 if axis else x1) - at)
        if d0 >= 0.0:
            add_corner(out, x0, y0)
        if (d0 >= 0.0) != (d1 >= 0.0):
            t = d0 / (d0 - d1)
            add_corner(
                out, x0 + t * (x1 - x0) if axis else at, at if axis else y0 + t * (y1 - y0)
            )


cdef void add_corner(Polygon* out, double x, double y) noexcept nogil:
    if out.n < MAX_CORNERS:
        out.x[out.n], out.y[out.n] = x, y
        out.n += 1


cdef double area(const Polygon* polygon) noexcept nogil:
    cdef double doubled = 0.0
    cdef int k, j
    for k in range(polygon.n):
        j = k + 1 if k + 1 < polygon.n else 0
        doubled += polygon.x[k] * polygon.y[j] - polygon.x[j] * polygon.y[k]
    return 0.5 * fabs(doubled)
