"""Kernel estimates of densities on surfaces from the k nearest photons."""

from cython.parallel cimport prange, threadid
from libc.math cimport M_PI, sqrt

from .kdtree cimport Candidate, Limits, Tree, lift_limits

cpdef enum:
    CONSTANT = 0
    CONE = 1
    EPANECHNIKOV = 2


cdef class Gather:
    """Photons to gather from and how.

    Parameters
    ----------
    tree : Tree
    values : (n, c) float64 array
        What is summed, in the tree's leaf order.
    k : int
    kernel : int
        CONSTANT, CONE or EPANECHNIKOV.
    radius : float
        Photons farther away are not gathered; may be infinite.
    normal_range : float
        Radius of the ball over the tree's range axes; negative for none.
    nearest_scale : float
        What estimates are multiplied by whose bandwidth is the distance to the k-th photon.
    """

    cdef Tree tree
    cdef const double[:, ::1] values
    cdef readonly Py_ssize_t k
    cdef readonly int kernel
    cdef double nearest_scale
    cdef Limits limits

    def __init__(self, tree, values, k, kernel, *, radius, normal_range, nearest_scale):
        self.tree = tree
        self.values = values
        self.k = k
        self.kernel = kernel
        self.nearest_scale = nearest_scale
        lift_limits(&self.limits)
        self.limits.squared_radius = radius * radius
        if normal_range >= 0.0:
            self.limits.squared_range = normal_range * normal_range

    def densities(
        self, const double[:, ::1] queries, Py_ssize_t first, Py_ssize_t end,
        double[:, ::1] out, int n_threads
    ):
        """Write the values per area around queries first … end to their rows of `out` (m, c)."""
        cdef unsigned char[:, ::1] found = self.tree.scratch(self.k, n_threads)
        cdef Py_ssize_t i
        for i in prange(
            first, end, nogil=True, schedule="dynamic", chunksize=256, num_threads=n_threads
        ):
            gather_one(self, i, queries, <Candidate*> &found[threadid(), 0], out)


cdef void gather_one(
    Gather photons, Py_ssize_t i, const double[:, ::1] queries, Candidate* found,
    double[:, ::1] out
) noexcept nogil:
    """Estimate the density at one query; write its row only.

    With k photons in reach the bandwidth is the distance to the k-th, whose own weight is zero;
    that makes the estimate unbiased for independent photons, as the mean of 1/r² is π ρ/(k − 1).
    With fewer, or all of them at the query itself, the bandwidth is the gather radius and all
    count.
    """
    cdef Py_ssize_t count = photons.tree.search(
        &queries[i, 0], &photons.limits, found, photons.k
    )
    cdef double squared_bandwidth = photons.limits.squared_radius
    cdef double scale = 1.0
    cdef double weight
    cdef Py_ssize_t j, channel
    for channel in range(out.shape[1]):
        out[i, channel] = 0.0
    if count == photons.k and found[count - 1].squared > 0.0:
        count -= 1
        squared_bandwidth = found[count].squared
        scale = photons.nearest_scale
    for j in range(count):
        weight = scale * kernel_weight(photons.kernel, found[j].squared / squared_bandwidth)
        for channel in range(out.shape[1]):
            out[i, channel] += weight * photons.values[found[j].place, channel]
    for channel in range(out.shape[1]):
        out[i, channel] /= M_PI * squared_bandwidth


cdef inline double kernel_weight(int kernel, double squared_ratio) noexcept nogil:
    """Return π h² times the kernel at (distance / bandwidth h)²; it integrates to one."""
    if kernel == EPANECHNIKOV:
        return 2.0 * (1.0 - squared_ratio)
    if kernel == CONE:
        return 3.0 * (1.0 - sqrt(squared_ratio))
    return 1.0
