"""Photons around sites, seen in the tangent planes there."""

from ..common.vec3 cimport dot
from ..spatial.tree cimport Tree
from ..spatial.simd.kernels cimport BLOCK, SearchBounds

cdef enum:
    # Photons that come in flatter than at 6° to the plane, whose sine is one over this, are moved
    # no farther than if they came so.
    STEEPEST = 10


cdef class Sites:
    cdef const double[:, ::1] queries
    cdef const double[:, ::1] normals
    cdef const double[::1] bandwidth


cdef class Photons:
    cdef Tree tree
    cdef const double[:, :, ::1] towards
    cdef const double[:, :, ::1] carried
    cdef double normal_range
    cdef double unit


cdef struct Plane:
    # A tangent plane: a point of it, two axes and the normal.
    const double* at
    double[9] frame
    # How far, m, and one over it.
    double bandwidth
    double scale
    # Of the photons, NULL if they are projected along the normal.
    const double* towards
    SearchBounds bounds


cdef bint fit(Photons photons, Sites sites, Py_ssize_t n_columns)
cdef void open_plane(Plane* plane, Photons photons, Sites sites, Py_ssize_t row) noexcept nogil


cdef inline double along(const double* axis, const double* lane) noexcept nogil:
    """Return the product of a vector with that of one lane of a block."""
    return axis[0] * lane[0] + axis[1] * lane[BLOCK] + axis[2] * lane[2 * BLOCK]


cdef inline bint project(
    const Plane* plane, Tree tree, Py_ssize_t block, int lane, double* offset
) noexcept nogil:
    """Write where on the plane the light of a photon would have landed (SSO08 Eq. A1–A2).

    In bandwidths, so that no square of it leaves the range of floats. Return whether it would land:
    light from behind the plane would not.
    """
    cdef const double* x = &tree.coords[block, 0, lane]
    cdef const double* towards
    cdef double[3] apart
    cdef double height, cosine
    apart[0] = (x[0] - plane.at[0]) * plane.scale
    apart[1] = (x[BLOCK] - plane.at[1]) * plane.scale
    apart[2] = (x[2 * BLOCK] - plane.at[2]) * plane.scale
    offset[0] = dot(plane.frame, apart)
    offset[1] = dot(plane.frame + 3, apart)
    if plane.towards == NULL:
        return True
    towards = plane.towards + 3 * BLOCK * block + lane
    cosine = along(plane.frame + 6, towards)
    if cosine <= 0.0:
        return False
    height = dot(plane.frame + 6, apart) / max(cosine, 1.0 / STEEPEST)
    offset[0] -= height * along(plane.frame, towards)
    offset[1] -= height * along(plane.frame + 3, towards)
    return True
