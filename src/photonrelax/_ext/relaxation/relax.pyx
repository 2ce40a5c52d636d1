"""One simultaneous move of every photon by the repulsion of its neighbours (SJ13 §4.4)."""

from cython cimport final, view
from cython.parallel cimport prange
from libc.math cimport INFINITY, sqrt

import numpy as np

from ..common.prefetch cimport prefetch_row
from ..common.threads cimport ELEMENTS, team_size
from ..common.vec3 cimport cross, dot
from ..spatial.batch cimport Batch, Query, gather_points, limit_radius, limit_range
from ..spatial.query_loop cimport BatchWork, search_points
from ..spatial.simd.kernels cimport BLOCK
from ..spatial.tree cimport Tree

from ..spatial.tree import aligned

cdef enum:
    # Least number of photons in range that repel one of them.
    MIN_NEIGHBOURS = 4
    # Columns of a record behind the slope: the origin and the squared largest distance from it, and
    # the same of the start.
    ORIGIN = 3
    FARTHEST = 6
    SHARE = 7
    START = 8
    COLUMNS = 11


@final
cdef class Rest:
    """The density in which photons are to rest, and how far they may go for it.

    Parameters
    ----------
    rows : (n,) intp array
        Rows of the photons, in tree order.
    slope : (m, 3) float64 array
        Relative slope of the density, 1/m, by row.
    limit : (m,) float64 array
        Largest distances from the origin, in units of `radius`, by row; may be infinite.
    radius : (n,) float64 array
        Of k photons before all moves, m, in tree order.
    limit_of_slope : float
        Largest distance from the origin in units of the length over which the density changes.
    origin : (m, 3) float64 array
        Positions before all moves, by row.
    start : (m, 3) float64 array or None
        Positions before the first of these moves, by row, if they are limited too.
    share : float
        Largest distance from the start in units of the limit and the present radius of k photons.
    longer : float
        Factor on the steps of photons that are limited.
    steep : float
        Relative change of density within the radius of k photons that makes a slope.
    n_threads : int

    Raises
    ------
    ValueError
        If arrays do not fit one another.
    """

    # In tree order: side by side, as all are read for a photon. The squared largest distance from
    # the origin is in m², that from the start in units of the squared present radius.
    cdef double[:, ::1] records
    cdef bint has_start
    cdef double longer
    cdef double squared_steep

    def __init__(
        self, *, const Py_ssize_t[::1] rows, slope, limit, const double[::1] radius,
        double limit_of_slope, origin, start, double share, double longer,
        double steep, int n_threads
    ):
        cdef Py_ssize_t place, row, axis, n = rows.shape[0]
        cdef const double[:, ::1] slopes = slope
        cdef const double[:, :] origins = origin, starts = start
        cdef const double[::1] limits = limit
        self.longer, self.squared_steep = longer, steep * steep
        self.has_start = start is not None
        if not (
            len(slopes) == len(limits) == len(origins)
            and n == radius.shape[0]
            and slopes.shape[1] == origins.shape[1] == 3
            and (start is None or np.shape(start) == np.shape(origin))
        ):
            raise ValueError("slopes, origins and limits do not fit one another")
        self.records = aligned((n, COLUMNS if self.has_start else START), np.float64)
        for place in prange(
            n, nogil=True, schedule="static", num_threads=team_size(n_threads, n, ELEMENTS)
        ):
            row = rows[place]
            for axis in range(3):
                self.records[place, axis] = slopes[row, axis]
                self.records[place, ORIGIN + axis] = origins[row, axis]
            self.records[place, FARTHEST] = self.squared_limit(
                place, limits[row] * radius[place], limit_of_slope
            )
            self.records[place, SHARE] = (share * limits[row]) ** 2
            if self.has_start:
                for axis in range(3):
                    self.records[place, START + axis] = starts[row, axis]

    cdef double squared_limit(
        self, Py_ssize_t place, double limit, double limit_of_slope
    ) noexcept nogil:
        cdef const double* g = &self.records[place, 0]
        cdef double squared_slope = dot(g, g), squared = INFINITY
        # Not a number where the limit is infinite and the radius zero.
        if limit < INFINITY:
            squared = limit * limit
        if squared_slope > 0.0:
            squared = min(squared, limit_of_slope * limit_of_slope / squared_slope)
        return squared

    cdef void compensate(
        self, double* f, Py_ssize_t place, double count, double squared_radius
    ) noexcept nogil:
        """Take from f the force of `count` photons at rest (docs/methods/mapped.md).

        It is −g r²/12 times the share of them that is within r, of which the last is on the border.
        """
        cdef double scale = (count - 0.5) / (12.0 * count) * squared_radius
        cdef Py_ssize_t axis
        for axis in range(3):
            f[axis] += scale * self.records[place, axis]

    cdef void prefetch(self, Py_ssize_t place) noexcept nogil:
        """Prefetch what a photon of the next moves needs: a search lies between two blocks."""
        prefetch_row(&self.records[place, 0], self.records.shape[1] * sizeof(double))

    cdef void hold(self, double* moved, Py_ssize_t place, double squared_radius) noexcept nogil:
        """Put a photon that went too far back to its limits, that of k photons among them."""
        cdef const double* record = &self.records[place, 0]
        if self.has_start:
            put_back(moved, record + START, record[SHARE] * squared_radius)
        put_back(moved, record + ORIGIN, record[FARTHEST])

    cdef double lengthened(self, Py_ssize_t place) noexcept nogil:
        """Factor on the steps of a photon."""
        return self.longer if self.records[place, FARTHEST] < INFINITY else 1.0

    cdef bint is_steep(self, Py_ssize_t place, double squared_radius) noexcept nogil:
        """True on a slope, by the radius of k photons."""
        cdef const double* g = &self.records[place, 0]
        return dot(g, g) * squared_radius > self.squared_steep


