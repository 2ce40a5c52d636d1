"""Rays at surfaces that are not there: those of dielectrics in media of larger priority."""

from libc.stdint cimport uint64_t

from ..common.vec3 cimport dot
from .materials cimport Faults, Materials, beyond_hidden, is_hidden
from .raycast cimport EmbreeHits, Hit, Triangles


cdef struct Passage:
    # A ray that is taken on, by pointers into it: its media become those beyond.
    const double* origin
    const double* direction
    uint64_t* media


cdef inline bint pass_surface(
    Hit* hit, const Passage* ray, Materials materials, Triangles triangles, EmbreeHits found,
    Py_ssize_t row, Faults faults,
) noexcept nogil:
    """Take a ray through the surface that it hits, and write its hit; false if that is there."""
    cdef int triangle = found.triangle[row]
    if triangle < 0 or not is_hidden(materials, triangles.faces[triangle, 3], ray.media[0]):
        return False
    triangles.refine_hit(found, row, ray.origin, ray.direction, hit)
    ray.media[0] = beyond_hidden(
        materials, faults, hit.object_id, dot(ray.direction, hit.geometric) > 0.0, ray.media[0]
    )
    return True
