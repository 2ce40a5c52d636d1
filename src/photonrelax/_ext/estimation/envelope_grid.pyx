"""Flux of triangles that falls on the texels of a grid, by exact overlap.

Triangles are gone through, not texels: each is divided at the lines of the grid that it crosses.
Bands of rows are computed side by side, each with its triangles in their order.
"""

from cython.parallel cimport prange, threadid
from libc.math cimport fabs, floor, rint, sqrt
from libc.stdint cimport int32_t, int64_t

import numpy as np

from ..common.threads cimport Watch, close_watch, goes_on, open_watch, team_size
from ..common.vec3 cimport dot
from .polygon cimport (
    MOST_CORNERS, Box, PlaneFrame, Polygon, area_of, is_line, longest_side, project, set_box,
    set_frame, split,
)

cdef enum:
    # Rows of a band at least, and bands at most.
    LEAST_ROWS = 8
    MOST_BANDS = 128
    # Triangles that are put into bands together.
    BLOCK = 8192

# Shares of texels are sums over the sides of a triangle while they keep twelve digits of it. Sides
# whose ends are nearer to each other in x are across.
cdef double MOST_DENSE = 1e2, ACROSS = 1e-15


cdef struct Grid:
    # Coordinates are in texels from a corner.
    PlaneFrame frame
    # Largest distance from the plane, m, and least cosine between normals.
    double slack
    double least_cosine
    int nx
    int ny
    int n_channels


def places(
    const double[:, ::1] points, const double[:, ::1] normals, const double[:, :, ::1] edges,
    const Py_ssize_t[::1] rows, *, double off, double[:, ::1] out,
):
    """Write places of footprints in the grid of the first, in texels; false if one is not of it.

    Parameters
    ----------
    points, normals, edges : (m, 3), (m, 3), (m, 2, 3)
        Centres, m, normals of any length, and edges.
    rows : (r,) intp array
        Footprints looked at, one at least.
    off : float
        Largest distance of a centre from that of a texel, over the shorter edge.
    out : (2, r)
        Whole numbers.
    """
    cdef PlaneFrame frame
    cdef Py_ssize_t i, r = rows.shape[0]
    cdef const double* first
    cdef double[2] place
    if not (
        points.shape[0] == normals.shape[0] == edges.shape[0] and r == out.shape[1] > 0
        and points.shape[1] == normals.shape[1] == edges.shape[2] == 3
        and edges.shape[1] == out.shape[0] == 2
        and 0 <= np.min(rows) and np.max(rows) < points.shape[0]
    ):
        raise ValueError("footprints and rows do not fit one another")
    first = &edges[rows[0], 0, 0]
    if not set_frame(&frame, &points[rows[0], 0], &normals[rows[0], 0], first):
        return False
    off = off * sqrt(min(dot(first, first), dot(first + 3, first + 3)))
    for i in range(r):
        if not (
            is_equal(&normals[rows[i], 0], &normals[rows[0], 0], 3)
            and is_equal(&edges[rows[i], 0, 0], first, 6)
            and find_place(&frame, &points[rows[i], 0], first, off, place)
        ):
            return False
        out[0, i], out[1, i] = place[0], place[1]
    return True


cdef bint is_equal(const double* a, const double* b, int n) noexcept nogil:
    cdef int c
    for c in range(n):
        if a[c] != b[c]:
            return False
    return True


cdef bint find_place(
    const PlaneFrame* frame, const double* point, const double* edges, double off, double* place
) noexcept nogil:
    """Write the texel whose centre a point is, counted from the origin; false if none."""
    cdef double[3] offset
    cdef int c
    for c in range(3):
        offset[c] = point[c] - frame.origin[c]
    place[0], place[1] = rint(dot(offset, frame.to_x)), rint(dot(offset, frame.to_y))
    for c in range(3):
        offset[c] -= place[0] * edges[c] + place[1] * edges[3 + c]
    return dot(offset, offset) <= off * off


