"""Embree's frame, hits and triangles, for kernels that cast rays."""


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

    cdef double ray_to_embree(
        self, const double* origin, const double* direction, const double* offset,
        float* out_origin, float* out_direction,
    ) noexcept nogil
    cdef double skipped(self, const double* o, const double* d) noexcept nogil
    cdef double resolution_at(self, const double* position) noexcept nogil
    cdef double step(
        self, const double* a, const double* b, const double* c, const double* p
    ) noexcept nogil


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
