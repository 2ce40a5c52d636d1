"""Projection of displaced photons onto their own objects.

A photon is displaced in the plane of its triangle, so most displacements end in that triangle,
which is known from the one before. The others are resolved by rays. Every loop writes its own
photons only.
"""

cimport cython
from libc.math cimport fabs, isfinite, sqrt
from libc.stdint cimport int32_t, int64_t

import numpy as np

from ..common.prefetch cimport prefetch_row
from ..common.vec3 cimport dot
from ..transport.raycast cimport EmbreeFrame, EmbreeHits, Hit, Triangles, ray_to_embree

# Hits farther along a ray than this multiple of the displacement do not count.
cdef double MAX_DISTANCE_SCALE = 2.0

cdef enum:
    # Photons between the prefetch of a position and its use.
    PREFETCH_DISTANCE = 8

# Signs of a ray's direction along the photon's normal.
DOWN, UP = -1, 1


@cython.final
cdef class Displacements:
    """Displacements of some photons, and their rays.

    `photons` (n,) are row numbers of the map; `target` (n, 3) are the displaced positions.
    `projected` and `projected_normal` (n, 3) are written. Without these, photons are only looked
    up where they are.
    """

    cdef const double[:, ::1] position, normal, target
    cdef const Py_ssize_t[::1] photons
    cdef double[:, ::1] projected, projected_normal
    cdef bint lookup
    # The first `n_pending` of `pending` are displacements without a result yet; rays as embree
    # takes them.
    cdef readonly Py_ssize_t n_pending
    cdef int32_t[::1] pending
    cdef readonly object origins, directions

    def __init__(
        self, const double[:, ::1] position, const double[:, ::1] normal,
        const double[:, ::1] target, const Py_ssize_t[::1] photons,
        *, double[:, ::1] projected=None, double[:, ::1] projected_normal=None,
    ):
        self.position, self.normal, self.target, self.photons = position, normal, target, photons
        self.projected, self.projected_normal = projected, projected_normal
        self.lookup = projected is None
        self.pending = np.empty(photons.shape[0], np.int32)

    cdef double squared_length(self, Py_ssize_t i) noexcept nogil:
        cdef double[3] step
        cdef int c
        for c in range(3):
            step[c] = self.target[i, c] - self.position[i, c]
        return dot(step, step)

    cdef void ray(
        self, double* origin, double* direction, Py_ssize_t i, int sign, double offset
    ) noexcept nogil:
        """Write the ray along the normal that starts `offset` before the target."""
        cdef int c
        for c in range(3):
            direction[c] = sign * self.normal[i, c]
            origin[c] = self.target[i, c] - offset * direction[c]

    cdef void reject(self, Py_ssize_t i) noexcept nogil:
        """Leave the photon at its position."""
        cdef int c
        for c in range(3):
            self.projected[i, c] = self.position[i, c]
            self.projected_normal[i, c] = self.normal[i, c]

    cdef void accept(self, Py_ssize_t i, const Hit* hit, int side) noexcept nogil:
        """Place the photon at the hit."""
        cdef int c
        for c in range(3):
            self.projected[i, c] = hit.position[c]
            self.projected_normal[i, c] = side * hit.geometric[c]


cdef struct SurfacePosition:
    # Where a ray that finds the photon's face starts, m before it; the photon's own object; -1
    # where the triangle is not known; side 0 for photons on no face, which are not displaced.
    double ray_offset
    int32_t object_id
    int32_t triangle
    int64_t side


SURFACE_POSITION = np.dtype(
    [("ray_offset", "f8"), ("object_id", "i4"), ("triangle", "i4"), ("side", "i8")]
)


