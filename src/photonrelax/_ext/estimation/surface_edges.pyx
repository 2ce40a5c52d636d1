"""The edges of surface_edges.pxd."""

from cython cimport final
from cython.parallel cimport prange, threadid
from libc.math cimport fabs, fmax, fmin, sqrt
from libc.stdint cimport int32_t

import numpy as np

from ..common.threads cimport Watch, close_watch, goes_on, open_watch, team_size
from ..common.vec3 cimport dot, orthonormal_frame
from ..spatial.box_tree cimport boxes_within
from .rectangle cimport largest_stretch
from .surface_integrals cimport SURFACE_WITHIN, share_of_radial, squared_of_disc

cdef enum:
    # Points that a thread takes at a time.
    GRAIN = 64

# Distance from an edge up to which a point is on it: in radii, in coordinates, for positions that
# were rounded to float32, and in radii at most.
cdef double ON_EDGE = 1e-6
cdef double ROUNDED = 1.2e-7
cdef double AT_MOST = 1e-3
# Length of the sum of unit normals of edges below which they run against one another.
cdef double NO_DIRECTION = 0.1
# Part along edges of the step that points on them are moved by: where edges meet it is along none.
cdef double SLANT = 0.05
# Height of an edge over a footprint's plane, in distances from its middle, up to which it is one of
# the same surface: where that turns by an angle, no more than its tangent and a little, as edges of
# another face that is parallel are not.
cdef double SLOPE = 0.5
cdef double LITTLE = 0.01
# Cosine between normals of the footprint and of a surface that counts, cos 60°, at least.
cdef double MIN_COSINE = 0.5


cdef class SurfaceEdges:
    """Edges of surfaces in a box tree.

    Parameters
    ----------
    tree : BoxTree
        Of the boxes of the segments.
    segments : (n, 2, 3) float64 array
        Ends, m; the surface is to the left where it is seen from the side of the normal.
    normals : (n, 3) float64 array
        Unit normals of the surface at each.
    one_sided : (n,) bool array
        True where only light on the side of the normal has an edge there.
    """

    def __init__(self, tree, segments, normals, one_sided):
        self.tree = tree
        self.segments = segments
        self.normals = normals
        self.one_sided = one_sided.view(np.uint8)
        if not (
            self.segments.shape[0] == self.normals.shape[0] == self.tree.n_boxes
            and self.one_sided.shape[0] == self.tree.n_boxes
            and self.segments.shape[1] == 2 and self.segments.shape[2] == 3
            and self.normals.shape[1] == 3
        ):
            raise ValueError("segments, normals and their tree do not fit one another")


cdef class EdgeSearch:
    """Edges near footprints, with scratch memory for each thread.

    Parameters
    ----------
    edges : SurfaceEdges
    n_threads : int
    """

    def __init__(self, SurfaceEdges edges, int n_threads):
        cdef Py_ssize_t room = max(edges.tree.n_boxes, 1)
        self.edges = edges
        self.n_threads = n_threads
        self.found = np.empty((n_threads, room), dtype=np.int32)
        self.ends = np.empty((n_threads, 4 * room))

    cdef void find(
        self, const Rectangle* rectangle, double radius, int thread, NearEdges* near
    ) noexcept nogil:
        """Find the edges within a radius of a footprint."""
        near.ends = &self.ends[thread, 0]
        find_edges(self.edges, rectangle, radius, &self.found[thread, 0], near)


# Edges near a footprint

cdef struct Nearest:
    # Distance of the nearest edges; the normal into the surface of one of them, and the sums of all
    # normals and of the distances from the middle to their lines, negative on the other side. An
    # edge whose end is nearest counts half, as there are two of them.
    double distance
    double[2] normal_of_one
    double[2] normal
    double height


cdef void find_edges(
    SurfaceEdges edges, const Rectangle* rectangle, double radius, int32_t* found, NearEdges* near
) noexcept nogil:
    """Find the edges within a radius of a footprint; `found` and `near.ends` have room for all."""
    cdef double diagonal = sqrt(
        rectangle.half[0] * rectangle.half[0] + rectangle.half[1] * rectangle.half[1]
    )
    cdef double reach = largest_stretch(rectangle) * (radius + diagonal)
    cdef double on_edge = fmin(ON_EDGE * radius + ROUNDED * size_of(rectangle.at), AT_MOST * radius)
    cdef Py_ssize_t n = boxes_within(
        edges.tree, rectangle.at, reach, found, edges.segments.shape[0]
    )
    cdef Nearest nearest
    cdef Py_ssize_t i
    near.n = 0
    near.inside = True
    nearest.distance = reach
    for i in range(n):
        add_edge(edges, found[i], rectangle, on_edge, &nearest, near)
    if near.n == 0:
        return
    nearest.normal[0] = nearest.normal[1] = nearest.height = 0.0
    for i in range(near.n):
        compare_edge(&near.ends[4 * i], on_edge, &nearest)
    near.inside = nearest.height >= -on_edge
    if nearest.distance <= on_edge:
        near.inside = True
        leave_edge(near, &nearest, 2.0 * on_edge)


