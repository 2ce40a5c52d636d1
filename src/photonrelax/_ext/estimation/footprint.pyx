"""Density estimates over footprints, from the k nearest photons or all that a footprint holds.

The rule and its symbols are those of `photonrelax.estimation.footprint`.
"""

from cython cimport final
from cython.parallel cimport prange, threadid
from libc.math cimport INFINITY, M_PI, exp, fabs, fmax, fmin, isfinite, nextafter, sqrt
from libc.stdint cimport int32_t, int64_t

import numpy as np

from ..common.prefetch cimport prefetch_row
from ..common.threads cimport Watch, close_watch, goes_on, open_watch, team_size
from ..spatial.simd.kernels cimport (
    BLOCK, GAUSSIAN_DEVIATION, Rectangle, RectangleWeights, highest_bit, lowest_bit,
)
from ..spatial.tree cimport Tree, fan_out, first_block, last_kept
from .rectangle cimport Footprint, open_rectangle

DEVIATION = GAUSSIAN_DEVIATION

cdef enum:
    # Queries that a thread takes at a time; each starts its search from the radius of the last.
    GRAIN = 64
    # Distances that are sorted at once; more are divided first.
    BAND = 128
    BAND_STRIDE = BAND + BLOCK
    # Depth-first traversal leaves at most 15 open groups per kept level, of which there are 7.
    STACK_SIZE = 128
    # Points of the polynomials that interpolate the table of integrals.
    STENCIL = 6

# Deviations inside the edge from which on a weight is one over the area, to 1e-9.
cdef double DEEP = 6.3
NARROW = 0.25
# Squared radii first searched between, as shares of a squared guess.
cdef double LOW = 0.78
cdef double HIGH = 1.3
# Half the thickness of the slab of photons that are on a footprint, over half its diagonal: the
# sagitta over the half chord of a cap whose normals turn by 60° at its rim, tan 30°.
cdef double SAGITTA = 0.58


cdef enum Task:
    # Densities with the radii of the rule, or with radii given; the radii of the rule alone.
    DENSITIES
    DENSITIES_WITHIN
    RADII


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


@final
cdef class FootprintGather:
    """Photons, footprints and where their densities go; see `gather`."""

    cdef Task task
    cdef Tree tree
    cdef const double[:, :, ::1] values
    cdef const double[:, :, ::1] sums
    cdef const double[:, ::1] queries
    cdef const double[:, ::1] normals
    cdef const double[:, :, ::1] edges
    cdef const double[::1] sides
    cdef const Py_ssize_t[::1] rows
    cdef double[:, ::1] out
    cdef const double[:, ::1] integrals
    # Radii given, and those of the rule.
    cdef const double[::1] given_radius
    cdef double[::1] radius
    # Of each footprint the least number of photons in a disc at the density of its surroundings.
    cdef const double[:] number
    cdef double squared_gather_radius
    cdef double squared_range
    # Estimates of a uniform field are too low by this at points, and by less over footprints.
    cdef const double[:] bias
    cdef double bias_decay
    # Bound on the error of distances of boxes.
    cdef double slack
    # Rows per thread.
    cdef int32_t[:, ::1] blocks
    cdef double[:, ::1] band
    cdef double[:, ::1] deep
    cdef int64_t[::1] n_single


