"""Camera rays at smooth surfaces: each splits into its reflection and its refraction."""

from cython.parallel cimport prange

from ..common.vec3 cimport dot
from .optics cimport facing_normal, fresnel_reflectance, reflect_into, refract_into

# MaterialTable.kind
cdef enum:
    DIELECTRIC = 2


cdef class Surfaces:
    """The materials of objects, row by object_id."""

    cdef const int[::1] kind
    cdef const double[:, ::1] reflectance
    cdef const double[::1] ior
    cdef const double[::1] exterior_ior

    def __init__(self, table):
        self.kind = table.kind
        self.reflectance = table.reflectance
        self.ior = table.ior
        self.exterior_ior = table.exterior_ior

    def split(self, const double[:, ::1] direction, const double[:, ::1] weight,
              const int[::1] medium, hits, *, double[:, ::1] out_direction,
              double[:, ::1] out_weight, int[::1] out_medium, int n_threads):
        """Write the two continuations of ray i to rows 2i (reflected) and 2i + 1 (refracted).

        Directions are unit vectors. A continuation that does not exist has weight 0 and the
        direction of its ray.
        """
        cdef const int[::1] object_id = hits.object_id
        cdef const double[:, ::1] geometric = hits.geometric_normal
        cdef const double[:, ::1] shading = hits.shading_normal
        cdef Py_ssize_t i
        for i in prange(direction.shape[0], nogil=True, num_threads=n_threads, schedule="static"):
            self.split_one(
                object_id[i], &direction[i, 0], &weight[i, 0], medium[i], &geometric[i, 0],
                &shading[i, 0], &out_direction[2 * i, 0], &out_weight[2 * i, 0],
                &out_medium[2 * i])

    cdef void split_one(self, int item, const double* d, const double* weight, int medium,
                        const double* geometric, const double* shading, double* out_d,
                        double* out_weight, int* out_medium) noexcept nogil:
        """Write two rows: 6 numbers of direction, 6 of weight, 2 media."""
        cdef bint inside = dot(d, geometric) > 0.0
        cdef bint transparent = self.kind[item] == DIELECTRIC
        cdef double n1 = 1.0
        cdef double n2 = 1.0
        cdef double reflected = 1.0
        cdef double n[3]
        cdef int axis
        if transparent:
            n1 = self.ior[item] if inside else self.exterior_ior[item]
            n2 = self.exterior_ior[item] if inside else self.ior[item]
        facing_normal(n, d, geometric, shading, n1, n2)
        reflect_into(out_d, d, n)
        for axis in range(3):
            out_d[3 + axis] = d[axis]
        if transparent:
            reflected = fresnel_reflectance(-dot(d, n), n1, n2)
            refract_into(out_d + 3, d, n, n1, n2)
        for axis in range(3):
            out_weight[axis] = weight[axis] * reflected * self.reflectance[item, axis]
            # Radiance over index squared is what an interface keeps.
            out_weight[3 + axis] = weight[axis] * (1.0 - reflected) * (n1 / n2) ** 2
        out_medium[0] = item if transparent and inside else medium
        out_medium[1] = -1 if inside else item
