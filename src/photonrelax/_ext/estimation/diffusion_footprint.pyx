"""Estimates over footprints whose kernels follow structure; see docs/methods/footprints.md.

Lengths are in bandwidths and along the sides of the footprint's rectangle, the shorter first.
"""

from cython.parallel cimport prange, threadid
from libc.math cimport M_PI, copysign, fabs, fmax, fmin, sqrt
from libc.stdint cimport int64_t

import numpy as np

from ..common.threads cimport Watch, close_watch, goes_on, open_watch, team_size
from ..common.vec3 cimport dot
from ..spatial.radius cimport visit_radius
from ..spatial.simd.kernels cimport BLOCK, GAUSSIAN_DEVIATION, SlantedWeights, lowest_bit
from ..spatial.tree cimport Tree
from .diffusion cimport KernelShape, Tensor, find_near, measure, shape
from .footprint cimport NARROW, STENCIL, kernel_integral, set_series
from .rectangle cimport Footprint, fit_rectangle, open_rectangle
from .surface_edges cimport transform
from .surface_integrals cimport NearEdges, share_on_surface
from .tangent_plane cimport EvaluationPoints, TangentPhotons, fit, project

cdef enum:
    # Points that a thread takes at a time.
    GRAIN = 64
    # Least and largest number of nodes along the first side.
    FEW_NODES = 3
    MANY_NODES = 8

# Length of a side, in deviations, for each node more; weights are then within 5e-5 of
# the largest.
cdef double SIDE_PER_NODE = 0.95


cdef class FootprintKernels:
    """Kernels over footprints.

    Parameters
    ----------
    kernel_shape : KernelShape
    footprint : (m, 2, 3) or (m,) float64 array
        Edge vectors, or sides of squares.
    integrals : (g, g) float64 array
        See `photonrelax.estimation.footprint.kernel_integrals`.
    """

    cdef KernelShape kernel_shape
    cdef const double[:, :, ::1] edges
    cdef const double[::1] sides
    cdef const double[:, ::1] integrals
    # Gauss–Legendre nodes on [-1, 1] and weights whose sum is one, by their number: (2, n) each.
    cdef const double[:, :, ::1] rules

    def __init__(self, kernel_shape, footprint, integrals):
        self.kernel_shape = kernel_shape
        self.edges = footprint if footprint.ndim == 3 else None
        self.sides = footprint if footprint.ndim == 1 else None
        self.integrals = integrals
        self.rules = quadrature_rules()
        if footprint.shape[1:] not in ((), (2, 3)):
            raise ValueError("footprints should be edge vectors or sides")
        if not self.integrals.shape[0] == self.integrals.shape[1] > STENCIL:
            raise ValueError("integrals should be a square table")


def quadrature_rules():
    """Gauss–Legendre nodes and weights (n, 2, n) of means over [-1, 1], by their number."""
    rules = np.zeros((MANY_NODES + 1, 2, MANY_NODES))
    for n in range(FEW_NODES, MANY_NODES + 1):
        nodes, weights = np.polynomial.legendre.leggauss(n)
        rules[n, 0, :n], rules[n, 1, :n] = nodes, 0.5 * weights
    return rules


cdef struct Mean:
    const Tensor* tensor
    # Values of the photons, (n_blocks, n_channels, 16).
    const double* values
    Py_ssize_t n_channels
    double* out
    # Direction of the first side in the plane's frame, and half the sides.
    double cosine
    double sine
    double[2] half
    # The diffusion tensor, and its determinant.
    double xx
    double xy
    double yy
    double determinant
    SlantedWeights weights
    # Factor of the weights.
    double scale


