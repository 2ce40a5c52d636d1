"""Points that have a face of similar normal within a radius."""

from cython.parallel cimport prange, threadid
from libc.math cimport fabs
from libc.stdint cimport int32_t

import numpy as np

from ..common.threads cimport Watch, close_watch, goes_on, open_watch, team_size
from ..common.vec3 cimport dot
from ..spatial.box_tree cimport BoxTree, BoxVisit, next_within, open_visit
from ..spatial.radius cimport LOOK_EVERY, QUERY_GRAIN


cdef class Faces:
    """Triangles in a tree of their boxes.

    Parameters
    ----------
    tree : BoxTree
    corners : (f, 3, 3) float64 array
    normals : (f, 3) float64 array
        Unit normals.
    min_cosine : float
        That of the largest angle between a point's normal and that of either side of a face.
    """

    cdef BoxTree tree
    cdef const double[:, :, ::1] corners
    cdef const double[:, ::1] normals
    cdef double min_cosine

    def __init__(self, tree, corners, normals, *, min_cosine):
        self.tree = tree
        self.corners = corners
        self.normals = normals
        self.min_cosine = min_cosine
        if not (
            self.corners.shape[0] == self.normals.shape[0] == self.tree.n_boxes
            and self.corners.shape[1] == self.corners.shape[2] == self.normals.shape[1] == 3
        ):
            raise ValueError("corners, normals and their tree do not fit one another")

    def within(
        self, const double[:, ::1] points, const double[:, ::1] normals, const double[::1] radius,
        int n_threads
    ):
        """Mask (m,) of the points (m, 3) with a face within their radii (m,)."""
        cdef Py_ssize_t i
        if not (
            points.shape[0] == normals.shape[0] == radius.shape[0]
            and points.shape[1] == normals.shape[1] == 3
        ):
            raise ValueError("points, normals and radii do not fit one another")
        found = np.zeros(points.shape[0], np.bool_)
        cdef unsigned char[::1] out = found.view(np.uint8)
        cdef Watch watch = open_watch()
        for i in prange(
            radius.shape[0], nogil=True, schedule="dynamic", chunksize=QUERY_GRAIN,
            num_threads=team_size(n_threads, radius.shape[0], QUERY_GRAIN)
        ):
            if goes_on(&watch, threadid() == 0 and i % LOOK_EVERY == 0):
                out[i] = has_face(self, &points[i, 0], &normals[i, 0], radius[i])
        close_watch(&watch)
        return found


cdef bint has_face(
    Faces faces, const double* point, const double* normal, double radius
) noexcept nogil:
    cdef BoxVisit visit = open_visit(faces.tree, point, point, radius)
    cdef int32_t face = next_within(faces.tree, &visit)
    while face >= 0:
        if (
            fabs(dot(normal, &faces.normals[face, 0])) >= faces.min_cosine
            and squared_distance(point, &faces.corners[face, 0, 0]) <= radius * radius
        ):
            return True
        face = next_within(faces.tree, &visit)
    return False


cdef double squared_distance(const double* point, const double* corners) noexcept nogil:
    """Squared distance from a triangle, by the part that is nearest (Ericson 2005, §5.1.5)."""
    cdef const double* a = corners
    cdef double[3] ab
    cdef double[3] ac
    cdef double[3] ap
    cdef double ab_ap, ac_ap, ab_bp, ac_bp, ab_cp, ac_cp, in_a, in_b, in_c
    cdef int axis
    for axis in range(3):
        ab[axis] = corners[3 + axis] - a[axis]
        ac[axis] = corners[6 + axis] - a[axis]
        ap[axis] = point[axis] - a[axis]
    ab_ap, ac_ap = dot(ab, ap), dot(ac, ap)
    if ab_ap <= 0.0 and ac_ap <= 0.0:
        return squared_offset(ap, ab, ac, 0.0, 0.0)
    ab_bp, ac_bp = ab_ap - dot(ab, ab), ac_ap - dot(ac, ab)
    if ab_bp >= 0.0 and ac_bp <= ab_bp:
        return squared_offset(ap, ab, ac, 1.0, 0.0)
    # Twice the areas that the point, projected, spans with the edge opposite to each corner, up to
    # a common factor.
    in_c = ab_ap * ac_bp - ab_bp * ac_ap
    if in_c <= 0.0 and ab_ap >= 0.0 and ab_bp <= 0.0:
        return squared_offset(ap, ab, ac, ab_ap / (ab_ap - ab_bp), 0.0)
    ab_cp, ac_cp = ab_ap - dot(ab, ac), ac_ap - dot(ac, ac)
    if ac_cp >= 0.0 and ab_cp <= ac_cp:
        return squared_offset(ap, ab, ac, 0.0, 1.0)
    in_b = ab_cp * ac_ap - ab_ap * ac_cp
    if in_b <= 0.0 and ac_ap >= 0.0 and ac_cp <= 0.0:
        return squared_offset(ap, ab, ac, 0.0, ac_ap / (ac_ap - ac_cp))
    in_a = ab_bp * ac_cp - ab_cp * ac_bp
    if in_a <= 0.0 and ac_bp >= ab_bp and ab_cp >= ac_cp:
        ac_bp -= ab_bp
        return squared_offset(
            ap, ab, ac, 1.0 - ac_bp / (ac_bp + ab_cp - ac_cp), ac_bp / (ac_bp + ab_cp - ac_cp)
        )
    return squared_offset(
        ap, ab, ac, in_b / (in_a + in_b + in_c), in_c / (in_a + in_b + in_c)
    )


cdef inline double squared_offset(
    const double* ap, const double* ab, const double* ac, double u, double v
) noexcept nogil:
    """Squared distance from the point with barycentric coordinates u and v."""
    cdef double[3] offset
    cdef int axis
    for axis in range(3):
        offset[axis] = ap[axis] - u * ab[axis] - v * ac[axis]
    return dot(offset, offset)
