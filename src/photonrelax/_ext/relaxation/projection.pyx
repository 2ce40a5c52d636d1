"""Moved photons back on their surfaces: those still on their triangle without a ray.

A photon moves in the plane of its triangle, so most moves end in that triangle, which is known
from the move before. For the others embree is asked. Every loop writes its own photons only.
"""

cimport cython
from libc.math cimport fabs, isfinite, sqrt
from libc.stdint cimport int8_t, int32_t

import numpy as np

from ..common.vec3 cimport dot
from ..transport.raycast cimport Found, Frame, Hit, Triangles

# A ray reaches this many times the length of the move.
cdef double REACH = 2.0
# A photon put back on a face turned by more than this (cosine) has gone round a corner.
cdef double LEAST_ALIGNMENT = 0.5

# Which way along its normal a photon's ray goes.
DOWN, UP = -1, 1


cdef int facing(const double* geometric, const double* normal) noexcept nogil:
    """Return +1 where normals point alike, -1 where opposite ways, 0 where neither."""
    cdef double cosine = dot(geometric, normal)
    if fabs(cosine) < LEAST_ALIGNMENT:
        return 0
    return 1 if cosine > 0.0 else -1


@cython.final
cdef class Moves:
    """Moves of some photons, and room for the rays that answer where they end.

    `photons` (n,) are the photons' numbers; `to` and `to_normal` (n, 3) are written. Without
    them photons are only looked up where they are.
    """

    cdef const double[:, ::1] position, normal, moved
    cdef const Py_ssize_t[::1] photons
    cdef double[:, ::1] to, to_normal
    cdef bint lookup
    # Those not answered yet, `n_pending` of them, and their rays as embree takes them.
    cdef readonly Py_ssize_t n_pending
    cdef int32_t[::1] pending
    cdef readonly object origins, directions

    def __init__(
        self, const double[:, ::1] position, const double[:, ::1] normal,
        const double[:, ::1] moved, const Py_ssize_t[::1] photons, double[:, ::1] to=None,
        double[:, ::1] to_normal=None,
    ):
        self.position, self.normal, self.moved, self.photons = position, normal, moved, photons
        self.to, self.to_normal = to, to_normal
        self.lookup = to is None
        self.pending = np.empty(photons.shape[0], np.int32)

    cdef double squared_length(self, Py_ssize_t i) noexcept nogil:
        cdef double[3] way
        cdef int c
        for c in range(3):
            way[c] = self.moved[i, c] - self.position[i, c]
        return dot(way, way)

    cdef void ray(
        self, double* origin, double* direction, Py_ssize_t i, int way, double start
    ) noexcept nogil:
        """Write the ray along the normal that starts just before the point moved to."""
        cdef int c
        for c in range(3):
            direction[c] = way * self.normal[i, c]
            origin[c] = self.moved[i, c] - start * direction[c]

    cdef void stay(self, Py_ssize_t i) noexcept nogil:
        cdef int c
        for c in range(3):
            self.to[i, c] = self.position[i, c]
            self.to_normal[i, c] = self.normal[i, c]

    cdef void land(self, Py_ssize_t i, const Hit* hit, int side) noexcept nogil:
        cdef int c
        for c in range(3):
            self.to[i, c] = hit.position[c]
            self.to_normal[i, c] = side * hit.geometric[c]


