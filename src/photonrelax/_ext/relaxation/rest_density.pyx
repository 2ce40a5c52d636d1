"""Slope of the density that the map from emitter coordinates to positions prescribes."""

from cython cimport final
from libc.math cimport INFINITY, M_PI, asin, exp, fabs, isfinite, sqrt
from libc.stdint cimport int64_t

import numpy as np

from ..common.vec3 cimport dot, orthonormal_frame
from ..spatial.batch cimport Batch, gather_neighbours
from ..spatial.query_loop cimport BatchWork, search_points
from ..spatial.simd.kernels cimport KEY_CHUNK, LANES
from ..spatial.tree cimport Tree
from .structure cimport Components, decompose

cdef enum:
    # Terms of a quadratic map: 1, a, b, a²/2, ab, b²/2.
    TERMS = 6
    # Rings of a hexagonal lattice around its centre, and its points.
    RINGS = 7
    LATTICE = 1 + 3 * RINGS * (RINGS + 1)
    # Points of the lattice whose force is taken, and the rows that they are stored in.
    NEAREST = 32
    STRIDE = NEAREST + LANES

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
    """Points (LATTICE, 2) of a hexagonal lattice around its centre, one to a unit of area."""
    axial = np.mgrid[-RINGS : RINGS + 1, -RINGS : RINGS + 1].reshape(2, -1)
    i, j = axial[:, np.abs(axial.sum(axis=0)) <= RINGS]
    spacing = np.sqrt(2.0 / np.sqrt(3.0))
    return spacing * np.column_stack([i + 0.5 * j, np.sqrt(0.75) * j])


cdef double[:, ::1] hexagonal = np.ascontiguousarray(_hexagonal())


cdef struct Samples:
    # Offsets of a photon's neighbours, nearest first: over the emitter coordinates (a, b), in units
    # of the radius of those that are fitted, and in the tangent plane (u, v), in units of `scale`.
    Py_ssize_t n
    double[KEY_CHUNK] a
    double[KEY_CHUNK] b
    double[KEY_CHUNK] u
    double[KEY_CHUNK] v
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
        gather_neighbours(self.tree, batch)
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
            self.prescribe(batch, lane, self.tree.ids[first + lane])

    cdef void prescribe(self, Batch* batch, Py_ssize_t lane, Py_ssize_t row) noexcept nogil:
        """Write the slope at a photon, zero where no map fits, the residual, and the noise."""
        cdef Samples samples
        cdef QuadraticMap fit
        cdef Sheet sheet
        cdef double[6] frame
        cdef double[2] force
        cdef double radius, scale
        cdef Py_ssize_t axis
        self.residual[row] = self.noise[row] = INFINITY
        for axis in range(3):
            self.slope[row, axis] = 0.0
        orthonormal_frame(frame, frame + 3, &self.normal[row, 0])
        if batch.queries[lane].candidates.count < self.k:
            return
        if not self.sample(&samples, row, batch.id + lane * batch.stride, frame):
            return
        if not fit_map(&fit, &samples, self.n_fitted):
            return
        sheet = sheet_around(&samples)
        radius = lattice_force(self.tree, &fit, &sheet, force)
        if not (radius > 0.0 and isfinite(force[0]) and isfinite(force[1])):
            return
        self.residual[row] = fit.residual / radius
        if not sheet.lopsided:
            self.noise[row] = unevenness(&samples, self.n_fitted)
        if self.residual[row] <= self.max_residual:
            scale = -1.0 / (self.lattice_force * radius * radius)
            for axis in range(3):
                self.slope[row, axis] = (
                    scale * (force[0] * frame[axis] + force[1] * frame[3 + axis]) / samples.scale
                )

    cdef bint sample(
        self, Samples* samples, Py_ssize_t row, const int64_t* ids, const double* frame
    ) noexcept nogil:
        """Offsets of a photon's neighbours; false where they have no extent."""
        cdef double[6] chart
        cdef double[3] offset
        cdef double radius, farthest = 0.0
        cdef Py_ssize_t j, axis, n_axes = self.coords.shape[1]
        if not self.chart_at(row, chart):
            return False
        samples.n = self.k
        for j in range(self.k):
            for axis in range(3):
                offset[axis] = self.position[ids[j], axis] - self.position[row, axis]
            samples.u[j] = dot(frame, offset)
            samples.v[j] = dot(frame + 3, offset)
            for axis in range(n_axes):
                offset[axis] = self.coords[ids[j], axis] - self.coords[row, axis]
            if n_axes == 2:
                offset[2] = 0.0
            samples.a[j] = dot(chart, offset)
            samples.b[j] = dot(chart + 3, offset)
            farthest = max(farthest, max(fabs(samples.u[j]), fabs(samples.v[j])))
        j = self.n_fitted - 1
        radius = max(fabs(samples.a[j]), fabs(samples.b[j]))
        if not (radius > 0.0 and farthest > 0.0):
            return False
        # Dividing lengths, not squares, keeps very small and very large scenes in range.
        radius *= sqrt((samples.a[j] / radius) ** 2 + (samples.b[j] / radius) ** 2)
        samples.scale = farthest
        for j in range(self.k):
            samples.a[j] /= radius
            samples.b[j] /= radius
            samples.u[j] /= farthest
            samples.v[j] /= farthest
        return True

    cdef bint chart_at(self, Py_ssize_t row, double* chart) noexcept nogil:
        """Two axes over the emitter coordinates: those of a plane, or tangents of a sphere."""
        cdef double[3] direction
        cdef double length
        cdef Py_ssize_t axis
        if self.coords.shape[1] == 2:
            for axis in range(6):
                chart[axis] = axis == 0 or axis == 4
            return True
        length = sqrt(dot(&self.coords[row, 0], &self.coords[row, 0]))
        if not length > 0.0:
            return False
        for axis in range(3):
            direction[axis] = self.coords[row, axis] / length
        orthonormal_frame(chart, chart + 3, direction)
        return True


