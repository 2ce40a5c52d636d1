"""Materials of a scene's objects: rays at their surfaces and inside them.

Photons, camera rays and replayed paths share these functions. A new material needs a kind, its
case in the functions below that tell kinds apart, and a class in `scene/materials.py`.
"""

from libc.math cimport exp, isnan
from libc.stdint cimport int32_t, int64_t, uint8_t, uint64_t

from ..common.vec3 cimport dot
from ..scene.dispersion cimport at_wavelength
from ..scene.textures cimport TextureView
from .media cimport current, entered, is_full, left
from .optics cimport Directions, deflect, fresnel_reflectance


cdef enum:
    DIFFUSE = 0
    MIRROR = 1
    DIELECTRIC = 2
    # Rays of paths and of cameras pass sensors without an event.
    SENSOR = 3


# Events by which the stack of a ray and the nesting of bodies disagree; columns of `Faults`.
cdef enum:
    LEFT_UNENTERED = 0
    OVERFLOWED = 1
    N_FAULTS = 2


cdef struct Arrival:
    # A ray at a surface: unit vectors, the object, and the media that the ray is in. `inside` is
    # true if it meets the back of the face.
    const double* direction
    const double* geometric
    const double* shading
    int32_t object_id
    bint inside
    uint64_t media
    # nm; 0 of white light and of cameras, which see by the index at the d line.
    double wavelength


cdef struct Interface:
    # A specular surface at a hit. n1 and n2 are the indices of refraction on the ray's side and
    # beyond. `reflected` is the share of the light that is reflected; the rest is refracted into
    # the media `beyond`, of which one is lost where `overflows`.
    Directions to
    double n1, n2, reflected
    uint64_t beyond
    bint overflows


cdef class Materials:
    # `medium` (objects,) is 0 but for dielectrics. The tables of media start with the surroundings.
    # Media rule over surfaces of a lower `surface_rank` (objects,), which are not there in them;
    # `has_hidden` is false if none is.
    cdef readonly object table
    cdef readonly int bits
    cdef readonly bint has_hidden, has_dispersion
    cdef const int32_t[::1] kind, surface_rank, rank
    cdef const double[:, ::1] reflectance, tint
    cdef const uint8_t[::1] is_tinted, is_schlick
    cdef const uint64_t[::1] medium
    cdef const double[::1] exterior_ior, medium_ior
    # Rows of media in `dispersed_ior` (curves, nodes), -1 for those of one index.
    cdef const int32_t[::1] curve
    cdef const double[:, ::1] dispersed_ior
    cdef const double[:, ::1] absorption
    cdef const uint8_t[::1] is_absorbing
    # Views of the textures of `is_textured` objects (objects, sizeof(TextureView)); `arrays` owns
    # what they point to.
    cdef const uint8_t[::1] is_textured
    cdef unsigned char[::1] view_memory
    cdef const TextureView* view
    cdef object arrays


cdef class Faults:
    # (objects, N_FAULTS)
    cdef int64_t[:, ::1] count
    cdef int64_t total


cdef inline void add_fault(Faults faults, int32_t object_id, int kind) noexcept nogil:
    faults.count[object_id, kind] += 1
    faults.total += 1


cdef inline bint is_diffuse(Materials materials, int32_t object_id) noexcept nogil:
    return materials.kind[object_id] == DIFFUSE


cdef inline bint is_absorbing_surface(Materials materials, int32_t object_id) noexcept nogil:
    """True for specular surfaces that reflect less than they receive, by their reflectance."""
    return materials.kind[object_id] == MIRROR


cdef inline void reflectance_at(
    double* out, Materials materials, int32_t object_id, double cosine
) noexcept nogil:
    """Reflectance of a mirror by the cosine of the angle of incidence; 1 for dielectrics."""
    cdef double rise = (1.0 - cosine) ** 5 if materials.is_schlick[object_id] else 0.0
    cdef double along_normal
    cdef int c
    for c in range(3):
        along_normal = materials.reflectance[object_id, c]
        out[c] = along_normal + (1.0 - along_normal) * rise