@cython.final
cdef class Places:
    """Where photons lie: on which triangle, and on which side of it.

    `object_id` (n,) are the photons' own objects. Rays start `start` before the points they are
    to meet, m.
    """

    cdef Frame frame
    cdef Triangles triangles
    cdef const int32_t[::1] object_id
    cdef double start
    # The triangle, or -1; the side, or 0 for photons that lie on no face and so do not move.
    cdef int32_t[::1] triangle
    cdef int8_t[::1] side

    def __init__(
        self, Frame frame, Triangles triangles, const int32_t[::1] object_id, double start
    ):
        self.frame, self.triangles = frame, triangles
        self.object_id = object_id
        self.start = start
        self.triangle = np.full(object_id.shape[0], -1, np.int32)
        self.side = np.zeros(object_id.shape[0], np.int8)

    def put_back(self, Moves moves):
        """Answer the moves that need no ray; the others are left pending."""
        cdef Py_ssize_t i
        moves.n_pending = 0
        with nogil:
            for i in range(moves.photons.shape[0]):
                if not self.is_known(moves, i):
                    moves.pending[moves.n_pending] = <int32_t>i
                    moves.n_pending += 1

    def cast(self, Moves moves, int way):
        """Write the rays of pending moves, `DOWN` the normal or `UP`."""
        cdef float[:, ::1] origins = np.empty((moves.n_pending, 3), np.float32)
        cdef float[:, ::1] directions = np.empty((moves.n_pending, 3), np.float32)
        cdef double[3] origin
        cdef double[3] direction
        cdef Py_ssize_t j
        cdef bint sound = True
        with nogil:
            for j in range(moves.n_pending):
                moves.ray(origin, direction, moves.pending[j], way, self.start)
                sound &= isfinite(
                    self.frame.enter_one(origin, direction, NULL, &origins[j, 0], &directions[j, 0])
                )
        if not sound:
            raise ValueError("photons should move to finite positions, but some do not")
        moves.origins, moves.directions = origins.base, directions.base

    def settle(self, Moves moves, Found found, int way):
        """Answer the moves whose rays found the photon's own object; of rays up, all."""
        cdef Py_ssize_t j, left = 0
        if found.n_rays != moves.n_pending:
            raise ValueError(
                f"found should be of {moves.n_pending} rays, but is of {found.n_rays}"
            )
        with nogil:
            for j in range(moves.n_pending):
                self.triangles.prefetch(found, j)
                if not self.settle_one(moves, found, j, way):
                    # Place `left` is never beyond place j.
                    moves.pending[left] = moves.pending[j]
                    left += 1
        moves.n_pending = left

    cdef bint is_known(self, Moves moves, Py_ssize_t i) noexcept nogil:
        """Answer a move within a triangle, or one that is not made; false for any other."""
        cdef Py_ssize_t photon = moves.photons[i]
        cdef int32_t triangle = self.triangle[photon]
        cdef double[3] origin
        cdef double[3] direction
        cdef Hit hit
        if moves.lookup:
            return False
        if self.side[photon] == 0 or moves.squared_length(i) == 0.0:
            moves.stay(i)
            return True
        if triangle < 0:
            return False
        moves.ray(origin, direction, i, -1, self.start)
        if not self.triangles.meets(triangle, origin, direction, 2.0 * self.start, &hit):
            return False
        self.put(moves, i, triangle, &hit)
        return True

    cdef bint settle_one(self, Moves moves, Found found, Py_ssize_t j, int way) noexcept nogil:
        """Answer a move by its ray; false where a ray the other way is to be asked."""
        cdef Py_ssize_t i = moves.pending[j]
        cdef Py_ssize_t photon = moves.photons[i]
        cdef double[3] origin
        cdef double[3] direction
        cdef double reach = REACH * sqrt(moves.squared_length(i)) + 2.0 * self.start
        cdef Hit hit
        cdef bint met
        moves.ray(origin, direction, i, way, self.start)
        met = self.triangles.resolve_one(found, j, origin, direction, &hit)
        if met and hit.distance <= reach and hit.object_id == self.object_id[photon]:
            self.put(moves, i, found.triangle[j], &hit)
        elif way < 0:
            return False
        elif not moves.lookup:
            moves.stay(i)
        elif met:
            # Off its object, but what lies above it may be the object, farther away.
            self.side[photon] = facing(hit.geometric, &moves.normal[i, 0])
        return True

    cdef void put(
        self, Moves moves, Py_ssize_t i, int32_t triangle, const Hit* hit
    ) noexcept nogil:
        """Let a photon lie where its own object was met, unless the face there is turned away."""
        cdef Py_ssize_t photon = moves.photons[i]
        cdef int side = facing(hit.geometric, &moves.normal[i, 0])
        if moves.lookup:
            self.side[photon] = side
        elif side != self.side[photon]:
            moves.stay(i)
            return
        else:
            moves.land(i, hit, side)
        self.triangle[photon] = triangle
