"""Conversion of rays to embree's float32 frame, and refinement of embree's hits in float64.

Embree works in float32 and only names the triangle that a ray hits; the intersection is computed
here in float64, from the original ray. Every loop body writes row i only.
"""

cimport cython
from libc.math cimport NAN, INFINITY, fabs, isfinite

import numpy as np

from ..common.prefetch cimport prefetch_row
from ..common.vec3 cimport cross, dot, normalise

# Barycentric coordinates may leave [0, 1] by this much through embree's rounding.
cdef double OUTSIDE = 1e-4
# A length in embree's frame that does not reach its end, however float32 rounds.
cdef double SHORTENED = 1.0 - 1e-6
# Number of rays between the prefetch of a triangle's corners and their use: some 100 ns each.
cdef enum:
    PREFETCH_DISTANCE = 6


cdef inline double entered_cube(const double* o, const double* d, double half_side) noexcept nogil:
    """Length of a ray before a cube around the origin, as of `entered`."""
    cdef double[3] low
    cdef double[3] high
    cdef int axis
    for axis in range(3):
        low[axis] = -half_side
        high[axis] = half_side
    return entered(o, d, low, high)


@cython.final
cdef class EmbreeFrame:
    """Embree's coordinates, (x - origin) * scale, and a box that holds the scene.

    Parameters
    ----------
    origin : (3,)
        m.
    low, high : (3,)
        Corners of the box, relative to the origin. Rays from beyond start where they enter it.
    scale : float
        Per m.
    rounding, local_rounding, least_distance : float
        Float32 displaces a triangle by no more than `rounding` times its largest coordinate, nor,
        at a point, than `local_rounding` times the point's largest coordinate or `least_distance`.
    """

    def __init__(self, const double[::1] origin, const double[::1] low, const double[::1] high, *,
                 double scale, double rounding, double local_rounding, double least_distance):
        cdef int axis
        for axis in range(3):
            self.origin[axis] = origin[axis]
            self.low[axis] = low[axis]
            self.high[axis] = high[axis]
        self.scale = scale
        self.rounding, self.local_rounding = rounding, local_rounding
        self.least_distance = least_distance

    def to_embree(
        self, const double[:, ::1] origins, const double[:, ::1] directions,
        const double[:, ::1] origin_offset, const double[::1] limits, *,
        float[:, ::1] out_origins, float[:, ::1] out_directions, float[::1] out_limits,
    ):
        """Write rays in embree's frame; return the index of the first invalid one, or -1.

        `origin_offset` has no rows for rays that start in free space; `limits` and `out_limits`
        have none for rays without end.
        """
        cdef Py_ssize_t i, bad = -1
        cdef bint from_surface = origin_offset.shape[0] > 0
        cdef bint limited = limits.shape[0] > 0
        cdef double skipped
        cdef double[3] d
        cdef int axis
        with nogil:
            for i in range(origins.shape[0]):
                for axis in range(3):
                    d[axis] = directions[i, axis]
                normalise(d)
                skipped = ray_to_embree(
                    self, &origins[i, 0], d,
                    &origin_offset[i, 0] if from_surface else NULL,
                    &out_origins[i, 0], &out_directions[i, 0],
                )
                if not isfinite(skipped):
                    bad = i
                    break
                if limited:
                    # Embree reports rays of negative length as occluded.
                    out_limits[i] = <float>(max(limits[i] - skipped, 0.0) * self.scale)
        return bad

    def far_rays(
        self, const double[:, ::1] origins, const double[:, ::1] directions, double half_side,
        double outer,
    ):
        """Rays that start outside of a cube around the origin and enter it.

        Parameters
        ----------
        origins, directions : (n, 3)
            Rays.
        half_side : float
            Half the side of the cube, m.
        outer : float
            Half the side of a larger cube. Rays that start outside of it, or of the box, are where
            they enter both of these.

        Returns
        -------
        rows : (m,) intp
            Indices of the rays.
        near : (m, 3) float32
            Where they enter, in embree's frame.
        limits : (m,) float32
            The lengths on the way, in embree's frame, less their rounding.
        """
        cdef Py_ssize_t i, found = 0, n = origins.shape[0]
        cdef Py_ssize_t[::1] rows = np.empty(n, np.intp)
        cdef float[:, ::1] near = np.empty((n, 3), np.float32)
        cdef float[::1] limits = np.empty(n, np.float32)
        cdef double[3] o
        cdef double[3] d
        cdef double enter, start
        cdef int axis
        with nogil:
            for i in range(n):
                for axis in range(3):
                    o[axis] = origins[i, axis] - self.origin[axis]
                    d[axis] = directions[i, axis]
                normalise(d)
                enter = entered_cube(o, d, half_side)
                # From inside the length is zero.
                if enter <= 0.0:
                    continue
                # A cube reaches beyond the box in some directions; rays are not moved back to it.
                start = max(skipped_length(self, o, d), entered_cube(o, d, outer))
                if enter > start:
                    rows[found] = i
                    for axis in range(3):
                        near[found, axis] = <float>((o[axis] + enter * d[axis]) * self.scale)
                    limits[found] = <float>(SHORTENED * (enter - start) * self.scale)
                    found += 1
        return rows.base[:found], near.base[:found], limits.base[:found]

    cdef double resolution_at(self, const double* position) noexcept nogil:
        """Distance, m, that rays resolve at a position, as of `scene.resolution.Resolution`."""
        cdef double distance = self.least_distance
        cdef int axis
        for axis in range(3):
            distance = max(distance, fabs(position[axis] - self.origin[axis]))
        return self.local_rounding * distance

    cdef double step(
        self, const double* a, const double* b, const double* c, const double* p
    ) noexcept nogil:
        """Distance that rays are moved off a triangle at a point, both relative to the origin."""
        cdef double farthest = 0.0, distance = self.least_distance
        cdef int axis
        for axis in range(3):
            farthest = max(farthest, max(fabs(a[axis]), max(fabs(b[axis]), fabs(c[axis]))))
            distance = max(distance, fabs(p[axis]))
        return min(self.rounding * farthest, self.local_rounding * distance)