@cython.final
cdef class SurfacePositions:
    """The triangle each photon lies on, and the side of it.

    `at` (n,) is an array of `SURFACE_POSITION`, which is updated. `min_cosine` is that of the
    largest angle between a photon's normal and the face it is projected onto.
    """

    cdef EmbreeFrame frame
    cdef Triangles triangles
    cdef double min_cosine
    cdef SurfacePosition[::1] at

    def __init__(
        self, EmbreeFrame frame, Triangles triangles, SurfacePosition[::1] at, *,
        double min_cosine,
    ):
        self.frame, self.triangles = frame, triangles
        self.min_cosine = min_cosine
        self.at = at

    def project(self, Displacements moves):
        """Project the photons that need no ray; the others are left pending."""
        cdef Py_ssize_t i
        moves.n_pending = 0
        with nogil:
            for i in range(moves.photons.shape[0]):
                if i + PREFETCH_DISTANCE < moves.photons.shape[0]:
                    prefetch_row(
                        &self.at[moves.photons[i + PREFETCH_DISTANCE]], sizeof(SurfacePosition)
                    )
                if not self.project_without_ray(moves, i):
                    moves.pending[moves.n_pending] = <int32_t>i
                    moves.n_pending += 1

    def write_rays(self, Displacements moves, int sign):
        """Write the rays of pending displacements, `DOWN` the normals or `UP`."""
        cdef float[:, ::1] origins = np.empty((moves.n_pending, 3), np.float32)
        cdef float[:, ::1] directions = np.empty((moves.n_pending, 3), np.float32)
        cdef double[3] origin
        cdef double[3] direction
        cdef Py_ssize_t j
        cdef bint finite = True
        with nogil:
            for j in range(moves.n_pending):
                moves.ray(
                    origin, direction, moves.pending[j], sign,
                    self.at[moves.photons[moves.pending[j]]].ray_offset
                )
                finite &= isfinite(
                    ray_to_embree(
                        self.frame, origin, direction, NULL, &origins[j, 0], &directions[j, 0]
                    )
                )
        if not finite:
            raise ValueError("photons should move to finite positions, but some do not")
        moves.origins, moves.directions = origins.base, directions.base

    def project_hits(self, Displacements moves, EmbreeHits found, int sign):
        """Project photons whose rays found their own object; after rays `UP` none is pending."""
        cdef Py_ssize_t j, left = 0
        if found.n_rays != moves.n_pending:
            raise ValueError(
                f"found should be of {moves.n_pending} rays, but is of {found.n_rays}"
            )
        with nogil:
            for j in range(moves.n_pending):
                self.triangles.prefetch(found, j)
                if not self.project_hit(moves, found, j, sign):
                    # Entry `left` is never beyond entry j.
                    moves.pending[left] = moves.pending[j]
                    left += 1
        moves.n_pending = left

    cdef bint project_without_ray(self, Displacements moves, Py_ssize_t i) noexcept nogil:
        """Project a photon within its triangle, or one that stays; false for any other."""
        cdef Py_ssize_t photon = moves.photons[i]
        cdef double offset = self.at[photon].ray_offset
        cdef int32_t triangle = self.at[photon].triangle
        cdef double[3] origin
        cdef double[3] direction
        cdef Hit hit
        if moves.lookup:
            return False
        if self.at[photon].side == 0 or moves.squared_length(i) == 0.0:
            moves.reject(i)
            return True
        if triangle < 0:
            return False
        moves.ray(origin, direction, i, -1, offset)
        if not self.triangles.intersects(triangle, origin, direction, 2.0 * offset, &hit):
            return False
        self.place(moves, i, triangle, &hit)
        return True

    cdef bint project_hit(
        self, Displacements moves, EmbreeHits found, Py_ssize_t j, int sign
    ) noexcept nogil:
        """Project a photon to what its ray hit; false where a ray the other way is needed."""
        cdef Py_ssize_t i = moves.pending[j]
        cdef Py_ssize_t photon = moves.photons[i]
        cdef double offset = self.at[photon].ray_offset
        cdef double[3] origin
        cdef double[3] direction
        cdef double max_distance = (
            MAX_DISTANCE_SCALE * sqrt(moves.squared_length(i)) + 2.0 * offset
        )
        cdef Hit hit
        cdef bint any_hit
        moves.ray(origin, direction, i, sign, offset)
        any_hit = self.triangles.refine_hit(found, j, origin, direction, &hit)
        if any_hit and hit.distance <= max_distance and hit.object_id == self.at[photon].object_id:
            self.place(moves, i, found.triangle[j], &hit)
        elif sign < 0:
            return False
        elif not moves.lookup:
            moves.reject(i)
        elif any_hit:
            # Off its object, but what lies above it may be the object, farther away.
            self.at[photon].side = self.side_of(hit.geometric, &moves.normal[i, 0])
        return True

    cdef void place(
        self, Displacements moves, Py_ssize_t i, int32_t triangle, const Hit* hit
    ) noexcept nogil:
        """Place a photon where its object was hit, unless the face there is turned away."""
        cdef Py_ssize_t photon = moves.photons[i]
        cdef int side = self.side_of(hit.geometric, &moves.normal[i, 0])
        if moves.lookup:
            self.at[photon].side = side
        elif side != self.at[photon].side:
            moves.reject(i)
            return
        else:
            moves.accept(i, hit, side)
        self.at[photon].triangle = triangle

    cdef int side_of(self, const double* geometric, const double* normal) noexcept nogil:
        """Return +1 or -1 by the side of the face the normal is on, 0 beyond the largest angle."""
        cdef double cosine = dot(geometric, normal)
        if fabs(cosine) < self.min_cosine:
            return 0
        return 1 if cosine > 0.0 else -1