cdef inline uint64_t media_at(
    Materials materials, int32_t object_id, bint inside, uint64_t media
) noexcept nogil:
    """Media that a ray was in up to its hit.

    A ray that meets a dielectric from inside was in it, even where it was not seen to enter.
    """
    cdef uint64_t medium = materials.medium[object_id]
    if inside and medium and left(media, medium, materials.bits) == media:
        return entered(media, medium, materials.bits, &materials.rank[0])
    return media


cdef inline uint64_t counted_media_at(
    Materials materials, Faults faults, int32_t object_id, bint inside, uint64_t media
) noexcept nogil:
    """Media that a ray was in up to its hit; a fault if it was not seen to enter one."""
    cdef uint64_t there = media_at(materials, object_id, inside, media)
    if there != media:
        add_fault(faults, object_id, LEFT_UNENTERED)
    return there


cdef inline bint is_hidden(
    Materials materials, int32_t object_id, uint64_t media
) noexcept nogil:
    """True for the surface of a dielectric inside of a medium of larger priority."""
    return materials.surface_rank[object_id] < materials.rank[current(media, materials.bits)]


cdef inline uint64_t beyond_hidden(
    Materials materials, Faults faults, int32_t object_id, bint inside, uint64_t media
) noexcept nogil:
    """Media of a ray beyond a surface that is not there; the same one rules."""
    cdef uint64_t medium = materials.medium[object_id]
    cdef uint64_t outside = left(
        counted_media_at(materials, faults, object_id, inside, media), medium, materials.bits
    )
    if inside:
        return outside
    if is_full(outside, materials.bits):
        add_fault(faults, object_id, OVERFLOWED)
    return entered(outside, medium, materials.bits, &materials.rank[0])


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
        out.reflected = fresnel_reflectance(cosine_at(out, at), out.n1, out.n2)


cdef inline double cosine_at(const Interface* interface, const Arrival* at) noexcept nogil:
    """Cosine of the angle of incidence on an interface."""
    return min(-dot(at.direction, interface.to.normal), 1.0)


cdef inline double index_in(
    Materials materials, uint64_t medium, double wavelength
) noexcept nogil:
    """Index of refraction of a medium for light of a wavelength; at the d line for 0."""
    if wavelength == 0.0 or materials.curve[medium] < 0:
        return materials.medium_ior[medium]
    return at_wavelength(&materials.dispersed_ior[materials.curve[medium], 0], 1, wavelength)


cdef inline bint is_dispersive(Materials materials, const Arrival* at) noexcept nogil:
    """True for a surface whose indices, of one side or both, depend on the wavelength."""
    cdef uint64_t medium = materials.medium[at.object_id]
    cdef uint64_t outside = left(at.media, medium, materials.bits), inside = at.media
    if not medium:
        return False
    if not isnan(materials.exterior_ior[at.object_id]):
        return materials.curve[medium] >= 0
    if not at.inside:
        inside = entered(outside, medium, materials.bits, &materials.rank[0])
    return (
        materials.curve[current(inside, materials.bits)] >= 0
        or materials.curve[current(outside, materials.bits)] >= 0
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
    cdef uint64_t inside = at.media
    cdef double inner, outer = materials.exterior_ior[at.object_id]
    if not at.inside:
        inside = entered(outside, medium, bits, &materials.rank[0])
    if isnan(outer):
        inner = index_in(materials, current(inside, bits), at.wavelength)
        outer = index_in(materials, current(outside, bits), at.wavelength)
    else:
        inner = index_in(materials, medium, at.wavelength)
    out.n1 = inner if at.inside else outer
    out.n2 = outer if at.inside else inner
    out.beyond = outside if at.inside else inside
    out.overflows = not at.inside and is_full(outside, bits)
