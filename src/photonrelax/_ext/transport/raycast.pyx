"""Rays into embree's frame, and embree's answers back into exact hits.

Embree works in float32 and only says which triangle a ray meets; where it meets it is computed
here in float64, from the ray as it was given. Every loop writes row i only.
"""

cimport cython
from libc.math cimport NAN, INFINITY, isfinite, sqrt

from ..common.vec3 cimport cross, dot, normalise

cdef extern from *:
    """
    #if defined(__GNUC__)
    #define prefetch_line(address) __builtin_prefetch(address)
    #else
    #define prefetch_line(address) ((void)0)
    #endif
    """
    void prefetch_line(const void* address) noexcept nogil

# Barycentric coordinates may leave [0, 1] by this much through the rounding of embree's choice.
cdef double OUTSIDE = 1e-4
# How many rays before its own the corners of a triangle are called for: some 100 ns each.
cdef enum:
    AHEAD = 6


@cython.final
cdef class Frame:
    """Embree's coordinates: (x - origin) * scale; and a sphere (centre, radius) around the scene.

    `step` is how far rays are moved off the surface they leave, in m.
    """

    def __init__(self, const double[::1] origin, const double[::1] centre, *,
                 double scale, double radius, double step):
        cdef int axis
        for axis in range(3):
            self.origin[axis] = origin[axis]
            self.centre[axis] = centre[axis]
        self.scale = scale
        self.radius = radius
        self.step = step

    def enter(self, const double[:, ::1] origins, const double[:, ::1] directions,
              const double[:, ::1] leaving, const double[::1] limits,
              float[:, ::1] out_origins, float[:, ::1] out_directions, float[::1] out_limits):
        """Write rays as embree takes them; return the first one that is not a ray, or -1.

        `leaving` and `limits` (with `out_limits`) may have no rows: no surface left, no limit.
        """
        cdef Py_ssize_t i, bad = -1
        cdef bint from_surface = leaving.shape[0] > 0
        cdef bint limited = limits.shape[0] > 0
        cdef double skipped
        with nogil:
            for i in range(origins.shape[0]):
                skipped = self.enter_one(
                    &origins[i, 0], &directions[i, 0], &leaving[i, 0] if from_surface else NULL,
                    &out_origins[i, 0], &out_directions[i, 0])
                if not isfinite(skipped):
                    bad = i
                    break
                if limited:
                    # Embree calls a ray of negative length blocked.
                    out_limits[i] = <float>(max(limits[i] - skipped, 0.0) * self.scale)
        return bad

    cdef double enter_one(self, const double* origin, const double* direction,
                          const double* normal, float* out_origin,
                          float* out_direction) noexcept nogil:
        """Write one ray and return the length of its skipped beginning; NaN if it is no ray."""
        cdef double d[3]
        cdef double o[3]
        cdef double from_centre[3]
        cdef int axis
        cdef double skipped
        cdef double side = 0.0
        for axis in range(3):
            d[axis] = direction[axis]
        normalise(d)
        if normal != NULL:
            side = self.step_along(normal, d)
        for axis in range(3):
            o[axis] = origin[axis] - self.origin[axis]
            if side != 0.0:
                o[axis] += side * normal[axis]
            from_centre[axis] = o[axis] - self.centre[axis]
        # A ray from afar starts where the scene may begin: far origins are coarse in float32.
        skipped = -dot(from_centre, d) - self.radius
        if skipped < 0.0:
            skipped = 0.0
        for axis in range(3):
            out_origin[axis] = <float>((o[axis] + skipped * d[axis]) * self.scale)
            out_direction[axis] = <float>d[axis]
        return skipped

    cdef double step_along(self, const double* normal, const double* d) noexcept nogil:
        """Multiple of the normal that steps to the side d points to; 0 without a normal."""
        cdef double square = dot(normal, normal)
        if not (square > 0.0 and isfinite(square)):
            return 0.0
        return (self.step if dot(normal, d) >= 0.0 else -self.step) / sqrt(square)


@cython.final
cdef class Found:
    """What embree found for `n_rays` rays; refuses arrays of other lengths or types."""

    def __init__(self, dict found, Py_ssize_t n_rays):
        self.n_rays = n_rays
        for name in ("primID", "u", "v"):
            if found[name].shape != (n_rays,):
                raise ValueError(
                    f"embree was given {n_rays} rays, but its {name} has shape {found[name].shape}"
                )
        self.triangle, self.u, self.v = found["primID"], found["u"], found["v"]


