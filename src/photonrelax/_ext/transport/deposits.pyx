"""Deposits of a batch: collected in the order of events, written in the order of their paths."""

cimport cython
from libc.stdint cimport int32_t, int64_t

import numpy as np

DEPOSIT = np.dtype(
    [
        ("position", np.float64, 3),
        ("normal", np.float64, 3),
        ("wi", np.float64, 3),
        ("throughput", np.float64, 3),
        ("path_length", np.float64),
        ("wavelength", np.float64),
        ("path_signature", np.int64),
        ("path", np.int32),
        ("n_bounces", np.int32),
        ("object_id", np.int32),
    ],
    align=True,
)


@cython.final
cdef class Columns:
    """The columns of a photon map, with rows for photons to come."""

    cdef double[:, ::1] position, normal, wi, flux, emitter_coords
    # `wavelength` is None in maps of white light.
    cdef double[::1] emitter_density, path_length, wavelength
    cdef int64_t[::1] path_signature
    cdef int32_t[::1] emitter_id, n_bounces, object_id

    def __init__(
        self, *, double[:, ::1] position, double[:, ::1] normal, double[:, ::1] wi,
        double[:, ::1] flux, double[:, ::1] emitter_coords, double[::1] emitter_density,
        int32_t[::1] emitter_id, int64_t[::1] path_signature, int32_t[::1] n_bounces,
        double[::1] path_length, int32_t[::1] object_id, double[::1] wavelength=None,
    ):
        self.position, self.normal, self.wi, self.flux = position, normal, wi, flux
        self.emitter_coords, self.emitter_density = emitter_coords, emitter_density
        self.emitter_id, self.path_signature = emitter_id, path_signature
        self.wavelength = wavelength
        self.n_bounces, self.path_length, self.object_id = n_bounces, path_length, object_id
        if not (
            position.shape[0] == normal.shape[0] == wi.shape[0] == flux.shape[0]
            == emitter_coords.shape[0] == emitter_density.shape[0] == emitter_id.shape[0]
            == path_signature.shape[0] == n_bounces.shape[0] == path_length.shape[0]
            == object_id.shape[0]
            and (wavelength is None or wavelength.shape[0] == object_id.shape[0])
            and position.shape[1] == normal.shape[1] == wi.shape[1] == flux.shape[1] == 3
        ):
            raise ValueError("columns do not fit one another")

    def write(
        self, const Deposit[::1] deposits, const double[:, ::1] coords, const double[::1] density,
        const int64_t[::1] counts, *, Py_ssize_t first, const double[:, ::1] flux,
        const int32_t[::1] emitter_id,
    ):
        """Fill the rows from `first` with photons; deposits of a path keep their order.

        `coords` and `density` have a row for each path. Paths of a region follow one another:
        `counts`, `flux` and `emitter_id` have a row for each region.
        """
        cdef Py_ssize_t i, n = deposits.shape[0]
        cdef int32_t[::1] row = np.zeros(density.shape[0], np.int32)
        cdef int32_t[::1] region = np.empty(density.shape[0], np.int32)
        cdef int32_t path
        if first < 0 or self.position.shape[0] < first + n:
            raise ValueError(f"columns should have rows {first} to {first + n}")
        if not (
            coords.shape[0] == density.shape[0] and numbers_in_parts(region, counts)
            and counts.shape[0] == flux.shape[0] == emitter_id.shape[0] and flux.shape[1] == 3
            and coords.shape[1] >= self.emitter_coords.shape[1]
        ):
            raise ValueError("coords, density, counts and flux do not fit the columns")
        with nogil:
            first_rows(row, deposits)
            for i in range(n):
                path = deposits[i].path
                self.fill(
                    first + row[path], &deposits[i], &coords[path, 0], density[path],
                    &flux[region[path], 0],
                )
                self.emitter_id[first + row[path]] = emitter_id[region[path]]
                row[path] += 1

    cdef void fill(
        self, Py_ssize_t row, const Deposit* deposit, const double* coords, double density,
        const double* flux,
    ) noexcept nogil:
        cdef int c
        for c in range(3):
            self.position[row, c] = deposit.position[c]
            self.normal[row, c] = deposit.normal[c]
            self.wi[row, c] = deposit.wi[c]
            self.flux[row, c] = deposit.throughput[c] * flux[c]
        for c in range(self.emitter_coords.shape[1]):
            self.emitter_coords[row, c] = coords[c]
        self.emitter_density[row] = density
        self.path_signature[row] = deposit.path_signature
        self.n_bounces[row] = deposit.n_bounces
        self.path_length[row] = deposit.path_length
        if self.wavelength is not None:
            self.wavelength[row] = deposit.wavelength
        self.object_id[row] = deposit.object_id


cdef bint numbers_in_parts(int32_t[::1] number, const int64_t[::1] counts) noexcept nogil:
    """Write the number of its part for each row; false if counts of parts are not of all rows."""
    cdef Py_ssize_t k, row = 0
    for k in range(counts.shape[0]):
        if not 0 <= counts[k] <= number.shape[0] - row:
            return False
        number[row : row + counts[k]] = <int32_t>k
        row += counts[k]
    return row == number.shape[0]


cdef void first_rows(int32_t[::1] row, const Deposit[::1] deposits) noexcept nogil:
    """Write the row of the first deposit of each path, in the order of the paths; from zeros."""
    cdef Py_ssize_t i
    cdef int32_t before = 0, own
    for i in range(deposits.shape[0]):
        row[deposits[i].path] += 1
    for i in range(row.shape[0]):
        own = row[i]
        row[i] = before
        before += own


@cython.final
cdef class Deposits:
    """Deposits of `n_paths` paths, and emitter coordinates and density of each path."""

    def __init__(self, Py_ssize_t n_paths):
        self.coords = np.empty((n_paths, 3))
        self.density = np.empty(n_paths)
        self.rows = np.empty(0, DEPOSIT)

    cdef void reserve(self, Py_ssize_t n):
        """Make room for n more deposits."""
        cdef Deposit[::1] larger
        if self.n + n > self.rows.shape[0]:
            larger = np.empty(max(self.n + n, 3 * self.rows.shape[0] // 2), DEPOSIT)
            larger[: self.n] = self.rows[: self.n]
            self.rows = larger

    cdef Deposit* add(self) noexcept nogil:
        """Return a row to be filled."""
        self.n += 1
        return &self.rows[self.n - 1]

    def arrays(self):
        """Return deposits (n,) as `DEPOSIT`, coordinates (n_paths, 3) and densities (n_paths,)."""
        return self.rows.base[: self.n], self.coords.base, self.density.base