def gather(
    Tree tree, values, queries, rows, out, *, normals, sums, footprint, integrals, number,
    bias, double radius, double range_radius, int n_threads
):
    """Write densities over the footprints named by `rows`, close ones in sequence, to `out`.

    Parameters
    ----------
    tree : Tree
    values : (n_blocks, c, 16) float64 array
        Values of the photons in tree order, zero in lanes without a photon.
    queries : (m, axes) float64 array
    rows : (r,) intp array
    out : (m, c) float64 array
        Rows of these queries are written.
    normals : (m, 3) float64 array
        Normals at the queries, of any length.
    sums : (groups, c, 16) float64 array
        Sums of the values over the nodes of the tree.
    footprint : (m, 2, 3) or (m,) float64 array
        Edge vectors, or sides of squares.
    integrals : (g, g) float64 array
        Integral of the kernel at evenly spaced s / (s + r) of both sides.
    number : float or (m,) float64 array
        Photons that a disc has to hold at the mean density within its radius of the footprint.
    bias : (float or (m,) float64 array, float)
        a, b: estimates are divided by 1 - a exp(-b x), x the mean of the sides in radii.
    radius : float
        Largest radius; may be infinite.
    range_radius : float
        Radius of the ball over the tree's range axes; negative for none.

    Returns
    -------
    int
        Number of photons that were looked at one by one.
    """
    cdef FootprintGather work = open_work(tree, queries, rows, normals, footprint, range_radius)
    set_values(work, values, sums, integrals, out)
    work.number = np.broadcast_to(np.float64(number), len(queries))
    work.bias = np.broadcast_to(np.float64(bias[0]), len(queries))
    work.bias_decay = bias[1]
    work.squared_gather_radius = radius * radius
    return do_all(work, n_threads)


def gather_within(
    Tree tree, values, queries, rows, out, *, normals, sums, footprint, integrals, radius,
    double range_radius, int n_threads
):
    """Write densities of given radii over the footprints named by `rows` to `out`.

    All photons within the radius count, those at it too.

    Parameters
    ----------
    radius : (m,) float64 array
        Positive and finite.
    tree, values, queries, rows, out, normals, sums, footprint, integrals, range_radius, n_threads
        See `gather`.

    Returns
    -------
    int
        Number of photons that were looked at one by one.
    """
    cdef FootprintGather work = open_work(tree, queries, rows, normals, footprint, range_radius)
    set_values(work, values, sums, integrals, out)
    work.task = DENSITIES_WITHIN
    work.given_radius = radius
    if work.given_radius.shape[0] != work.queries.shape[0]:
        raise ValueError("radii and queries do not fit one another")
    return do_all(work, n_threads)


def write_radii(
    Tree tree, queries, rows, out, *, normals, footprint, double number, double radius,
    double range_radius, int n_threads
):
    """Write the radii of the rule over the footprints named by `rows` to `out`.

    They are zero where all photons that are asked for are at a point.

    Parameters
    ----------
    out : (m,) float64 array
    tree, queries, rows, normals, footprint, number, radius, range_radius, n_threads
        See `gather`.
    """
    cdef FootprintGather work = open_work(tree, queries, rows, normals, footprint, range_radius)
    work.task = RADII
    work.radius = out
    if work.radius.shape[0] != work.queries.shape[0]:
        raise ValueError("radii and queries do not fit one another")
    if tree.n_points == 0:
        work.radius[...] = radius
    work.number = np.broadcast_to(number, len(queries))
    work.squared_gather_radius = radius * radius
    do_all(work, n_threads)


cdef FootprintGather open_work(
    Tree tree, queries, rows, normals, footprint, double range_radius
):
    """Footprints to be gathered over; raises ValueError if arrays do not fit one another."""
    cdef FootprintGather work = FootprintGather()
    work.task = DENSITIES
    work.tree = tree
    work.queries, work.normals, work.rows = queries, normals, rows
    work.edges = footprint if footprint.ndim == 3 else None
    work.sides = footprint if footprint.ndim == 1 else None
    if footprint.shape[1:] not in ((), (2, 3)) or not footprints_fit(work):
        raise ValueError("queries and footprints do not fit one another")
    work.squared_range = range_radius * range_radius if range_radius >= 0.0 else -1.0
    work.slack = 1e-14 * np.abs([tree.low[:3], tree.high[:3]]).max()
    return work


cdef set_values(FootprintGather work, values, sums, integrals, out):
    """Set the values whose densities are written; raises ValueError if they do not fit."""
    work.values, work.sums, work.integrals, work.out = values, sums, integrals, out
    if not values_fit(work):
        raise ValueError("queries, densities and photon values do not fit one another")
    if work.tree.n_points == 0:
        work.out[...] = 0.0


