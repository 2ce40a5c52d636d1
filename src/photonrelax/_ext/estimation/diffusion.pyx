"""Gradients of irradiance at photons, and estimates whose kernels follow structure (SSO08 §6).

All sums around a point are over photons projected onto its tangent plane along their light (SSO08
Appendix A). Offsets there are in bandwidths, and flux and gradients in units of the photons, so
that squares stay within the range of floats in any scene.
"""

from cython.parallel cimport prange, threadid
from libc.math cimport M_PI, pow, sqrt

from ..common.threads cimport Watch, close_watch, goes_on, open_watch, team_size
from ..relaxation.structure cimport Components, decompose
from ..spatial.radius cimport visit_radius
from ..spatial.simd.kernels cimport BLOCK, EPANECHNIKOV_WEIGHTS, Rectangle, lowest_bit
from ..spatial.tree cimport Tree
from .surface_edges cimport transform
from .surface_integrals cimport NearEdges, share_of_radial
from .tangent_plane cimport (
    EvaluationPoints, Plane, TangentPhotons, along, fit, open_plane, project,
)

cdef enum:
    # Points that a thread takes at a time.
    GRAIN = 64


cdef class KernelShape:
    """The shape of a kernel from the structure tensor at its point (SSO08 Eq. 15–16).

    Parameters
    ----------
    edge_threshold : float
        q.
    exponent : float
        1 + α.
    least_eigenvalue : float
        Least eigenvalue of the diffusion tensor.
    largest : float
        Divisor of the eigenvalues of structure tensors, in their unit; zero for the square of
        irradiance over bandwidth at the point.
    isotropic : bool
        Both eigenvalues of the diffusion tensor are the one across the structure (§7.3).
    """

    def __init__(self, *, edge_threshold, exponent, least_eigenvalue, largest, isotropic):
        self.edge_threshold = edge_threshold
        self.exponent = exponent
        self.least_eigenvalue = least_eigenvalue
        self.largest = largest
        self.isotropic = isotropic


# --- gradients ---------------------------------------------------------------------------------


cdef struct Slope:
    Plane plane
    # Mean flux, first of the columns of (n_blocks, n_columns, 16).
    const double* flux
    Py_ssize_t n_columns
    double u
    double v


def gradients(TangentPhotons photons, EvaluationPoints points, double[:, ::1] out, int n_threads):
    """Write the gradients of irradiance (m, 3), unit of flux / unit³, at the points evaluated."""
    cdef Py_ssize_t i
    if out.shape[0] != points.queries.shape[0] or out.shape[1] != 3 or not fit(photons, points, 1):
        raise ValueError("gradients do not fit the points")
    cdef Watch watch = open_watch()
    for i in prange(
        points.rows.shape[0], nogil=True, schedule="dynamic", chunksize=GRAIN,
        num_threads=team_size(n_threads, points.rows.shape[0], GRAIN)
    ):
        if goes_on(&watch, threadid() == 0):
            write_gradient(photons, points, i, &out[points.rows[i], 0])
    close_watch(&watch)


cdef void write_gradient(
    TangentPhotons photons, EvaluationPoints points, Py_ssize_t i, double* out
) noexcept nogil:
    """Write the gradient of the Epanechnikov estimate at one point (SSO08 Eq. 13).

    ∂/∂x of 2/(π h²) Σ (1 - |x - xᵢ|²/h²) Φᵢ is 4/(π h³) Σ (xᵢ - x)/h Φᵢ.
    """
    cdef Slope slope
    cdef double scale, units
    cdef Py_ssize_t axis
    open_plane(&slope.plane, photons, points, i)
    slope.flux = &photons.columns[0, 0, 0]
    slope.n_columns = photons.columns.shape[1]
    slope.u = slope.v = 0.0
    visit_radius(photons.tree, &slope.plane.bounds, add_slope, &slope)
    units = photons.unit / slope.plane.bandwidth
    scale = 4.0 / M_PI * units * units * units
    for axis in range(3):
        out[axis] = slope.u * slope.plane.frame[axis] + slope.v * slope.plane.frame[3 + axis]
        out[axis] *= scale


