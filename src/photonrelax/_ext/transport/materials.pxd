"""Materials of a scene's objects: rays at their surfaces and inside them.

Photons, camera rays and replayed paths share these functions. A new material needs a kind, its
case in the functions below that tell kinds apart, and a class in `scene/materials.py`.
"""

from libc.math cimport exp, isnan
from libc.stdint cimport int32_t, uint8_t, uint64_t

from ..common.vec3 cimport dot
from .media cimport current, entered, is_full, left
from .optics cimport Directions, deflect, fresnel_reflectance


cdef enum:
    DIFFUSE = 0
    MIRROR = 1
    DIELECTRIC = 2
    # Rays of paths and of cameras pass sensors without an event.
    SENSOR = 3


cdef struct Arrival:
    # A ray at a surface: unit vectors, the object, and the media that the ray is in. `inside` is
    # true if it meets the back of the face.
    const double* direction
    const double* geometric
    const double* shading
    int32_t object_id
    bint inside
    uint64_t media


cdef struct Interface:
    # A specular surface at a hit. n1 and n2 are the indices of refraction on the ray's side and
    # beyond. `reflected` is the share of the light that is reflected; the rest is refracted into
    # the media `beyond`, of which the outermost is lost where `overflows`.
    Directions to
    double n1, n2, reflected
    uint64_t beyond
    bint overflows


cdef class Materials:
    # `medium` (objects,) is 0 but for dielectrics. The tables of media start with the surroundings.
    cdef readonly object table
    cdef readonly int bits
    cdef const int32_t[::1] kind
    cdef const double[:, ::1] reflectance
    cdef const uint64_t[::1] medium
    cdef const double[::1] exterior_ior, medium_ior
    cdef const double[:, ::1] absorption
    cdef const uint8_t[::1] is_absorbing


cdef inline bint is_diffuse(Materials materials, int32_t object_id) noexcept nogil:
    return materials.kind[object_id] == DIFFUSE


cdef inline bint is_absorbing_surface(Materials materials, int32_t object_id) noexcept nogil:
    """True for specular surfaces that reflect less than they receive, by their reflectance."""
    return materials.kind[object_id] == MIRROR


cdef inline uint64_t media_at(
    Materials materials, int32_t object_id, bint inside, uint64_t media
) noexcept nogil:
    """Media that a ray was in up to its hit.

    A ray that meets a dielectric from inside was in it, even where it was not seen to enter.
    """
    cdef uint64_t medium = materials.medium[object_id]
    if inside and medium and left(media, medium, materials.bits) == media:
        return entered(media, medium, materials.bits)
    return media


cdef inline bint is_absorbing(Materials materials, uint64_t media) noexcept nogil:
    return materials.is_absorbing[current(media, materials.bits)]


cdef inline void transmittance(
    double* out, Materials materials, uint64_t media, double distance
) noexcept nogil:
    """Beer–Lambert law along a distance."""
    cdef uint64_t medium = current(media, materials.bits)
    cdef int c
    for c in range(3):
        out[c] = exp(-materials.absorption[medium, c] * distance)


cdef inline void interface_at(
    Interface* out, Materials materials, const Arrival* at
) noexcept nogil:
    """Write the interface that a ray meets; mirrors have equal indices and reflect all."""
    cdef uint64_t medium = materials.medium[at.object_id]
    out.n1 = out.n2 = out.reflected = 1.0
    out.beyond = at.media
    out.overflows = False
    if medium:
        set_media(out, materials, medium, at)
    deflect(&out.to, at.direction, at.geometric, at.shading, out.n1, out.n2)
    if medium:
        out.reflected = fresnel_reflectance(
            min(-dot(at.direction, out.to.normal), 1.0), out.n1, out.n2
        )


cdef inline void set_media(
    Interface* out, Materials materials, uint64_t medium, const Arrival* at
) noexcept nogil:
    """Write the indices on both sides of a dielectric's surface, and the media beyond it.

    Each side has the index of the medium that rules there, unless the dielectric has indices of
    its own.
    """
    cdef int bits = materials.bits
    cdef uint64_t outside = left(at.media, medium, bits)
    cdef uint64_t inside = at.media if at.inside else entered(outside, medium, bits)
    cdef double inner = materials.medium_ior[current(inside, bits)]
    cdef double outer = materials.exterior_ior[at.object_id]
    if isnan(outer):
        outer = materials.medium_ior[current(outside, bits)]
    else:
        inner = materials.medium_ior[medium]
    out.n1 = inner if at.inside else outer
    out.n2 = outer if at.inside else inner
    out.beyond = outside if at.inside else inside
    out.overflows = not at.inside and is_full(outside, bits)