cdef bint footprints_fit(FootprintGather work):
    """Whether footprints and their points fit one another and the tree."""
    cdef Py_ssize_t m = work.queries.shape[0]
    cdef Py_ssize_t n_footprints = (
        work.sides.shape[0] if work.edges is None else work.edges.shape[0]
    )
    return (
        m == work.normals.shape[0] == n_footprints and work.normals.shape[1] == 3
        and work.queries.shape[1] >= work.tree.n_axes and work.tree.n_metric == 3
    )


cdef bint values_fit(FootprintGather work):
    """Whether values and densities fit the tree and the queries."""
    return (
        work.queries.shape[0] == work.out.shape[0]
        and work.values.shape[0] == work.tree.n_blocks
        and work.values.shape[1] == work.sums.shape[1] == work.out.shape[1]
        and work.sums.shape[0] == work.tree.boxes.shape[0]
        and work.integrals.shape[0] == work.integrals.shape[1] > STENCIL
    )


cdef int64_t do_all(FootprintGather work, int n_threads) except -1:
    """Do the task; returns the number of photons that were looked at one by one."""
    if work.tree.n_points == 0:
        return 0
    allocate(work, n_threads)
    gather_all(work, n_threads)
    return int(np.sum(work.n_single))


cdef allocate(FootprintGather work, int n_threads):
    """Allocate a row of scratch memory a thread."""
    work.blocks = np.empty((n_threads, work.tree.n_blocks + BLOCK), dtype=np.int32)
    work.band = np.empty((n_threads, BAND_STRIDE))
    work.deep = np.empty((n_threads, 1 if work.task == RADII else work.out.shape[1]))
    work.n_single = np.zeros(n_threads, dtype=np.int64)


cdef int gather_all(FootprintGather work, int n_threads) except -1:
    cdef Py_ssize_t n_chunks = (work.rows.shape[0] + GRAIN - 1) // GRAIN
    cdef Watch watch = open_watch()
    cdef Py_ssize_t i
    for i in prange(
        n_chunks, nogil=True, schedule="dynamic",
        num_threads=team_size(n_threads, n_chunks, 1)
    ):
        if goes_on(&watch, threadid() == 0):
            gather_chunk(work, GRAIN * i, threadid())
    return close_watch(&watch)


cdef void gather_chunk(FootprintGather work, Py_ssize_t first, int thread) noexcept nogil:
    """Do the task over `first` of the footprints and those that follow, up to a grain."""
    cdef Scratch scratch
    cdef Footprint footprint
    cdef Py_ssize_t i, end = min(first + GRAIN, work.rows.shape[0])
    scratch.blocks = &work.blocks[thread, 0]
    scratch.band = &work.band[thread, 0]
    scratch.deep = &work.deep[thread, 0]
    scratch.n_single = scratch.n_blocks = scratch.n_deep = 0
    scratch.squared_guess = spacing_near(work.tree, &work.queries[work.rows[first], 0])
    if work.task != DENSITIES_WITHIN:
        scratch.squared_guess *= work.number[work.rows[first]]
    for i in range(first, end):
        if i + 1 < end:
            prefetch_row(&work.queries[work.rows[i + 1], 0], 8 * work.queries.shape[1])
        open_footprint(work, &footprint, work.rows[i])
        if work.task == DENSITIES:
            write_densities(work, &footprint, &scratch, &work.out[work.rows[i], 0])
        elif work.task == DENSITIES_WITHIN:
            write_within(work, &footprint, &scratch, work.rows[i])
        else:
            write_radius(work, &footprint, &scratch, work.rows[i])
    work.n_single[thread] += scratch.n_single