cdef void add_slope(
    void* state, Tree tree, Py_ssize_t block, unsigned int lanes
) noexcept nogil:
    cdef Slope* slope = <Slope*> state
    cdef const double* flux = slope.flux + BLOCK * slope.n_columns * block
    cdef double[2] offset
    cdef int lane
    while lanes:
        lane = lowest_bit(lanes)
        lanes &= lanes - 1
        if not project(&slope.plane, tree, block, lane, offset):
            continue
        if offset[0] * offset[0] + offset[1] * offset[1] < 1.0:
            slope.u += offset[0] * flux[lane]
            slope.v += offset[1] * flux[lane]


# --- structure and diffusion tensors -----------------------------------------------------------


cdef void measure(
    Tensor* tensor, TangentPhotons photons, EvaluationPoints points, Py_ssize_t i
) noexcept nogil:
    """Set the mean structure tensor around a point (SSO08 Eq. 14), and decompose it."""
    cdef Components components
    open_plane(&tensor.plane, photons, points, i)
    tensor.columns = &photons.columns[0, 0, 0]
    tensor.weight = tensor.flux = tensor.uu = tensor.uv = tensor.vv = 0.0
    visit_radius(photons.tree, &tensor.plane.bounds, add_tensor, tensor)
    tensor.cosine = 1.0
    tensor.sine = tensor.edge = 0.0
    if tensor.weight > 0.0:
        components = decompose(
            tensor.uu / tensor.weight, tensor.uv / tensor.weight, tensor.vv / tensor.weight
        )
        tensor.cosine = components.cosine
        tensor.sine = components.sine
        tensor.edge = components.first


cdef void add_tensor(
    void* state, Tree tree, Py_ssize_t block, unsigned int lanes
) noexcept nogil:
    cdef Tensor* tensor = <Tensor*> state
    cdef const double* columns = tensor.columns + 4 * BLOCK * block
    cdef double[2] offset
    cdef double weight, u, v
    cdef int lane
    while lanes:
        lane = lowest_bit(lanes)
        lanes &= lanes - 1
        if not project(&tensor.plane, tree, block, lane, offset):
            continue
        weight = 1.0 - (offset[0] * offset[0] + offset[1] * offset[1])
        if weight <= 0.0:
            continue
        u = along(tensor.plane.frame, columns + BLOCK + lane)
        v = along(tensor.plane.frame + 3, columns + BLOCK + lane)
        tensor.weight += weight
        tensor.flux += weight * columns[lane]
        tensor.uu += weight * u * u
        tensor.uv += weight * u * v
        tensor.vv += weight * v * v


cdef void shape(Tensor* tensor, TangentPhotons photons, KernelShape kernel_shape) noexcept nogil:
    """Set the eigenvalues of the diffusion tensor (SSO08 Eq. 15–16).

    λ₁ is divided by the largest of the map, or by what it would be if irradiance changed by
    its own value over the bandwidth: |∇E|·h/E squared, where E is 2 ΣwΦ / (π h²).
    """
    cdef double edge = tensor.edge, units
    tensor.length = tensor.width = 1.0
    if edge <= 0.0 or tensor.flux <= 0.0:
        return
    if kernel_shape.largest > 0.0:
        edge /= kernel_shape.largest
    else:
        units = tensor.plane.bandwidth / photons.unit
        units *= units * units * M_PI / (2.0 * tensor.flux)
        edge *= units * units
    tensor.width = 1.0 / (1.0 + pow(edge / kernel_shape.edge_threshold, kernel_shape.exponent))
    tensor.width = max(tensor.width, kernel_shape.least_eigenvalue)
    if kernel_shape.isotropic:
        tensor.length = tensor.width


