"""Constraints from photon neighbourhoods: from principal components (SJ13 §4.3) or gradients."""

from cython.parallel cimport prange, threadid
from libc.math cimport INFINITY, M_PI, erf, fabs, sqrt

import numpy as np

from ..common.vec3 cimport orthonormal_frame
from ..spatial.batch cimport Batch, Query, allocate_batches, limit_radius, limit_range, open_block
from ..spatial.tree cimport Tree
from ..spatial.simd.kernels cimport BLOCK, prefetch_row
from ..spatial.knn cimport query_batch

# Below this many photons in range a neighbourhood says nothing about structure.
cdef enum:
    MIN_NEIGHBOURS = 4


cdef double MARGIN = 1.6
# The squares of squares of numbers in between are normal.
cdef double SMALLEST = 1e-75
cdef double LARGEST = 1e75


cpdef double anisotropy_to_gradient(double eigenvalue) noexcept nogil:
    """Return M of SJ13 Eq. 2, the pressure in the gradient direction, for a λ₂.

    λ₂ is clamped to [1/4 − 16/(9π²), 1/4]: from a neighbourhood cut in half by an edge, where
    M = 4/(3π), to an isotropic one, where M = 0.
    """
    cdef double lowest = 0.25 - 16.0 / (9.0 * M_PI * M_PI)
    return sqrt(0.25 - min(max(eigenvalue, lowest), 0.25))


cpdef double isotropic_mean(double k) noexcept nogil:
    """Return the mean µ_N of λ₂ for k independent, uniform photons in a disc.

    The paper prints 0.25 − 0.2809/√k (SJ13 Eq. 5), fitted at k = 100 alone. This is the exact
    expansion: 1/(4k) for centring on the mean, and the mean splitting of two equal eigenvalues.
    """
    return 0.25 - 0.25 / k - sqrt(M_PI / 48.0) / sqrt(k)


cpdef double isotropic_sd(double k) noexcept nogil:
    """Return the standard deviation σ_N of λ₂ for k independent, uniform photons in a disc.

    The paper prints 0.188/√k (SJ13 Eq. 4), fitted at k = 100 alone.
    """
    return 0.1968 / sqrt(k) - 0.087 / k


cpdef double noise_attenuation(double eigenvalue, double k) noexcept nogil:
    """Return Φ of SJ13 Eq. 6: the chance that k isotropic photons have a greater λ₂."""
    return attenuation(eigenvalue, isotropic_mean(k), isotropic_scale(k))


cpdef double constraint(double eigenvalue, double k) noexcept nogil:
    """Return 3π/4 · M(λ₂) · Φ(λ₂) in [0, 1]: one minus the length of v_b in SJ13 Eq. 7."""
    return constraint_among(eigenvalue, isotropic_mean(k), isotropic_scale(k))


cdef double isotropic_scale(double k) noexcept nogil:
    return 1.0 / (sqrt(2.0) * isotropic_sd(k))


cdef inline double attenuation(double eigenvalue, double mean, double scale) noexcept nogil:
    return 0.5 * (1.0 - erf((eigenvalue - mean) * scale))


cdef inline double constraint_among(double eigenvalue, double mean, double scale) noexcept nogil:
    cdef double full = 0.75 * M_PI * anisotropy_to_gradient(eigenvalue)
    return min(full * attenuation(eigenvalue, mean, scale), 1.0)


cpdef double gradient_constraint(double shift, double gain) noexcept nogil:
    """Return min(1, gain · 3π/4 · shift), for the length of a mean offset over the radius."""
    return min(gain * 0.75 * M_PI * shift, 1.0)


