"""Camera rays at specular surfaces: each splits into its reflection and its refraction.

Every loop body writes only rows 2i and 2i + 1.
"""

from cython.parallel cimport prange
from libc.stdint cimport int32_t, uint64_t

from ..common.threads cimport ELEMENTS, team_size
from ..common.vec3 cimport copy, dot
from .materials cimport Arrival, Interface, Materials, interface_at


def split(
    Materials materials, hits, *, const double[:, ::1] direction, const double[:, ::1] weight,
    const uint64_t[::1] media, double[:, ::1] out_direction, double[:, ::1] out_weight,
    uint64_t[::1] out_media, int n_threads,
):
    """Write the two continuations of ray i to rows 2i (reflected) and 2i + 1 (refracted).

    Directions are unit vectors; `media` are those up to the hits. A continuation that does not
    exist has weight 0. Returns the number of rays whose refraction loses its outermost medium.
    """
    cdef const int32_t[::1] object_id = hits.object_id
    cdef const double[:, ::1] geometric = hits.geometric_normal
    cdef const double[:, ::1] shading = hits.shading_normal
    cdef Py_ssize_t i, n = direction.shape[0], n_overflows = 0
    if not (
        n == weight.shape[0] == media.shape[0]
        == object_id.shape[0] == geometric.shape[0] == shading.shape[0]
        and 2 * n == out_direction.shape[0] == out_weight.shape[0] == out_media.shape[0]
        and 3 == direction.shape[1] == weight.shape[1] == geometric.shape[1] == shading.shape[1]
        == out_direction.shape[1] == out_weight.shape[1]
    ):
        raise ValueError("rays, hits and continuations do not fit one another")
    for i in prange(
        n, nogil=True, schedule="static", num_threads=team_size(n_threads, n, ELEMENTS)
    ):
        out_media[2 * i] = media[i]
        n_overflows += split_ray(
            &out_direction[2 * i, 0], &out_weight[2 * i, 0], &out_media[2 * i + 1], materials,
            Arrival(
                &direction[i, 0], &geometric[i, 0], &shading[i, 0], object_id[i],
                dot(&direction[i, 0], &geometric[i, 0]) > 0.0, media[i],
            ),
            &weight[i, 0],
        )
    return n_overflows


cdef bint split_ray(
    double* out_direction, double* out_weight, uint64_t* out_beyond, Materials materials,
    Arrival arrival, const double* weight,
) noexcept nogil:
    """Write two rows, 6 numbers of direction and 6 of weight, and the media of the second.

    True if a refracted ray loses its outermost medium.
    """
    cdef Interface at
    cdef int c
    interface_at(&at, materials, &arrival)
    copy(out_direction, at.to.reflection)
    copy(out_direction + 3, arrival.direction)
    if at.reflected < 1.0:
        copy(out_direction + 3, at.to.refraction)
    for c in range(3):
        out_weight[c] = weight[c] * at.reflected * materials.reflectance[arrival.object_id, c]
        # Radiance over the square of the index is constant across an interface.
        out_weight[3 + c] = weight[c] * (1.0 - at.reflected) * (at.n1 / at.n2) ** 2
    out_beyond[0] = at.beyond
    return at.overflows and at.reflected < 1.0