def densities(
    TangentPhotons photons, const double[:, :, ::1] values, EvaluationPoints points,
    FootprintKernels kernels, double[:, ::1] out, *, int n_threads
):
    """Write the densities over the footprints of points to their rows of `out` (m, c).

    `values` (n_blocks, c, 16) are those of the photons in tree order.
    """
    cdef Py_ssize_t i, m = points.queries.shape[0]
    if not (
        m == out.shape[0] == (
            kernels.sides.shape[0] if kernels.edges is None else kernels.edges.shape[0]
        )
        and out.shape[1] == values.shape[1]
        and values.shape[0] == photons.columns.shape[0] and fit(photons, points, 4)
    ):
        raise ValueError("photons, values, footprints and densities do not fit one another")
    if points.surface is not None and points.surface.n_threads < n_threads:
        raise ValueError("the edges were opened for fewer threads")
    cdef Watch watch = open_watch()
    for i in prange(
        points.rows.shape[0], nogil=True, schedule="dynamic", chunksize=GRAIN,
        num_threads=team_size(n_threads, points.rows.shape[0], GRAIN)
    ):
        if goes_on(&watch, threadid() == 0):
            write_densities(photons, values, points, kernels, i, out, threadid())
    close_watch(&watch)


cdef void write_densities(
    TangentPhotons photons, const double[:, :, ::1] values, EvaluationPoints points,
    FootprintKernels kernels, Py_ssize_t i, double[:, ::1] densities, int thread
) noexcept nogil:
    """Write the densities over one footprint."""
    cdef Tensor tensor
    cdef Mean mean
    cdef Footprint footprint
    cdef NearEdges near
    cdef double scale, reach
    cdef double* out = &densities[points.rows[i], 0]
    cdef Py_ssize_t channel
    measure(&tensor, photons, points, i)
    shape(&tensor, photons, kernels.kernel_shape)
    open_footprint(kernels, points, i, &footprint)
    open_mean(&mean, &tensor, &footprint, kernels)
    mean.values = &values[0, 0, 0]
    mean.n_channels = values.shape[1]
    mean.out = out
    for channel in range(mean.n_channels):
        out[channel] = 0.0
    reach = 1.0 + sqrt(mean.half[0] * mean.half[0] + mean.half[1] * mean.half[1])
    tensor.plane.bounds.squared_limit *= reach * reach
    visit_radius(photons.tree, &tensor.plane.bounds, add_weighted, &mean)
    scale = mean.scale * tensor.plane.scale * tensor.plane.scale
    scale /= whole(&mean, kernels.integrals)
    if points.surface is not None:
        find_near(points, &tensor, mean.half, thread, &near)
        open_whitened(&mean, &footprint)
        turn_edges(&near, &footprint)
        scale /= share_on_surface(&near, footprint.sides, 1.0)
    for channel in range(mean.n_channels):
        out[channel] *= scale


cdef void open_footprint(
    FootprintKernels kernels, EvaluationPoints points, Py_ssize_t i, Footprint* footprint
) noexcept nogil:
    """Set the rectangle of a footprint."""
    if kernels.edges is None:
        open_rectangle(footprint, &points.normals[i, 0], NULL, kernels.sides[points.rows[i]])
    else:
        open_rectangle(
            footprint, &points.normals[i, 0], &kernels.edges[points.rows[i], 0, 0], 0.0
        )


cdef void open_mean(
    Mean* mean, Tensor* tensor, const Footprint* footprint, FootprintKernels kernels
) noexcept nogil:
    """Set the mean of a kernel over a footprint, but for the values."""
    cdef int first = footprint.sides[0] > footprint.sides[1]
    cdef const double* axis = &footprint.rectangle.axes[3 * first]
    mean.tensor = tensor
    mean.cosine = dot(axis, tensor.plane.frame)
    mean.sine = dot(axis, tensor.plane.frame + 3)
    mean.half[0] = 0.5 * footprint.sides[first] * tensor.plane.scale
    mean.half[1] = 0.5 * footprint.sides[1 - first] * tensor.plane.scale
    widen(tensor, mean.half[1], kernels.kernel_shape.isotropic)
    set_tensor(mean)
    set_weights(mean, kernels)


