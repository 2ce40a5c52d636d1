"""Derivatives of interpolated normals along faces, for camera rays and replayed paths."""

from libc.math cimport sqrt

from ..common.vec3 cimport cross, dot


cdef void normal_derivative(
    double* out, const double* position, const double* a, const double* b, const double* c,
    const double* normal_a, const double* normal_b, const double* normal_c,
) noexcept nogil:
    """Write the derivative (3, 3) of n = N / |N|, N interpolated between the corners of a face.

    Zero where the geometric normal serves, because N points behind the face.
    """
    cdef double[3] ab, ac, offset, to_b, to_c, face, gradient_u, gradient_v, normal
    cdef double squared_area, u, v, length, along
    cdef int i, j
    for i in range(3):
        ab[i], ac[i] = b[i] - a[i], c[i] - a[i]
        offset[i] = position[i] - a[i]
        to_b[i], to_c[i] = normal_b[i] - normal_a[i], normal_c[i] - normal_a[i]
    cross(face, ab, ac)
    # Of the parallelogram.
    squared_area = dot(face, face)
    cross(gradient_u, ac, face)
    cross(gradient_v, face, ab)
    for i in range(3):
        gradient_u[i] /= squared_area
        gradient_v[i] /= squared_area
    u, v = dot(gradient_u, offset), dot(gradient_v, offset)
    for i in range(3):
        normal[i] = normal_a[i] + u * to_b[i] + v * to_c[i]
    if not dot(normal, face) > 0.0:
        for i in range(9):
            out[i] = 0.0
        return
    length = sqrt(dot(normal, normal))
    for i in range(3):
        normal[i] /= length
    for j in range(3):
        along = 0.0
        for i in range(3):
            out[3 * i + j] = to_b[i] * gradient_u[j] + to_c[i] * gradient_v[j]
            along += normal[i] * out[3 * i + j]
        for i in range(3):
            out[3 * i + j] = (out[3 * i + j] - along * normal[i]) / length


cdef void change_along(double* out, const double* derivative, const double* step) noexcept nogil:
    """Write a derivative (3, 3) times a step."""
    cdef int i
    for i in range(3):
        out[i] = dot(derivative + 3 * i, step)


def normal_derivatives(
    const double[:, ::1] position, const double[:, :, ::1] corners, const double[:, :, ::1] normals,
    double[:, :, ::1] out,
):
    """Write the derivatives (n, 3, 3) of normals at positions (n, 3) on faces.

    `corners` and `normals` (n, 3, 3) are those of each face.
    """
    cdef Py_ssize_t i, n = position.shape[0]
    if not (
        corners.shape[0] == normals.shape[0] == out.shape[0] == n
        and position.shape[1] == corners.shape[1] == corners.shape[2] == normals.shape[1]
        == normals.shape[2] == out.shape[1] == out.shape[2] == 3
    ):
        raise ValueError("positions, faces and derivatives do not fit one another")
    with nogil:
        for i in range(n):
            normal_derivative(
                &out[i, 0, 0], &position[i, 0],
                &corners[i, 0, 0], &corners[i, 1, 0], &corners[i, 2, 0],
                &normals[i, 0, 0], &normals[i, 1, 0], &normals[i, 2, 0],
            )