@cython.final
cdef class EmbreeHits:
    """Embree's hits of `n_rays` rays; raises ValueError for arrays of other lengths or types."""

    def __init__(self, dict found, Py_ssize_t n_rays):
        self.n_rays = n_rays
        for name in ("primID", "u", "v"):
            if found[name].shape != (n_rays,):
                raise ValueError(
                    f"embree was given {n_rays} rays, but its {name} has shape {found[name].shape}"
                )
        self.triangle, self.u, self.v = found["primID"], found["u"], found["v"]

    def replace(self, const Py_ssize_t[::1] rows, EmbreeHits found):
        """Replace the hits of some rays by those found of these alone."""
        cdef Py_ssize_t i
        if found.n_rays != rows.shape[0]:
            raise ValueError(f"found should be of {rows.shape[0]} rays, but is of {found.n_rays}")
        for i in range(rows.shape[0]):
            self.triangle[rows[i]] = found.triangle[i]
            self.u[rows[i]], self.v[rows[i]] = found.u[i], found.v[i]

    def to_faces(self, const int[::1] face, const double[:, :, ::1] uv):
        """Replace embree's triangles by faces, and barycentric coordinates by those in faces.

        `face` (t,) are the faces of embree's triangles; the last of these are parts of faces,
        and have corners at the barycentric coordinates `uv` (p, 3, 2).
        """
        cdef Py_ssize_t i, part, n_whole = face.shape[0] - uv.shape[0]
        cdef const double* corner
        cdef double u, v, w
        with nogil:
            for i in range(self.n_rays):
                part = self.triangle[i] - n_whole
                if self.triangle[i] >= 0:
                    self.triangle[i] = face[self.triangle[i]]
                if part >= 0:
                    u, v = self.u[i], self.v[i]
                    w = 1.0 - u - v
                    corner = &uv[part, 0, 0]
                    self.u[i] = <float>(w * corner[0] + u * corner[2] + v * corner[4])
                    self.v[i] = <float>(w * corner[1] + u * corner[3] + v * corner[5])