def eigenvalues(TangentPhotons photons, EvaluationPoints points, double[::1] out, int n_threads):
    """Write λ₁ of the structure tensors (m,) at the points evaluated.

    In the square of the unit of gradients.
    """
    cdef Py_ssize_t i
    if out.shape[0] != points.queries.shape[0] or not fit(photons, points, 4):
        raise ValueError("eigenvalues do not fit the points")
    cdef Watch watch = open_watch()
    for i in prange(
        points.rows.shape[0], nogil=True, schedule="dynamic", chunksize=GRAIN,
        num_threads=team_size(n_threads, points.rows.shape[0], GRAIN)
    ):
        if goes_on(&watch, threadid() == 0):
            out[points.rows[i]] = first_eigenvalue(photons, points, i)
    close_watch(&watch)


cdef double first_eigenvalue(
    TangentPhotons photons, EvaluationPoints points, Py_ssize_t i
) noexcept nogil:
    cdef Tensor tensor
    measure(&tensor, photons, points, i)
    return tensor.edge


def half_axes(
    TangentPhotons photons, EvaluationPoints points, KernelShape kernel_shape,
    double[:, :, ::1] out, int n_threads
):
    """Write the half-axes of the kernels' ellipses (m, 2, 3), m, along the structure and across."""
    cdef Py_ssize_t i
    if not (
        out.shape[0] == points.queries.shape[0] and out.shape[1] == 2 and out.shape[2] == 3
        and fit(photons, points, 4)
    ):
        raise ValueError("axes do not fit the points")
    cdef Watch watch = open_watch()
    for i in prange(
        points.rows.shape[0], nogil=True, schedule="dynamic", chunksize=GRAIN,
        num_threads=team_size(n_threads, points.rows.shape[0], GRAIN)
    ):
        if goes_on(&watch, threadid() == 0):
            write_axes(photons, points, kernel_shape, i, &out[points.rows[i], 0, 0])
    close_watch(&watch)


cdef void write_axes(
    TangentPhotons photons, EvaluationPoints points, KernelShape kernel_shape, Py_ssize_t i,
    double* out
) noexcept nogil:
    """Write the half-axes at one point."""
    cdef Tensor tensor
    cdef double length, width
    cdef Py_ssize_t axis
    measure(&tensor, photons, points, i)
    shape(&tensor, photons, kernel_shape)
    length = points.bandwidth[i] * sqrt(tensor.length)
    width = points.bandwidth[i] * sqrt(tensor.width)
    for axis in range(3):
        out[axis] = length * (
            tensor.cosine * tensor.plane.frame[3 + axis] - tensor.sine * tensor.plane.frame[axis]
        )
        out[3 + axis] = width * (
            tensor.cosine * tensor.plane.frame[axis] + tensor.sine * tensor.plane.frame[3 + axis]
        )


# --- estimates ---------------------------------------------------------------------------------


cdef struct Estimate:
    const Tensor* tensor
    # (n_blocks, n_channels, 16).
    const double* values
    Py_ssize_t n_channels
    double* out


def densities(
    TangentPhotons photons, const double[:, :, ::1] values, EvaluationPoints points,
    KernelShape kernel_shape, double[:, ::1] out, *, int n_threads
):
    """Write the densities at the points evaluated to their rows of `out` (m, c).

    `values` (n_blocks, c, 16) are those of the photons in tree order.
    """
    cdef Py_ssize_t i
    if not (
        out.shape[0] == points.queries.shape[0] and out.shape[1] == values.shape[1]
        and values.shape[0] == photons.columns.shape[0] and fit(photons, points, 4)
    ):
        raise ValueError("photons, values, points and densities do not fit one another")
    if points.surface is not None and points.surface.n_threads < n_threads:
        raise ValueError("the edges were opened for fewer threads")
    cdef Watch watch = open_watch()
    for i in prange(
        points.rows.shape[0], nogil=True, schedule="dynamic", chunksize=GRAIN,
        num_threads=team_size(n_threads, points.rows.shape[0], GRAIN)
    ):
        if goes_on(&watch, threadid() == 0):
            write_densities(photons, values, points, kernel_shape, i, out, threadid())
    close_watch(&watch)


