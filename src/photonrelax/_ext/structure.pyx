"""Principal components of photon neighbourhoods and the constraints they imply (SJ13 §4.3)."""

from cython.parallel cimport prange, threadid
from libc.math cimport M_PI, atan2, cos, erf, hypot, sin, sqrt

import numpy as np

from .core cimport dot, orthonormal_frame
from .kdtree cimport Candidate, Limits, Tree, lift_limits

# Below this many photons in range a neighbourhood says nothing about structure.
cdef enum:
    FEWEST = 4


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
    cdef double deviation = (eigenvalue - isotropic_mean(k)) / (sqrt(2.0) * isotropic_sd(k))
    return 0.5 * (1.0 - erf(deviation))


cpdef double constraint(double eigenvalue, double k) noexcept nogil:
    """Return 3π/4 · M(λ₂) · Φ(λ₂) in [0, 1]: one minus the length of v_b in SJ13 Eq. 7."""
    cdef double full = 0.75 * M_PI * anisotropy_to_gradient(eigenvalue)
    return min(full * noise_attenuation(eigenvalue, k), 1.0)


cdef struct Components:
    # Eigenvalues, larger first, and the first eigenvector.
    double first
    double second
    double cosine
    double sine


cdef class Targets:
    """Views of the arrays that will make a `photonrelax.Structure`."""

    cdef double[:, ::1] eigenvalues
    cdef double[::1] constraint
    cdef double[:, :, ::1] basis
    cdef double[::1] radius
    cdef int[::1] n_found

    def __init__(self, *, eigenvalues, constraint, basis, radius, n_found):
        self.eigenvalues = eigenvalues
        self.constraint = constraint
        self.basis = basis
        self.radius = radius
        self.n_found = n_found


cdef Components decompose(const double* offsets, Py_ssize_t count) noexcept nogil:
    """Decompose the covariance (divisor `count`, about the mean) of planar offsets (count, 2)."""
    cdef Components pca
    cdef double mean_u = 0.0, mean_v = 0.0, uu = 0.0, uv = 0.0, vv = 0.0
    cdef double u, v, middle, spread, angle
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
    middle = 0.5 * (uu + vv) / count
    spread = hypot(0.5 * (uu - vv), uv) / count
    angle = 0.5 * atan2(uv, 0.5 * (uu - vv))
    pca.first = middle + spread
    # Rounding may leave photons on a line a variance just below zero across it.
    pca.second = max(middle - spread, 0.0)
    pca.cosine = cos(angle)
    pca.sine = sin(angle)
    return pca


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
    cdef Components pca = decompose(&offsets[i, 0, 0], offsets.shape[1])
    eigenvalues[i, 0] = pca.first
    eigenvalues[i, 1] = pca.second
    vectors[i, 0] = pca.cosine
    vectors[i, 1] = pca.sine


def detect(
    Tree tree, Py_ssize_t first, Py_ssize_t end, const double[:, ::1] normal, targets_by_name, *,
    const double[::1] range_radius, const double[::1] reach, Py_ssize_t k, int n_threads
):
    """Fill the rows of the photons at places first … end of the tree; see `detect_structure`.

    `range_radius` and `reach` limit the search over the range axes and in space; None for none.
    """
    cdef Targets targets = Targets(**targets_by_name)
    cdef unsigned char[:, ::1] found = tree.scratch(k, n_threads)
    cdef double[:, ::1] offsets = np.empty((n_threads, 2 * min(k, tree.n_points)))
    cdef Py_ssize_t place
    for place in prange(
        first, end, nogil=True, schedule="dynamic", chunksize=256, num_threads=n_threads
    ):
        detect_one(
            tree, place, normal, range_radius, reach, k, <Candidate*> &found[threadid(), 0],
            &offsets[threadid(), 0], targets
        )


cdef void detect_one(
    Tree tree, Py_ssize_t place, const double[:, ::1] normal, const double[::1] range_radius,
    const double[::1] reach, Py_ssize_t k, Candidate* found, double* offsets, Targets out
) noexcept nogil:
    """Detect the structure around one photon; write its row only."""
    cdef Py_ssize_t row = tree.ids[place]
    cdef Py_ssize_t axis, count
    cdef Limits limits
    cdef Components pca
    cdef double[3] u
    cdef double[3] v
    cdef double scale
    lift_limits(&limits)
    if range_radius is not None:
        limits.squared_range = range_radius[row] * range_radius[row]
    if reach is not None:
        limits.squared_radius = reach[row] * reach[row]
    count = tree.search(&tree.points[place, 0], &limits, found, k)
    orthonormal_frame(u, v, &normal[row, 0])
    pca.cosine = 1.0
    pca.sine = 0.0
    out.n_found[row] = <int> count
    out.radius[row] = sqrt(found[count - 1].squared)
    out.eigenvalues[row, 0] = 0.0
    out.eigenvalues[row, 1] = 0.0
    out.constraint[row] = 0.0
    if count >= FEWEST and out.radius[row] > 0.0:
        project(tree, place, found, count, u, v, offsets)
        # Dividing lengths, not squares, keeps very small and very large scenes in range.
        scale = 1.0 / out.radius[row]
        for axis in range(2 * count):
            offsets[axis] *= scale
        pca = decompose(offsets, count)
        out.eigenvalues[row, 0] = pca.first
        out.eigenvalues[row, 1] = pca.second
        out.constraint[row] = constraint(pca.second, count)
    for axis in range(3):
        out.basis[row, 0, axis] = pca.cosine * u[axis] + pca.sine * v[axis]
        out.basis[row, 1, axis] = pca.cosine * v[axis] - pca.sine * u[axis]


cdef void project(
    Tree tree, Py_ssize_t place, const Candidate* found, Py_ssize_t count, const double* u,
    const double* v, double* offsets
) noexcept nogil:
    """Write the neighbours' offsets from the photon in its tangent plane, (count, 2)."""
    cdef double[3] offset
    cdef Py_ssize_t j, axis
    for j in range(count):
        for axis in range(3):
            offset[axis] = tree.points[found[j].place, axis] - tree.points[place, axis]
        offsets[2 * j] = dot(offset, u)
        offsets[2 * j + 1] = dot(offset, v)