cdef void add_edge(
    SurfaceEdges edges, Py_ssize_t i, const Rectangle* rectangle, double on_edge,
    Nearest* nearest, NearEdges* near
) noexcept nogil:
    """Append an edge to those near a footprint if it is one of the same surface."""
    cdef double cosine = dot(&edges.normals[i, 0], &rectangle.axes[6])
    cdef double* ends = &near.ends[4 * near.n]
    cdef double[2] height
    cdef double[3] offset
    cdef double along, distance, across
    cdef Py_ssize_t end, place, axis
    if (cosine if edges.one_sided[i] else fabs(cosine)) < MIN_COSINE:
        return
    for end in range(2):
        for axis in range(3):
            offset[axis] = edges.segments[i, end, axis] - rectangle.at[axis]
        # Seen from the other side the surface is to the right.
        place = end if cosine > 0.0 else 1 - end
        ends[2 * place] = dot(offset, &rectangle.axes[0])
        ends[2 * place + 1] = dot(offset, &rectangle.axes[3])
        height[place] = dot(offset, &rectangle.axes[6])
    distance = distance_of(ends, &along)
    across = fabs(height[0] + along * (height[1] - height[0]))
    if across > fmin(SLOPE, LITTLE + tangent(cosine)) * distance + on_edge:
        return
    near.n += 1
    nearest.distance = fmin(nearest.distance, distance)


cdef inline double tangent(double cosine) noexcept nogil:
    """Tangent of the acute angle of a cosine, at most that of `MIN_COSINE`."""
    return sqrt(fmax(1.0 - cosine * cosine, 0.0)) / fmax(fabs(cosine), MIN_COSINE)


cdef inline double distance_of(const double* ends, double* along) noexcept nogil:
    """Distance of the middle from an edge; sets the place of the nearest point, in [0, 1]."""
    cdef double dx = ends[2] - ends[0], dy = ends[3] - ends[1]
    cdef double squared = dx * dx + dy * dy
    cdef double x, y
    along[0] = 0.0
    if squared > 0.0:
        along[0] = fmin(fmax(-(ends[0] * dx + ends[1] * dy) / squared, 0.0), 1.0)
    x = ends[0] + along[0] * dx
    y = ends[1] + along[0] * dy
    return sqrt(x * x + y * y)


cdef void compare_edge(const double* ends, double on_edge, Nearest* nearest) noexcept nogil:
    """Add an edge to the sums over the nearest ones, if it is one of them."""
    cdef double along, dx = ends[2] - ends[0], dy = ends[3] - ends[1]
    cdef double length = sqrt(dx * dx + dy * dy), weight, end
    cdef double limit = nearest.distance + on_edge
    if length == 0.0 or distance_of(ends, &along) > limit:
        return
    end = fmin(
        ends[0] * ends[0] + ends[1] * ends[1], ends[2] * ends[2] + ends[3] * ends[3]
    )
    weight = 0.5 if end <= limit * limit else 1.0
    nearest.normal_of_one[0] = -dy / length
    nearest.normal_of_one[1] = dx / length
    nearest.normal[0] += weight * nearest.normal_of_one[0]
    nearest.normal[1] += weight * nearest.normal_of_one[1]
    nearest.height += weight * (dy * ends[0] - dx * ends[1]) / length


cdef void leave_edge(NearEdges* near, const Nearest* nearest, double step) noexcept nogil:
    """Move the middle off the edges that it is on, onto the surface."""
    cdef double x = nearest.normal[0], y = nearest.normal[1]
    cdef double length = sqrt(x * x + y * y)
    cdef Py_ssize_t i
    if length < NO_DIRECTION:
        # On a seam: either side is surface.
        x, y = nearest.normal_of_one[0], nearest.normal_of_one[1]
        length = 1.0
    for i in range(2 * near.n):
        near.ends[2 * i] -= step * (x - SLANT * y) / length
        near.ends[2 * i + 1] -= step * (y + SLANT * x) / length


cdef inline double size_of(const double* at) noexcept nogil:
    return fmax(fabs(at[0]), fmax(fabs(at[1]), fabs(at[2])))