cdef inline void widen(Tensor* tensor, double half_side, bint isotropic) noexcept nogil:
    """Raise the eigenvalues so that half-axes of a kernel are no shorter than half a side."""
    tensor.width = fmax(tensor.width, fmin(half_side * half_side, 1.0))
    if isotropic:
        tensor.length = tensor.width


cdef inline void set_tensor(Mean* mean) noexcept nogil:
    """Set the diffusion tensor in the frame of the sides."""
    cdef const Tensor* tensor = mean.tensor
    cdef double cosine = mean.cosine * tensor.cosine + mean.sine * tensor.sine
    cdef double sine = mean.cosine * tensor.sine - mean.sine * tensor.cosine
    mean.xx = tensor.width * cosine * cosine + tensor.length * sine * sine
    mean.yy = tensor.width * sine * sine + tensor.length * cosine * cosine
    mean.xy = (tensor.width - tensor.length) * cosine * sine
    mean.determinant = tensor.width * tensor.length


cdef inline void set_weights(Mean* mean, FootprintKernels kernels) noexcept nogil:
    """Set the weights of the Gaussian, of covariance (0.41)² D, and their factor."""
    cdef SlantedWeights* weights = &mean.weights
    cdef double least = GAUSSIAN_DEVIATION * sqrt(mean.determinant / mean.yy)
    cdef double nodes = FEW_NODES + 2.0 * mean.half[0] / (SIDE_PER_NODE * least)
    weights.n_nodes = <int64_t> fmin(nodes, MANY_NODES)
    weights.nodes = &kernels.rules[weights.n_nodes, 0, 0]
    weights.weights = &kernels.rules[weights.n_nodes, 1, 0]
    weights.first_half = mean.half[0]
    weights.first_scale = 1.0 / (GAUSSIAN_DEVIATION * sqrt(mean.xx))
    weights.second_scale = 1.0 / (GAUSSIAN_DEVIATION * sqrt(mean.determinant / mean.xx))
    weights.slope = mean.xy / mean.xx
    weights.half = mean.half[1] * weights.second_scale
    weights.is_narrow = 2.0 * weights.half < NARROW
    mean.scale = weights.first_scale / sqrt(2.0 * M_PI)
    if weights.is_narrow:
        set_series(2.0 * weights.half, weights.series)
        mean.scale *= weights.second_scale / sqrt(2.0 * M_PI)
    else:
        mean.scale /= 2.0 * mean.half[1]


cdef double whole(const Mean* mean, const double[:, ::1] integrals) noexcept nogil:
    """Integral of a cut kernel over the plane.

    In coordinates in which D is the unit the footprint is a parallelogram. The integral is that of
    a rectangle of the same area and moments, whose sides are the singular values of the edges.
    """
    cdef Footprint footprint
    cdef double xx = 4.0 * mean.half[0] * mean.half[0] * mean.yy / mean.determinant
    cdef double yy = 4.0 * mean.half[1] * mean.half[1] * mean.xx / mean.determinant
    cdef double xy = -4.0 * mean.half[0] * mean.half[1] * mean.xy / mean.determinant
    cdef double area = 4.0 * mean.half[0] * mean.half[1] / sqrt(mean.determinant)
    cdef double apart = 0.5 * (xx - yy)
    footprint.sides[0] = sqrt(0.5 * (xx + yy) + sqrt(apart * apart + xy * xy))
    footprint.sides[1] = area / footprint.sides[0] if footprint.sides[0] > 0.0 else 0.0
    return kernel_integral(integrals, &footprint, 1.0)