@cython.final
cdef class Triangles:
    """The triangles embree knows, in float64 relative to the frame's origin.

    corners (v, 6) are vertices and their normals; faces (f, 4) are three corners and the object;
    face_id (f,) is the number in the object's mesh; smooth (objects,) says whether normals are
    interpolated.
    """

    def __init__(
        self, Frame frame, const double[:, ::1] corners, const int[:, ::1] faces,
        const int[::1] face_id, const unsigned char[::1] smooth,
    ):
        self.frame = frame
        self.corners = corners
        self.faces = faces
        self.face_id = face_id
        self.smooth = smooth

    def resolve(self, const double[:, ::1] origins, const double[:, ::1] directions,
                Found found, out):
        """Write the exact hits of rays into `out` (Intersections) from what embree `found`."""
        cdef int[::1] object_id = out.object_id
        cdef int[::1] face_id = out.face_id
        cdef double[::1] distance = out.distance
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
                met = self.resolve_one(found, i, &origins[i, 0], &directions[i, 0], &hit)
                object_id[i] = hit.object_id
                face_id[i] = self.face_id[found.triangle[i]] if met else -1
                distance[i] = hit.distance if met else INFINITY
                for axis in range(3):
                    position[i, axis] = hit.position[axis] if met else NAN
                    geometric[i, axis] = hit.geometric[axis] if met else NAN
                    shading[i, axis] = hit.shading[axis] if met else NAN

    cdef void prefetch(self, Found found, Py_ssize_t ray) noexcept nogil:
        """Call for the triangles of rays to come: they lie all over the memory."""
        cdef int triangle, corner
        cdef const double* row
        if ray + 2 * AHEAD < found.n_rays:
            triangle = found.triangle[ray + 2 * AHEAD]
            if triangle >= 0:
                prefetch_line(&self.faces[triangle, 0])
        if ray + AHEAD < found.n_rays:
            triangle = found.triangle[ray + AHEAD]
            if triangle >= 0:
                for corner in range(3):
                    row = &self.corners[self.faces[triangle, corner], 0]
                    prefetch_line(row)
                    prefetch_line(row + 5)

    cdef bint resolve_one(
        self, Found found, Py_ssize_t ray, const double* origin, const double* direction, Hit* hit
    ) noexcept nogil:
        """Write where a ray meets its triangle; false, and object -1, where it meets none."""
        cdef int triangle = found.triangle[ray]
        cdef double u, v
        cdef Sight sight
        if triangle < 0:
            hit.object_id = -1
            return False
        u, v = found.u[ray], found.v[ray]
        self.look(&sight, triangle, origin, direction)
        barycentric(&u, &v, &sight)
        self.write_hit(hit, triangle, u, v, &sight)
        return True

    cdef bint meets(
        self, int triangle, const double* origin, const double* direction, double reach, Hit* hit
    ) noexcept nogil:
        """Write where a ray meets a triangle, as `resolve_one` does; false where it does not.

        The triangle itself is asked, not embree: another may lie before it, within `reach`.
        """
        cdef double u, v, t
        cdef Sight sight
        self.look(&sight, triangle, origin, direction)
        if not (plane_point(&u, &v, &t, &sight) and 0.0 <= t <= reach):
            return False
        if not (u >= 0.0 and v >= 0.0 and u + v <= 1.0):
            return False
        self.write_hit(hit, triangle, u, min(v, 1.0 - u), &sight)
        return True

    cdef void look(
        self, Sight* sight, int triangle, const double* origin, const double* direction
    ) noexcept nogil:
        """Write a ray as seen from the first corner of a triangle."""
        cdef const double* b = &self.corners[self.faces[triangle, 1], 0]
        cdef const double* c = &self.corners[self.faces[triangle, 2], 0]
        cdef int axis
        sight.corner = &self.corners[self.faces[triangle, 0], 0]
        for axis in range(3):
            sight.ab[axis] = b[axis] - sight.corner[axis]
            sight.ac[axis] = c[axis] - sight.corner[axis]
            sight.origin[axis] = (origin[axis] - self.frame.origin[axis]) - sight.corner[axis]
            sight.direction[axis] = direction[axis]
        normalise(sight.direction)

    cdef void write_hit(
        self, Hit* hit, int triangle, double u, double v, const Sight* sight
    ) noexcept nogil:
        cdef double offset, distance = 0.0
        cdef int axis
        cross(hit.geometric, sight.ab, sight.ac)
        normalise(hit.geometric)
        for axis in range(3):
            offset = u * sight.ab[axis] + v * sight.ac[axis]
            hit.position[axis] = sight.corner[axis] + u * sight.ab[axis] + v * sight.ac[axis]
            distance += (offset - sight.origin[axis]) * sight.direction[axis]
            hit.position[axis] += self.frame.origin[axis]
        hit.distance = max(distance, 0.0)
        hit.object_id = self.faces[triangle, 3]
        self.interpolate_normal(triangle, u, v, hit)

    cdef void interpolate_normal(self, int triangle, double u, double v, Hit* hit) noexcept nogil:
        """Write the interpolated normal, or the geometric one where that is not sensible."""
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


cdef bint plane_point(double* u, double* v, double* t, const Sight* sight) noexcept nogil:
    """Write where a ray meets a triangle's plane (Möller & Trumbore 1997); false if nowhere."""
    cdef double[3] p
    cdef double[3] q
    cdef double det
    cross(p, sight.direction, sight.ac)
    cross(q, sight.origin, sight.ab)
    det = dot(sight.ab, p)
    if det == 0.0:
        return False
    u[0] = dot(sight.origin, p) / det
    v[0] = dot(sight.direction, q) / det
    t[0] = dot(sight.ac, q) / det
    return True


cdef void barycentric(double* u, double* v, const Sight* sight) noexcept nogil:
    """Replace embree's u, v by exact ones, clamped to the triangle.

    Embree's are kept where the exact ray does not meet the triangle, which happens at grazing
    angles: embree's ray starts a step off the surface.
    """
    cdef double exact_u, exact_v, t
    if not plane_point(&exact_u, &exact_v, &t, sight):
        return
    # Written so that NaN fails.
    if not (t >= 0.0 and exact_u >= -OUTSIDE and exact_v >= -OUTSIDE
            and exact_u + exact_v <= 1.0 + OUTSIDE):
        return
    u[0] = min(max(exact_u, 0.0), 1.0)
    v[0] = min(max(exact_v, 0.0), 1.0 - u[0])