@cython.final
cdef class Triangles:
    """Embree's triangles, in float64 relative to the frame's origin.

    corners (v, 6) are vertices and their normals; faces (f, 4) are three corners and the object;
    face_id (f,) is the index in the object's mesh; smooth (objects,) is nonzero where normals are
    interpolated.
    """

    def __init__(
        self, EmbreeFrame frame, const double[:, ::1] corners, const int[:, ::1] faces,
        const int[::1] face_id, const unsigned char[::1] smooth,
    ):
        self.frame = frame
        self.corners = corners
        self.faces = faces
        self.face_id = face_id
        self.smooth = smooth

    def refine_hits(
        self, const double[:, ::1] origins, const double[:, ::1] directions, EmbreeHits found, out
    ):
        """Write the float64 intersections of embree's hits into `out` (Intersections)."""
        cdef int[::1] object_id = out.object_id
        cdef int[::1] face_id = out.face_id
        cdef double[::1] distance = out.distance
        cdef double[::1] step = out.step
        cdef double[:, ::1] position = out.position
        cdef double[:, ::1] geometric = out.geometric_normal
        cdef double[:, ::1] shading = out.shading_normal
        cdef Py_ssize_t i
        cdef int axis
        cdef bint met
        cdef Hit hit
        with nogil:
            for i in range(found.n_rays):
                self.prefetch(found, i)
                met = self.refine_hit(found, i, &origins[i, 0], &directions[i, 0], &hit)
                object_id[i] = hit.object_id
                face_id[i] = self.face_id[found.triangle[i]] if met else -1
                distance[i] = hit.distance if met else INFINITY
                step[i] = hit.step if met else NAN
                for axis in range(3):
                    position[i, axis] = hit.position[axis] if met else NAN
                    geometric[i, axis] = hit.geometric[axis] if met else NAN
                    shading[i, axis] = hit.shading[axis] if met else NAN

    cdef void prefetch(self, EmbreeHits found, Py_ssize_t ray) noexcept nogil:
        """Prefetch the triangles of the next rays, which are scattered in memory."""
        cdef int triangle, corner
        cdef const double* row
        if ray + 2 * PREFETCH_DISTANCE < found.n_rays:
            triangle = found.triangle[ray + 2 * PREFETCH_DISTANCE]
            if triangle >= 0:
                prefetch_row(&self.faces[triangle, 0], 3 * sizeof(int))
        if ray + PREFETCH_DISTANCE < found.n_rays:
            triangle = found.triangle[ray + PREFETCH_DISTANCE]
            if triangle >= 0:
                for corner in range(3):
                    row = &self.corners[self.faces[triangle, corner], 0]
                    prefetch_row(row, 6 * sizeof(double))

    cdef bint refine_hit(
        self, EmbreeHits found, Py_ssize_t ray, const double* origin, const double* direction,
        Hit* hit,
    ) noexcept nogil:
        """Write the float64 intersection of a ray; false, and object -1, for a miss."""
        cdef int triangle = found.triangle[ray]
        cdef double u, v
        cdef TriangleRay local
        if triangle < 0:
            hit.object_id = -1
            return False
        u, v = found.u[ray], found.v[ray]
        self.triangle_setup(&local, triangle, origin, direction)
        barycentric(&u, &v, &local)
        self.write_hit(hit, triangle, u, v, &local)
        hit.step = self.step_at(triangle, u, v, &local)
        return True

    cdef double step_at(
        self, int triangle, double u, double v, const TriangleRay* local
    ) noexcept nogil:
        """Distance that rays are moved off a triangle at a point of it."""
        cdef double[3] point
        cdef int axis
        for axis in range(3):
            point[axis] = local.corner[axis] + u * local.ab[axis] + v * local.ac[axis]
        return self.frame.step(
            local.corner, &self.corners[self.faces[triangle, 1], 0],
            &self.corners[self.faces[triangle, 2], 0], point
        )

    cdef bint intersects(
        self, int triangle, const double* origin, const double* direction, double max_distance,
        Hit* hit,
    ) noexcept nogil:
        """Write the intersection of a ray and one triangle; false where there is none.

        Other triangles are ignored, also where they lie nearer. The step is not written.
        """
        cdef double u, v, t
        cdef TriangleRay local
        self.triangle_setup(&local, triangle, origin, direction)
        if not (plane_point(&u, &v, &t, &local) and 0.0 <= t <= max_distance):
            return False
        if not (u >= 0.0 and v >= 0.0 and u + v <= 1.0):
            return False
        self.write_hit(hit, triangle, u, min(v, 1.0 - u), &local)
        return True

    cdef void triangle_setup(
        self, TriangleRay* local, int triangle, const double* origin, const double* direction
    ) noexcept nogil:
        """Write a ray and the edges of a triangle, relative to its first corner."""
        cdef const double* b = &self.corners[self.faces[triangle, 1], 0]
        cdef const double* c = &self.corners[self.faces[triangle, 2], 0]
        cdef int axis
        local.corner = &self.corners[self.faces[triangle, 0], 0]
        for axis in range(3):
            local.ab[axis] = b[axis] - local.corner[axis]
            local.ac[axis] = c[axis] - local.corner[axis]
            local.origin[axis] = (origin[axis] - self.frame.origin[axis]) - local.corner[axis]
            local.direction[axis] = direction[axis]
        normalise(local.direction)

    cdef void write_hit(
        self, Hit* hit, int triangle, double u, double v, const TriangleRay* local
    ) noexcept nogil:
        cdef double offset, distance = 0.0
        cdef int axis
        cross(hit.geometric, local.ab, local.ac)
        normalise(hit.geometric)
        for axis in range(3):
            offset = u * local.ab[axis] + v * local.ac[axis]
            hit.position[axis] = local.corner[axis] + u * local.ab[axis] + v * local.ac[axis]
            distance += (offset - local.origin[axis]) * local.direction[axis]
        for axis in range(3):
            hit.position[axis] += self.frame.origin[axis]
        hit.distance = max(distance, 0.0)
        hit.object_id = self.faces[triangle, 3]
        self.interpolate_normal(triangle, u, v, hit)

    cdef void interpolate_normal(self, int triangle, double u, double v, Hit* hit) noexcept nogil:
        """Write the interpolated normal, or the geometric one where that points behind the face."""
        cdef int axis
        cdef const double* a
        cdef const double* b
        cdef const double* c
        if self.smooth[hit.object_id]:
            a = &self.corners[self.faces[triangle, 0], 3]
            b = &self.corners[self.faces[triangle, 1], 3]
            c = &self.corners[self.faces[triangle, 2], 3]
            for axis in range(3):
                hit.shading[axis] = (1.0 - u - v) * a[axis] + u * b[axis] + v * c[axis]
            if dot(hit.shading, hit.geometric) > 0.0:
                normalise(hit.shading)
                return
        for axis in range(3):
            hit.shading[axis] = hit.geometric[axis]