cdef void open_whitened(const Mean* mean, Footprint* footprint) noexcept nogil:
    """Set the rectangle of a footprint in coordinates in which D is the unit.

    There it is a parallelogram, and a rectangle of the same area stands for it. The coordinates are
    those of `diffusion.find_near`.
    """
    cdef const Tensor* tensor = mean.tensor
    cdef double[6] edges
    cdef double cosine = mean.cosine * tensor.cosine + mean.sine * tensor.sine
    cdef double sine = mean.cosine * tensor.sine - mean.sine * tensor.cosine
    cdef int i
    for i in range(9):
        footprint.rectangle.axes[i] = 1.0 if i % 4 == 0 else 0.0
    edges[0] = 2.0 * mean.half[0] * cosine / sqrt(tensor.width)
    edges[1] = -2.0 * mean.half[0] * sine / sqrt(tensor.length)
    edges[3] = 2.0 * mean.half[1] * sine / sqrt(tensor.width)
    edges[4] = 2.0 * mean.half[1] * cosine / sqrt(tensor.length)
    edges[2] = edges[5] = 0.0
    fit_rectangle(footprint, edges)


cdef inline void turn_edges(NearEdges* near, const Footprint* footprint) noexcept nogil:
    """Turn edges to the axes of a rectangle."""
    cdef const double* axes = footprint.rectangle.axes
    cdef double[4] matrix = [axes[0], axes[1], axes[3], axes[4]]
    transform(near, matrix)


cdef void add_weighted(
    void* state, Tree tree, Py_ssize_t block, unsigned int lanes
) noexcept nogil:
    cdef Mean* mean = <Mean*> state
    cdef const double* values = mean.values + BLOCK * mean.n_channels * block
    cdef double[BLOCK] along
    cdef double[BLOCK] beside
    cdef double[BLOCK] weight
    cdef Py_ssize_t channel
    cdef int lane
    for lane in range(BLOCK):
        along[lane] = beside[lane] = 0.0
    lanes = lanes_within(mean, tree, block, lanes, along, beside)
    if not lanes:
        return
    tree.simd.slanted_weights(along, beside, &mean.weights, weight)
    while lanes:
        lane = lowest_bit(lanes)
        lanes &= lanes - 1
        for channel in range(mean.n_channels):
            mean.out[channel] += weight[lane] * values[BLOCK * channel + lane]


cdef inline unsigned int lanes_within(
    const Mean* mean, Tree tree, Py_ssize_t block, unsigned int lanes, double* along,
    double* beside
) noexcept nogil:
    """Write the offsets of photons along both sides; return those that the kernel reaches."""
    cdef double[2] offset
    cdef unsigned int within = 0
    cdef int lane
    while lanes:
        lane = lowest_bit(lanes)
        lanes &= lanes - 1
        if not project(&mean.tensor.plane, tree, block, lane, offset):
            continue
        along[lane] = mean.cosine * offset[0] + mean.sine * offset[1]
        beside[lane] = mean.cosine * offset[1] - mean.sine * offset[0]
        within |= <unsigned int> (squared_distance(mean, along[lane], beside[lane]) <= 1.0) << lane
    return within


cdef inline double squared_distance(const Mean* mean, double x, double y) noexcept nogil:
    """Least squared distance from the rectangle, in the metric of the inverse of D.

    The nearest point is on an edge that the offset is beyond.
    """
    cdef double beyond_x = x - copysign(fmin(fabs(x), mean.half[0]), x)
    cdef double beyond_y = y - copysign(fmin(fabs(y), mean.half[1]), y)
    cdef double squared = 0.0, other, at
    if beyond_x != 0.0:
        at = y - mean.xy / mean.xx * beyond_x
        other = y - fmax(-mean.half[1], fmin(mean.half[1], at))
        squared = squared_length(mean, beyond_x, other)
    if beyond_y != 0.0:
        at = x - mean.xy / mean.yy * beyond_y
        other = squared_length(mean, x - fmax(-mean.half[0], fmin(mean.half[0], at)), beyond_y)
        squared = fmin(squared, other) if beyond_x != 0.0 else other
    return squared


cdef inline double squared_length(const Mean* mean, double x, double y) noexcept nogil:
    """Squared length of a vector in the metric of the inverse of D."""
    return (mean.yy * x * x - 2.0 * mean.xy * x * y + mean.xx * y * y) / mean.determinant
