"""Flux of triangles that falls on footprints, by exact overlap."""

from cython.parallel cimport prange, threadid
from libc.math cimport fabs, sqrt

from ..common.threads cimport Watch, close_watch, goes_on, open_watch, team_size
from ..common.vec3 cimport dot
from ..spatial.box_tree cimport FAN, BoxTree, BoxVisit, open_visit, squared_gap, step_over
from .polygon cimport (
    Box, PlaneFrame, Polygon, area_of, is_line, longest_side, project, set_box, set_frame,
)

import numpy as np

cdef enum:
    LOOK_EVERY = 256
    GRAIN = 64


cdef enum Reach:
    # Of a square, that is inside of the sides of a polygon.
    NONE
    SOME
    ALL


def node_sums(BoxTree tree, values):
    """Sums (rows, c) of values (t, c) of triangles over the nodes of their tree."""
    return over_nodes(tree, values, np.add)


def node_normals(BoxTree tree, normals):
    """Least and greatest components (rows, 6) of normals (t, 3) in the nodes of their tree."""
    return np.hstack([over_nodes(tree, normals, each) for each in (np.minimum, np.maximum)])


def over_nodes(BoxTree tree, columns, combine):
    """Columns (t, c) of triangles, combined in each node, level by level as the tree's bounds."""
    level = columns[np.asarray(tree.ids)]
    levels = [level]
    while len(level) > 1:
        level = combine.reduceat(level, np.arange(0, len(level), FAN))
        levels.append(level)
    return np.concatenate(levels)


def means(
    BoxTree tree, const double[:, :, ::1] triangles, const double[:, ::1] normals,
    const double[:, ::1] sums, const double[:, ::1] points, const double[:, ::1] towards,
    const double[:, :, ::1] edges, const Py_ssize_t[::1] rows, *, double thickness,
    double least_cosine, double[:, ::1] out, int n_threads,
):
    """Write means over footprints of values that are spread evenly over triangles.

    Parameters
    ----------
    tree : BoxTree
        Of the triangles.
    triangles : (t, 3, 3)
        Corners, m.
    normals, sums : (rows, 6), (rows, c)
        Bounds of the unit normals of the surfaces they lie on, and sums of values; of all nodes.
    points, towards : (m, 3), edges (m, 2, 3)
        Centres, normals of any length, and edges of the footprints.
    rows : (r,) intp array
        Rows of the footprints whose means are wanted.
    thickness : float
        Largest distance of a triangle from the plane of a footprint over the size of that.
    least_cosine : float
        Of the angle between the normals of a footprint and of light on it.
    out : (r, c) float64 array
        Values per m².
    """
    cdef Py_ssize_t i, m = points.shape[0], r = rows.shape[0]
    cdef Watch watch = open_watch()
    if not (
        tree.n_boxes == triangles.shape[0] and triangles.shape[1] == triangles.shape[2] == 3
        and tree.bounds.shape[0] == normals.shape[0] == sums.shape[0] and normals.shape[1] == 6
        and m == towards.shape[0] == edges.shape[0] and r == out.shape[0]
        and points.shape[1] == towards.shape[1] == edges.shape[2] == 3 and edges.shape[1] == 2
        and out.shape[1] == sums.shape[1]
    ):
        raise ValueError("triangles, footprints and values do not fit one another")
    for i in range(r):
        if not 0 <= rows[i] < m:
            raise ValueError(f"rows should be of {m} footprints, but one is {rows[i]}")
    for i in prange(
        r, nogil=True, schedule="dynamic", chunksize=GRAIN,
        num_threads=team_size(n_threads, r, GRAIN)
    ):
        if goes_on(&watch, threadid() == 0 and i % LOOK_EVERY == 0):
            mean_over(
                tree, triangles, normals, sums, &points[rows[i], 0], &towards[rows[i], 0],
                &edges[rows[i], 0, 0], thickness, least_cosine, &out[i, 0],
            )
    close_watch(&watch)


cdef void mean_over(
    BoxTree tree, const double[:, :, ::1] triangles, const double[:, ::1] normals,
    const double[:, ::1] sums, const double* point, const double* towards, const double* edges,
    double thickness, double least_cosine, double* out,
) noexcept nogil:
    """Write the mean of one footprint; nodes that lie in it add their sums."""
    cdef PlaneFrame footprint
    cdef BoxVisit visit
    cdef double[3] low, high
    cdef double share, slack
    cdef Py_ssize_t c, row
    for c in range(sums.shape[1]):
        out[c] = 0.0
    if not set_frame(&footprint, point, towards, edges):
        return
    slack = thickness * sqrt(footprint.area)
    for c in range(3):
        share = 0.5 * (fabs(edges[c]) + fabs(edges[3 + c])) + slack * fabs(footprint.normal[c])
        low[c], high[c] = point[c] - share, point[c] + share
    visit = open_visit(tree, low, high, 0.0)
    while 0 <= visit.level <= tree.root:
        row = visit.row
        share = 0.0
        if squared_gap(&tree.bounds[row, 0], low, high) <= 0.0:
            if visit.level == 0:
                if dot(&normals[row, 0], footprint.normal) > least_cosine:
                    share = share_within(&footprint, &triangles[tree.ids[row], 0, 0], slack)
            elif holds(
                &footprint, &tree.bounds[row, 0], &normals[row, 0], slack, least_cosine
            ):
                share = 1.0
            else:
                visit.level -= 1
                visit.row = tree.first[visit.level] + FAN * (row - tree.first[visit.level + 1])
                continue
        step_over(tree, &visit)
        if share > 0.0:
            for c in range(sums.shape[1]):
                out[c] += share * sums[row, c]
    for c in range(sums.shape[1]):
        out[c] /= footprint.area