cdef double spacing_near(Tree tree, const double* at) noexcept nogil:
    """Guess of the squared radius that a photon near a point has to itself."""
    cdef Py_ssize_t level, child, nearest = 0, group = 0, axis
    cdef double least, squared, diagonal = 0.0
    for level in range(last_kept(tree) + 1):
        group = tree.first_group[level] + nearest
        least = INFINITY
        child = 0
        for child in range(fan_out(tree, level)):
            squared = squared_gap(tree, group, child, at)
            if squared < least:
                least = squared
                nearest = (group - tree.first_group[level]) * fan_out(tree, level) + child
    child = nearest % fan_out(tree, last_kept(tree))
    for axis in range(3):
        least = tree.boxes[group, 1, axis, child] - tree.boxes[group, 0, axis, child]
        diagonal += least * least
    # A square of 16 photons, whose diagonal this is, is 16 discs of this radius.
    return diagonal / (2.0 * M_PI * BLOCK)


cdef inline double squared_gap(
    Tree tree, Py_ssize_t group, Py_ssize_t child, const double* at
) noexcept nogil:
    """Squared distance of a node's box, infinite for one without points."""
    cdef double gap, squared = 0.0
    cdef Py_ssize_t axis
    for axis in range(3):
        gap = fmax(
            tree.boxes[group, 0, axis, child] - at[axis],
            fmax(at[axis] - tree.boxes[group, 1, axis, child], 0.0)
        )
        squared += gap * gap
    return squared


# Footprints

cdef void open_footprint(
    FootprintGather work, Footprint* footprint, Py_ssize_t row
) noexcept nogil:
    """Set the rectangle of a footprint."""
    cdef Rectangle* rectangle = &footprint.rectangle
    cdef bint has_edges = work.edges is not None
    cdef double diagonal
    footprint.number = 0.0 if work.task == DENSITIES_WITHIN else work.number[row]
    footprint.bias = work.bias[row] if work.task == DENSITIES else 0.0
    open_rectangle(
        footprint, &work.normals[row, 0], &work.edges[row, 0, 0] if has_edges else NULL,
        0.0 if has_edges else work.sides[row]
    )
    diagonal = sqrt(
        footprint.sides[0] * footprint.sides[0] + footprint.sides[1] * footprint.sides[1]
    )
    rectangle.half[0] = 0.5 * footprint.sides[0]
    rectangle.half[1] = 0.5 * footprint.sides[1]
    rectangle.half[2] = 0.5 * SAGITTA * diagonal
    rectangle.at = &work.queries[row, 0]
    rectangle.squared_range = work.squared_range
    rectangle.n_axes = work.tree.n_axes


def rectangle_sides(const double[:, ::1] normals, footprint):
    """Sides (m, 2) of the rectangles of footprints, m; those of parallelograms in any order.

    Parameters
    ----------
    normals : (m, 3) float64 array
        Of any length.
    footprint : (m, 2, 3) or (m,) float64 array
        Edge vectors, or sides of squares.
    """
    cdef const double[:, :, ::1] edges
    cdef Footprint one
    cdef Py_ssize_t i
    if footprint.ndim == 1:
        return np.repeat(footprint[:, np.newaxis], 2, axis=1)
    edges = footprint
    sides = np.empty((normals.shape[0], 2))
    cdef double[:, ::1] out = sides
    if not (edges.shape[0] == normals.shape[0] and normals.shape[1] == edges.shape[2] == 3):
        raise ValueError("normals and footprints do not fit one another")
    for i in range(out.shape[0]):
        open_rectangle(&one, &normals[i, 0], &edges[i, 0, 0], 0.0)
        out[i, 0] = one.sides[0]
        out[i, 1] = one.sides[1]
    return sides


# The radius

cdef inline double squared_root(
    FootprintGather work, const Footprint* footprint, double n
) noexcept nogil:
    """Squared radius at which n photons are just enough; infinite where they never are."""
    cdef double excess = M_PI * (n - footprint.number)
    cdef double linear = footprint.number * (footprint.sides[0] + footprint.sides[1])
    cdef double root
    if excess <= 0.0:
        return INFINITY
    root = linear + sqrt(linear * linear + excess * footprint.number * footprint.area)
    return (root / excess) * (root / excess)


