"""Structure around photons: principal components and constraints (SJ13 §4.3), or gradients."""

from cython cimport final
from cython.parallel cimport prange
from libc.math cimport INFINITY, M_PI, erf, fabs, sqrt

import numpy as np

from ..common.prefetch cimport prefetch_row
from ..common.threads cimport ELEMENTS, team_size
from ..common.vec3 cimport orthonormal_frame
from ..spatial.batch cimport Batch, Query, gather_neighbours, limit_radius, limit_range
from ..spatial.query_loop cimport BatchWork, search_points
from ..spatial.simd.kernels cimport BLOCK, Candidates
from ..spatial.tree cimport Tree

cdef enum:
    # Least number of photons whose neighbourhood has a structure.
    MIN_NEIGHBOURS = 4
    # Rings in which neighbours are counted.
    RINGS = 32


# Factor of the search radius that the last block suggests; it differs where a sheet ends.
cdef double MARGIN = 1.6
# The squares of squares of numbers in between are normal.
cdef double SMALLEST = 1e-75
cdef double LARGEST = 1e75


cpdef double anisotropy_to_gradient(double eigenvalue) noexcept nogil:
    """Pressure M in the gradient direction from an eigenvalue λ₂ (SJ13 Eq. 2).

    λ₂ is clamped to [1/4 − 16/(9π²), 1/4]: from a neighbourhood cut in half by an edge, where
    M = 4/(3π), to an isotropic one, where M = 0.
    """
    cdef double lowest = 0.25 - 16.0 / (9.0 * M_PI * M_PI)
    return sqrt(0.25 - min(max(eigenvalue, lowest), 0.25))


cpdef double isotropic_mean(double k) noexcept nogil:
    """Mean µ_N of λ₂ for k independent, uniform photons in a disc (SJ13 Eq. 5).

    The paper prints 0.25 − 0.2809/√k, fitted at k = 100 alone. This is the exact expansion:
    1/(4k) for centring on the mean, and the mean splitting of two equal eigenvalues.
    """
    return 0.25 - 0.25 / k - sqrt(M_PI / 48.0) / sqrt(k)


cpdef double isotropic_sd(double k) noexcept nogil:
    """Standard deviation σ_N of λ₂ for k independent, uniform photons in a disc (SJ13 Eq. 4).

    The paper prints 0.188/√k, fitted at k = 100 alone.
    """
    return 0.1968 / sqrt(k) - 0.087 / k


cpdef double noise_attenuation(double eigenvalue, double k) noexcept nogil:
    """Probability Φ that k isotropic photons have a greater λ₂ (SJ13 Eq. 6)."""
    return attenuation(eigenvalue, isotropic_mean(k), isotropic_scale(k))


cpdef double constraint(double eigenvalue, double k) noexcept nogil:
    """Constraint 3π/4 · M(λ₂) · Φ(λ₂) in [0, 1], one minus the length of v_b (SJ13 Eq. 7)."""
    return constraint_among(eigenvalue, isotropic_mean(k), isotropic_scale(k))


cdef double isotropic_scale(double k) noexcept nogil:
    return 1.0 / (sqrt(2.0) * isotropic_sd(k))


cdef inline double attenuation(double eigenvalue, double mean, double scale) noexcept nogil:
    return 0.5 * (1.0 - erf((eigenvalue - mean) * scale))


cdef inline double constraint_among(double eigenvalue, double mean, double scale) noexcept nogil:
    cdef double full = 0.75 * M_PI * anisotropy_to_gradient(eigenvalue)
    return min(full * attenuation(eigenvalue, mean, scale), 1.0)


cpdef double gradient_constraint(double shift, double gain) noexcept nogil:
    """Constraint min(1, gain · 3π/4 · shift), for the length of a mean offset over the radius."""
    return min(gain * 0.75 * M_PI * shift, 1.0)


