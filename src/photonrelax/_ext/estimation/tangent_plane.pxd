"""Tangent planes at evaluation points, and photons projected onto them (SSO08 Appendix A)."""

from ..common.vec3 cimport dot
from ..spatial.tree cimport Tree
from ..spatial.simd.kernels cimport BLOCK, SearchBounds
from .surface_edges cimport EdgeSearch

cdef enum:
    # Inverse sine of the least angle of light to the plane, 6°: light that comes in flatter is
    # projected no farther.
    MAX_SLOPE = 10


cdef class EvaluationPoints:
    cdef const double[:, ::1] queries
    cdef const Py_ssize_t[::1] rows
    cdef const double[:, ::1] normals
    cdef const double[::1] bandwidth
    # None without a scene.
    cdef EdgeSearch surface


cdef class TangentPhotons:
    cdef Tree tree
    cdef const double[:, :, ::1] towards
    cdef const double[:, :, ::1] columns
    cdef double range_radius
    cdef double unit


cdef struct Plane:
    # The evaluation point; two axes and the normal.
    const double* at
    double[9] frame
    # Bandwidth, m, and its inverse.
    double bandwidth
    double scale
    # Directions of the photons, NULL if they are projected along the normal.
    const double* towards
    SearchBounds bounds


cdef bint fit(TangentPhotons photons, EvaluationPoints points, Py_ssize_t n_columns)
cdef void open_plane(
    Plane* plane, TangentPhotons photons, EvaluationPoints points, Py_ssize_t i
) noexcept nogil


cdef inline double along(const double* axis, const double* lane) noexcept nogil:
    """Dot product of a vector with that of one lane of a block."""
    return axis[0] * lane[0] + axis[1] * lane[BLOCK] + axis[2] * lane[2 * BLOCK]


cdef inline bint project(
    const Plane* plane, Tree tree, Py_ssize_t block, int lane, double* offset
) noexcept nogil:
    """Write the offset of a photon, projected onto the plane along its light (SSO08 Eq. A1–A2).

    In bandwidths, so that no square of it leaves the range of floats. Returns False for light from
    behind the plane, which does not reach it.
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
    height = dot(plane.frame + 6, apart) / max(cosine, 1.0 / MAX_SLOPE)
    offset[0] -= height * along(plane.frame, towards)
    offset[1] -= height * along(plane.frame + 3, towards)
    return True
