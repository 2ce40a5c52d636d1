"""Photons around footprints: those of the blocks of their tree that may be near.

The rule that they are searched by is that of `photonrelax.estimation.footprint`.
"""

from libc.math cimport sqrt
from libc.stdint cimport int32_t, int64_t

from ..spatial.simd.kernels cimport BLOCK, GAUSSIAN_DEVIATION, Rectangle
from ..spatial.tree cimport Tree
from .rectangle cimport Footprint
from .surface_edges cimport EdgeSearch

cdef enum:
    # Distances that are sorted at once; more are divided first.
    BAND = 128
    BAND_STRIDE = BAND + BLOCK


cdef struct Scratch:
    # Blocks that may hold a photon within a squared radius, but for nodes deep inside; the margin
    # that makes them so, or -1; their number of photons and, if wanted, the sums of their values.
    int32_t* blocks
    Py_ssize_t n_blocks
    double squared_listed
    double margin
    int64_t n_deep
    double* deep
    bint with_sums
    # Squared distances.
    double* band
    # Squared radius of the last query.
    double squared_guess
    int thread
    # Whether a photon is at the radius, and whether the radius is the largest allowed.
    bint at_photon
    bint is_limited
    # Photons that were looked at one by one.
    int64_t n_single


cdef struct Bracket:
    # Squared radii, and the numbers of photons up to the first and between both.
    double low
    double high
    int64_t n_low
    int64_t n_band


cdef class FootprintPhotons:
    cdef Tree tree
    # Sums of the photons' values over nodes; None if only radii are wanted.
    cdef const double[:, :, ::1] sums
    # None without a scene.
    cdef EdgeSearch surface
    cdef double squared_gather_radius
    cdef double squared_range
    # Bound on the error of distances of boxes.
    cdef double slack


cdef double spacing_near(Tree tree, const double* at) noexcept nogil

cdef double squared_reach(Tree tree, const Rectangle* rectangle) noexcept nogil

cdef void find_band(
    FootprintPhotons work, const Footprint* footprint, Scratch* scratch, Bracket* bracket
) noexcept nogil

cdef void list_blocks(
    FootprintPhotons work, const Footprint* footprint, Scratch* scratch, double squared
) noexcept nogil


cdef inline double deep_margin(const Footprint* footprint, double squared) noexcept nogil:
    """Distance inside its sides from which on a footprint's weights are equal; -1 if there is none.
    """
    # A weight is one over the area, to 1e-9, from 6.3 deviations inside.
    cdef double margin = 6.3 * GAUSSIAN_DEVIATION * sqrt(squared)
    if margin < footprint.rectangle.half[0] and margin < footprint.rectangle.half[1]:
        return margin
    return -1.0


cdef inline void find_near(
    FootprintPhotons work, Footprint* footprint, Scratch* scratch
) noexcept nogil:
    work.surface.find(
        &footprint.rectangle, sqrt(footprint.squared_known), scratch.thread, &footprint.near
    )