cdef class StructureInputs:
    """The photons of a tree, and the limits of their neighbourhoods.

    Parameters
    ----------
    rows : (m,) intp array
        Rows of the photons, in tree order.
    normal : (n, 3) float64 array
        Unit normals.
    range_radius, reach : (n,) float64 arrays or None
        Limits over the range axes and in space; None for none.
    """

    cdef const Py_ssize_t[::1] rows
    cdef const double[:, ::1] normal
    cdef const double[:] range_radius
    cdef const double[::1] reach

    def __init__(self, *, rows, normal, range_radius, reach):
        self.rows = rows
        self.normal = normal
        self.range_radius = range_radius
        self.reach = reach


@final
cdef class Detection(BatchWork):
    """Detection of the structure around a tree's photons, into the columns of a `Structure`."""

    cdef StructureInputs inputs
    # Factor of constraints along the gradient; negative for those of principal components.
    cdef double gain
    # Mean of λ₂ of isotropic photons, and scale of deviations from it, by their number.
    cdef double[:, ::1] isotropic
    cdef double[:, ::1] eigenvalues
    cdef double[::1] constraint
    cdef double[:, :, ::1] basis
    cdef double[::1] radius
    cdef int[::1] n_found
    # Bounds of distances to the nearest so many; None for none.
    cdef double[::1] inner
    cdef Py_ssize_t k_inner

    cdef void limit(self, Batch* batch, Query* query, Py_ssize_t place) noexcept nogil:
        """Limit the neighbourhood of the photon at a tree position.

        The share of its reach that a photon searches, all of it where too few are in range, is
        much the same as in the last block.
        """
        cdef Py_ssize_t row = self.inputs.rows[place]
        cdef double squared_reach
        self.prefetch(row, place + BLOCK)
        if self.inputs.range_radius is not None:
            limit_range(query, self.inputs.range_radius[row])
        if self.inputs.reach is not None:
            squared_reach = self.inputs.reach[row] * self.inputs.reach[row]
            limit_radius(query, squared_reach)
            if squared_reach < INFINITY:
                query.squared_guess = MARGIN * batch.share * squared_reach

    cdef void prefetch(self, Py_ssize_t row, Py_ssize_t next_place) noexcept nogil:
        """Prefetch a row that will be written, and the limits at a position of the next block."""
        prefetch_row(&self.inputs.normal[row, 0], 3 * sizeof(double))
        prefetch_row(&self.eigenvalues[row, 0], 2 * sizeof(double))
        prefetch_row(&self.constraint[row], sizeof(double))
        prefetch_row(&self.basis[row, 0, 0], 6 * sizeof(double))
        prefetch_row(&self.radius[row], sizeof(double))
        prefetch_row(&self.n_found[row], sizeof(int))
        if next_place < self.tree.n_points:
            row = self.inputs.rows[next_place]
            if self.inputs.range_radius is not None:
                prefetch_row(&self.inputs.range_radius[row], sizeof(double))
            if self.inputs.reach is not None:
                prefetch_row(&self.inputs.reach[row], sizeof(double))

    cdef void finish(self, Batch* batch, Py_ssize_t first, int thread) noexcept nogil:
        """Detect the structure around the photons of a block; write their rows only."""
        cdef Py_ssize_t lane, row
        cdef double squared_reach, share = 0.0
        if self.inner is not None:
            gather_neighbours(self.tree, batch)
        for lane in range(batch.n_queries):
            row = self.inputs.rows[first + lane]
            if self.inner is not None:
                self.inner[row] = bound_of_nearest(
                    &batch.queries[lane].candidates, batch.squared + lane * batch.stride,
                    self.k_inner
                )
            self.detect_one(&batch.queries[lane], row, &self.inputs.normal[row, 0])
            if self.inputs.reach is not None and self.inputs.reach[row] > 0.0:
                squared_reach = self.inputs.reach[row] * self.inputs.reach[row]
                if batch.queries[lane].candidates.count < batch.k:
                    share += 1.0
                else:
                    share += batch.queries[lane].candidates.squared_radius / squared_reach
        batch.share = share / batch.n_queries

    cdef void detect_one(
        self, const Query* query, Py_ssize_t row, const double* normal
    ) noexcept nogil:
        """Detect the structure around one photon from its neighbours; write its row only."""
        cdef Py_ssize_t axis, count = query.candidates.count
        cdef Components pca
        cdef double inverse, strength = 0.0, radius = sqrt(query.candidates.squared_radius)
        cdef double[6] frame, scaled
        cdef double[5] moments
        orthonormal_frame(frame, frame + 3, normal)
        pca.first = pca.second = pca.sine = 0.0
        pca.cosine = 1.0
        if count >= MIN_NEIGHBOURS and radius > 0.0:
            # Dividing lengths, not squares, keeps very small and very large scenes in range.
            inverse = 1.0 / radius
            for axis in range(6):
                scaled[axis] = inverse * frame[axis]
            self.tree.simd.moments(
                &self.tree.coords[0, 0, 0], self.tree.n_axes, &query.candidates,
                query.bounds.low, scaled, moments
            )
            pca = decompose(moments[0], moments[1], moments[2])
            if self.gain < 0.0:
                strength = constraint_among(
                    pca.second, self.isotropic[count, 0], self.isotropic[count, 1]
                )
            else:
                strength = gradient_constraint(align(&pca, moments[3], moments[4]), self.gain)
        self.n_found[row] = <int> count
        self.radius[row] = radius
        self.constraint[row] = strength
        self.eigenvalues[row, 0] = pca.first
        self.eigenvalues[row, 1] = pca.second
        for axis in range(3):
            self.basis[row, 0, axis] = pca.cosine * frame[axis] + pca.sine * frame[3 + axis]
            self.basis[row, 1, axis] = pca.cosine * frame[3 + axis] - pca.sine * frame[axis]