# --- the map -----------------------------------------------------------------------------------


cdef bint fit_map(QuadraticMap* fit, const Samples* samples, Py_ssize_t n) noexcept nogil:
    """Fit the map to the nearest n samples, by exp(−squared offset); false if none is unique."""
    cdef double[TERMS][TERMS] matrix
    cdef double[TERMS] terms
    cdef double weight
    cdef Py_ssize_t i, j, sample
    for i in range(TERMS):
        fit.u[i] = fit.v[i] = 0.0
        for j in range(TERMS):
            matrix[i][j] = 0.0
    for sample in range(n):
        weight = quadratic_terms(samples.a[sample], samples.b[sample], terms)
        for i in range(TERMS):
            fit.u[i] += weight * terms[i] * samples.u[sample]
            fit.v[i] += weight * terms[i] * samples.v[sample]
            for j in range(i + 1):
                matrix[i][j] += weight * terms[i] * terms[j]
    if not factorise(&matrix[0][0]):
        return False
    back_substitute(&matrix[0][0], fit.u)
    back_substitute(&matrix[0][0], fit.v)
    set_residual(fit, samples, n)
    return True


cdef double quadratic_terms(double a, double b, double* terms) noexcept nogil:
    """Write the terms of a quadratic map at an offset; return its weight."""
    terms[0] = 1.0
    terms[1] = a
    terms[2] = b
    terms[3] = 0.5 * a * a
    terms[4] = a * b
    terms[5] = 0.5 * b * b
    return exp(-(a * a + b * b))


cdef void set_residual(QuadraticMap* fit, const Samples* samples, Py_ssize_t n) noexcept nogil:
    cdef double[TERMS] terms
    cdef double weight, u, v, weights = 0.0, squares = 0.0
    cdef Py_ssize_t i, sample
    for sample in range(n):
        weight = quadratic_terms(samples.a[sample], samples.b[sample], terms)
        u = samples.u[sample]
        v = samples.v[sample]
        for i in range(TERMS):
            u -= fit.u[i] * terms[i]
            v -= fit.v[i] * terms[i]
        weights += weight
        squares += weight * (u * u + v * v)
    fit.residual = sqrt(squares / weights)


