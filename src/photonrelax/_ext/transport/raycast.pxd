"""What kernels that cast rays share: embree's frame, what it finds, the triangles it knows."""


cdef struct Hit:
    # Where a ray meets a triangle: m, unit vectors.
    int object_id
    double distance
    double[3] position
    double[3] geometric
    double[3] shading


cdef struct Sight:
    # A triangle and a ray, from the triangle's first corner.
    const double* corner
    double[3] ab
    double[3] ac
    double[3] origin
    double[3] direction


cdef class Found:
    # `triangle` is -1 where a ray meets nothing.
    cdef readonly Py_ssize_t n_rays
    cdef const int[::1] triangle
    cdef const float[::1] u, v


cdef class Frame:
    cdef double[3] origin
    cdef double[3] centre
    cdef double scale, radius, step

    cdef double enter_one(
        self, const double* origin, const double* direction, const double* normal,
        float* out_origin, float* out_direction,
    ) noexcept nogil
    cdef double step_along(self, const double* normal, const double* d) noexcept nogil


cdef class Triangles:
    cdef Frame frame
    cdef const double[:, ::1] corners
    cdef const int[:, ::1] faces
    cdef const int[::1] face_id
    cdef const unsigned char[::1] smooth

    cdef void prefetch(self, Found found, Py_ssize_t ray) noexcept nogil
    cdef bint resolve_one(
        self, Found found, Py_ssize_t ray, const double* origin, const double* direction, Hit* hit,
    ) noexcept nogil
    cdef bint meets(
        self, int triangle, const double* origin, const double* direction, double reach, Hit* hit,
    ) noexcept nogil
    cdef void look(
        self, Sight* sight, int triangle, const double* origin, const double* direction
    ) noexcept nogil
    cdef void write_hit(
        self, Hit* hit, int triangle, double u, double v, const Sight* sight
    ) noexcept nogil
    cdef void interpolate_normal(self, int triangle, double u, double v, Hit* hit) noexcept nogil