cdef bint plane_point(double* u, double* v, double* t, const TriangleRay* local) noexcept nogil:
    """Intersect a ray and a triangle's plane (Möller & Trumbore 1997); false if parallel."""
    cdef double[3] p
    cdef double[3] q
    cdef double det
    cross(p, local.direction, local.ac)
    cross(q, local.origin, local.ab)
    det = dot(local.ab, p)
    if det == 0.0:
        return False
    u[0] = dot(local.origin, p) / det
    v[0] = dot(local.direction, q) / det
    t[0] = dot(local.ac, q) / det
    return True


cdef void barycentric(double* u, double* v, const TriangleRay* local) noexcept nogil:
    """Replace embree's u, v by those of float64, clamped to the triangle.

    Embree's are kept where the ray misses the triangle in float64. That happens at grazing angles,
    because embree's ray starts a step off the surface.
    """
    cdef double exact_u, exact_v, t
    if not plane_point(&exact_u, &exact_v, &t, local):
        return
    # Written so that NaN fails.
    if not (t >= 0.0 and exact_u >= -OUTSIDE and exact_v >= -OUTSIDE
            and exact_u + exact_v <= 1.0 + OUTSIDE):
        return
    u[0] = min(max(exact_u, 0.0), 1.0)
    v[0] = min(max(exact_v, 0.0), 1.0 - u[0])
