"""Derivatives of interpolated normals along faces."""


cdef void normal_derivative(
    double* out, const double* position, const double* a, const double* b, const double* c,
    const double* normal_a, const double* normal_b, const double* normal_c,
) noexcept nogil
cdef void change_along(double* out, const double* derivative, const double* step) noexcept nogil
