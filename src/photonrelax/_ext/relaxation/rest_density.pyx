"""Slope of the density that the map from emitter coordinates to positions prescribes."""

from cython cimport final
from libc.math cimport INFINITY, M_PI, asin, fabs, isfinite, sqrt
from libc.stdint cimport int64_t

import numpy as np

from ..common.vec3 cimport dot, orthonormal_frame
from ..spatial.batch cimport Batch
from ..spatial.query_loop cimport BatchWork, search_points
from ..spatial.simd.kernels cimport (
    KEY_CHUNK, LANES, LATTICE_ROW, QUADRATIC_TERMS, LatticeMap, MapSamples, SimdKernels
)
from ..spatial.tree cimport Tree
from .structure cimport Components, decompose

cdef enum:
    TERMS = QUADRATIC_TERMS
    # Rings of a hexagonal lattice around its centre.
    RINGS = 7
    # Points of the lattice whose force is taken.
    NEAREST = 32

# Points of the lattice to a photon.
cdef double LATTICE_DENSITY = 2.0
# Largest stretch of the lattice.
cdef double MAX_ASPECT = 6.0
# Mean offset of a photon's neighbours over their radius from which they may end at an edge; at the
# edge itself it is 4/(3π). That of independent photons exceeds it twice in a hundred times, so none
# may lie beyond the edge by more than the margin, which only one in a thousand passes.
cdef double EDGE_SHIFT = 0.3
cdef double EDGE_MARGIN = 0.2
# Pivots of normal equations below this share of their diagonal are rounding errors.
cdef double SINGULAR = 1e-10


def _hexagonal():
    """Terms (5, LATTICE_ROW) of a quadratic map at a hexagonal lattice, one point to a unit of area.

    Nearest first, so that few vectors hold those whose force is taken; NaN behind the last.
    """
    axial = np.mgrid[-RINGS : RINGS + 1, -RINGS : RINGS + 1].reshape(2, -1)
    i, j = axial[:, np.abs(axial.sum(axis=0)) <= RINGS]
    order = np.argsort(i * i + i * j + j * j, kind="stable")
    p, q = np.sqrt(2.0 / np.sqrt(3.0)) * np.stack([i + 0.5 * j, np.sqrt(0.75) * j])[:, order]
    terms = np.full((TERMS - 1, LATTICE_ROW), np.nan)
    terms[:, : len(p)] = p, q, 0.5 * p * p, p * q, 0.5 * q * q
    return terms


cdef double[:, ::1] hexagonal = _hexagonal()


cdef struct Samples:
    # Offsets of a photon's neighbours, nearest first: over the emitter coordinates (a, b), in units
    # of the radius of those that are fitted, and in the tangent plane (u, v), in units of `scale`.
    Py_ssize_t n
    MapSamples at
    double scale


cdef struct QuadraticMap:
    # Coefficients of u and v, and the root mean square of what they leave.
    double[TERMS] u
    double[TERMS] v
    double residual


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
    cdef const double[:, ::1] position
    cdef const double[:, ::1] normal
    cdef const double[:, ::1] coords
    cdef Py_ssize_t n_fitted
    cdef double max_residual
    cdef double lattice_force
    cdef double[:, ::1] slope
    cdef double[::1] residual
    cdef double[::1] noise

    cdef void finish(self, Batch* batch, Py_ssize_t first, int thread) noexcept nogil:
        """Fit the maps around the photons of a block; write their rows only."""
        cdef Py_ssize_t lane
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
        for lane in range(batch.n_queries):
            self.prescribe(batch, lane, first + lane)

    cdef void prescribe(self, Batch* batch, Py_ssize_t lane, Py_ssize_t place) noexcept nogil:
        """Write the slope at a photon, zero where no map fits, the residual, and the noise."""
        cdef Samples samples
        cdef QuadraticMap fit
        cdef Sheet sheet
        cdef double[6] frame
        cdef double[2] force
        cdef double radius, scale
        cdef Py_ssize_t axis, row = self.tree.ids[place]
        self.residual[row] = self.noise[row] = INFINITY
        for axis in range(3):
            self.slope[row, axis] = 0.0
        orthonormal_frame(frame, frame + 3, &self.normal[place, 0])
        if batch.queries[lane].candidates.count < self.k:
            return
        if not self.sample(&samples, place, batch.id + lane * batch.stride, frame):
            return
        if not fit_map(self.tree.simd, &fit, &samples, self.n_fitted):
            return
        sheet = sheet_around(&samples)
        radius = lattice_force(self.tree.simd, &fit, &sheet, force)
        if not (radius > 0.0 and isfinite(force[0]) and isfinite(force[1])):
            return
        self.residual[row] = fit.residual / radius
        if not sheet.lopsided:
            self.noise[row] = unevenness(self.tree.simd, &samples, self.n_fitted)
        if self.residual[row] <= self.max_residual:
            scale = -1.0 / (self.lattice_force * radius * radius)
            for axis in range(3):
                self.slope[row, axis] = (
                    scale * (force[0] * frame[axis] + force[1] * frame[3 + axis]) / samples.scale
                )

    cdef bint sample(
        self, Samples* samples, Py_ssize_t place, const int64_t* others, const double* frame
    ) noexcept nogil:
        """Offsets of a photon's neighbours; false where they have no extent."""
        cdef double[6] chart
        cdef double radius, farthest = 0.0
        cdef Py_ssize_t j
        if not self.chart_at(place, chart):
            return False
        samples.n = self.k
        write_offsets(self.coords, others, place, self.k, chart, samples.at.a, samples.at.b)
        write_offsets(self.position, others, place, self.k, frame, samples.at.u, samples.at.v)
        for j in range(self.k):
            farthest = max(farthest, max(fabs(samples.at.u[j]), fabs(samples.at.v[j])))
        j = self.n_fitted - 1
        radius = max(fabs(samples.at.a[j]), fabs(samples.at.b[j]))
        if not (radius > 0.0 and farthest > 0.0):
            return False
        # Dividing lengths, not squares, keeps very small and very large scenes in range.
        radius *= sqrt((samples.at.a[j] / radius) ** 2 + (samples.at.b[j] / radius) ** 2)
        samples.scale = farthest
        scale_rows(samples, 1.0 / radius, 1.0 / farthest)
        return True

    cdef bint chart_at(self, Py_ssize_t place, double* chart) noexcept nogil:
        """Two axes over the emitter coordinates: those of a plane, or tangents of a sphere."""
        cdef double[3] direction
        cdef double length
        cdef Py_ssize_t axis
        if self.coords.shape[1] == 2:
            for axis in range(6):
                chart[axis] = axis == 0 or axis == 4
            return True
        length = sqrt(dot(&self.coords[place, 0], &self.coords[place, 0]))
        if not length > 0.0:
            return False
        for axis in range(3):
            direction[axis] = self.coords[place, axis] / length
        orthonormal_frame(chart, chart + 3, direction)
        return True