cdef inline void put_back(
    double* moved, const double* origin, double squared_limit
) noexcept nogil:
    """Move a point to no farther from the origin than a limit."""
    cdef double[3] gone
    cdef double squared, scale
    cdef Py_ssize_t axis
    for axis in range(3):
        gone[axis] = moved[axis] - origin[axis]
    squared = dot(gone, gone)
    if squared > squared_limit:
        scale = sqrt(squared_limit / squared)
        for axis in range(3):
            moved[axis] = origin[axis] + gone[axis] * scale


@final
cdef class Paths:
    """Distances that photons searched and went in a stage of iterations.

    Parameters
    ----------
    last : (m,) intp array
        Last iteration of interest of each photon, by row; those that follow may leave it out.
    tracked : (t,) intp array
        Rows of photons of which all searches are kept.
    n_iterations : int

    Attributes
    ----------
    searched : (m,) float64 array
        Largest distance from where a photon started that a search reached; infinite where fewer
        than k photons were found without a limit.
    travelled : (m,) float64 array
        Largest distance of a photon from where it started, before the last of its iterations.
    tracks : (t, n_iterations, 4) float64 array
        Positions of the photons tracked, and the radii of their searches, negative where there was
        none.
    """

    cdef readonly object searched, travelled, tracks
    cdef const Py_ssize_t[::1] last
    cdef double[::1] searched_view
    cdef double[::1] travelled_view
    cdef double[:, :, ::1] tracks_view
    # By row, the place among those tracked, or -1.
    cdef Py_ssize_t[::1] track_of
    # In tree order.
    cdef const double[:, ::1] start
    cdef Py_ssize_t iteration

    def __init__(self, const Py_ssize_t[::1] last, tracked, Py_ssize_t n_iterations):
        track_of = np.full(last.shape[0], -1, dtype=np.intp)
        track_of[tracked] = np.arange(len(tracked))
        self.tracks = np.full((len(tracked), n_iterations, 4), -1.0)
        self.track_of, self.tracks_view = track_of, self.tracks
        self.last = last
        self.searched, self.travelled = np.zeros((2, last.shape[0]))
        self.searched_view, self.travelled_view = self.searched, self.travelled

    def begin(self, const double[:, ::1] start):
        """Start at some positions (n, 3), in tree order."""
        self.start = start
        self.iteration = 0

    def next(self):
        """Begin an iteration."""
        self.iteration += 1

    cdef bint needs(self, Py_ssize_t row) noexcept nogil:
        return self.last[row] >= self.iteration

    cdef void add(
        self, Py_ssize_t row, Py_ssize_t place, const double* position, double radius
    ) noexcept nogil:
        """Add the search of a photon that is at a position."""
        cdef double[3] gone
        cdef double distance
        cdef Py_ssize_t axis
        for axis in range(3):
            gone[axis] = position[axis] - self.start[place, axis]
        distance = sqrt(dot(gone, gone))
        self.travelled_view[row] = max(self.travelled_view[row], distance)
        if self.needs(row):
            self.searched_view[row] = max(self.searched_view[row], radius + distance)
            if self.track_of[row] >= 0:
                for axis in range(3):
                    self.tracks_view[self.track_of[row], self.iteration - 1, axis] = position[axis]
                self.tracks_view[self.track_of[row], self.iteration - 1, 3] = radius


