"""Rays into embree's frame, and embree's answers back into exact hits.

Embree works in float32 and only says which triangle a ray meets; where it meets it is computed
here in float64, from the ray as it was given. Every loop writes row i only.
"""

from libc.math cimport NAN, INFINITY, isfinite, sqrt

from .core cimport cross, dot, normalise

# Barycentric coordinates may leave [0, 1] by this much through the rounding of embree's choice.
cdef double OUTSIDE = 1e-4


cdef class Frame:
    """Embree's coordinates: (x - origin) * scale; and a sphere (centre, radius) around the scene.

    `step` is how far rays are moved off the surface they leave, in m.
    """

    cdef double origin[3]
    cdef double centre[3]
    cdef double scale, radius, step

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


cdef class Triangles:
    """The triangles embree knows, in float64 relative to the frame's origin.

    vertices and vertex_normals are (v, 3), faces (f, 3) int32; object_id, face_id and smooth
    (f,) say for each triangle where it comes from and whether its normals are interpolated.
    """

    cdef const double[:, ::1] vertices
    cdef const double[:, ::1] vertex_normals
    cdef const int[:, ::1] faces
    cdef const int[::1] object_id
    cdef const int[::1] face_id
    cdef const unsigned char[::1] smooth

    def __init__(self, vertices, vertex_normals, faces, object_id, face_id, smooth):
        self.vertices = vertices
        self.vertex_normals = vertex_normals
        self.faces = faces
        self.object_id = object_id
        self.face_id = face_id
        self.smooth = smooth

    def resolve(self, Frame frame, const double[:, ::1] origins,
                const double[:, ::1] directions, found, out):
        """Write the exact hits of rays into `out` (Intersections) from what embree `found`."""
        cdef const int[::1] triangle = found["primID"]
        cdef const float[::1] u = found["u"]
        cdef const float[::1] v = found["v"]
        cdef int[::1] object_id = out.object_id
        cdef int[::1] face_id = out.face_id
        cdef double[::1] distance = out.distance
        cdef double[:, ::1] position = out.position
        cdef double[:, ::1] geometric = out.geometric_normal
        cdef double[:, ::1] shading = out.shading_normal
        cdef Py_ssize_t i
        cdef int axis
        with nogil:
            for i in range(origins.shape[0]):
                if triangle[i] >= 0:
                    object_id[i] = self.object_id[triangle[i]]
                    face_id[i] = self.face_id[triangle[i]]
                    distance[i] = self.resolve_one(
                        frame, triangle[i], &origins[i, 0], &directions[i, 0], u[i], v[i],
                        &position[i, 0], &geometric[i, 0], &shading[i, 0])
                else:
                    object_id[i] = -1
                    face_id[i] = -1
                    distance[i] = INFINITY
                    for axis in range(3):
                        position[i, axis] = NAN
                        geometric[i, axis] = NAN
                        shading[i, axis] = NAN

    cdef double resolve_one(self, Frame frame, int triangle, const double* origin,
                            const double* direction, double u, double v, double* position,
                            double* geometric, double* shading) noexcept nogil:
        """Write position and normals of one hit and return its distance."""
        cdef const double* a = &self.vertices[self.faces[triangle, 0], 0]
        cdef const double* b = &self.vertices[self.faces[triangle, 1], 0]
        cdef const double* c = &self.vertices[self.faces[triangle, 2], 0]
        cdef double ab[3]
        cdef double ac[3]
        cdef double ao[3]
        cdef double d[3]
        cdef int axis
        cdef double distance = 0.0
        for axis in range(3):
            ab[axis] = b[axis] - a[axis]
            ac[axis] = c[axis] - a[axis]
            ao[axis] = (origin[axis] - frame.origin[axis]) - a[axis]
            d[axis] = direction[axis]
        normalise(d)
        barycentric(&u, &v, ab, ac, ao, d)
        cross(geometric, ab, ac)
        normalise(geometric)
        for axis in range(3):
            position[axis] = a[axis] + u * ab[axis] + v * ac[axis]
            distance += (u * ab[axis] + v * ac[axis] - ao[axis]) * d[axis]
            position[axis] += frame.origin[axis]
        self.interpolate_normal(triangle, u, v, geometric, shading)
        return max(distance, 0.0)

    cdef void interpolate_normal(self, int triangle, double u, double v,
                                 const double* geometric, double* shading) noexcept nogil:
        """Write the interpolated normal, or the geometric one where that is not sensible."""
        cdef const double* a = &self.vertex_normals[self.faces[triangle, 0], 0]
        cdef const double* b = &self.vertex_normals[self.faces[triangle, 1], 0]
        cdef const double* c = &self.vertex_normals[self.faces[triangle, 2], 0]
        cdef int axis
        for axis in range(3):
            shading[axis] = (1.0 - u - v) * a[axis] + u * b[axis] + v * c[axis]
        if self.smooth[triangle] and dot(shading, geometric) > 0.0:
            normalise(shading)
        else:
            for axis in range(3):
                shading[axis] = geometric[axis]


cdef void barycentric(double* u, double* v, const double* ab, const double* ac,
                      const double* ao, const double* d) noexcept nogil:
    """Replace embree's u, v by exact ones (Möller & Trumbore 1997), clamped to the triangle.

    Embree's are kept where the exact ray does not meet the triangle, which happens at grazing
    angles: embree's ray starts a step off the surface.
    """
    cdef double p[3]
    cdef double q[3]
    cdef double det, exact_u, exact_v, t
    cross(p, d, ac)
    cross(q, ao, ab)
    det = dot(ab, p)
    if det == 0.0:
        return
    exact_u = dot(ao, p) / det
    exact_v = dot(d, q) / det
    t = dot(ac, q) / det
    # Written so that NaN fails.
    if not (t >= 0.0 and exact_u >= -OUTSIDE and exact_v >= -OUTSIDE
            and exact_u + exact_v <= 1.0 + OUTSIDE):
        return
    u[0] = min(max(exact_u, 0.0), 1.0)
    v[0] = min(max(exact_v, 0.0), 1.0 - u[0])
