"""The radius of footprint_radius.pxd."""

from libc.float cimport DBL_MIN
from libc.math cimport INFINITY, M_PI, fmax, fmin, isfinite, sqrt
from libc.stdint cimport int64_t

from .footprint_photons cimport (
    BAND, Bracket, FootprintPhotons, Scratch, find_band, find_near, squared_reach,
)
from .rectangle cimport Footprint
from .surface_integrals cimport SURFACE_WITHIN, area_on_surface, squared_of_disc

cdef enum:
    # Steps of a search for a root, at most.
    MAX_STEPS = 200

# Squared radii first searched between, as shares of a squared guess.
cdef double LOW = 0.78
cdef double HIGH = 1.3
# Squared radius that edges are first searched within, over that where there are none.
cdef double EDGES_WITHIN = 2.0
# Squared radius, over the area of the footprint, below which none is searched.
cdef double LEAST = 1e-12
# Relative error of the squared radius of a number of photons near edges.
cdef double ROOT = 1e-13

cdef double[2] NO_SIDES = [0.0, 0.0]


cdef inline bint is_enough(
    const Footprint* footprint, double n, double squared
) noexcept nogil:
    """Whether n photons within a squared radius are enough for it."""
    if footprint.near.n == 0:
        return squared_root(footprint, n) <= squared
    return excess_on_surface(footprint, n, sqrt(squared)) >= 0.0


cdef inline double squared_root(
    const Footprint* footprint, double n
) noexcept nogil:
    """Squared radius at which n photons are just enough; infinite where they never are."""
    cdef double excess = M_PI * (n - footprint.number)
    cdef double linear = footprint.number * (footprint.sides[0] + footprint.sides[1])
    cdef double root
    if excess <= 0.0:
        return INFINITY
    if footprint.near.n > 0:
        return squared_root_on_surface(footprint, n)
    root = linear + sqrt(linear * linear + excess * footprint.number * footprint.area)
    return (root / excess) * (root / excess)


cdef double excess_on_surface(
    const Footprint* footprint, double n, double radius
) noexcept nogil:
    """N(r) |disc(r)| - (k - ½) |B(r)| for n photons, of areas that are surface."""
    cdef double disc = area_on_surface(&footprint.near, NO_SIDES, radius)
    cdef double around = area_on_surface(&footprint.near, footprint.sides, radius)
    if disc > 0.0:
        return n * disc - footprint.number * around
    return -footprint.number * around - DBL_MIN


cdef double squared_root_on_surface(
    const Footprint* footprint, double n
) noexcept nogil:
    """`squared_root` near edges, as far as these are known: by false position (Illinois)."""
    cdef double low = 0.0, high = sqrt(footprint.squared_known), at, here
    cdef double below = excess_on_surface(footprint, n, low)
    cdef double above = excess_on_surface(footprint, n, high)
    cdef int step
    if above < 0.0:
        return INFINITY
    if footprint.area == 0.0:
        return 0.0
    for step in range(MAX_STEPS):
        if high - low <= ROOT * high:
            break
        at = high - above * (high - low) / (above - below)
        if not low < at < high or step % 8 == 7:
            at = 0.5 * (low + high)
        here = excess_on_surface(footprint, n, at)
        if here >= 0.0:
            below *= 0.5
            above = here
            high = at
        else:
            above *= 0.5
            below = here
            low = at
    return high * high


cdef inline double squared_expected(
    const Footprint* footprint, double squared, double n
) noexcept nogil:
    """Squared radius to expect where n photons are within a squared radius."""
    cdef double sides = 2.0 * (footprint.sides[0] + footprint.sides[1])
    cdef double around = footprint.area + sides * sqrt(squared) + M_PI * squared
    return footprint.number * around / (M_PI * n) if n > 0.0 else INFINITY


cdef inline double squared_limit(FootprintPhotons work, const Footprint* footprint) noexcept nogil:
    """Squared radius that none is searched beyond."""
    if footprint.near.n > 0:
        return fmin(footprint.squared_largest, footprint.squared_known)
    return fmin(
        footprint.squared_largest, squared_reach(work.tree, &footprint.rectangle)
    )


cdef double search_squared_radius(
    FootprintPhotons work, const Footprint* footprint, Scratch* scratch
) noexcept nogil:
    """Squared radius of the rule: the least of max(distance to the n-th photon, root of n).

    Distances grow with n and roots fall, so it is between any two radii of which the first is too
    small and the second large enough: brackets are moved until they are such and hold few photons.
    It depends on the photons alone, not on the brackets.
    """
    cdef double largest = squared_limit(work, footprint)
    # Known to be too small, and large enough.
    cdef double below = 0.0, above = INFINITY, expected
    cdef Bracket bracket
    scratch.squared_listed = -1.0
    scratch.at_photon = scratch.is_limited = False
    bracket.high = HIGH * scratch.squared_guess
    if not 0.0 < bracket.high < largest:
        bracket.high = largest
    bracket.low = fmin(LOW * scratch.squared_guess, 0.5 * bracket.high)
    while True:
        find_band(work, footprint, scratch, &bracket)
        if not is_enough(footprint, bracket.n_low + bracket.n_band, bracket.high):
            if bracket.high == largest:
                return limited_radius(footprint, scratch, bracket.n_low + bracket.n_band)
            below = bracket.low = bracket.high
            expected = squared_expected(footprint, below, bracket.n_low + bracket.n_band)
            bracket.high = fmax(fmin(HIGH * expected, 16.0 * below), 1.5 * below)
            bracket.high = fmin(fmin(bracket.high, above), largest)
        elif bracket.low > below and is_enough(footprint, bracket.n_low, bracket.low):
            if bracket.low <= LEAST * footprint.area:
                # Photons inside of a footprint that hardly lies on surface are enough for any.
                return LEAST * footprint.area
            above = bracket.high = bracket.low
            expected = squared_expected(footprint, above, bracket.n_low)
            bracket.low = fmax(fmin(LOW * expected, 0.75 * above), below)
        elif bracket.n_band <= BAND:
            return radius_in_band(work, footprint, scratch, &bracket)
        elif bracket.low < 0.5 * (bracket.low + bracket.high) < bracket.high:
            above = bracket.high
            narrow(footprint, &bracket)
        else:
            scratch.at_photon = True
            return bracket.high


