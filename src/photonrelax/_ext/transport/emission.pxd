"""Emission of single photons, for kernels that trace them."""

from libc.stdint cimport uint64_t

from ..scene.sky_map cimport SkyMap

cdef enum:
    # Numbers of the shape of any kind of region, at most.
    SHAPE_NUMBERS = 5


cdef class EmissionRegion:
    cdef int kind
    cdef double start_distance, density
    # Read for every photon: part of the object itself.
    cdef double[3] origin, coords_offset
    cdef double[3][3] frame
    cdef double[SHAPE_NUMBERS] shape
    # Of extended emitters, else None.
    cdef const double[::1] target, cumulative
    cdef const double[:, :, ::1] triangles
    # Of a map of the sky, and the colours (texels, 3) of its photons, else None.
    cdef SkyMap sky
    cdef const double[:, ::1] colours

    cdef void to_world(self, double* out, const double* local) noexcept nogil
    cdef double from_point(self, double* direction, double u, double v) noexcept nogil
    cdef double from_plane(
        self, double* origin, double* direction, double* coords, double u, double v
    ) noexcept nogil
    cdef double from_area(
        self, double* origin, double* direction, double* coords, const double* point
    ) noexcept nogil
    cdef void at_area(self, double* position, double* normal, const double* point) noexcept nogil
    cdef double to_target(
        self, double* direction, const double* origin, const double* point
    ) noexcept nogil
    cdef double taken(self, const double* point) noexcept nogil
    cdef double from_sun(
        self, double* origin, double* direction, double* coords, const double* point
    ) noexcept nogil
    cdef double ray(
        self, double* origin, double* direction, double* coords, const double* point
    ) noexcept nogil


cdef class Emission:
    cdef EmissionRegion region
    # Hash of seed and stream.
    cdef uint64_t stream_key
    cdef bint halton
    # Numbers of a photon's ray, and their shifts.
    cdef int n_numbers
    cdef double[4] shift
    # Shift of the numbers that turn wavelengths.
    cdef double turned
    # Of earlier regions, and the clip of this one, whose square is negative: centre in emitter
    # coordinates and squared radius.
    cdef const double[:, ::1] outlines

    # Photons differ in colour.
    cdef bint is_coloured

    cdef void colour(self, double* out, uint64_t index) noexcept nogil
    cdef double turn(self, uint64_t index) noexcept nogil
    cdef uint64_t key(self, uint64_t index) noexcept nogil
    cdef bint accepts(self, uint64_t index) noexcept nogil
    cdef double ray(
        self, uint64_t index, double* origin, double* direction, double* coords
    ) noexcept nogil