cdef inline double squared_expected(
    FootprintGather work, const Footprint* footprint, double squared, double n
) noexcept nogil:
    """Squared radius to expect where n photons are within a squared radius."""
    cdef double sides = 2.0 * (footprint.sides[0] + footprint.sides[1])
    cdef double around = footprint.area + sides * sqrt(squared) + M_PI * squared
    return footprint.number * around / (M_PI * n) if n > 0.0 else INFINITY


cdef double squared_reach(Tree tree, const double* at) noexcept nogil:
    """Squared radius around a point beyond which there is no photon."""
    cdef double squared = 0.0, gap
    cdef int axis
    for axis in range(3):
        gap = fmax(fabs(tree.high[axis] - at[axis]), fabs(at[axis] - tree.low[axis]))
        squared += gap * gap
    return squared * (1.0 + 1e-9)


cdef double find_squared_radius(
    FootprintGather work, const Footprint* footprint, Scratch* scratch
) noexcept nogil:
    """Squared radius of the rule: the least of max(distance to the n-th photon, root of n).

    Distances grow with n and roots fall, so it is between any two radii of which the first is too
    small and the second large enough: brackets are moved until they are such and hold few photons.
    It depends on the photons alone, not on the brackets.
    """
    cdef double largest = fmin(
        work.squared_gather_radius, squared_reach(work.tree, footprint.rectangle.at)
    )
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
        if squared_root(work, footprint, bracket.n_low + bracket.n_band) > bracket.high:
            if bracket.high == largest:
                return limited_radius(work, footprint, scratch, bracket.n_low + bracket.n_band)
            below = bracket.low = bracket.high
            expected = squared_expected(work, footprint, below, bracket.n_low + bracket.n_band)
            bracket.high = fmax(fmin(HIGH * expected, 16.0 * below), 1.5 * below)
            bracket.high = fmin(fmin(bracket.high, above), largest)
        elif (
            bracket.low > below
            and squared_root(work, footprint, bracket.n_low) <= bracket.low
        ):
            above = bracket.high = bracket.low
            expected = squared_expected(work, footprint, above, bracket.n_low)
            bracket.low = fmax(fmin(LOW * expected, 0.75 * above), below)
        elif bracket.n_band <= BAND:
            return radius_in_band(work, footprint, scratch, &bracket)
        elif bracket.low < 0.5 * (bracket.low + bracket.high) < bracket.high:
            above = bracket.high
            narrow(work, footprint, &bracket)
        else:
            scratch.at_photon = True
            return bracket.high


cdef inline void narrow(
    FootprintGather work, const Footprint* footprint, Bracket* bracket
) noexcept nogil:
    """Narrow a bracket by the roots of the numbers of photons at its ends, at least to a half."""
    cdef double low = squared_root(work, footprint, bracket.n_low + bracket.n_band)
    cdef double high = squared_root(work, footprint, bracket.n_low)
    low = fmax(bracket.low, (1.0 - 1e-12) * low)
    high = fmin(bracket.high, (1.0 + 1e-12) * high)
    if high - low > 0.5 * (bracket.high - bracket.low):
        bracket.high = 0.5 * (bracket.low + bracket.high)
        return
    bracket.low = low
    bracket.high = high


cdef double limited_radius(
    FootprintGather work, const Footprint* footprint, Scratch* scratch, int64_t n
) noexcept nogil:
    """Squared radius where the n photons within reach are too few for a smaller one."""
    cdef double root = squared_root(work, footprint, n)
    scratch.is_limited = not root <= work.squared_gather_radius
    return fmin(root, work.squared_gather_radius)


cdef double radius_in_band(
    FootprintGather work, const Footprint* footprint, Scratch* scratch, const Bracket* bracket
) noexcept nogil:
    """Squared radius, which is among the squared distances of a band or between two of them."""
    cdef double root = squared_root(work, footprint, bracket.n_low)
    cdef Py_ssize_t i
    sort_few(scratch.band, bracket.n_band)
    for i in range(bracket.n_band):
        if root < scratch.band[i]:
            return root
        root = squared_root(work, footprint, bracket.n_low + i + 1)
        if root <= scratch.band[i]:
            scratch.at_photon = True
            return scratch.band[i]
    return fmin(root, bracket.high)


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