cdef bint factorise(double* matrix) noexcept nogil:
    """Cholesky factor of a symmetric matrix, in its lower triangle; false if it is singular."""
    cdef Py_ssize_t i, j, m
    cdef double pivot
    for j in range(TERMS):
        pivot = matrix[TERMS * j + j]
        for m in range(j):
            pivot -= matrix[TERMS * j + m] * matrix[TERMS * j + m]
        if not pivot > SINGULAR * matrix[TERMS * j + j]:
            return False
        matrix[TERMS * j + j] = sqrt(pivot)
        for i in range(j + 1, TERMS):
            for m in range(j):
                matrix[TERMS * i + j] -= matrix[TERMS * i + m] * matrix[TERMS * j + m]
            matrix[TERMS * i + j] /= matrix[TERMS * j + j]
    return True


cdef void back_substitute(const double* factor, double* x) noexcept nogil:
    """Solve for x, whose right side it holds, by a Cholesky factor."""
    cdef Py_ssize_t i, m
    for i in range(TERMS):
        for m in range(i):
            x[i] -= factor[TERMS * i + m] * x[m]
        x[i] /= factor[TERMS * i + i]
    for i in range(TERMS - 1, -1, -1):
        for m in range(i + 1, TERMS):
            x[i] -= factor[TERMS * m + i] * x[m]
        x[i] /= factor[TERMS * i + i]


# --- the sheet over the emitter coordinates ----------------------------------------------------


cdef Sheet sheet_around(const Samples* samples) noexcept nogil:
    """Area of a photon, and the edge of the sheet, from the offsets of all samples."""
    cdef Sheet sheet
    cdef Py_ssize_t j, last = samples.n - 1
    cdef double radius, shift, distance
    sheet.a = sheet.b = 0.0
    # The photon itself is the first, at offset zero.
    for j in range(1, samples.n):
        sheet.a += samples.a[j] / last
        sheet.b += samples.b[j] / last
    radius = sqrt(samples.a[last] * samples.a[last] + samples.b[last] * samples.b[last])
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
        extent = max(extent, -(a * samples.a[j] + b * samples.b[j]))
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


cdef double unevenness(const Samples* samples, Py_ssize_t n) noexcept nogil:
    """Force of the nearest n samples over the emitter coordinates, in units of their radius."""
    cdef double a = 0.0, b = 0.0, distance
    cdef Py_ssize_t j
    for j in range(n):
        distance = sqrt(samples.a[j] * samples.a[j] + samples.b[j] * samples.b[j])
        if distance > 0.0:
            a -= samples.a[j] * (1.0 / distance - 1.0)
            b -= samples.b[j] * (1.0 / distance - 1.0)
    return sqrt(a * a + b * b) / n


# --- the lattice -------------------------------------------------------------------------------


cdef double lattice_force(
    Tree tree, const QuadraticMap* fit, const Sheet* sheet, double* force
) noexcept nogil:
    """Write the force of the nearest lattice points; return their radius, zero if there is none.

    It is that of an even disc of the same mean squared distance. The distance of the farthest jumps
    between the shells of a lattice: along a slope, where a shell is no circle, it falls too soon.
    """
    cdef double[LATTICE] u, v, squared
    cdef double[3 * STRIDE] nearest
    cdef double[3] centre, mean
    cdef double limit, distance, total = 0.0
    cdef Py_ssize_t i, axis, n = 0
    cdef Py_ssize_t n_points = lay_lattice(fit, sheet, u, v)
    if n_points < NEAREST:
        return 0.0
    for i in range(n_points):
        squared[i] = u[i] * u[i] + v[i] * v[i]
    limit = nth_smallest(squared, n_points, NEAREST - 1)
    for axis in range(3):
        centre[axis] = 0.0
    for i in range(3 * STRIDE):
        nearest[i] = 0.0
    # Those at the radius exert no force, nor do places left at the centre.
    for i in range(n_points):
        distance = u[i] * u[i] + v[i] * v[i]
        if distance < limit:
            nearest[n] = u[i]
            nearest[STRIDE + n] = v[i]
            total += distance
            n += 1
    total += (NEAREST - n) * limit
    tree.simd.repulsion(nearest, NEAREST, limit, centre, mean)
    force[0] = mean[0]
    force[1] = mean[1]
    return sqrt(2.0 / NEAREST * total)


