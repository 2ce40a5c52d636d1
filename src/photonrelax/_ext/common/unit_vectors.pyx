"""Vectors scaled to unit length, in parallel."""

from cython.parallel cimport prange

from .threads cimport team_size


def unit_vectors(const double[:, ::1] vectors, double[:, ::1] out, int n_threads):
    """Write vectors (n, 3) scaled to unit length; true if all have one."""
    cdef Py_ssize_t part, n_bad = 0, n_parts = n_grains(vectors.shape[0])
    for part in prange(
        n_parts, nogil=True, schedule="static", num_threads=team_size(n_threads, n_parts, 1)
    ):
        n_bad += scale_part(vectors, out, part)
    return n_bad == 0


cdef Py_ssize_t scale_part(
    const double[:, ::1] vectors, double[:, ::1] out, Py_ssize_t part
) noexcept nogil:
    """Scale some vectors; the number of those that cannot be."""
    cdef Py_ssize_t i, n_bad = 0
    for i in range(GRAIN_SIZE * part, min(GRAIN_SIZE * part + GRAIN_SIZE, vectors.shape[0])):
        n_bad += not to_unit(&out[i, 0], &vectors[i, 0])
    return n_bad