def sums(
    const double[:, :, ::1] triangles, const double[:, ::1] normals, const double[:, ::1] values, *,
    const double[::1] origin, const double[:, ::1] edges, const double[::1] towards,
    double thickness, double least_cosine, double[:, :, ::1] out, int n_threads,
):
    """Write sums over texels of values that are spread evenly over triangles.

    Parameters
    ----------
    triangles, normals : (t, 3, 3), (t, 3)
        Corners, m, and the unit normals of the surfaces they lie on.
    values : (t, c)
    origin, edges, towards : (3,), (2, 3), (3,)
        Corner of the grid, the edges of a texel, and any vector on the side of the light.
    thickness : float
        Largest distance of a triangle from the plane over the size of a texel.
    least_cosine : float
        Of the angle between the normals of the plane and of light on it.
    out : (ny, nx, c)
    """
    cdef Grid grid
    cdef Py_ssize_t t = triangles.shape[0]
    if not (
        t == normals.shape[0] == values.shape[0] and triangles.shape[1] == triangles.shape[2] == 3
        and normals.shape[1] == 3 and values.shape[1] == out.shape[2]
        and origin.shape[0] == towards.shape[0] == edges.shape[1] == 3 and edges.shape[0] == 2
    ):
        raise ValueError("triangles, values and grid do not fit one another")
    out[:] = 0.0
    if t == 0 or out.size == 0 or not set_frame(&grid.frame, &origin[0], &towards[0], &edges[0, 0]):
        return
    grid.slack = thickness * sqrt(grid.frame.area)
    grid.least_cosine = least_cosine
    grid.ny, grid.nx, grid.n_channels = out.shape[0], out.shape[1], out.shape[2]
    rows = max(LEAST_ROWS, -(-grid.ny // MOST_BANDS))
    ids, ends = bands(&grid, triangles, normals, rows, n_threads)
    fill(&grid, triangles, values, ids, ends, rows, out, n_threads)


cdef bands(
    const Grid* grid, const double[:, :, ::1] triangles, const double[:, ::1] normals, int rows,
    int n_threads,
):
    """Triangles (k,) int32 that reach into each band of so many rows, band by band, and ends."""
    cdef Py_ssize_t t = triangles.shape[0], n_blocks = (t + BLOCK - 1) // BLOCK, block
    cdef Py_ssize_t n_bands = (grid.ny + rows - 1) // rows
    cdef int32_t[:, ::1] reach = np.empty((t, 2), np.int32)
    counts = np.zeros((n_bands, n_blocks), np.int64)
    cdef int64_t[:, ::1] place = counts
    cdef int32_t[::1] ids
    cdef Watch watch = open_watch()
    for block in prange(
        n_blocks, nogil=True, schedule="static", num_threads=team_size(n_threads, n_blocks, 1)
    ):
        if goes_on(&watch, threadid() == 0):
            find_bands(
                grid, triangles, normals, rows, block * BLOCK, min(block * BLOCK + BLOCK, t),
                reach, &place[0, block], n_blocks,
            )
    close_watch(&watch)
    ends = np.cumsum(counts)
    found = np.empty(ends[-1], np.int32)
    # Where the next triangle of each block goes.
    counts[:] = ends.reshape(counts.shape) - counts
    ids = found
    watch = open_watch()
    for block in prange(
        n_blocks, nogil=True, schedule="static", num_threads=team_size(n_threads, n_blocks, 1)
    ):
        if goes_on(&watch, threadid() == 0):
            write_bands(
                block * BLOCK, min(block * BLOCK + BLOCK, t), reach, &place[0, block], n_blocks, ids
            )
    close_watch(&watch)
    return found, ends.reshape(counts.shape)[:, -1].copy()


cdef void find_bands(
    const Grid* grid, const double[:, :, ::1] triangles, const double[:, ::1] normals, int rows,
    Py_ssize_t first, Py_ssize_t end, int32_t[:, ::1] reach, int64_t* count, Py_ssize_t stride,
) noexcept nogil:
    """Write the first and last band of some triangles, none where the first is beyond."""
    cdef Polygon triangle
    cdef Box box
    cdef Py_ssize_t i
    cdef int band
    for i in range(first, end):
        reach[i, 0], reach[i, 1] = 0, -1
        if not dot(&normals[i, 0], grid.frame.normal) > grid.least_cosine:
            continue
        if not project(&grid.frame, &triangles[i, 0, 0], grid.slack, &triangle):
            continue
        set_box(&box, &triangle)
        if not (
            box.low[0] < grid.nx and box.high[0] >= 0.0 and box.low[1] < grid.ny
            and box.high[1] >= 0.0
        ):
            continue
        reach[i, 0] = cell(box.low[1], grid.ny) // rows
        reach[i, 1] = cell(box.high[1], grid.ny) // rows
        for band in range(reach[i, 0], reach[i, 1] + 1):
            count[band * stride] += 1


cdef void write_bands(
    Py_ssize_t first, Py_ssize_t end, const int32_t[:, ::1] reach, int64_t* place,
    Py_ssize_t stride, int32_t[::1] ids,
) noexcept nogil:
    """Write the numbers of some triangles to each band they reach into."""
    cdef Py_ssize_t i
    cdef int band
    for i in range(first, end):
        for band in range(reach[i, 0], reach[i, 1] + 1):
            ids[place[band * stride]] = <int32_t>i
            place[band * stride] += 1


cdef fill(
    const Grid* grid, const double[:, :, ::1] triangles, const double[:, ::1] values,
    const int32_t[::1] ids, const int64_t[::1] ends, int rows, double[:, :, ::1] out,
    int n_threads,
):
    """Write the sums of all bands."""
    cdef Py_ssize_t band, n_bands = ends.shape[0]
    cdef Watch watch = open_watch()
    for band in prange(
        n_bands, nogil=True, schedule="dynamic", chunksize=1,
        num_threads=team_size(n_threads, n_bands, 1)
    ):
        if goes_on(&watch, threadid() == 0):
            fill_band(
                grid, triangles, values, ids, ends[band - 1] if band else 0, ends[band],
                <int>band * rows, min(<int>band * rows + rows, grid.ny), out,
            )
    close_watch(&watch)


cdef void fill_band(
    const Grid* grid, const double[:, :, ::1] triangles, const double[:, ::1] values,
    const int32_t[::1] ids, int64_t first, int64_t end, int low, int high, double[:, :, ::1] out,
) noexcept nogil:
    """Add triangles to the texels of rows from `low` up to `high`."""
    cdef Polygon triangle
    cdef double area, squared
    cdef int64_t k
    cdef int longest
    for k in range(first, end):
        project(&grid.frame, &triangles[ids[k], 0, 0], grid.slack, &triangle)
        longest = longest_side(&triangle, &squared)
        area = fabs(area_of(&triangle))
        if is_line(area, squared):
            add_line(
                grid, triangle.corner[longest], triangle.corner[(longest + 1) % 3], low, high,
                &values[ids[k], 0], &out[0, 0, 0],
            )
        else:
            add(grid, &triangle, 1.0 / area, low, high, &values[ids[k], 0], &out[0, 0, 0])


cdef int cell(double coordinate, int n) noexcept nogil:
    """Cell of n in a row that a coordinate is in; the first or last where it is beyond."""
    return <int>floor(min(max(coordinate, 0.0), n - 1.0))


cdef void add(
    const Grid* grid, const Polygon* triangle, double density, int low, int high,
    const double* values, double* out,
) noexcept nogil:
    """Add a triangle to rows from `low` up to `high`, which are split off one after the other."""
    cdef Polygon rest = triangle[0], strip, above
    cdef Box box
    cdef int row
    set_box(&box, triangle)
    if box.low[1] < low:
        split(triangle, 1, low, &strip, &rest)
    for row in range(max(low, cell(box.low[1], grid.ny)), high):
        if box.high[1] <= row + 1:
            add_to_row(grid, &rest, density, row, values, out)
            return
        split(&rest, 1, row + 1, &strip, &above)
        add_to_row(grid, &strip, density, row, values, out)
        rest = above


cdef void add_to_row(
    const Grid* grid, const Polygon* strip, double density, int row, const double* values,
    double* out,
) noexcept nogil:
    """Add the part of a triangle in a row to its texels."""
    cdef Polygon rest, left, right
    cdef Box box
    cdef int column
    if strip.n < 3:
        return
    set_box(&box, strip)
    if box.high[0] <= 0.0 or box.low[0] >= grid.nx:
        return
    column = cell(box.low[0], grid.nx)
    if box.low[0] >= 0.0 and box.high[0] <= column + 1:
        add_share(grid, density * fabs(area_of(strip)), row, column, values, out)
        return
    if density <= MOST_DENSE:
        add_below_sides(grid, strip, density, row, &box, values, out)
        return
    # Split off one after the other.
    rest = strip[0]
    if box.low[0] < 0.0:
        split(strip, 0, 0.0, &left, &rest)
    for column in range(cell(box.low[0], grid.nx), grid.nx):
        if box.high[0] <= column + 1:
            add_share(grid, density * fabs(area_of(&rest)), row, column, values, out)
            return
        split(&rest, 0, column + 1, &left, &right)
        add_share(grid, density * fabs(area_of(&left)), row, column, values, out)
        rest = right


cdef void add_below_sides(
    const Grid* grid, const Polygon* strip, double density, int row, const Box* box,
    const double* values, double* out,
) noexcept nogil:
    """Add the part of a triangle in a row to its texels, by areas between the row and its sides."""
    cdef double[MOST_CORNERS] left, right, height, slope
    cdef double area, enter, leave, turn = 1.0 if area_of(strip) < 0.0 else -1.0
    cdef int i, j, column, n = 0, first = cell(box.low[0], grid.nx)
    # From the first column, so that shares keep their digits wherever they are.
    for i in range(strip.n):
        j = i + 1 if i + 1 < strip.n else 0
        enter, leave = strip.corner[i][0] - first, strip.corner[j][0] - first
        if fabs(leave - enter) < ACROSS or strip.corner[i][1] == row == strip.corner[j][1]:
            continue
        slope[n] = (strip.corner[j][1] - strip.corner[i][1]) / (leave - enter)
        left[n], right[n], height[n] = enter, leave, strip.corner[i][1] - row
        n += 1
    for column in range(cell(box.high[0], grid.nx) + 1 - first):
        area = 0.0
        for i in range(n):
            enter = min(max(left[i], column), column + 1.0)
            leave = min(max(right[i], column), column + 1.0)
            area += (leave - enter) * (
                height[i] + slope[i] * (0.5 * (enter + leave) - left[i])
            )
        add_share(grid, max(turn * density * area, 0.0), row, first + column, values, out)


cdef void add_line(
    const Grid* grid, const double* start, const double* end, int low, int high,
    const double* values, double* out,
) noexcept nogil:
    """Add a line, or a point, to rows from `low` up to `high`.

    Of texels that share a side one has what lies on it: that of larger coordinates.
    """
    cdef double[2] part, share
    cdef int row, column, first, last
    for row in range(
        max(low, cell(min(start[1], end[1]), grid.ny)),
        min(high, cell(max(start[1], end[1]), grid.ny) + 1)
    ):
        if not set_part(part, start[1], end[1], row, 0.0, 1.0):
            continue
        first = cell(start[0] + part[0] * (end[0] - start[0]), grid.nx)
        last = cell(start[0] + part[1] * (end[0] - start[0]), grid.nx)
        for column in range(min(first, last), max(first, last) + 1):
            if set_part(share, start[0], end[0], column, part[0], part[1]):
                add_share(grid, share[1] - share[0], row, column, values, out)


cdef bint set_part(
    double* part, double start, double end, int cell, double enter, double leave
) noexcept nogil:
    """Write the part of a line, from `enter` to `leave` at most, in a cell; false for none."""
    cdef double change = end - start, here, there
    part[0], part[1] = enter, leave
    if change == 0.0:
        return cell <= start < cell + 1
    here, there = (cell - start) / change, (cell + 1 - start) / change
    part[0] = max(enter, min(here, there))
    part[1] = min(leave, max(here, there))
    return part[1] > part[0]


cdef void add_share(
    const Grid* grid, double share, int row, int column, const double* values, double* out
) noexcept nogil:
    """Add a share of values to a texel."""
    cdef double* to = out + (<Py_ssize_t>row * grid.nx + column) * grid.n_channels
    cdef int c
    for c in range(grid.n_channels):
        to[c] += share * values[c]