@final
cdef class RelaxInputs:
    """The photons of a tree in tree order, and their structure by row.

    Parameters
    ----------
    rows : (n,) intp array
        Rows of the photons, in tree order.
    normal : (n, 3) float64 array
        Unit normals, in tree order.
    largest_step : (n,) float64 array
        Longest moves, m, in tree order.
    squared_radius : (n,) float64 array
        Squared distance to the farthest neighbour, or an estimate of it, -1 for none; in
        tree order and updated by moves.
    too_few : (n,) bool array, optional
        True if fewer than k photons are expected in range, so that the whole range is searched at
        once; in tree order and updated by moves.
    basis : (m, 2, 3) float64 array
        Directions along the structure, in which the photon is free, and across, by row.
    constraint : (m,) float64 array
        Constraint of the direction across, by row.
    range_radius, reach : (m,) float64 arrays or None
        Limits over the range axes and in space, by row; None for none.
    rest : Rest, optional
        None for even density.
    paths : Paths, optional
        Are added to; photons that they no longer need may stay.
    """

    cdef const Py_ssize_t[::1] rows
    cdef const double[:, ::view.contiguous] normal
    cdef const double[:, :, ::1] basis
    cdef const double[::1] constraint
    cdef const double[:] range_radius
    cdef const double[::1] reach
    cdef const double[::1] largest_step
    cdef double[::1] squared_radius
    cdef unsigned char[::1] too_few
    cdef Rest rest
    cdef Paths paths

    def __init__(
        self, *, rows, normal, largest_step, squared_radius, basis, constraint, range_radius,
        reach, too_few=None, Rest rest=None, Paths paths=None
    ):
        self.rows = rows
        self.normal = normal
        self.basis = basis
        self.constraint = constraint
        self.range_radius = range_radius
        self.reach = reach
        self.rest = rest
        self.paths = paths
        self.largest_step = largest_step
        self.squared_radius = squared_radius
        if too_few is None:
            too_few = np.zeros(len(rows), dtype=bool)
        self.too_few = too_few.view(np.uint8)