cdef double bound_of_nearest(
    const Candidates* candidates, const double* squared, Py_ssize_t k
) noexcept nogil:
    """Bound of the distance to the k-th nearest of some neighbours: of the ring that it is in.

    Of no more than k it is the distance to the farthest.
    """
    cdef int[RINGS] counts
    cdef Py_ssize_t i, n = 0, number = 0
    cdef double scale
    if candidates.count <= k or candidates.squared_radius <= 0.0:
        return sqrt(candidates.squared_radius)
    scale = RINGS / candidates.squared_radius
    for i in range(RINGS):
        counts[i] = 0
    for i in range(candidates.count):
        counts[min(<int> (scale * squared[i]), RINGS - 1)] += 1
    while n < k:
        n += counts[number]
        number += 1
    return sqrt(number / scale)


cdef double align(Components* pca, double u, double v) noexcept nogil:
    """Turn the second direction along (u, v), if it has a length; return that."""
    cdef double length = sqrt(u * u + v * v)
    if length > 0.0:
        pca.cosine = v / length
        pca.sine = -u / length
    return length


def detect(
    Tree tree, Py_ssize_t first, Py_ssize_t end, StructureInputs inputs, columns, *,
    Py_ssize_t k, double gain=-1.0, Py_ssize_t k_inner=0, int n_threads
):
    """Fill the rows of the photons at tree positions first … end, whole blocks.

    Parameters
    ----------
    tree : Tree
    first, end : int
    inputs : StructureInputs
    columns : dict
        Those of a `photonrelax.Structure`: eigenvalues, constraint, basis, radius and n_found; and
        `inner`, if it is there, a bound of the distance to the nearest `k_inner` photons.
    k : int
        Photons in a neighbourhood, at most.
    gain : float
        Factor of constraints along the gradient; negative for those of principal components.
    """
    cdef Detection work = Detection(tree, k=k, radius=INFINITY, range_radius=-1.0)
    work.inputs = inputs
    work.gain = gain
    work.isotropic = isotropic_statistics(min(k, tree.n_points))
    work.eigenvalues = columns["eigenvalues"]
    work.constraint = columns["constraint"]
    work.basis = columns["basis"]
    work.radius = columns["radius"]
    work.n_found = columns["n_found"]
    work.inner = columns.get("inner")
    work.k_inner = k_inner
    search_points(work, first, end, n_threads)


