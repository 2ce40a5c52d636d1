"""Deposits of a batch: collected in the order of events, written in the order of their paths."""

cimport cython
from libc.stdint cimport int32_t, int64_t

import numpy as np


@cython.final
cdef class Columns:
    """The columns of a photon map, with room for photons to come."""

    cdef double[:, ::1] position, normal, wi, flux, emitter_coords
    cdef double[::1] emitter_density, path_length
    cdef int64_t[::1] path_signature
    cdef int32_t[::1] emitter_id, n_bounces, object_id

    def __init__(
        self, *, double[:, ::1] position, double[:, ::1] normal, double[:, ::1] wi,
        double[:, ::1] flux, double[:, ::1] emitter_coords, double[::1] emitter_density,
        int32_t[::1] emitter_id, int64_t[::1] path_signature, int32_t[::1] n_bounces,
        double[::1] path_length, int32_t[::1] object_id,
    ):
        self.position, self.normal, self.wi, self.flux = position, normal, wi, flux
        self.emitter_coords, self.emitter_density = emitter_coords, emitter_density
        self.emitter_id, self.path_signature = emitter_id, path_signature
        self.n_bounces, self.path_length, self.object_id = n_bounces, path_length, object_id

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
        self.object_id[row] = deposit.object_id


@cython.final
cdef class Deposits:
    """What up to `n_paths` paths store, and where each of them left its emitter."""

    def __init__(self, Py_ssize_t n_paths):
        self.coords = np.zeros((n_paths, 3))
        self.density = np.empty(n_paths)
        self.place = np.empty(n_paths, np.int32)
        self.memory = np.empty(0, np.uint8)

    def __len__(self):
        return self.n

    cdef void clear(self, Py_ssize_t n_paths):
        """Make ready for paths that have stored nothing yet."""
        self.n_paths, self.n = n_paths, 0

    cdef void reserve(self, Py_ssize_t n):
        """Have room for n deposits more."""
        cdef Py_ssize_t size = (self.n + n) * sizeof(Deposit)
        if size > self.memory.shape[0]:
            larger = np.empty(max(size, 3 * self.memory.shape[0] // 2), np.uint8)
            larger[: self.memory.shape[0]] = self.memory
            self.memory = larger
            self.rows = <Deposit*> &self.memory[0]

    cdef Deposit* add(self) noexcept nogil:
        """Return a row to be filled."""
        self.n += 1
        return &self.rows[self.n - 1]

    cdef void order(self) noexcept nogil:
        """Count which place in the order of the paths the first deposit of each path has."""
        cdef Py_ssize_t i
        cdef int32_t before = 0, here
        self.place[: self.n_paths] = 0
        for i in range(self.n):
            self.place[self.rows[i].path] += 1
        for i in range(self.n_paths):
            here = self.place[i]
            self.place[i] = before
            before += here

    def ends(self):
        """Return, for each path, the number of photons up to its last; after `write`."""
        return np.array(self.place[: self.n_paths])

    def write(self, Columns columns, Py_ssize_t first, const double[::1] flux, int emitter_id):
        """Fill the rows from `first` with photons of `flux`; deposits of a path keep their order.

        May be called once.
        """
        cdef Py_ssize_t i
        cdef int32_t path
        if columns.position.shape[0] < first + self.n:
            raise ValueError(f"columns should have {first + self.n} rows")
        with nogil:
            self.order()
            for i in range(self.n):
                path = self.rows[i].path
                columns.fill(
                    first + self.place[path], &self.rows[i], &self.coords[path, 0],
                    self.density[path], &flux[0],
                )
                self.place[path] += 1
            columns.emitter_id[first : first + self.n] = emitter_id
