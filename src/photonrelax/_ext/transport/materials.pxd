"""Materials of a scene's objects: rays at their surfaces and inside them.

Photons, camera rays and replayed paths share these functions. A new material needs a kind, its
case in the functions below that tell kinds apart, and a class in `scene/materials.py`.
"""

from libc.math cimport exp
from libc.stdint cimport int32_t

from ..common.vec3 cimport dot
from .optics cimport facing_normal, fresnel_reflectance


cdef enum:
    DIFFUSE = 0
    MIRROR = 1
    DIELECTRIC = 2


cdef struct Interface:
    # A specular surface at a hit. The normal faces the ray; `is_shading` is true for the
    # interpolated one. n1 and n2 are the indices of refraction on the ray's side and beyond.
    double[3] normal
    double n1, n2
    bint is_shading


cdef class Materials:
    cdef readonly object table
    cdef const int32_t[::1] kind
    cdef const double[:, ::1] reflectance, absorption
    cdef const double[::1] ior, exterior_ior


cdef inline bint is_diffuse(Materials materials, int32_t object_id) noexcept nogil:
    return materials.kind[object_id] == DIFFUSE


cdef inline bint is_absorbing_surface(Materials materials, int32_t object_id) noexcept nogil:
    """True for specular surfaces that reflect less than they receive, by their reflectance."""
    return materials.kind[object_id] == MIRROR


cdef inline void interface_at(
    Interface* out, Materials materials, int32_t object_id, const double* direction,
    const double* geometric, const double* shading,
) noexcept nogil:
    """Write the interface that a ray meets; mirrors have equal indices."""
    cdef double inner = materials.ior[object_id], outer = materials.exterior_ior[object_id]
    cdef bint inside = dot(direction, geometric) > 0.0
    out.n1 = inner if inside else outer
    out.n2 = outer if inside else inner
    out.is_shading = facing_normal(out.normal, direction, geometric, shading, out.n1, out.n2)


cdef inline double reflected_share(
    Materials materials, int32_t object_id, double cosine, double n1, double n2
) noexcept nogil:
    """Share of the light at a specular surface that is reflected; the rest is refracted."""
    if materials.kind[object_id] == DIELECTRIC:
        return fresnel_reflectance(cosine, n1, n2)
    return 1.0


cdef inline int32_t medium_at_hit(
    Materials materials, int32_t object_id, bint inside, int32_t medium
) noexcept nogil:
    """Object that a ray travelled in up to its hit, -1 in none.

    A ray that hits a dielectric from inside was in it; any other was in `medium`, which it entered
    last.
    """
    if inside and materials.kind[object_id] == DIELECTRIC:
        return object_id
    return medium


cdef inline int32_t medium_beyond(int32_t object_id, bint inside) noexcept nogil:
    """Object that a refracted ray travels in, -1 in none."""
    return -1 if inside else object_id


cdef inline void transmittance(
    double* out, Materials materials, int32_t medium, double distance
) noexcept nogil:
    """Beer–Lambert law along a distance in an object."""
    cdef int c
    for c in range(3):
        out[c] = exp(-materials.absorption[medium, c] * distance)
