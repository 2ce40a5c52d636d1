"""Materials of a scene's objects, and their functions for arrays of rays.

Every loop body writes only row i.
"""

cimport cython
from libc.stdint cimport int32_t, uint8_t

import numpy as np

from ..common.vec3 cimport dot

# The kinds of `scene.materials.MaterialTable`.
KINDS = {"diffuse": DIFFUSE, "mirror": MIRROR, "dielectric": DIELECTRIC}


@cython.final
cdef class Materials:
    """Materials of n objects; `table` is their `MaterialTable`."""

    def __init__(self, table):
        self.table = table
        self.kind = np.array([KINDS[kind] for kind in table.kind], dtype=np.int32)
        self.reflectance, self.absorption = table.reflectance, table.absorption
        self.ior, self.exterior_ior = table.ior, table.exterior_ior

    @property
    def diffuse(self):
        """Flags (n,) of the diffuse objects, on which photons and camera rays end."""
        return np.asarray(self.kind) == DIFFUSE

    def media(self, const double[:, ::1] direction, hits, const int32_t[::1] medium):
        """Objects that rays travel in, -1 in none: up to their hits (m,), and if refracted (m,).

        `medium` (m,) are the objects that they last entered.
        """
        cdef const int32_t[::1] object_id = hits.object_id
        cdef const double[:, ::1] geometric = hits.geometric_normal
        cdef Py_ssize_t i, m = direction.shape[0]
        cdef int32_t[::1] at_hit = np.empty(m, np.int32)
        cdef int32_t[::1] beyond = np.empty(m, np.int32)
        cdef bint inside
        with nogil:
            for i in range(m):
                inside = dot(&direction[i, 0], &geometric[i, 0]) > 0.0
                at_hit[i] = medium_at_hit(self, object_id[i], inside, medium[i])
                beyond[i] = medium_beyond(object_id[i], inside)
        return at_hit.base, beyond.base

    def interfaces(self, const double[:, ::1] direction, hits):
        """Specular surfaces that rays of unit direction (m, 3) meet.

        Returns normals (m, 3) that face the rays; flags (m,) where these are the interpolated
        ones; and indices of refraction on the side of the ray (m,) and beyond (m,).
        """
        cdef const int32_t[::1] object_id = hits.object_id
        cdef const double[:, ::1] geometric = hits.geometric_normal
        cdef const double[:, ::1] shading = hits.shading_normal
        cdef Py_ssize_t i, m = direction.shape[0]
        cdef double[:, ::1] normal = np.empty((m, 3))
        cdef uint8_t[::1] is_shading = np.empty(m, np.uint8)
        cdef double[::1] n1 = np.empty(m)
        cdef double[::1] n2 = np.empty(m)
        cdef Interface at
        with nogil:
            for i in range(m):
                interface_at(
                    &at, self, object_id[i], &direction[i, 0], &geometric[i, 0], &shading[i, 0]
                )
                normal[i, 0], normal[i, 1], normal[i, 2] = at.normal[0], at.normal[1], at.normal[2]
                is_shading[i], n1[i], n2[i] = at.is_shading, at.n1, at.n2
        return normal.base, is_shading.base.view(np.bool_), n1.base, n2.base

    def reflected_shares(
        self, const int32_t[::1] object_id, const double[::1] cosine, const double[::1] n1,
        const double[::1] n2,
    ):
        """Shares (m,) of the light at specular surfaces that are reflected."""
        cdef Py_ssize_t i, m = object_id.shape[0]
        cdef double[::1] share = np.empty(m)
        with nogil:
            for i in range(m):
                share[i] = reflected_share(
                    self, object_id[i], min(max(cosine[i], 0.0), 1.0), n1[i], n2[i]
                )
        return share.base