cdef double[:, ::1] isotropic_statistics(Py_ssize_t k):
    """Mean and scale of λ₂ of isotropic photons (k + 1, 2), by their number."""
    cdef double[:, ::1] statistics = np.empty((k + 1, 2))
    cdef Py_ssize_t count
    for count in range(MIN_NEIGHBOURS, k + 1):
        statistics[count, 0] = isotropic_mean(count)
        statistics[count, 1] = isotropic_scale(count)
    return statistics


# --- principal components ----------------------------------------------------------------------


cdef Components decompose(double uu, double uv, double vv) noexcept nogil:
    """Eigenvalues and first eigenvector of the matrix ((uu, uv), (uv, vv))."""
    cdef Components pca
    cdef double middle = 0.5 * (uu + vv)
    cdef double difference = 0.5 * (uu - vv)
    cdef double size = max(fabs(difference), fabs(uv))
    cdef double spread, length
    pca.first = pca.second = middle
    pca.cosine = 1.0
    pca.sine = 0.0
    if size == 0.0:
        return pca
    if SMALLEST <= size <= LARGEST:
        size = 1.0
    else:
        # Divided by their size the squares stay in range.
        difference /= size
        uv /= size
    spread = sqrt(difference * difference + uv * uv)
    # The half of the angle whose cosine is difference / spread, without cancellation.
    if difference >= 0.0:
        pca.cosine = spread + difference
        pca.sine = uv
    else:
        pca.cosine = fabs(uv)
        pca.sine = spread - difference if uv >= 0.0 else difference - spread
    length = 1.0 / sqrt(pca.cosine * pca.cosine + pca.sine * pca.sine)
    pca.cosine *= length
    pca.sine *= length
    pca.first = middle + spread * size
    # Rounding may leave photons on a line a variance just below zero across it.
    pca.second = max(middle - spread * size, 0.0)
    return pca


cdef Components decompose_offsets(const double* offsets, Py_ssize_t count) noexcept nogil:
    """Decompose the covariance about the mean, of divisor `count`, of planar offsets (count, 2)."""
    cdef double mean_u = 0.0, mean_v = 0.0, uu = 0.0, uv = 0.0, vv = 0.0
    cdef double u, v
    cdef Py_ssize_t j
    for j in range(count):
        mean_u += offsets[2 * j]
        mean_v += offsets[2 * j + 1]
    mean_u /= count
    mean_v /= count
    for j in range(count):
        u = offsets[2 * j] - mean_u
        v = offsets[2 * j + 1] - mean_v
        uu += u * u
        uv += u * v
        vv += v * v
    return decompose(uu / count, uv / count, vv / count)


def principal_components(const double[:, :, ::1] offsets, int n_threads):
    """Eigenvalues (n, 2), larger first, and first eigenvectors (n, 2) of n planar sets."""
    cdef Py_ssize_t n = offsets.shape[0]
    eigenvalues = np.empty((n, 2))
    vectors = np.empty((n, 2))
    cdef double[:, ::1] eigenvalues_view = eigenvalues
    cdef double[:, ::1] vectors_view = vectors
    cdef Py_ssize_t i
    for i in prange(
        n, nogil=True, schedule="static", num_threads=team_size(n_threads, n, ELEMENTS)
    ):
        write_components(i, offsets, eigenvalues_view, vectors_view)
    return eigenvalues, vectors


cdef void write_components(
    Py_ssize_t i, const double[:, :, ::1] offsets, double[:, ::1] eigenvalues,
    double[:, ::1] vectors
) noexcept nogil:
    """Decompose set i; write row i only."""
    cdef Components pca = decompose_offsets(&offsets[i, 0, 0], offsets.shape[1])
    eigenvalues[i, 0] = pca.first
    eigenvalues[i, 1] = pca.second
    vectors[i, 0] = pca.cosine
    vectors[i, 1] = pca.sine
