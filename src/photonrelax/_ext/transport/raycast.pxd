"""Embree's frame, hits and triangles, for kernels that cast rays."""

from libc.math cimport INFINITY, NAN, isfinite

from ..common.vec3 cimport dot


cdef struct Hit:
    # Intersection of a ray and a triangle: m, unit vectors.
    # `step` is how far rays that leave have to be moved off the triangle.
    int object_id
    double distance, step
    double[3] position
    double[3] geometric
    double[3] shading


cdef struct TriangleRay:
    # A ray and the edges of a triangle, relative to the triangle's first corner.
    const double* corner
    double[3] ab
    double[3] ac
    double[3] origin
    double[3] direction


cdef class EmbreeHits:
    # `triangle` is -1 for rays that miss.
    cdef readonly Py_ssize_t n_rays
    cdef int[::1] triangle
    cdef float[::1] u, v


cdef class EmbreeFrame:
    cdef double[3] origin
    cdef double[3] low
    cdef double[3] high
    cdef readonly double scale
    cdef double rounding, local_rounding, least_distance

    cdef double resolution_at(self, const double* position) noexcept nogil
    cdef double step(
        self, const double* a, const double* b, const double* c, const double* p
    ) noexcept nogil


cdef inline double entered(
    const double* o, const double* d, const double* low, const double* high
) noexcept nogil:
    """Length of a ray before a box, zero from inside; negative if the ray misses the box."""
    cdef double enter = 0.0, leave = INFINITY, near, far, inverse
    cdef int axis
    for axis in range(3):
        if d[axis] != 0.0:
            inverse = 1.0 / d[axis]
            near = (low[axis] - o[axis]) * inverse
            far = (high[axis] - o[axis]) * inverse
            enter = max(enter, min(near, far))
            leave = min(leave, max(near, far))
        elif not low[axis] <= o[axis] <= high[axis]:
            return -1.0
    return enter if enter <= leave else -1.0


cdef inline double skipped_length(
    EmbreeFrame frame, const double* o, const double* d
) noexcept nogil:
    """Length of a ray before the box: distant origins are coarse in float32. NaN if invalid.

    Rays that miss the box start where they are nearest to its centre.
    """
    cdef double enter, closest = 0.0
    cdef bint inside = True
    cdef int axis
    if not isfinite(dot(o, d)):
        return NAN
    for axis in range(3):
        inside &= frame.low[axis] <= o[axis] <= frame.high[axis]
    if inside:
        return 0.0
    enter = entered(o, d, frame.low, frame.high)
    if enter >= 0.0:
        return enter
    for axis in range(3):
        closest += d[axis] * (0.5 * (frame.low[axis] + frame.high[axis]) - o[axis])
    return max(closest, 0.0)


cdef inline double ray_to_embree(
    EmbreeFrame frame, const double* origin, const double* direction, const double* offset,
    float* out_origin, float* out_direction,
) noexcept nogil:
    """Write one ray and return the length skipped at its start; not finite if it is invalid.

    `direction` is a unit vector. The ray starts off the surface by `offset`, which is along the
    normal, to the side that the ray leaves to; NULL for rays that start in free space.
    """
    cdef double[3] o
    cdef int axis
    cdef double skipped, side = 0.0
    if offset != NULL and isfinite(offset[0] + offset[1] + offset[2]):
        side = 1.0 if dot(offset, direction) >= 0.0 else -1.0
    for axis in range(3):
        o[axis] = origin[axis] - frame.origin[axis]
        if side != 0.0:
            o[axis] += side * offset[axis]
    skipped = skipped_length(frame, o, direction)
    for axis in range(3):
        out_origin[axis] = <float>((o[axis] + skipped * direction[axis]) * frame.scale)
        out_direction[axis] = <float>direction[axis]
    return skipped


cdef class Triangles:
    cdef EmbreeFrame frame
    cdef const double[:, ::1] corners
    cdef const int[:, ::1] faces
    cdef const int[::1] face_id
    cdef const unsigned char[::1] smooth

    cdef void prefetch(self, EmbreeHits found, Py_ssize_t ray) noexcept nogil
    cdef bint refine_hit(
        self, EmbreeHits found, Py_ssize_t ray, const double* origin, const double* direction,
        Hit* hit,
    ) noexcept nogil
    cdef double step_at(
        self, int triangle, double u, double v, const TriangleRay* local
    ) noexcept nogil
    cdef bint intersects(
        self, int triangle, const double* origin, const double* direction,
        double max_distance, Hit* hit,
    ) noexcept nogil
    cdef void triangle_setup(
        self, TriangleRay* local, int triangle, const double* origin, const double* direction
    ) noexcept nogil
    cdef void write_hit(
        self, Hit* hit, int triangle, double u, double v, const TriangleRay* local
    ) noexcept nogil
    cdef void interpolate_normal(self, int triangle, double u, double v, Hit* hit) noexcept nogil