cdef void find_band(
    FootprintGather work, const Footprint* footprint, Scratch* scratch, Bracket* bracket
) noexcept nogil:
    """Count the photons of a bracket, and write the squared distances between its ends.

    Only as far as there is room.
    """
    # A list made for a much larger radius takes longer to look through than a new one to make.
    if not bracket.high <= scratch.squared_listed <= 4.0 * bracket.high:
        scratch.with_sums = False
        list_blocks(work, footprint, scratch, bracket.high)
    scratch.n_single += BLOCK * scratch.n_blocks
    bracket.n_low = scratch.n_deep
    bracket.n_band = work.tree.simd.rectangle_band(
        &work.tree.coords[0, 0, 0], scratch.blocks, scratch.n_blocks, &footprint.rectangle,
        bracket.low, bracket.high, scratch.band, BAND, &bracket.n_low
    )


# Traversal

cdef inline double deep_margin(const Footprint* footprint, double squared) noexcept nogil:
    """Distance inside its sides from which on a footprint's weights are equal; -1 if there is none.
    """
    cdef double margin = DEEP * GAUSSIAN_DEVIATION * sqrt(squared)
    if margin < footprint.rectangle.half[0] and margin < footprint.rectangle.half[1]:
        return margin
    return -1.0


cdef void list_blocks(
    FootprintGather work, const Footprint* footprint, Scratch* scratch, double squared
) noexcept nogil:
    """List the blocks within a squared radius, in tree order, and count nodes deep inside."""
    scratch.squared_listed = squared
    scratch.margin = deep_margin(footprint, squared)
    scratch.n_blocks = scratch.n_deep = 0
    visit_nodes(work, work.tree, footprint, scratch)


cdef void visit_nodes(
    FootprintGather work, Tree tree, const Footprint* footprint, Scratch* scratch
) noexcept nogil:
    """Visit the nodes within the radius of the list, depth first."""
    cdef Py_ssize_t[STACK_SIZE] open_level
    cdef Py_ssize_t[STACK_SIZE] open_group
    cdef Py_ssize_t n_open = 1, level, g
    cdef double limit = sqrt(scratch.squared_listed) * (1.0 + 1e-9) + work.slack
    cdef unsigned int near, child, deep
    open_level[0] = open_group[0] = 0
    while n_open > 0:
        n_open -= 1
        level = open_level[n_open]
        g = open_group[n_open]
        near = tree.simd.boxes_near_rectangle(
            &tree.boxes[tree.first_group[level] + g, 0, 0, 0], &footprint.rectangle,
            limit * limit, scratch.margin, &deep
        )
        if deep:
            add_deep(work, scratch, level, g, deep)
            near &= ~deep
        if level == last_kept(tree):
            append_blocks(tree, g * fan_out(tree, level), near, scratch)
            continue
        while near:
            child = highest_bit(near)
            near ^= 1u << child
            open_level[n_open] = level + 1
            open_group[n_open] = g * fan_out(tree, level) + child
            n_open += 1


cdef inline void append_blocks(
    Tree tree, Py_ssize_t node, unsigned int near, Scratch* scratch
) noexcept nogil:
    while near:
        scratch.blocks[scratch.n_blocks] = <int32_t> first_block(tree, node + lowest_bit(near))
        scratch.n_blocks += 1
        near &= near - 1


cdef void add_deep(
    FootprintGather work, Scratch* scratch, Py_ssize_t level, Py_ssize_t g, unsigned int deep
) noexcept nogil:
    """Count the photons of nodes of a group, and add their values."""
    cdef Py_ssize_t group = work.tree.first_group[level] + g
    cdef Py_ssize_t child, channel
    while deep:
        child = lowest_bit(deep)
        deep &= deep - 1
        scratch.n_deep += points_of_node(work.tree, level, g * fan_out(work.tree, level) + child)
        if scratch.with_sums:
            for channel in range(work.sums.shape[1]):
                scratch.deep[channel] += work.sums[group, channel, child]


