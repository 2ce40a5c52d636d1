"""Unit normals: grouping of nearly equal ones, and comparison with the faces photons lie on."""

from cython.parallel cimport prange
from libc.math cimport fabs
from libc.stdint cimport int8_t, uint64_t

import numpy as np

from ..common.unit_vectors cimport GRAIN_SIZE, n_grains, to_unit

# Normals of the triangles of a plane differ by so little.
cdef double ROUNDINGS = 1e-15


cdef inline bint same(const double* a, const double* b) noexcept nogil:
    return a[0] == b[0] and a[1] == b[1] and a[2] == b[2]


cdef inline bint nearly_same(const double* a, const double* b) noexcept nogil:
    return (
        fabs(a[0] - b[0]) <= ROUNDINGS and fabs(a[1] - b[1]) <= ROUNDINGS
        and fabs(a[2] - b[2]) <= ROUNDINGS
    )


def distinct(const double[:, ::1] normals, int most):
    """Tell normals apart that differ by more than roundings, as long as they are few.

    Parameters
    ----------
    normals : (n, 3) float array
    most : int
        At most 64.

    Returns
    -------
    faces : (f, 3) float array or None
        The normals told apart, as they first appear; None if there are more than `most`.
    face : (n,) int8 array
        Which of them each row has.
    """
    cdef double[:, ::1] faces = np.empty((most, 3))
    cdef int8_t[::1] face = np.empty(normals.shape[0], np.int8)
    cdef Py_ssize_t i
    cdef int number = 0, n_faces = 0
    with nogil:
        for i in range(normals.shape[0]):
            if n_faces == 0 or not nearly_same(&normals[i, 0], &faces[number, 0]):
                number = face_of(faces, n_faces, &normals[i, 0])
            if number == most:
                break
            if number == n_faces:
                faces[number] = normals[i]
                n_faces += 1
            face[i] = number
    if number == most:
        return None, face.base
    return faces.base[:n_faces], face.base


cdef int face_of(const double[:, ::1] faces, int n_faces, const double* normal) noexcept nogil:
    """Return which of the faces has this normal but for roundings, `n_faces` if none."""
    cdef int number = 0
    while number < n_faces and not nearly_same(&faces[number, 0], normal):
        number += 1
    return number


def alike(const double[:, ::1] normals, const Py_ssize_t[::1] rows):
    """Tell whether normals are the same but for roundings: in some rows, or all for None."""
    cdef Py_ssize_t i, n = normals.shape[0] if rows is None else rows.shape[0]
    cdef Py_ssize_t first, row
    if n == 0:
        return True
    first = 0 if rows is None else rows[0]
    with nogil:
        for i in range(1, n):
            row = i if rows is None else rows[i]
            if not nearly_same(&normals[row, 0], &normals[first, 0]):
                break
        else:
            i = n
    return i == n


def faced(
    const double[:, ::1] normals, const double[:, ::1] faces, const uint64_t[::1] sets,
    double limit, int n_threads
):
    """Find which faces are turned from each normal by no more than a limit.

    Parameters
    ----------
    normals : (m, 3) float array
        Of any length; not yet known to have one.
    faces : (f, 3) float array
        Unit normals, at most 64.
    sets : (s,) uint64 array
        Sets of faces, face j being bit j; fewer than 126.
    limit : float
        Longest chord between unit normals.

    Returns
    -------
    (m,) int8 array
        The set of the faces in reach, -1 if there are none, s if they are another set;
        -2 where the normal is zero or not finite.
    """
    cdef int8_t[::1] found = np.empty(normals.shape[0], np.int8)
    cdef Py_ssize_t part
    for part in prange(
        n_grains(normals.shape[0]), nogil=True, schedule="static", num_threads=n_threads
    ):
        find_faced(normals, faces, sets, limit * limit, part, found)
    return found.base


cdef void find_faced(
    const double[:, ::1] normals, const double[:, ::1] faces, const uint64_t[::1] sets,
    double squared_limit, Py_ssize_t part, int8_t[::1] found
) noexcept nogil:
    """Find the sets of some normals; those that follow each other are often the same."""
    cdef Py_ssize_t i
    cdef double[3] unit
    for i in range(GRAIN_SIZE * part, min(GRAIN_SIZE * part + GRAIN_SIZE, normals.shape[0])):
        if i > GRAIN_SIZE * part and same(&normals[i, 0], &normals[i - 1, 0]):
            found[i] = found[i - 1]
        elif to_unit(unit, &normals[i, 0]):
            found[i] = number_of(sets, faces_near(faces, unit, squared_limit))
        else:
            found[i] = -2


cdef uint64_t faces_near(
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


cdef int number_of(const uint64_t[::1] sets, uint64_t wanted) noexcept nogil:
    cdef int number = 0
    if wanted == 0:
        return -1
    while number < sets.shape[0] and sets[number] != wanted:
        number += 1
    return number