cdef void write_offsets(
    const double[:, ::1] points, const int64_t* others, Py_ssize_t place, Py_ssize_t n,
    const double* frame, double* along, double* across
) noexcept nogil:
    """Offsets of n points from the one at `place`, along the two vectors of a frame."""
    cdef const double* at = &points[place, 0]
    cdef const double* other
    cdef Py_ssize_t j, n_axes = points.shape[1]
    cdef double x, y, z
    for j in range(n):
        other = &points[others[j], 0]
        x = other[0] - at[0]
        y = other[1] - at[1]
        along[j] = frame[0] * x + frame[1] * y
        across[j] = frame[3] * x + frame[4] * y
        if n_axes > 2:
            z = other[2] - at[2]
            along[j] += frame[2] * z
            across[j] += frame[5] * z


cdef void scale_rows(Samples* samples, double emitter_scale, double scale) noexcept nogil:
    """Scale offsets; kernels read rows in whole vectors, which are filled up with zeros."""
    cdef Py_ssize_t j
    for j in range(samples.n):
        samples.at.a[j] *= emitter_scale
        samples.at.b[j] *= emitter_scale
        samples.at.u[j] *= scale
        samples.at.v[j] *= scale
    for j in range(samples.n, min(samples.n + LANES, <Py_ssize_t> KEY_CHUNK)):
        samples.at.a[j] = samples.at.b[j] = samples.at.u[j] = samples.at.v[j] = 0.0


# --- the map -----------------------------------------------------------------------------------


cdef bint fit_map(
    const SimdKernels* simd, QuadraticMap* fit, const Samples* samples, Py_ssize_t n
) noexcept nogil:
    """Fit the map to the nearest n samples, by exp(−squared offset); false if none is unique."""
    cdef double[TERMS][TERMS] matrix
    simd.quadratic_sums(&samples.at, n, &matrix[0][0], fit.u, fit.v)
    if not factorise(&matrix[0][0]):
        return False
    back_substitute(&matrix[0][0], fit.u)
    back_substitute(&matrix[0][0], fit.v)
    fit.residual = simd.quadratic_residual(&samples.at, n, fit.u, fit.v)
    return True


cdef bint factorise(double* matrix) noexcept nogil:
    """Cholesky factor of a symmetric matrix, in its lower triangle; false if it is singular.

    The diagonal has the inverses.
    """
    cdef Py_ssize_t i, j, m
    cdef double pivot
    for j in range(TERMS):
        pivot = matrix[TERMS * j + j]
        for m in range(j):
            pivot -= matrix[TERMS * j + m] * matrix[TERMS * j + m]
        if not pivot > SINGULAR * matrix[TERMS * j + j]:
            return False
        matrix[TERMS * j + j] = 1.0 / sqrt(pivot)
        for i in range(j + 1, TERMS):
            for m in range(j):
                matrix[TERMS * i + j] -= matrix[TERMS * i + m] * matrix[TERMS * j + m]
            matrix[TERMS * i + j] *= matrix[TERMS * j + j]
    return True