cdef void write_densities(
    TangentPhotons photons, const double[:, :, ::1] values, EvaluationPoints points,
    KernelShape kernel_shape, Py_ssize_t i, double[:, ::1] densities, int thread
) noexcept nogil:
    """Write the densities at one point (SSO08 Eq. 20, with D inverted as in Eq. 19).

    With d the offset of a photon, the sum of 2/(π h² √det D) (1 - dᵀD⁻¹d/h²)₊ Φ.
    """
    cdef Tensor tensor
    cdef Estimate estimate
    cdef NearEdges near
    cdef double[2] half = [0.0, 0.0]
    cdef double area
    cdef double* out = &densities[points.rows[i], 0]
    cdef Py_ssize_t channel
    estimate.tensor = &tensor
    estimate.values = &values[0, 0, 0]
    estimate.n_channels = values.shape[1]
    estimate.out = out
    for channel in range(estimate.n_channels):
        out[channel] = 0.0
    measure(&tensor, photons, points, i)
    shape(&tensor, photons, kernel_shape)
    visit_radius(photons.tree, &tensor.plane.bounds, add_weighted, &estimate)
    area = M_PI * tensor.plane.bandwidth * tensor.plane.bandwidth
    area *= sqrt(tensor.length * tensor.width)
    if points.surface is not None:
        find_near(points, &tensor, half, thread, &near)
        area *= share_of_radial(&near, 1.0, EPANECHNIKOV_WEIGHTS)
    for channel in range(estimate.n_channels):
        out[channel] *= 2.0 / area


cdef void find_near(
    EvaluationPoints points, const Tensor* tensor, const double* half, int thread, NearEdges* near
) noexcept nogil:
    """Find the edges within a bandwidth of a footprint, in coordinates in which D is the unit.

    These are along the eigenvectors of D, in bandwidths; `half` are half the sides of the
    footprint, in bandwidths.
    """
    cdef Rectangle rectangle
    cdef double[4] matrix
    cdef double across = tensor.plane.scale / sqrt(tensor.width)
    cdef double forth = tensor.plane.scale / sqrt(tensor.length)
    cdef int axis
    for axis in range(9):
        rectangle.axes[axis] = tensor.plane.frame[axis]
    for axis in range(2):
        rectangle.half[axis] = half[axis] * tensor.plane.bandwidth
    rectangle.half[2] = 0.0
    rectangle.at = tensor.plane.at
    points.surface.find(&rectangle, tensor.plane.bandwidth, thread, near)
    matrix[0] = tensor.cosine * across
    matrix[1] = tensor.sine * across
    matrix[2] = -tensor.sine * forth
    matrix[3] = tensor.cosine * forth
    transform(near, matrix)


cdef void add_weighted(
    void* state, Tree tree, Py_ssize_t block, unsigned int lanes
) noexcept nogil:
    cdef Estimate* estimate = <Estimate*> state
    cdef const Tensor* tensor = estimate.tensor
    cdef const double* values = estimate.values + BLOCK * estimate.n_channels * block
    cdef double[2] offset
    cdef double weight, across, forth
    cdef Py_ssize_t channel
    cdef int lane
    while lanes:
        lane = lowest_bit(lanes)
        lanes &= lanes - 1
        if not project(&tensor.plane, tree, block, lane, offset):
            continue
        across = tensor.cosine * offset[0] + tensor.sine * offset[1]
        forth = tensor.cosine * offset[1] - tensor.sine * offset[0]
        weight = 1.0 - (across * across / tensor.width + forth * forth / tensor.length)
        if weight > 0.0:
            for channel in range(estimate.n_channels):
                estimate.out[channel] += weight * values[BLOCK * channel + lane]
