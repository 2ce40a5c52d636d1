"""Deposits of a batch: collected in the order of events, written in the order of their paths."""

cimport cython
from libc.stdint cimport int32_t, int64_t
from libc.string cimport memcpy

import numpy as np

from ..common.vec3 cimport copy

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
        ("block", np.int32),
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
        self, deposits, const int32_t[::1] rows, const double[:, ::1] coords,
        const double[::1] density, *, Py_ssize_t first, const double[:, ::1] flux,
        const int32_t[::1] emitter_id,
    ):
        """Fill the rows from `first` with deposits (n,), each its own of `rows` from there.

        `coords` and `density` have a row for each deposit, `flux` and `emitter_id` for each block.
        """
        cdef Py_ssize_t i, n = len(deposits)
        cdef const unsigned char[::1] memory
        cdef const Deposit* deposit
        cdef bint fits = True
        if first < 0 or self.position.shape[0] < first + n:
            raise ValueError(f"columns should have rows {first} to {first + n}")
        if not (
            deposits.dtype == DEPOSIT and n == rows.shape[0] == coords.shape[0] == density.shape[0]
            and flux.shape[0] == emitter_id.shape[0] and flux.shape[1] == 3
            and coords.shape[1] >= self.emitter_coords.shape[1]
        ):
            raise ValueError("deposits, rows, coords, density and flux do not fit the columns")
        if n == 0:
            return
        memory = np.ascontiguousarray(deposits).view(np.uint8)
        deposit = <const Deposit*> &memory[0]
        with nogil:
            for i in range(n):
                if not (0 <= rows[i] < n and 0 <= deposit.block < flux.shape[0]):
                    fits = False
                    break
                self.fill(
                    first + rows[i], deposit, &coords[i, 0], density[i], &flux[deposit.block, 0]
                )
                self.emitter_id[first + rows[i]] = emitter_id[deposit.block]
                deposit += 1
        if not fits:
            raise ValueError("rows and blocks of deposits should be below their numbers")

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


@cython.final
cdef class Deposits:
    """Deposits of up to `size` paths, and emitter coordinates and density of each path."""

    def __init__(self, Py_ssize_t size):
        self.coords = np.empty((size, 3))
        self.density = np.empty(size)
        self.next_row = np.empty(size, np.int32)
        self.clear(0)

    cdef void clear(self, Py_ssize_t n_paths):
        """Start anew, with deposits of so many paths to come."""
        self.n, self.n_paths, self.capacity = 0, n_paths, 0

    cdef void reserve(self, Py_ssize_t n):
        """Make room for n more deposits."""
        cdef Py_ssize_t capacity = max(self.n + n, 3 * self.capacity // 2)
        cdef unsigned char[::1] larger
        if self.n + n > self.capacity:
            larger = np.empty(capacity * sizeof(Deposit), np.uint8)
            if self.n:
                memcpy(&larger[0], self.rows, self.n * sizeof(Deposit))
            self.memory, self.capacity = larger, capacity
            self.rows = <Deposit*> &larger[0]

    cdef Deposit* add(self) noexcept nogil:
        """Return a row to be filled."""
        self.n += 1
        return &self.rows[self.n - 1]

    def take(self):
        """Arrays of the deposits, which are then no longer here.

        Returns
        -------
        (n,) `DEPOSIT`, (n,) int32, (n, 3), (n,)
            In the order of events: deposits, their rows in the order of the paths (deposits of a
            path keep their order), and emitter coordinates and density of their paths.
        """
        cdef Py_ssize_t i
        cdef int32_t path
        cdef int32_t[::1] rows = np.empty(self.n, np.int32)
        cdef double[:, ::1] coords = np.empty((self.n, 3))
        cdef double[::1] density = np.empty(self.n)
        deposits = np.empty(0, DEPOSIT)
        if self.n:
            deposits = self.memory.base[: self.n * sizeof(Deposit)].view(DEPOSIT)
        with nogil:
            self.find_rows()
            for i in range(self.n):
                path = self.rows[i].path
                rows[i] = self.next_row[path]
                self.next_row[path] += 1
                copy(&coords[i, 0], &self.coords[path, 0])
                density[i] = self.density[path]
        self.clear(0)
        return deposits, rows.base, coords.base, density.base

    cdef void find_rows(self) noexcept nogil:
        """Write the row of the first deposit of each path, in the order of the paths."""
        cdef Py_ssize_t i
        cdef int32_t before = 0, own
        if self.n == 0:
            return
        self.next_row[: self.n_paths] = 0
        for i in range(self.n):
            self.next_row[self.rows[i].path] += 1
        for i in range(self.n_paths):
            own = self.next_row[i]
            self.next_row[i] = before
            before += own