cdef void back_substitute(const double* factor, double* x) noexcept nogil:
    """Solve for x, whose right side it holds, by a Cholesky factor."""
    cdef Py_ssize_t i, m
    for i in range(TERMS):
        for m in range(i):
            x[i] -= factor[TERMS * i + m] * x[m]
        x[i] *= factor[TERMS * i + i]
    for i in range(TERMS - 1, -1, -1):
        for m in range(i + 1, TERMS):
            x[i] -= factor[TERMS * m + i] * x[m]
        x[i] *= factor[TERMS * i + i]


# --- the sheet over the emitter coordinates ----------------------------------------------------


cdef Sheet sheet_around(const Samples* samples) noexcept nogil:
    """Area of a photon, and the edge of the sheet, from the offsets of all samples."""
    cdef Sheet sheet
    cdef Py_ssize_t j, last = samples.n - 1
    cdef double radius, shift, distance
    sheet.a = sheet.b = 0.0
    # The photon itself is the first, at offset zero.
    for j in range(1, samples.n):
        sheet.a += samples.at.a[j] / last
        sheet.b += samples.at.b[j] / last
    radius = sqrt(samples.at.a[last] * samples.at.a[last] + samples.at.b[last] * samples.at.b[last])
    shift = sqrt(sheet.a * sheet.a + sheet.b * sheet.b)
    sheet.edge = -INFINITY
    sheet.area = M_PI * radius * radius / last
    sheet.lopsided = shift > EDGE_SHIFT * radius
    if sheet.lopsided:
        sheet.a /= shift
        sheet.b /= shift
        distance = edge_distance(shift / radius)
        if extent_against(samples, sheet.a, sheet.b) <= (distance + EDGE_MARGIN) * radius:
            sheet.edge = -distance * radius
            sheet.area = cut_area(distance) * radius * radius / last
    return sheet


cdef double extent_against(const Samples* samples, double a, double b) noexcept nogil:
    """Largest offset of a sample against a direction."""
    cdef double extent = 0.0
    cdef Py_ssize_t j
    for j in range(samples.n):
        extent = max(extent, -(a * samples.at.a[j] + b * samples.at.b[j]))
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


cdef double unevenness(
    const SimdKernels* simd, const Samples* samples, Py_ssize_t n
) noexcept nogil:
    """Force of the nearest n samples over the emitter coordinates, in units of their radius."""
    cdef double[3 * (KEY_CHUNK + LANES)] points
    cdef double[3] centre, force
    cdef Py_ssize_t j, stride = n + LANES
    for j in range(n):
        points[j] = samples.at.a[j]
        points[stride + j] = samples.at.b[j]
        points[2 * stride + j] = 0.0
    centre[0] = centre[1] = centre[2] = 0.0
    simd.repulsion(points, n, 1.0, centre, force)
    return sqrt(force[0] * force[0] + force[1] * force[1])


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
    Tree tree, Py_ssize_t first, Py_ssize_t end, *, position, normal, coords, places, Py_ssize_t k,
    Py_ssize_t n_fitted, double max_residual, double lattice_force, double[:, ::1] slope,
    double[::1] residual, double[::1] noise, int n_threads
):
    """Fill the rows of the photons at tree positions first … end, whole blocks.

    Parameters
    ----------
    tree : Tree
        The emitter coordinates of photons, whose neighbours are within one on the range axes.
    first, end : int
    position, normal, coords : float64 arrays
        Of the photons, in tree order.
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

    Raises
    ------
    ValueError
        If k is too large, or arrays do not fit the tree.
    """
    cdef double range_radius = 1.0 if tree.n_axes > tree.n_metric else -1.0
    cdef RestDensity work = RestDensity(tree, k=k, radius=INFINITY, range_radius=range_radius)
    if k > KEY_CHUNK:
        raise ValueError(f"k should be at most {KEY_CHUNK}, but is {k}")
    work.places = places
    work.position, work.normal, work.coords = position, normal, coords
    work.n_fitted, work.max_residual = n_fitted, max_residual
    work.lattice_force = lattice_force
    work.slope, work.residual, work.noise = slope, residual, noise
    if not fits(work):
        raise ValueError("photons, slopes, residuals and noise do not fit the tree")
    search_points(work, first, end, n_threads)


cdef bint fits(RestDensity work):
    """Whether all arrays have a row for each of the photons of the tree."""
    cdef Py_ssize_t n = work.tree.n_points
    return (
        n == work.position.shape[0] == work.normal.shape[0] == work.coords.shape[0]
        and n == work.places.shape[0]
        and n == work.slope.shape[0] == work.residual.shape[0] == work.noise.shape[0]
        and work.position.shape[1] == work.normal.shape[1] == work.slope.shape[1] == 3
        and work.coords.shape[1] in (2, 3)
    )