@final
cdef class Move(BatchWork):
    """One move of a tree's photons by the repulsion of their neighbours (SJ13 Eq. 8–9)."""

    cdef RelaxInputs inputs
    cdef double step
    # Share of the step that photons on slopes take.
    cdef double share_on_slopes
    cdef double[:, ::1] moved

    cdef bint skips(self, Py_ssize_t first) noexcept nogil:
        """True for photons that their paths no longer need: they stay."""
        cdef Py_ssize_t place, axis, end = min(first + BLOCK, self.tree.n_points)
        if self.inputs.paths is None:
            return False
        for place in range(first, end):
            if self.inputs.paths.needs(self.inputs.rows[place]):
                return False
        for place in range(first, end):
            for axis in range(3):
                self.moved[place, axis] = self.tree.coords[first // BLOCK, axis, place - first]
        return True

    cdef void limit(self, Batch* batch, Query* query, Py_ssize_t place) noexcept nogil:
        cdef Py_ssize_t row = self.inputs.rows[place]
        self.prefetch(row, place + BLOCK)
        if self.inputs.rest is not None:
            self.inputs.rest.prefetch(place)
        query.squared_guess = self.inputs.squared_radius[place]
        if self.inputs.too_few[place]:
            query.squared_guess = INFINITY
        if self.inputs.range_radius is not None:
            limit_range(query, self.inputs.range_radius[row])
        if self.inputs.reach is not None:
            limit_radius(query, self.inputs.reach[row] * self.inputs.reach[row])

    cdef void prefetch(self, Py_ssize_t row, Py_ssize_t next_place) noexcept nogil:
        """Prefetch the constraint of a photon, and the limits at a position of the next block."""
        prefetch_row(&self.inputs.basis[row, 0, 0], 3 * sizeof(double))
        prefetch_row(&self.inputs.constraint[row], sizeof(double))
        if next_place < self.tree.n_points:
            row = self.inputs.rows[next_place]
            if self.inputs.range_radius is not None:
                prefetch_row(&self.inputs.range_radius[row], sizeof(double))
            if self.inputs.reach is not None:
                prefetch_row(&self.inputs.reach[row], sizeof(double))

    cdef void finish(self, Batch* batch, Py_ssize_t first, int thread) noexcept nogil:
        """Move the photons of a block; write their rows of `moved` only."""
        cdef Py_ssize_t lane
        gather_points(self.tree, batch)
        for lane in range(batch.n_queries):
            self.move_one(batch, lane, first + lane)

    cdef double searched(self, const Query* query, Py_ssize_t k, Py_ssize_t row) noexcept nogil:
        """Distance to which the neighbours of a photon were searched."""
        if query.candidates.count == k:
            return sqrt(query.candidates.squared_radius)
        return INFINITY if self.inputs.reach is None else self.inputs.reach[row]

    cdef void move_one(self, Batch* batch, Py_ssize_t lane, Py_ssize_t place) noexcept nogil:
        """Move one photon by the repulsion of its neighbours; write its row of `moved` only."""
        cdef const Query* query = &batch.queries[lane]
        cdef Py_ssize_t axis, row = self.inputs.rows[place]
        cdef double step = self.step
        cdef double[3] f
        f[0] = f[1] = f[2] = 0.0
        if query.candidates.count >= MIN_NEIGHBOURS and query.candidates.squared_radius > 0.0:
            self.tree.simd.repulsion(
                batch.points + 3 * lane * batch.stride, query.candidates.count,
                query.candidates.squared_radius, query.bounds.low, f
            )
            if self.inputs.rest is not None:
                self.inputs.rest.compensate(
                    f, place, query.candidates.count, query.candidates.squared_radius
                )
                step *= self.inputs.rest.lengthened(place)
                if self.share_on_slopes < 1.0 and self.inputs.rest.is_steep(
                    place, query.candidates.squared_radius
                ):
                    step *= self.share_on_slopes
            project(
                f, &self.inputs.normal[place, 0], &self.inputs.basis[row, 0, 0],
                self.inputs.constraint[row]
            )
            shorten(f, step, self.inputs.largest_step[place])
        self.inputs.squared_radius[place] = query.candidates.squared_radius
        self.inputs.too_few[place] = query.candidates.count < batch.k
        if self.inputs.paths is not None:
            self.inputs.paths.add(row, place, query.bounds.low, self.searched(query, batch.k, row))
        for axis in range(3):
            self.moved[place, axis] = query.bounds.low[axis] + f[axis]
        if self.inputs.rest is not None and query.candidates.count >= MIN_NEIGHBOURS:
            # The squared radius of those that there are, scaled to hold k.
            self.inputs.rest.hold(
                &self.moved[place, 0], place,
                query.candidates.squared_radius * batch.k / query.candidates.count
            )


def move(
    Tree tree, Py_ssize_t first, Py_ssize_t end, RelaxInputs inputs, *, Py_ssize_t k, double step,
    double[:, ::1] moved, int n_threads, double share_on_slopes=1.0
):
    """Write the new positions of the photons at tree positions first … end, whole blocks.

    All positions read are the tree's: photons move simultaneously, in no order. Where the density
    to rest in has a slope, they take a share of the step.
    """
    cdef Move work = Move(tree, k=k, radius=INFINITY, range_radius=-1.0)
    work.inputs = inputs
    work.step, work.share_on_slopes = step, share_on_slopes
    work.moved = moved
    search_points(work, first, end, n_threads)


cdef void project(
    double* f, const double* normal, const double* basis, double constraint
) noexcept nogil:
    """Constrain f to the basis (SJ13 Eq. 9): u (u · f) + (1 − constraint) v (v · f).

    The basis is of the point where the photon landed; on a curved surface it is turned into the
    tangent plane of its present position.
    """
    cdef double[3] u
    cdef double[3] v
    cdef double tilt = dot(basis, normal)
    cdef double length, along, across
    cdef Py_ssize_t axis
    for axis in range(3):
        u[axis] = basis[axis] - tilt * normal[axis]
    length = sqrt(dot(u, u))
    if length < 1e-6:
        # The surface has turned by a right angle: the basis has no direction here.
        f[0] = f[1] = f[2] = 0.0
        return
    for axis in range(3):
        u[axis] /= length
    cross(v, normal, u)
    along = dot(u, f)
    across = (1.0 - constraint) * dot(v, f)
    for axis in range(3):
        f[axis] = along * u[axis] + across * v[axis]


cdef void shorten(double* f, double step, double largest) noexcept nogil:
    """Scale f by `step`, but to no more than `largest`."""
    cdef double length = step * sqrt(dot(f, f))
    cdef double scale = step
    cdef Py_ssize_t axis
    if length > largest:
        scale = step * largest / length
    for axis in range(3):
        f[axis] *= scale
