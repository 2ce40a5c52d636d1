"""Camera rays at specular surfaces: each splits into its reflection and its refraction.

Every loop body writes only rows 2i and 2i + 1.
"""

from cython.parallel cimport prange
from libc.stdint cimport int32_t

from ..common.threads cimport ELEMENTS, team_size
from ..common.vec3 cimport dot
from .materials cimport (
    Interface, Materials, interface_at, medium_at_hit, medium_beyond, reflected_share,
)
from .optics cimport reflect_into, refract_into


def split(
    Materials materials, hits, *, const double[:, ::1] direction, const double[:, ::1] weight,
    const int32_t[::1] medium, double[:, ::1] out_direction, double[:, ::1] out_weight,
    int32_t[::1] out_medium, int n_threads,
):
    """Write the two continuations of ray i to rows 2i (reflected) and 2i + 1 (refracted).

    Directions are unit vectors; `medium` are the objects that rays last entered, -1 for none. A
    continuation that does not exist has weight 0.
    """
    cdef const int32_t[::1] object_id = hits.object_id
    cdef const double[:, ::1] geometric = hits.geometric_normal
    cdef const double[:, ::1] shading = hits.shading_normal
    cdef Py_ssize_t i, n = direction.shape[0]
    if not (
        n == weight.shape[0] == medium.shape[0]
        == object_id.shape[0] == geometric.shape[0] == shading.shape[0]
        and 2 * n == out_direction.shape[0] == out_weight.shape[0] == out_medium.shape[0]
        and 3 == direction.shape[1] == weight.shape[1] == geometric.shape[1] == shading.shape[1]
        == out_direction.shape[1] == out_weight.shape[1]
    ):
        raise ValueError("rays, hits and continuations do not fit one another")
    for i in prange(
        n, nogil=True, schedule="static", num_threads=team_size(n_threads, n, ELEMENTS)
    ):
        split_direction(
            &out_direction[2 * i, 0], &out_weight[2 * i, 0], materials, object_id[i],
            &direction[i, 0], &weight[i, 0], &geometric[i, 0], &shading[i, 0],
        )
        split_media(
            &out_medium[2 * i], materials, object_id[i],
            dot(&direction[i, 0], &geometric[i, 0]) > 0.0, medium[i],
        )


cdef void split_direction(
    double* out_direction, double* out_weight, Materials materials, int32_t object_id,
    const double* d, const double* weight, const double* geometric, const double* shading,
) noexcept nogil:
    """Write two rows: 6 numbers of direction and 6 of weight."""
    cdef Interface at
    cdef double reflected
    cdef int c
    interface_at(&at, materials, object_id, d, geometric, shading)
    reflected = reflected_share(materials, object_id, -dot(d, at.normal), at.n1, at.n2)
    reflect_into(out_direction, d, at.normal)
    for c in range(3):
        out_direction[3 + c] = d[c]
    if reflected < 1.0:
        refract_into(out_direction + 3, d, at.normal, at.n1, at.n2)
    for c in range(3):
        out_weight[c] = weight[c] * reflected * materials.reflectance[object_id, c]
        # Radiance over the square of the index is constant across an interface.
        out_weight[3 + c] = weight[c] * (1.0 - reflected) * (at.n1 / at.n2) ** 2


cdef void split_media(
    int32_t* out, Materials materials, int32_t object_id, bint inside, int32_t medium
) noexcept nogil:
    out[0] = medium_at_hit(materials, object_id, inside, medium)
    out[1] = medium_beyond(object_id, inside)