cdef class StructureInputs:
    """What is read of inputs.

    Parameters
    ----------
    rows : (m,) intp array
        Row of the photon at each place in the tree.
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


cdef class Targets:
    """Views of the arrays that will make a `photonrelax.Structure`, and how they are made.

    Photons are constrained along the gradient, times `gain`; if that is negative, as their
    principal components tell.
    """

    cdef double gain
    # By the number of photons, the isotropic mean of λ₂ and what deviations from it are scaled by.
    cdef double[:, ::1] isotropic
    cdef double[:, ::1] eigenvalues
    cdef double[::1] constraint
    cdef double[:, :, ::1] basis
    cdef double[::1] radius
    cdef int[::1] n_found

    def __init__(
        self, Py_ssize_t most_found, double gain, *, eigenvalues, constraint, basis, radius, n_found
    ):
        cdef Py_ssize_t count
        self.gain = gain
        self.isotropic = np.empty((most_found + 1, 2))
        for count in range(MIN_NEIGHBOURS, most_found + 1):
            self.isotropic[count, 0] = isotropic_mean(count)
            self.isotropic[count, 1] = isotropic_scale(count)
        self.eigenvalues = eigenvalues
        self.constraint = constraint
        self.basis = basis
        self.radius = radius
        self.n_found = n_found


cdef Components decompose(double uu, double uv, double vv) noexcept nogil:
    """Decompose the matrix ((uu, uv), (uv, vv))."""
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
    """Decompose the covariance (divisor `count`, about the mean) of planar offsets (count, 2)."""
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
    """Return eigenvalues (n, 2), larger first, and first eigenvectors (n, 2) of n planar sets."""
    cdef Py_ssize_t n = offsets.shape[0]
    eigenvalues = np.empty((n, 2))
    vectors = np.empty((n, 2))
    cdef double[:, ::1] eigenvalues_view = eigenvalues
    cdef double[:, ::1] vectors_view = vectors
    cdef Py_ssize_t i
    for i in prange(n, nogil=True, schedule="static", num_threads=n_threads):
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


def detect(
    Tree tree, Py_ssize_t first, Py_ssize_t end, StructureInputs inputs, targets_by_name, *,
    Py_ssize_t k, double gain=-1.0, int n_threads
):
    """Fill the rows of the photons at places first … end, whole blocks, of the tree.

    Photons are constrained along the gradient, times `gain`; if that is negative, as their
    principal components tell.
    """
    cdef Targets targets = Targets(min(k, tree.n_points), gain, **targets_by_name)
    cdef unsigned char[:, ::1] batches = allocate_batches(tree, k, n_threads)
    cdef Py_ssize_t block
    for block in prange(
        first // BLOCK, (end + BLOCK - 1) // BLOCK, nogil=True, schedule="dynamic", chunksize=16,
        num_threads=n_threads
    ):
        detect_block(tree, <Batch*> &batches[threadid(), 0], block, inputs, targets)


cdef void detect_block(
    Tree tree, Batch* batch, Py_ssize_t block, StructureInputs inputs, Targets out
) noexcept nogil:
    """Detect the structure around the photons of a block; write their rows only.

    How much of its reach a photon has to look at, all of it where too few are in range, is much
    the same next to it, if not where a inputs ends; hence the margin.
    """
    cdef Py_ssize_t lane, row
    cdef Query* query
    cdef double squared_reach, share = 0.0
    open_block(tree, batch, block)
    prefetch_limits(tree, block + 1, inputs)
    for lane in range(batch.n_queries):
        query = &batch.queries[lane]
        row = inputs.rows[BLOCK * block + lane]
        prefetch(out, row)
        prefetch_row(&inputs.normal[row, 0], 3 * sizeof(double))
        if inputs.range_radius is not None:
            limit_range(query, inputs.range_radius[row])
        if inputs.reach is not None:
            squared_reach = inputs.reach[row] * inputs.reach[row]
            limit_radius(query, squared_reach)
            if squared_reach < INFINITY:
                query.squared_guess = MARGIN * batch.share * squared_reach
    query_batch(tree, batch)
    for lane in range(batch.n_queries):
        row = inputs.rows[BLOCK * block + lane]
        detect_one(tree, &batch.queries[lane], row, &inputs.normal[row, 0], out)
        if inputs.reach is not None and inputs.reach[row] > 0.0:
            squared_reach = inputs.reach[row] * inputs.reach[row]
            if batch.queries[lane].candidates.count < batch.k:
                share += 1.0
            else:
                share += batch.queries[lane].candidates.squared_radius / squared_reach
    batch.share = share / batch.n_queries


cdef inline void prefetch_limits(
    Tree tree, Py_ssize_t block, StructureInputs inputs
) noexcept nogil:
    """Have the limits that the next block reads brought into the cache."""
    cdef Py_ssize_t place
    for place in range(BLOCK * block, min(BLOCK * block + BLOCK, tree.n_points)):
        if inputs.range_radius is not None:
            prefetch_row(&inputs.range_radius[inputs.rows[place]], sizeof(double))
        if inputs.reach is not None:
            prefetch_row(&inputs.reach[inputs.rows[place]], sizeof(double))


cdef inline void prefetch(Targets out, Py_ssize_t row) noexcept nogil:
    """Have the rows that will be written brought into the cache: they are all over the map."""
    prefetch_row(&out.eigenvalues[row, 0], 2 * sizeof(double))
    prefetch_row(&out.constraint[row], sizeof(double))
    prefetch_row(&out.basis[row, 0, 0], 6 * sizeof(double))
    prefetch_row(&out.radius[row], sizeof(double))
    prefetch_row(&out.n_found[row], sizeof(int))


cdef void detect_one(
    Tree tree, const Query* query, Py_ssize_t row, const double* normal, Targets out
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
        tree.simd.moments(
            &tree.coords[0, 0, 0], tree.n_axes, &query.candidates, query.bounds.low, scaled, moments
        )
        pca = decompose(moments[0], moments[1], moments[2])
        if out.gain < 0.0:
            strength = constraint_among(
                pca.second, out.isotropic[count, 0], out.isotropic[count, 1]
            )
        else:
            strength = gradient_constraint(turn(&pca, moments[3], moments[4]), out.gain)
    out.n_found[row] = <int> count
    out.radius[row] = radius
    out.constraint[row] = strength
    out.eigenvalues[row, 0] = pca.first
    out.eigenvalues[row, 1] = pca.second
    for axis in range(3):
        out.basis[row, 0, axis] = pca.cosine * frame[axis] + pca.sine * frame[3 + axis]
        out.basis[row, 1, axis] = pca.cosine * frame[3 + axis] - pca.sine * frame[axis]


cdef double turn(Components* pca, double u, double v) noexcept nogil:
    """Turn the first direction to the right of (u, v), if it has a length; return that."""
    cdef double length = sqrt(u * u + v * v)
    if length > 0.0:
        pca.cosine = v / length
        pca.sine = -u / length
    return length
