"""Columns of arrays put side by side."""

from cython.parallel cimport prange


def copy_rows(
    double[:, ::1] target, Py_ssize_t first, const double[:, ::1] source,
    const Py_ssize_t[::1] rows, double scale, int n_threads
):
    """Copy some rows of `source`, multiplied by `scale`, to columns of `target` from `first` on.

    All rows if `rows` is None.
    """
    cdef Py_ssize_t i, row
    if target.shape[0] != (source.shape[0] if rows is None else rows.shape[0]):
        raise ValueError("rows do not fit the target")
    if first < 0 or first + source.shape[1] > target.shape[1]:
        raise ValueError("columns do not fit the target")
    for i in prange(target.shape[0], nogil=True, schedule="static", num_threads=n_threads):
        row = i if rows is None else rows[i]
        copy_row(&target[i, first], &source[row, 0], source.shape[1], scale)


cdef inline void copy_row(
    double* target, const double* source, Py_ssize_t n, double scale
) noexcept nogil:
    cdef Py_ssize_t column
    for column in range(n):
        target[column] = scale * source[column]