cdef inline int64_t points_of_node(Tree tree, Py_ssize_t level, Py_ssize_t node) noexcept nogil:
    """Number of points of a node of a kept level."""
    cdef Py_ssize_t bits = tree.n_levels - 4 * (last_kept(tree) - level)
    cdef Py_ssize_t first = (node * tree.n_blocks) >> bits
    cdef Py_ssize_t end = ((node + 1) * tree.n_blocks) >> bits
    return min(BLOCK * end, tree.n_points) - BLOCK * first


# Sums

cdef void write_densities(
    FootprintGather work, const Footprint* footprint, Scratch* scratch, double* out
) noexcept nogil:
    """Write the densities over one footprint."""
    cdef double squared = find_squared_radius(work, footprint, scratch)
    cdef Py_ssize_t channel
    cdef RectangleWeights weights
    cdef double scale
    if squared == 0.0:
        # All photons that are asked for are at the point itself, as in nearest.pyx.
        scratch.at_photon = False
        scratch.is_limited = True
        squared = work.squared_gather_radius
    for channel in range(work.out.shape[1]):
        out[channel] = scratch.deep[channel] = 0.0
    if not isfinite(squared):
        return
    scratch.squared_guess = squared
    list_for_sums(work, footprint, scratch, squared)
    scale = set_weights(work, footprint, squared, scratch.at_photon, &weights)
    if not scratch.is_limited:
        scale /= uniform_mean(work, footprint, squared)
    write_sums(work, footprint, scratch, &weights, scale, out)


cdef void write_within(
    FootprintGather work, const Footprint* footprint, Scratch* scratch, Py_ssize_t row
) noexcept nogil:
    """Write the densities over one footprint of the photons within its radius."""
    cdef double squared = work.given_radius[row] * work.given_radius[row]
    cdef double* out = &work.out[row, 0]
    cdef Py_ssize_t channel
    cdef RectangleWeights weights
    cdef double scale
    for channel in range(work.out.shape[1]):
        out[channel] = scratch.deep[channel] = 0.0
    scratch.with_sums = True
    list_blocks(work, footprint, scratch, squared)
    scale = set_weights(work, footprint, squared, False, &weights)
    write_sums(work, footprint, scratch, &weights, scale, out)


cdef void write_radius(
    FootprintGather work, const Footprint* footprint, Scratch* scratch, Py_ssize_t row
) noexcept nogil:
    """Write the radius of one footprint."""
    cdef double squared = find_squared_radius(work, footprint, scratch)
    work.radius[row] = sqrt(squared)
    if squared > 0.0 and isfinite(squared):
        scratch.squared_guess = squared


cdef inline void write_sums(
    FootprintGather work, const Footprint* footprint, Scratch* scratch,
    const RectangleWeights* weights, double scale, double* out
) noexcept nogil:
    """Write the weighted sums over the photons of the list, times a scale."""
    cdef Py_ssize_t channel
    scratch.n_single += BLOCK * scratch.n_blocks
    work.tree.simd.rectangle_sum(
        &work.tree.coords[0, 0, 0], scratch.blocks, scratch.n_blocks, &footprint.rectangle,
        weights, &work.values[0, 0, 0], work.values.shape[1], out
    )
    for channel in range(work.out.shape[1]):
        out[channel] = scale * (out[channel] + scratch.deep[channel])


cdef void list_for_sums(
    FootprintGather work, const Footprint* footprint, Scratch* scratch, double squared
) noexcept nogil:
    """List the blocks within the radius found: those listed last, unless there are deep nodes.

    Which nodes are deep has to follow from the radius found, not from that of a search.
    """
    cdef double reach = squared_reach(work.tree, footprint.rectangle.at)
    cdef bint covered = scratch.squared_listed >= fmin(squared, reach)
    if not covered or scratch.margin >= 0.0 or deep_margin(footprint, squared) >= 0.0:
        scratch.with_sums = True
        list_blocks(work, footprint, scratch, squared)