cdef void transform(NearEdges* near, const double* matrix) noexcept nogil:
    """Transform the plane by a matrix of two rows, which keeps orientations."""
    cdef double* end
    cdef double x
    cdef Py_ssize_t i
    for i in range(2 * near.n):
        end = &near.ends[2 * i]
        x = matrix[0] * end[0] + matrix[1] * end[1]
        end[1] = matrix[2] * end[0] + matrix[3] * end[1]
        end[0] = x


# Points

@final
cdef class PointsNearEdges:
    """Points on surfaces, and the edges near them."""

    cdef EdgeSearch search
    cdef const double[:, ::1] points
    cdef const double[:, ::1] normals

    def __init__(self, SurfaceEdges edges, points, normals, int n_threads):
        self.search = EdgeSearch(edges, n_threads)
        self.points = points
        self.normals = normals
        if not (
            self.points.shape[0] == self.normals.shape[0]
            and self.points.shape[1] == self.normals.shape[1] == 3
        ):
            raise ValueError("points and normals do not fit one another")

    cdef void find(
        self, Py_ssize_t row, double radius, int thread, NearEdges* near
    ) noexcept nogil:
        """Find the edges within a radius of a point."""
        cdef Rectangle rectangle
        cdef Py_ssize_t axis
        for axis in range(3):
            rectangle.axes[6 + axis] = self.normals[row, axis]
            rectangle.half[axis] = 0.0
        orthonormal_frame(&rectangle.axes[0], &rectangle.axes[3], &rectangle.axes[6])
        rectangle.at = &self.points[row, 0]
        self.search.find(&rectangle, radius, thread, near)


def shares(
    SurfaceEdges edges, points, normals, const double[::1] radius, *, int kernel, int n_threads
):
    """Parts (m,) that lie on surface of the kernels with given radii (m,) at points (m, 3).

    `normals` (m, 3) have unit length.
    """
    cdef PointsNearEdges work = PointsNearEdges(edges, points, normals, n_threads)
    cdef Py_ssize_t n = work.points.shape[0], i
    if radius.shape[0] != n:
        raise ValueError("radii do not fit the points")
    cdef double[::1] out = np.empty(n)
    cdef Watch watch = open_watch()
    for i in prange(
        n, nogil=True, schedule="dynamic", chunksize=GRAIN,
        num_threads=team_size(n_threads, n, GRAIN)
    ):
        if goes_on(&watch, threadid() == 0):
            out[i] = share_at_point(work, i, radius[i], kernel, threadid())
    close_watch(&watch)
    return np.asarray(out)


def largest_radii(SurfaceEdges edges, points, normals, *, double radius, int n_threads):
    """Radii (m,) of the discs around points with as much surface as one without edges.

    They are at most `SURFACE_WITHIN` times the radius, and the radius where no edge is near.
    """
    cdef PointsNearEdges work = PointsNearEdges(edges, points, normals, n_threads)
    cdef Py_ssize_t n = work.points.shape[0], i
    cdef double[::1] out = np.empty(n)
    cdef Watch watch = open_watch()
    for i in prange(
        n, nogil=True, schedule="dynamic", chunksize=GRAIN,
        num_threads=team_size(n_threads, n, GRAIN)
    ):
        if goes_on(&watch, threadid() == 0):
            out[i] = largest_at_point(work, i, radius, threadid())
    close_watch(&watch)
    return np.asarray(out)


def near_edges(
    SurfaceEdges edges, const double[:, ::1] points, double radius, int n_threads
):
    """Mask (m,) of the points (m, 3) with the box of an edge within the largest of their radii."""
    cdef Py_ssize_t n = points.shape[0], i
    cdef double reach = SURFACE_WITHIN * radius
    if points.shape[1] != 3:
        raise ValueError("points should have three coordinates")
    found = np.empty(n, dtype=bool)
    cdef unsigned char[::1] out = found.view(np.uint8)
    cdef Watch watch = open_watch()
    for i in prange(
        n, nogil=True, schedule="dynamic", chunksize=GRAIN,
        num_threads=team_size(n_threads, n, GRAIN)
    ):
        if goes_on(&watch, threadid() == 0):
            out[i] = boxes_within(edges.tree, &points[i, 0], reach, NULL, 0) > 0
    close_watch(&watch)
    return found


cdef double largest_at_point(
    PointsNearEdges work, Py_ssize_t i, double radius, int thread
) noexcept nogil:
    cdef NearEdges near
    work.find(i, SURFACE_WITHIN * radius, thread, &near)
    return sqrt(squared_of_disc(&near, radius))


cdef double share_at_point(
    PointsNearEdges work, Py_ssize_t i, double radius, int kernel, int thread
) noexcept nogil:
    cdef NearEdges near
    work.find(i, radius, thread, &near)
    return share_of_radial(&near, radius, kernel)
