"""Optics of smooth interfaces, as inline functions for kernels.

Normals face against the incoming direction: -dot(d, n) is the cosine of incidence, >= 0. The
forms below keep their relative precision at grazing incidence and for nearly equal indices,
where the usual differences of products cancel.
"""

from libc.math cimport sqrt

from ..common.vec3 cimport dot, normalise


cdef struct Directions:
    # Unit vectors: the normal that faces a ray at a specular surface, and where the ray is
    # reflected and refracted about it; that is not written for total reflection. `is_shading` is
    # true if the normal is the interpolated one.
    double[3] normal
    double[3] reflection
    double[3] refraction
    bint is_shading


cdef inline double cos_refracted_squared(double cos_i, double n1, double n2) noexcept nogil:
    """Squared cosine of refraction, by Snell's law; negative for total internal reflection."""
    cdef double sin2_i = (1.0 - cos_i) * (1.0 + cos_i)
    return cos_i * cos_i + (n2 - n1) / n2 * ((n2 + n1) / n2) * sin2_i


cdef inline double fresnel_reflectance(double cos_i, double n1, double n2) noexcept nogil:
    """Fresnel reflectance for unpolarised light.

    The numerators of r_s and r_p are expanded by their denominators, which turns
    n1 cos_i - n2 cos_t into (n1^2 - n2^2) / (n1 cos_i + n2 cos_t), and likewise for p.
    """
    cdef double cos2_t, cos_t, contrast, sum_s, sum_p, r_s, r_p, ratio
    if n1 == n2:
        return 0.0
    cos2_t = cos_refracted_squared(cos_i, n1, n2)
    if cos2_t <= 0.0:
        return 1.0
    cos_t = sqrt(cos2_t)
    ratio = n1 / n2
    contrast = (n1 - n2) * (n1 + n2)
    sum_s = n1 * cos_i + n2 * cos_t
    sum_p = n2 * cos_i + n1 * cos_t
    r_s = contrast / (sum_s * sum_s)
    r_p = (
        -contrast * (cos_i * cos_i - ratio * ratio * (1.0 - cos_i) * (1.0 + cos_i))
        / (sum_p * sum_p)
    )
    return 0.5 * (r_s * r_s + r_p * r_p)


cdef inline void reflect_into(double* out, const double* d, const double* n) noexcept nogil:
    """Write the reflected unit direction."""
    cdef double twice = 2.0 * dot(d, n)
    out[0] = d[0] - twice * n[0]
    out[1] = d[1] - twice * n[1]
    out[2] = d[2] - twice * n[2]
    normalise(out)


cdef inline bint refract_into(
    double* out, const double* d, const double* n, double n1, double n2
) noexcept nogil:
    """Write the refracted unit direction; false, and nothing written, for total reflection."""
    cdef double cos_i = -dot(d, n)
    cdef double ratio = n1 / n2
    cdef double cos2_t = cos_refracted_squared(cos_i, n1, n2)
    cdef double along = 0.0
    if cos2_t < 0.0:
        return False
    if n1 != n2:
        # ratio cos_i - cos_t, expanded by its sum.
        along = (n1 - n2) / n2 * ((n1 + n2) / n2) / (ratio * cos_i + sqrt(cos2_t))
    out[0] = ratio * d[0] + along * n[0]
    out[1] = ratio * d[1] + along * n[1]
    out[2] = ratio * d[2] + along * n[2]
    normalise(out)
    return True


cdef inline void deflect(
    Directions* out, const double* d, const double* geometric, const double* shading, double n1,
    double n2
) noexcept nogil:
    """Write the directions in which a ray leaves a specular surface; mirrors have n1 = n2.

    They are about the shading normal where the reflection about it stays on the ray's side of the
    face and the refraction, if there is one, goes to the other; else the geometric normal.
    """
    cdef double side = -1.0 if dot(d, geometric) > 0.0 else 1.0
    cdef int c
    for c in range(3):
        out.normal[c] = side * shading[c]
    out.is_shading = dot(d, out.normal) < 0.0
    if out.is_shading:
        reflect_into(out.reflection, d, out.normal)
        out.is_shading = side * dot(out.reflection, geometric) > 0.0
    if out.is_shading and refract_into(out.refraction, d, out.normal, n1, n2):
        out.is_shading = side * dot(out.refraction, geometric) < 0.0
    if not out.is_shading:
        for c in range(3):
            out.normal[c] = side * geometric[c]
        reflect_into(out.reflection, d, out.normal)
        refract_into(out.refraction, d, out.normal, n1, n2)


cdef inline void reflection_change(
    double* out, const double* d, const double* n, const double* d_change, const double* n_change
) noexcept nogil:
    """Write the change of a reflected direction by those of the ray and the normal (Igehy 1999)."""
    cdef double along = dot(d, n)
    cdef double along_change = dot(d_change, n) + dot(d, n_change)
    cdef int c
    for c in range(3):
        out[c] = d_change[c] - 2.0 * (along * n_change[c] + along_change * n[c])


cdef inline void refraction_change(
    double* out, const double* d, const double* n, const double* d_change, const double* n_change,
    double n1, double n2
) noexcept nogil:
    """Write the change of a refracted direction by those of the ray and the normal (Igehy 1999).

    It is not finite where the ray leaves along the surface.
    """
    cdef double ratio = n1 / n2
    cdef double cos_i = -dot(d, n)
    cdef double cos_change = -(dot(d_change, n) + dot(d, n_change))
    cdef double cos_t = sqrt(max(cos_refracted_squared(cos_i, n1, n2), 0.0))
    cdef double along = ratio * cos_i - cos_t
    cdef double along_change = ratio * (1.0 - ratio * cos_i / cos_t) * cos_change
    cdef int c
    for c in range(3):
        out[c] = ratio * d_change[c] + along * n_change[c] + along_change * n[c]