cdef bint holds(
    const PlaneFrame* footprint, const double* bounds, const double* normals, double slack,
    double least_cosine
) noexcept nogil:
    """True if all triangles between bounds, with normals between others, count as a whole."""
    cdef double[3] middle, half
    cdef double least = 0.0
    cdef int c
    for c in range(3):
        middle[c] = 0.5 * (bounds[c] + bounds[3 + c]) - footprint.origin[c]
        half[c] = 0.5 * (bounds[3 + c] - bounds[c])
        least += min(normals[c] * footprint.normal[c], normals[3 + c] * footprint.normal[c])
    return (
        least > least_cosine
        and farthest(footprint.to_x, middle, half) < 0.5
        and farthest(footprint.to_y, middle, half) < 0.5
        and farthest(footprint.normal, middle, half) < slack
    )


cdef double farthest(const double* axis, const double* middle, const double* half) noexcept nogil:
    """Largest magnitude of a coordinate in a box."""
    cdef double reach = 0.0
    cdef int c
    for c in range(3):
        reach += fabs(axis[c]) * half[c]
    return fabs(dot(middle, axis)) + reach


cdef double share_within(
    const PlaneFrame* footprint, const double* triangle, double slack
) noexcept nogil:
    """Share of a triangle that lies in a footprint, seen along the normal."""
    cdef Polygon polygon
    cdef Box box
    cdef double whole, squared
    cdef int i, reach, longest
    if not project(footprint, triangle, slack, &polygon):
        return 0.0
    whole, longest = area_of(&polygon), longest_side(&polygon, &squared)
    if is_line(whole, squared):
        return share_of_line(polygon.corner[longest], polygon.corner[(longest + 1) % 3])
    set_box(&box, &polygon)
    if not box.low[0] < 0.5 or not box.high[0] > -0.5 or not box.low[1] < 0.5 or (
        not box.high[1] > -0.5
    ):
        return 0.0
    reach = reach_of_sides(&polygon, 1.0 if whole > 0.0 else -1.0)
    whole = fabs(whole)
    if reach == NONE:
        return 0.0
    if reach == ALL:
        return 1.0 / whole
    for i in range(2):
        if box.low[i] < -0.5:
            clip(&polygon, i, -1.0)
        if box.high[i] > 0.5:
            clip(&polygon, i, 1.0)
        if polygon.n < 3:
            return 0.0
    return fabs(area_of(&polygon)) / whole


cdef int reach_of_sides(const Polygon* polygon, double turn) noexcept nogil:
    """Which of the square lies inside of all sides of a polygon that turns to one side.

    `NONE` if it is outside of one of them: light is streaks, of which most only come near.
    """
    cdef int i, j, reach = ALL
    cdef double x, y, inside, spread
    for i in range(polygon.n):
        j = i + 1 if i + 1 < polygon.n else 0
        x = turn * (polygon.corner[j][0] - polygon.corner[i][0])
        y = turn * (polygon.corner[j][1] - polygon.corner[i][1])
        # Of the centre, and by how much corners are farther in or out.
        inside = y * polygon.corner[i][0] - x * polygon.corner[i][1]
        spread = 0.5 * (fabs(x) + fabs(y))
        if inside <= -spread:
            return NONE
        if inside < spread:
            reach = SOME
    return reach


cdef void clip(Polygon* polygon, int axis, double side) noexcept nogil:
    """Cut a convex polygon at side · coordinate <= 1/2 (Sutherland & Hodgman 1974)."""
    cdef Polygon cut
    cdef double here, there, t
    cdef int i, j
    cut.n = 0
    for i in range(polygon.n):
        j = i + 1 if i + 1 < polygon.n else 0
        here = 0.5 - side * polygon.corner[i][axis]
        there = 0.5 - side * polygon.corner[j][axis]
        if here >= 0.0:
            cut.corner[cut.n] = polygon.corner[i]
            cut.n += 1
        if (here >= 0.0) != (there >= 0.0):
            t = here / (here - there)
            cut.corner[cut.n][axis] = 0.5 * side
            cut.corner[cut.n][1 - axis] = polygon.corner[i][1 - axis] + t * (
                polygon.corner[j][1 - axis] - polygon.corner[i][1 - axis]
            )
            cut.n += 1
    polygon[0] = cut


cdef double share_of_line(const double* start, const double* end) noexcept nogil:
    """Share of a line that lies within; of a point, whether it does."""
    cdef double enter = 0.0, leave = 1.0, change, t
    cdef int axis
    for axis in range(2):
        change = end[axis] - start[axis]
        if change == 0.0:
            # Of footprints that share an edge one has what lies on it.
            if not -0.5 <= start[axis] < 0.5:
                return 0.0
            continue
        t = (-0.5 - start[axis]) / change
        enter = max(enter, min(t, (0.5 - start[axis]) / change))
        leave = min(leave, max(t, (0.5 - start[axis]) / change))
    return max(leave - enter, 0.0)
