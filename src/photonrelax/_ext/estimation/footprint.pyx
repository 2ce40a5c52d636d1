"""Density estimates over footprints, from the k nearest photons or all that a footprint holds.

The rule and its symbols are those of `photonrelax.estimation.footprint`.
"""

from cython cimport final
from cython.parallel cimport prange, threadid
from libc.math cimport M_PI, exp, fmin, isfinite, nextafter, sqrt
from libc.stdint cimport int32_t, int64_t

import numpy as np

from ..common.prefetch cimport prefetch_row
from ..common.threads cimport Watch, close_watch, goes_on, open_watch, team_size
from ..spatial.simd.kernels cimport BLOCK, GAUSSIAN_DEVIATION, Rectangle, RectangleWeights
from ..spatial.tree cimport Tree
from .footprint_photons cimport (
    BAND_STRIDE, FootprintPhotons, Scratch, deep_margin, find_near, list_blocks, spacing_near,
    squared_reach,
)
from .footprint_radius cimport find_squared_radius
from .rectangle cimport Footprint, open_parallelogram, open_rectangle
from .surface_edges cimport EdgeSearch, SurfaceEdges
from .surface_integrals cimport share_on_surface

DEVIATION = GAUSSIAN_DEVIATION

cdef enum:
    # Queries that a thread takes at a time; each starts its search from the radius of the last.
    GRAIN = 64

NARROW = 0.25
# Half the thickness of the slab of photons that are on a footprint, over half its diagonal: the
# sagitta over the half chord of a cap whose normals turn by 60° at its rim, tan 30°.
cdef double SAGITTA = 0.58


cdef enum Task:
    # Densities with the radii of the rule, or with radii given; the radii of the rule alone.
    DENSITIES
    DENSITIES_WITHIN
    RADII


@final
cdef class FootprintGather(FootprintPhotons):
    """Photons, footprints and where their densities go; see `gather`."""

    cdef Task task
    cdef const double[:, :, ::1] values
    cdef const double[:, ::1] queries
    cdef const double[:, ::1] normals
    cdef const double[:, :, ::1] edges
    cdef const double[::1] sides
    cdef const Py_ssize_t[::1] rows
    cdef double[:, ::1] out
    cdef const double[:, ::1] integrals
    # None without a scene.
    cdef SurfaceEdges edges_of_surface
    # Radii given, and those of the rule.
    cdef const double[::1] given_radius
    cdef double[::1] radius
    # Of each footprint the least number of photons in a disc at the density of its surroundings.
    cdef const double[:] number
    # Estimates of a uniform field are too low by this at points, and by less over footprints.
    cdef const double[:] bias
    cdef double bias_decay
    # Rows per thread.
    cdef int32_t[:, ::1] blocks
    cdef double[:, ::1] band
    cdef double[:, ::1] deep
    cdef int64_t[::1] n_single


