"""Slope of the density that the map from emitter coordinates to positions prescribes."""

from cython cimport final
from libc.math cimport INFINITY, M_PI, asin, isfinite, sqrt
from libc.stdint cimport int64_t

import numpy as np

from ..common.vec3 cimport dot, orthonormal_frame
from ..spatial.batch cimport Batch
from ..spatial.query_loop cimport BatchWork, search_points
from ..spatial.simd.kernels cimport (
    KEY_CHUNK, LANES, LATTICE_HALF, QUADRATIC_TERMS, LatticeMap, MapSamples, QuadraticMaps,
    SimdKernels
)
from ..spatial.tree cimport Tree
from .structure cimport Components, decompose

from ..spatial.tree import aligned

cdef enum:
    TERMS = QUADRATIC_TERMS
    # Rings of a hexagonal lattice around its centre.
    RINGS = 5
    # Points of the lattice whose force is taken.
    NEAREST = 32

# Points of the lattice to a photon.
cdef double LATTICE_DENSITY = 2.0
# Largest stretch of the lattice.
cdef double MAX_ASPECT = 6.0
# Relative difference of the stretches along two axes up to which they are one.
cdef double SAME_STRETCH = 1e-6
# Mean offset of a photon's neighbours over their radius from which they may end at an edge; at the
# edge itself it is 4/(3π). That of independent photons exceeds it twice in a hundred times, so none
# may lie beyond the edge by more than the margin, which only one in a thousand passes.
cdef double EDGE_SHIFT = 0.3
cdef double EDGE_MARGIN = 0.2


def _hexagonal():
    """Terms (5, LATTICE_HALF) of a quadratic map at half a hexagonal lattice around its centre.

    One point has a unit of area. The other half is opposite. Nearest first, so that few vectors
    hold those whose force is taken; NaN behind the last.
    """
    i, j = np.mgrid[-RINGS : RINGS + 1, -RINGS : RINGS + 1].reshape(2, -1)
    half = (np.abs(i + j) <= RINGS) & ((i > 0) | ((i == 0) & (j >= 0)))
    i, j = i[half], j[half]
    order = np.argsort(i * i + i * j + j * j, kind="stable")
    p, q = np.sqrt(2.0 / np.sqrt(3.0)) * np.stack([i + 0.5 * j, np.sqrt(0.75) * j])[:, order]
    terms = aligned((TERMS - 1, LATTICE_HALF), np.float64)
    terms[:] = np.nan
    terms[:, : len(p)] = p, q, 0.5 * p * p, p * q, 0.5 * q * q
    return terms


cdef double[:, ::1] hexagonal = _hexagonal()


cdef struct QuadraticMap:
    # Coefficients of u and v.
    double[TERMS] u
    double[TERMS] v


cdef struct Sheet:
    # Area of a photon over the emitter coordinates, and the straight edge, if there is one: the
    # sheet is where the product with the direction (a, b) is above `edge`. Lopsided: there may be
    # an edge, or the photons are uneven.
    bint lopsided
    double area
    double edge
    double a
    double b