cdef Py_ssize_t lay_lattice(
    const QuadraticMap* fit, const Sheet* sheet, double* u, double* v
) noexcept nogil:
    """Offsets of lattice points that are on the sheet; their number."""
    cdef double[4] basis
    cdef double[TERMS] terms
    cdef double a, b
    cdef Py_ssize_t i, term, n = 0
    if not stretched_basis(fit, sheet.area, basis):
        return 0
    for i in range(LATTICE):
        a = basis[0] * hexagonal[i, 0] + basis[1] * hexagonal[i, 1]
        b = basis[2] * hexagonal[i, 0] + basis[3] * hexagonal[i, 1]
        if a * sheet.a + b * sheet.b < sheet.edge:
            continue
        u[n] = v[n] = 0.0
        quadratic_terms(a, b, terms)
        for term in range(1, TERMS):
            u[n] += fit.u[term] * terms[term]
            v[n] += fit.v[term] * terms[term]
        n += 1
    return n


cdef bint stretched_basis(const QuadraticMap* fit, double area, double* basis) noexcept nogil:
    """Matrix of a lattice over the emitter coordinates that the map makes isotropic.

    The metric has the second derivatives too, which are what is left of it on a fold; false if
    nothing is.
    """
    cdef double uu = metric(fit.u, fit.u + 3, area) + metric(fit.v, fit.v + 3, area)
    cdef double vv = metric(fit.u + 1, fit.u + 4, area) + metric(fit.v + 1, fit.v + 4, area)
    cdef double uv = mixed_metric(fit.u, area) + mixed_metric(fit.v, area)
    cdef Components axes = decompose(uu, uv, vv)
    cdef double aspect = MAX_ASPECT, narrow, wide
    if not axes.first > 0.0:
        return False
    if axes.first < MAX_ASPECT * MAX_ASPECT * axes.second:
        aspect = sqrt(axes.first / axes.second)
    narrow = sqrt(area / (LATTICE_DENSITY * aspect))
    wide = narrow * aspect
    basis[0] = narrow * axes.cosine
    basis[1] = -wide * axes.sine
    basis[2] = narrow * axes.sine
    basis[3] = wide * axes.cosine
    return True


cdef double metric(const double* first, const double* second, double area) noexcept nogil:
    """Squared change along an axis: first[1] is the first derivative, second[0:2] the second."""
    return first[1] * first[1] + area * (second[0] * second[0] + second[1] * second[1])


cdef double mixed_metric(const double* fit, double area) noexcept nogil:
    return fit[1] * fit[2] + area * (fit[3] * fit[4] + fit[4] * fit[5])


cdef double nth_smallest(double* values, Py_ssize_t n, Py_ssize_t nth) noexcept nogil:
    """The value of rank `nth`, from 0, of n values, which are reordered (Hoare's selection)."""
    cdef Py_ssize_t low = 0, high = n - 1, i, j
    cdef double pivot
    while low < high:
        pivot = values[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if nth <= j:
            high = j
        elif nth >= i:
            low = i
        else:
            break
    return values[nth]


def prescribe(
    Tree tree, Py_ssize_t first, Py_ssize_t end, *, position, normal, coords, Py_ssize_t k,
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
        Of the photons, by id.
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
        and n == work.slope.shape[0] == work.residual.shape[0] == work.noise.shape[0]
        and work.position.shape[1] == work.normal.shape[1] == work.slope.shape[1] == 3
        and work.coords.shape[1] in (2, 3)
    )