def gather(
    Tree tree, values, queries, rows, out, *, normals, sums, footprint, integrals, number, bias,
    double radius, double range_radius, int n_threads, SurfaceEdges surface=None
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
    surface : SurfaceEdges, optional
        Edges of the surface, which without it has none.

    Returns
    -------
    int
        Number of photons that were looked at one by one.
    """
    cdef FootprintGather work = open_work(
        tree, queries, rows, normals, footprint, range_radius, surface
    )
    set_values(work, values, sums, integrals, out)
    work.number = np.broadcast_to(np.float64(number), len(queries))
    work.bias = np.broadcast_to(np.float64(bias[0]), len(queries))
    work.bias_decay = bias[1]
    work.squared_gather_radius = radius * radius
    return do_all(work, n_threads)


def gather_within(
    Tree tree, values, queries, rows, out, *, normals, sums, footprint, integrals, radius,
    double range_radius, int n_threads, SurfaceEdges surface=None
):
    """Write densities of given radii over the footprints named by `rows` to `out`.

    All photons within the radius count, those at it too.

    Parameters
    ----------
    radius : (m,) float64 array
        Positive and finite.
    tree, values, queries, rows, out, normals, sums, footprint, integrals, range_radius, n_threads,
    surface
        See `gather`.

    Returns
    -------
    int
        Number of photons that were looked at one by one.
    """
    cdef FootprintGather work = open_work(
        tree, queries, rows, normals, footprint, range_radius, surface
    )
    set_values(work, values, sums, integrals, out)
    work.task = DENSITIES_WITHIN
    work.given_radius = radius
    if work.given_radius.shape[0] != work.queries.shape[0]:
        raise ValueError("radii and queries do not fit one another")
    return do_all(work, n_threads)


def write_radii(
    Tree tree, queries, rows, out, *, normals, footprint, double number, double radius,
    double range_radius, int n_threads, SurfaceEdges surface=None
):
    """Write the radii of the rule over the footprints named by `rows` to `out`.

    They are zero where all photons that are asked for are at a point.

    Parameters
    ----------
    out : (m,) float64 array
    tree, queries, rows, normals, footprint, number, radius, range_radius, n_threads, surface
        See `gather`.
    """
    cdef FootprintGather work = open_work(
        tree, queries, rows, normals, footprint, range_radius, surface
    )
    work.task = RADII
    work.radius = out
    if work.radius.shape[0] != work.queries.shape[0]:
        raise ValueError("radii and queries do not fit one another")
    if tree.n_points == 0:
        np.asarray(work.radius)[np.asarray(work.rows)] = radius
    work.number = np.broadcast_to(number, len(queries))
    work.squared_gather_radius = radius * radius
    do_all(work, n_threads)


cdef FootprintGather open_work(
    Tree tree, queries, rows, normals, footprint, double range_radius, SurfaceEdges surface
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
    work.edges_of_surface = surface
    work.slack = 1e-14 * np.abs([tree.low[:3], tree.high[:3]]).max()
    return work


cdef set_values(FootprintGather work, values, sums, integrals, out):
    """Set the values whose densities are written; raises ValueError if they do not fit."""
    work.values, work.sums, work.integrals, work.out = values, sums, integrals, out
    if not values_fit(work):
        raise ValueError("queries, densities and photon values do not fit one another")
    if work.tree.n_points == 0:
        np.asarray(work.out)[np.asarray(work.rows)] = 0.0


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
    if work.edges_of_surface is not None:
        work.surface = EdgeSearch(work.edges_of_surface, n_threads)


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
    scratch.thread = thread
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


# Footprints

cdef void open_footprint(
    FootprintGather work, Footprint* footprint, Py_ssize_t row
) noexcept nogil:
    """Set the rectangle of a footprint."""
    cdef Rectangle* rectangle = &footprint.rectangle
    cdef double diagonal
    footprint.number = 0.0 if work.task == DENSITIES_WITHIN else work.number[row]
    footprint.bias = work.bias[row] if work.task == DENSITIES else 0.0
    if work.edges is None:
        open_rectangle(footprint, &work.normals[row, 0], NULL, work.sides[row])
    else:
        open_parallelogram(footprint, &work.normals[row, 0], &work.edges[row, 0, 0])
    diagonal = sqrt(
        footprint.sides[0] * footprint.sides[0] + footprint.sides[1] * footprint.sides[1]
    )
    rectangle.half[0] = 0.5 * footprint.sides[0]
    rectangle.half[1] = 0.5 * footprint.sides[1]
    rectangle.half[2] = 0.5 * SAGITTA * diagonal
    rectangle.at = &work.queries[row, 0]
    rectangle.squared_range = work.squared_range
    rectangle.n_axes = work.tree.n_axes
    footprint.squared_largest = work.squared_gather_radius
    footprint.near.n = 0


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


# Sums

cdef void write_densities(
    FootprintGather work, Footprint* footprint, Scratch* scratch, double* out
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
    FootprintGather work, Footprint* footprint, Scratch* scratch, Py_ssize_t row
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
    FootprintGather work, Footprint* footprint, Scratch* scratch, Py_ssize_t row
) noexcept nogil:
    """Write the radius of one footprint."""
    cdef double squared = find_squared_radius(work, footprint, scratch)
    work.radius[row] = sqrt(squared)
    if squared > 0.0 and isfinite(squared):
        scratch.squared_guess = squared


cdef inline void write_sums(
    FootprintGather work, Footprint* footprint, Scratch* scratch,
    const RectangleWeights* weights, double scale, double* out
) noexcept nogil:
    """Write the weighted sums over the photons of the list, times a scale, per area of surface."""
    cdef Py_ssize_t channel
    if work.surface is not None:
        scale /= share_of_kernel(work, footprint, scratch, weights.squared_radius)
    scratch.n_single += BLOCK * scratch.n_blocks
    work.tree.simd.rectangle_sum(
        &work.tree.coords[0, 0, 0], scratch.blocks, scratch.n_blocks, &footprint.rectangle,
        weights, &work.values[0, 0, 0], work.values.shape[1], out
    )
    for channel in range(work.out.shape[1]):
        out[channel] = scale * (out[channel] + scratch.deep[channel])


cdef inline double share_of_kernel(
    FootprintGather work, Footprint* footprint, Scratch* scratch, double squared
) noexcept nogil:
    """Part of a kernel that is on surface; one where none of it is."""
    footprint.squared_known = squared
    find_near(work, footprint, scratch)
    return share_on_surface(&footprint.near, footprint.sides, sqrt(squared))


cdef void list_for_sums(
    FootprintGather work, const Footprint* footprint, Scratch* scratch, double squared
) noexcept nogil:
    """List the blocks within the radius found: those listed last, unless there are deep nodes.

    Which nodes are deep has to follow from the radius found, not from that of a search.
    """
    cdef double reach = squared_reach(work.tree, &footprint.rectangle)
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