@final
cdef class RestDensity(BatchWork):
    """Prescribed slopes of the photons of a tree over their emitter coordinates."""

    # Places of photons in the tree, which take the part of ids; photons are in that order.
    cdef const int64_t[::1] places
    # Their positions, emitter coordinates and normals.
    cdef const double[:, ::1] records
    cdef Py_ssize_t n_fitted
    cdef double max_residual
    cdef double lattice_force
    cdef double[:, ::1] slope
    cdef double[::1] residual
    cdef double[::1] noise
    # None if it is not asked for.
    cdef double[::1] reached

    cdef void finish(self, Batch* batch, Py_ssize_t first, int thread) noexcept nogil:
        """Fit the maps around the photons of a block; write their rows only."""
        cdef Py_ssize_t lane, part
        if self.reached is not None:
            self.write_reached(batch, first)
        for lane in range(batch.n_queries):
            self.tree.simd.gather_neighbours(
                &self.tree.coords[0, 0, 0], &batch.queries[lane].bounds,
                &batch.queries[lane].candidates, &self.places[0],
                batch.squared + lane * batch.stride, batch.id + lane * batch.stride
            )
        # Each step for all photons: reading what has just been written would stall.
        for lane in range(batch.n_queries):
            self.tree.simd.sort_neighbours(
                batch.squared + lane * batch.stride, batch.id + lane * batch.stride,
                batch.queries[lane].candidates.count,
                batch.queries[lane].candidates.squared_radius,
                batch.sorted + lane * batch.stride, batch.sorted_id + lane * batch.stride
            )
        for lane in range(batch.n_queries):
            self.tree.simd.write_neighbours(
                batch.sorted + lane * batch.stride, batch.sorted_id + lane * batch.stride,
                batch.queries[lane].candidates.count, False,
                batch.squared + lane * batch.stride, batch.id + lane * batch.stride
            )
        for part in range((batch.n_queries + LANES - 1) // LANES):
            self.prescribe_some(batch, LANES * part, first + LANES * part)

    cdef void write_reached(self, Batch* batch, Py_ssize_t first) noexcept nogil:
        cdef double squared
        cdef Py_ssize_t lane
        for lane in range(batch.n_queries):
            squared = batch.queries[lane].candidates.squared_radius
            if batch.queries[lane].candidates.count < self.k:
                squared = INFINITY
            self.reached[self.tree.ids[first + lane]] = sqrt(squared)

    cdef void prescribe_some(
        self, Batch* batch, Py_ssize_t first, Py_ssize_t place
    ) noexcept nogil:
        """Prescribe the slopes of the photons of some queries of a batch, in one vector."""
        cdef MapSamples samples
        cdef QuadraticMaps maps
        cdef double[LANES][6] frames
        cdef bint[LANES] complete
        cdef Py_ssize_t lane, n = min(batch.n_queries - first, <Py_ssize_t> LANES)
        for lane in range(LANES):
            complete[lane] = lane < n and batch.queries[first + lane].candidates.count >= self.k
            if complete[lane]:
                complete[lane] = self.sample(
                    &samples, lane, place + lane, batch.id + (first + lane) * batch.stride,
                    frames[lane]
                )
            if not complete[lane]:
                clear_lane(&samples, lane, self.k)
        self.tree.simd.fit_maps(&samples, self.k, self.n_fitted, &maps)
        for lane in range(n):
            self.prescribe(
                &samples, &maps, lane, self.tree.ids[place + lane],
                frames[lane] if complete[lane] else NULL
            )

    cdef bint sample(
        self, MapSamples* samples, Py_ssize_t lane, Py_ssize_t place, const int64_t* others,
        double* frame
    ) noexcept nogil:
        """Offsets of a photon's neighbours, and its frame; false if it has no emitter coordinates.
        """
        cdef double[6] chart
        cdef const double* at = &self.records[place, 0]
        cdef const double* other
        cdef Py_ssize_t j, n_axes = self.records.shape[1] - 6
        orthonormal_frame(frame, frame + 3, at + 3 + n_axes)
        if not chart_at(at + 3, n_axes, chart):
            return False
        for j in range(self.k):
            other = &self.records[others[j], 0]
            write_offset(other, at, 3, frame, &samples.u[j][lane], &samples.v[j][lane])
            write_offset(
                other + 3, at + 3, n_axes, chart, &samples.a[j][lane], &samples.b[j][lane]
            )
        return True

    cdef void prescribe(
        self, const MapSamples* samples, const QuadraticMaps* maps, Py_ssize_t lane,
        Py_ssize_t row, const double* frame
    ) noexcept nogil:
        """Write the slope at a photon, zero where no map fits, the residual, and the noise."""
        cdef QuadraticMap fit
        cdef Sheet sheet
        cdef double[2] force
        cdef double radius, scale
        cdef Py_ssize_t axis
        self.residual[row] = self.noise[row] = INFINITY
        for axis in range(3):
            self.slope[row, axis] = 0.0
        if frame == NULL or not isfinite(maps.residual[lane]):
            return
        for axis in range(TERMS):
            fit.u[axis] = maps.u[axis][lane]
            fit.v[axis] = maps.v[axis][lane]
        sheet = sheet_around(samples, maps, lane, self.k)
        radius = lattice_force(self.tree.simd, &fit, &sheet, force)
        if not (radius > 0.0 and isfinite(force[0]) and isfinite(force[1])):
            return
        self.residual[row] = maps.residual[lane] / radius
        if not sheet.lopsided:
            self.noise[row] = maps.unevenness[lane]
        if self.residual[row] <= self.max_residual:
            scale = -1.0 / (self.lattice_force * radius * radius)
            for axis in range(3):
                self.slope[row, axis] = (
                    scale * (force[0] * frame[axis] + force[1] * frame[3 + axis])
                    / maps.scale[lane]
                )


cdef bint chart_at(const double* coords, Py_ssize_t n_axes, double* chart) noexcept nogil:
    """Two axes over the emitter coordinates: those of a plane, or tangents of a sphere."""
    cdef double[3] direction
    cdef double length
    cdef Py_ssize_t axis
    if n_axes == 2:
        for axis in range(6):
            chart[axis] = axis == 0 or axis == 4
        return True
    length = sqrt(dot(coords, coords))
    if not length > 0.0:
        return False
    for axis in range(3):
        direction[axis] = coords[axis] / length
    orthonormal_frame(chart, chart + 3, direction)
    return True


cdef inline void write_offset(
    const double* point, const double* origin, Py_ssize_t n_axes, const double* frame,
    double* along, double* across
) noexcept nogil:
    """Offset of a point from another, of two or three axes, along a frame."""
    cdef double x = point[0] - origin[0], y = point[1] - origin[1]
    cdef double z = point[2] - origin[2] if n_axes > 2 else 0.0
    along[0] = frame[0] * x + frame[1] * y + frame[2] * z
    across[0] = frame[3] * x + frame[4] * y + frame[5] * z


cdef void clear_lane(MapSamples* samples, Py_ssize_t lane, Py_ssize_t n) noexcept nogil:
    """Set the offsets of a lane without neighbours, whose fit is not unique, to zero."""
    cdef Py_ssize_t j
    for j in range(n):
        samples.a[j][lane] = samples.b[j][lane] = 0.0
        samples.u[j][lane] = samples.v[j][lane] = 0.0


# --- the sheet over the emitter coordinates ----------------------------------------------------


cdef Sheet sheet_around(
    const MapSamples* samples, const QuadraticMaps* maps, Py_ssize_t lane, Py_ssize_t n
) noexcept nogil:
    """Area of a photon, and the edge of the sheet, from the offsets of all n samples."""
    cdef Sheet sheet
    cdef double a = samples.a[n - 1][lane], b = samples.b[n - 1][lane]
    cdef double radius = sqrt(a * a + b * b), shift, distance
    # The photon itself is the first, at offset zero.
    sheet.a = maps.sum_a[lane] / (n - 1)
    sheet.b = maps.sum_b[lane] / (n - 1)
    shift = sqrt(sheet.a * sheet.a + sheet.b * sheet.b)
    sheet.edge = -INFINITY
    sheet.area = M_PI * radius * radius / (n - 1)
    sheet.lopsided = shift > EDGE_SHIFT * radius
    if sheet.lopsided:
        sheet.a /= shift
        sheet.b /= shift
        distance = edge_distance(shift / radius)
        if extent_against(samples, lane, n, &sheet) <= (distance + EDGE_MARGIN) * radius:
            sheet.edge = -distance * radius
            sheet.area = cut_area(distance) * radius * radius / (n - 1)
    return sheet


cdef double extent_against(
    const MapSamples* samples, Py_ssize_t lane, Py_ssize_t n, const Sheet* sheet
) noexcept nogil:
    """Largest offset of a sample against the direction of a sheet."""
    cdef double extent = 0.0
    cdef Py_ssize_t j
    for j in range(n):
        extent = max(extent, -(sheet.a * samples.a[j][lane] + sheet.b * samples.b[j][lane]))
    return extent


cdef double cut_area(double distance) noexcept nogil:
    """Area of a unit disc cut by a straight line that far from its centre."""
    return 0.5 * M_PI + asin(distance) + distance * sqrt(1.0 - distance * distance)


cdef double edge_distance(double shift) noexcept nogil:
    """Distance of a line that cuts a unit disc, from the distance of the centroid; at least 0."""
    cdef double low = 0.0, high = 1.0, middle, gap
    cdef int _step
    for _step in range(52):
        middle = 0.5 * (low + high)
        gap = 1.0 - middle * middle
        if 2.0 / 3.0 * gap * sqrt(gap) > shift * cut_area(middle):
            low = middle
        else:
            high = middle
    return low


# --- the lattice -------------------------------------------------------------------------------


cdef double lattice_force(
    const SimdKernels* simd, const QuadraticMap* fit, const Sheet* sheet, double* force
) noexcept nogil:
    """Write the force of the nearest lattice points; return their radius, zero if there is none.

    It is that of an even disc of the same mean squared distance. The distance of the farthest jumps
    between the shells of a lattice: along a slope, where a shell is no circle, it falls too soon.
    """
    cdef LatticeMap lattice
    cdef double[4] basis
    cdef double spacing = stretched_basis(fit, sheet.area, basis)
    if not spacing > 0.0:
        return 0.0
    transform(fit.u, basis, lattice.u)
    transform(fit.v, basis, lattice.v)
    lattice.inward[0] = basis[0] * sheet.a + basis[2] * sheet.b
    lattice.inward[1] = basis[1] * sheet.a + basis[3] * sheet.b
    lattice.edge = sheet.edge
    return simd.lattice_repulsion(
        &hexagonal[0, 0], &lattice, NEAREST / M_PI * spacing, NEAREST, force
    )


cdef void transform(const double* fit, const double* basis, double* terms) noexcept nogil:
    """Coefficients of a quadratic map over lattice coordinates, from those over the emitter's."""
    cdef double first_a = fit[3] * basis[0] + fit[4] * basis[2]
    cdef double first_b = fit[4] * basis[0] + fit[5] * basis[2]
    cdef double second_a = fit[3] * basis[1] + fit[4] * basis[3]
    cdef double second_b = fit[4] * basis[1] + fit[5] * basis[3]
    terms[0] = fit[1] * basis[0] + fit[2] * basis[2]
    terms[1] = fit[1] * basis[1] + fit[2] * basis[3]
    terms[2] = first_a * basis[0] + first_b * basis[2]
    terms[3] = first_a * basis[1] + first_b * basis[3]
    terms[4] = second_a * basis[1] + second_b * basis[3]


cdef double stretched_basis(const QuadraticMap* fit, double area, double* basis) noexcept nogil:
    """Matrix of a lattice over the emitter coordinates that the map makes isotropic.

    The metric has the second derivatives too, which are what is left of it on a fold. Returns the
    area of a point of the lattice in it, zero if nothing is left.
    """
    cdef double uu = metric(fit.u, fit.u + 3, area) + metric(fit.v, fit.v + 3, area)
    cdef double vv = metric(fit.u + 1, fit.u + 4, area) + metric(fit.v + 1, fit.v + 4, area)
    cdef double uv = mixed_metric(fit.u, area) + mixed_metric(fit.v, area)
    cdef Components axes = decompose(uu, uv, vv)
    cdef double aspect = MAX_ASPECT, narrow, wide
    if not axes.first > 0.0:
        return 0.0
    if axes.first - axes.second <= SAME_STRETCH * axes.first:
        # Rounding alone would choose the direction, on which the force beside an edge depends.
        axes.cosine, axes.sine = 1.0, 0.0
    if axes.first < MAX_ASPECT * MAX_ASPECT * axes.second:
        aspect = sqrt(axes.first / axes.second)
    narrow = sqrt(area / (LATTICE_DENSITY * aspect))
    wide = narrow * aspect
    basis[0] = narrow * axes.cosine
    basis[1] = -wide * axes.sine
    basis[2] = narrow * axes.sine
    basis[3] = wide * axes.cosine
    return narrow * narrow * axes.first


cdef double metric(const double* first, const double* second, double area) noexcept nogil:
    """Squared change along an axis: first[1] is the first derivative, second[0:2] the second."""
    return first[1] * first[1] + area * (second[0] * second[0] + second[1] * second[1])


cdef double mixed_metric(const double* fit, double area) noexcept nogil:
    return fit[1] * fit[2] + area * (fit[3] * fit[4] + fit[4] * fit[5])


def prescribe(
    Tree tree, Py_ssize_t first, Py_ssize_t end, *, records, places, Py_ssize_t k,
    Py_ssize_t n_fitted, double max_residual, double lattice_force, double[:, ::1] slope,
    double[::1] residual, double[::1] noise, double[::1] reached=None, int n_threads
):
    """Fill the rows of the photons at tree positions first … end, whole blocks.

    Parameters
    ----------
    tree : Tree
        The emitter coordinates of photons, whose neighbours are within one on the range axes.
    first, end : int
    records : (n, 8) or (n, 9) float64 array
        Positions, emitter coordinates and normals of the photons, in tree order.
    places : (n,) int64 array
        0, 1, … of the photons.
    k, n_fitted : int
        Photons in a neighbourhood, and those nearest that the map is fitted to.
    max_residual : float
        Largest residual over the radius of the lattice points.
    lattice_force : float
        Force of the lattice in units of slope times squared radius.
    slope, residual, noise : (n, 3), (n,) and (n,) float64 arrays
        Written, by id; the noise is infinite where it is not known.
    reached : (n,) float64 array, optional
        Distances over the emitter coordinates to the farthest of k photons, by id; infinite where
        there are fewer.

    Raises
    ------
    ValueError
        If k is too large, or arrays do not fit the tree.
    """
    cdef double range_radius = 1.0 if tree.n_axes > tree.n_metric else -1.0
    cdef RestDensity work = RestDensity(tree, k=k, radius=INFINITY, range_radius=range_radius)
    if k > KEY_CHUNK:
        raise ValueError(f"k should be at most {KEY_CHUNK}, but is {k}")
    work.places, work.records = places, records
    work.n_fitted, work.max_residual = n_fitted, max_residual
    work.lattice_force = lattice_force
    work.slope, work.residual, work.noise = slope, residual, noise
    work.reached = reached
    if not fits(work):
        raise ValueError("photons, slopes, residuals and noise do not fit the tree")
    search_points(work, first, end, n_threads)


cdef bint fits(RestDensity work):
    """Whether all arrays have a row for each of the photons of the tree."""
    cdef Py_ssize_t n = work.tree.n_points
    return (
        n == work.records.shape[0] == work.places.shape[0]
        and n == work.slope.shape[0] == work.residual.shape[0] == work.noise.shape[0]
        and (work.reached is None or n == work.reached.shape[0])
        and work.slope.shape[1] == 3
        and work.records.shape[1] in (8, 9)
    )