cdef double set_weights(
    FootprintGather work, const Footprint* footprint, double squared, bint at_photon,
    RectangleWeights* weights
) noexcept nogil:
    """Set the weights for a squared radius; return their factor.

    The photon whose distance is the radius does not count itself, as in nearest.pyx.
    """
    cdef double radius = sqrt(squared)
    cdef double deviation = GAUSSIAN_DEVIATION * radius
    cdef double scale = 1.0 / kernel_integral(work.integrals, footprint, radius)
    cdef int side
    weights.squared_radius = nextafter(squared, 0.0) if at_photon else squared
    weights.inverse_deviation = 1.0 / deviation
    for side in range(2):
        weights.is_narrow[side] = footprint.sides[side] < NARROW * deviation
        if weights.is_narrow[side]:
            set_series(footprint.sides[side] / deviation, weights.series[side])
            scale /= sqrt(2.0 * M_PI) * deviation
        else:
            scale /= footprint.sides[side]
    return scale


cdef inline double uniform_mean(
    FootprintGather work, const Footprint* footprint, double squared
) noexcept nogil:
    """Mean of estimates of a uniform field, over its value, where k photons set the radius."""
    cdef double sides = 0.5 * (footprint.sides[0] + footprint.sides[1])
    return 1.0 - footprint.bias * exp(-work.bias_decay * sides / sqrt(squared))


cdef void set_series(double side, double* series) noexcept nogil:
    """Set the mean of a normal density over a side s, in deviations, over the density.

    1 + s²/24 He₂ + s⁴/1920 He₄ + s⁶/322560 He₆ in the Hermite polynomials of the offset; the
    coefficients of powers of its square, that of the highest first.
    """
    cdef double second = side * side / 24.0
    cdef double fourth = side ** 4 / 1920.0
    cdef double sixth = side ** 6 / 322560.0
    series[0] = sixth
    series[1] = fourth - 15.0 * sixth
    series[2] = second - 6.0 * fourth + 45.0 * sixth
    series[3] = 1.0 - second + 3.0 * fourth - 15.0 * sixth


cdef double kernel_integral(
    const double[:, ::1] table, const Footprint* footprint, double radius
) noexcept nogil:
    """Integral of a footprint's kernel over the plane, interpolated in s / (s + r)."""
    cdef double[STENCIL] first
    cdef double[STENCIL] second
    cdef Py_ssize_t n = table.shape[0] - 1
    cdef Py_ssize_t row = set_stencil(footprint.sides[0] / (footprint.sides[0] + radius), n, first)
    cdef Py_ssize_t column = set_stencil(
        footprint.sides[1] / (footprint.sides[1] + radius), n, second
    )
    cdef double total = 0.0, own
    cdef Py_ssize_t i, j
    for i in range(STENCIL):
        own = 0.0
        for j in range(STENCIL):
            own += second[j] * table[row + i, column + j]
        total += first[i] * own
    return total


cdef inline Py_ssize_t set_stencil(double x, Py_ssize_t n, double* weights) noexcept nogil:
    """Set Lagrange's weights at x in [0, 1] of n intervals; return the first of their points."""
    cdef Py_ssize_t first = min(max(<Py_ssize_t> (n * x) - 2, <Py_ssize_t> 0), n + 1 - STENCIL)
    cdef double t = n * x - first
    cdef double[STENCIL] left
    cdef double right = 1.0
    cdef Py_ssize_t i
    left[0] = 1.0
    for i in range(1, STENCIL):
        left[i] = left[i - 1] * (t - (i - 1))
    # Products of the other points' distances: i! (5 - i)!, with alternating signs.
    cdef double[STENCIL] inverse = [-1 / 120.0, 1 / 24.0, -1 / 12.0, 1 / 12.0, -1 / 24.0, 1 / 120.0]
    for i in range(STENCIL - 1, -1, -1):
        weights[i] = left[i] * right * inverse[i]
        right *= t - i
    return first