cdef inline void narrow(
    const Footprint* footprint, Bracket* bracket
) noexcept nogil:
    """Narrow a bracket by the roots of the numbers of photons at its ends, at least to a half."""
    cdef double low = 0.0, high = INFINITY
    if footprint.near.n == 0:
        low = squared_root(footprint, bracket.n_low + bracket.n_band)
        high = squared_root(footprint, bracket.n_low)
    low = fmax(bracket.low, (1.0 - 1e-12) * low)
    high = fmin(bracket.high, (1.0 + 1e-12) * high)
    if high - low > 0.5 * (bracket.high - bracket.low):
        bracket.high = 0.5 * (bracket.low + bracket.high)
        return
    bracket.low = low
    bracket.high = high


cdef double limited_radius(
    const Footprint* footprint, Scratch* scratch, int64_t n
) noexcept nogil:
    """Squared radius where the n photons within reach are too few for a smaller one."""
    cdef double root = squared_root(footprint, n)
    scratch.is_limited = not root <= footprint.squared_largest
    return fmin(root, footprint.squared_largest)


cdef double radius_in_band(
    FootprintPhotons work, const Footprint* footprint, Scratch* scratch, const Bracket* bracket
) noexcept nogil:
    """Squared radius, which is among the squared distances of a band or between two of them."""
    cdef double root
    cdef Py_ssize_t i, first
    sort_few(scratch.band, bracket.n_band)
    first = first_enough(footprint, scratch, bracket)
    root = squared_root(footprint, bracket.n_low + first)
    for i in range(first, bracket.n_band):
        if root < scratch.band[i]:
            return root
        root = squared_root(footprint, bracket.n_low + i + 1)
        if root <= scratch.band[i]:
            scratch.at_photon = True
            return scratch.band[i]
    return fmin(root, bracket.high)


cdef inline Py_ssize_t first_enough(
    const Footprint* footprint, Scratch* scratch, const Bracket* bracket
) noexcept nogil:
    """Number of the photons of a sorted band that are not enough for sure, near edges.

    There roots take long; without any they do not.
    """
    cdef Py_ssize_t low = 0, high = bracket.n_band, middle
    if footprint.near.n == 0:
        return 0
    while low < high:
        middle = (low + high) // 2
        if is_enough(footprint, bracket.n_low + middle + 1, scratch.band[middle]):
            high = middle
        else:
            low = middle + 1
    return low


cdef void sort_few(double* x, Py_ssize_t n) noexcept nogil:
    cdef Py_ssize_t i, hole
    cdef double own
    for i in range(1, n):
        own = x[i]
        hole = i
        while hole > 0 and x[hole - 1] > own:
            x[hole] = x[hole - 1]
            hole -= 1
        x[hole] = own


# Beside edges

cdef double find_squared_radius(
    FootprintPhotons work, Footprint* footprint, Scratch* scratch
) noexcept nogil:
    """Squared radius of a footprint, zero where all photons that it asks for are at its point.

    Sets whether a photon is at it, and whether it is the largest.
    """
    cdef double squared = search_squared_radius(work, footprint, scratch)
    if work.surface is not None and squared > 0.0 and isfinite(squared):
        squared = squared_radius_on_surface(work, footprint, scratch, squared)
    return squared


cdef double squared_radius_on_surface(
    FootprintPhotons work, Footprint* footprint, Scratch* scratch, double squared
) noexcept nogil:
    """Squared radius with the edges that are near, from the one without: the same if none is."""
    footprint.squared_known = squared
    find_near(work, footprint, scratch)
    if footprint.near.n == 0:
        return squared
    scratch.squared_guess = squared
    squared = radius_among_edges(work, footprint, scratch)
    if scratch.is_limited and isfinite(footprint.squared_largest):
        footprint.squared_known = SURFACE_WITHIN * SURFACE_WITHIN * footprint.squared_largest
        find_near(work, footprint, scratch)
        footprint.squared_largest = squared_of_disc(
            &footprint.near, sqrt(footprint.squared_largest)
        )
        squared = search_squared_radius(work, footprint, scratch)
    return squared


cdef double radius_among_edges(
    FootprintPhotons work, Footprint* footprint, Scratch* scratch
) noexcept nogil:
    """Squared radius among edges, of which as many are found as it takes; infinite for none."""
    cdef double squared = INFINITY
    cdef double largest = fmin(
        footprint.squared_largest, 16.0 * squared_reach(work.tree, &footprint.rectangle)
    )
    while squared >= footprint.squared_known and footprint.squared_known < largest:
        footprint.squared_known = fmin(EDGES_WITHIN * footprint.squared_known, largest)
        find_near(work, footprint, scratch)
        squared = search_squared_radius(work, footprint, scratch)
    return squared
