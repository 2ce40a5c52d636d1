"""Unit normals: grouping of nearly equal ones, and the faces near each of them."""

from cython.parallel cimport prange
from libc.math cimport fabs
from libc.stdint cimport int8_t, uint64_t

import numpy as np

from ..common.threads cimport team_size
from ..common.unit_vectors cimport GRAIN_SIZE, n_grains, to_unit

# Largest difference between the normals of the triangles of a plane, by rounding.
cdef double ROUNDING_ERROR = 1e-15


cdef inline bint equal(const double* a, const double* b) noexcept nogil:
    return a[0] == b[0] and a[1] == b[1] and a[2] == b[2]


cdef inline bint nearly_equal(const double* a, const double* b) noexcept nogil:
    return (
        fabs(a[0] - b[0]) <= ROUNDING_ERROR and fabs(a[1] - b[1]) <= ROUNDING_ERROR
        and fabs(a[2] - b[2]) <= ROUNDING_ERROR
    )


def group_normals(const double[:, ::1] normals, int max_groups):
    """Group normals that are equal but for rounding, as long as the groups are few.

    Parameters
    ----------
    normals : (n, 3) float array
    max_groups : int
        At most 64.

    Returns
    -------
    faces : (f, 3) float array or None
        One normal a group, in the order of their first rows; None for more than `max_groups`.
    face : (n,) int8 array
        The group of each row.
    """
    cdef double[:, ::1] faces = np.empty((max_groups, 3))
    cdef int8_t[::1] face = np.empty(normals.shape[0], np.int8)
    cdef Py_ssize_t i
    cdef int number = 0, n_faces = 0
    with nogil:
        for i in range(normals.shape[0]):
            if n_faces == 0 or not nearly_equal(&normals[i, 0], &faces[number, 0]):
                number = face_of(faces, n_faces, &normals[i, 0])
            if number == max_groups:
                break
            if number == n_faces:
                faces[number] = normals[i]
                n_faces += 1
            face[i] = number
    if number == max_groups:
        return None, face.base
    return faces.base[:n_faces], face.base


cdef int face_of(const double[:, ::1] faces, int n_faces, const double* normal) noexcept nogil:
    """Number of the face that has this normal but for rounding, `n_faces` if none has."""
    cdef int number = 0
    while number < n_faces and not nearly_equal(&faces[number, 0], normal):
        number += 1
    return number


def all_nearly_equal(const double[:, ::1] normals, const Py_ssize_t[::1] rows):
    """True if the normals of some rows, all for None, are equal but for rounding."""
    cdef Py_ssize_t i, n = normals.shape[0] if rows is None else rows.shape[0]
    cdef Py_ssize_t first, row
    if n == 0:
        return True
    first = 0 if rows is None else rows[0]
    with nogil:
        for i in range(1, n):
            row = i if rows is None else rows[i]
            if not nearly_equal(&normals[row, 0], &normals[first, 0]):
                break
        else:
            i = n
    return i == n


def find_face_sets(
    const double[:, ::1] normals, const double[:, ::1] faces, const uint64_t[::1] sets,
    double limit, int n_threads
):
    """Return the set of the faces within a limit of each normal.

    Parameters
    ----------
    normals : (m, 3) float array
        Of any length, which may be zero.
    faces : (f, 3) float array
        Unit normals, at most 64.
    sets : (s,) uint64 array
        Sets of faces, face j being bit j; fewer than 126.
    limit : float
        Longest chord between unit normals.

    Returns
    -------
    (m,) int8 array
        The number of the set of faces within the limit, -1 if that is empty, s if it is not one
        of the sets; -2 where the normal is zero or not finite.
    """
    cdef int8_t[::1] found = np.empty(normals.shape[0], np.int8)
    cdef Py_ssize_t grain, n_parts = n_grains(normals.shape[0])
    for grain in prange(
        n_parts, nogil=True, schedule="static", num_threads=team_size(n_threads, n_parts, 1)
    ):
        find_sets_of_grain(normals, faces, sets, limit * limit, grain, found)
    return found.base


cdef void find_sets_of_grain(
    const double[:, ::1] normals, const double[:, ::1] faces, const uint64_t[::1] sets,
    double squared_limit, Py_ssize_t grain, int8_t[::1] found
) noexcept nogil:
    """Find the sets of one grain of normals; consecutive ones are often equal."""
    cdef Py_ssize_t i
    cdef double[3] unit
    for i in range(GRAIN_SIZE * grain, min(GRAIN_SIZE * grain + GRAIN_SIZE, normals.shape[0])):
        if i > GRAIN_SIZE * grain and equal(&normals[i, 0], &normals[i - 1, 0]):
            found[i] = found[i - 1]
        elif to_unit(unit, &normals[i, 0]):
            found[i] = number_of(sets, faces_within(faces, unit, squared_limit))
        else:
            found[i] = -2


cdef uint64_t faces_within(
    const double[:, ::1] faces, const double* unit, double squared_limit
) noexcept nogil:
    cdef uint64_t near = 0
    cdef double x, y, z
    cdef Py_ssize_t face
    for face in range(faces.shape[0]):
        x = faces[face, 0] - unit[0]
        y = faces[face, 1] - unit[1]
        z = faces[face, 2] - unit[2]
        if x * x + y * y + z * z <= squared_limit:
            near |= <uint64_t> 1 << face
    return near


cdef int number_of(const uint64_t[::1] sets, uint64_t members) noexcept nogil:
    cdef int number = 0
    if members == 0:
        return -1
    while number < sets.shape[0] and sets[number] != members:
        number += 1
    return number
