"""Gradients of irradiance at photons, and estimates whose kernel follows the structure (SSO08 §6).

Everything around a point happens in its tangent plane, where photons are put by projecting them
along the direction they came from (SSO08 Appendix A). Their offsets there are in bandwidths, and
flux and gradients in units of the photons, so that squares stay in range whatever the scene's.
"""

from cython.parallel cimport prange
from libc.math cimport M_PI, pow, sqrt

from ..spatial.tree cimport Tree
from ..spatial.simd.kernels cimport BLOCK, lowest_bit
from ..relaxation.structure cimport Components, decompose
from .tangent_plane cimport Photons, Plane, Sites, along, fit, open_plane, project
from ..spatial.radius cimport visit_radius

from ..spatial.blocks import to_soa_blocks


cdef class Shaping:
    """How the structure around a point shapes the kernel there (SSO08 Eq. 16).

    Parameters
    ----------
    edge_threshold : float
        q.
    exponent : float
        1 + α.
    least_eigenvalue : float
        Of the diffusion tensor.
    largest : float
        What eigenvalues of structure tensors are divided by, in their unit; zero for the square of
        irradiance over bandwidth at the point.
    isotropic : bool
        Shrink the kernel in both directions.
    """

    cdef double edge_threshold
    cdef double exponent
    cdef double least_eigenvalue
    cdef double largest
    cdef bint isotropic

    def __init__(self, *, edge_threshold, exponent, least_eigenvalue, largest, isotropic):
        self.edge_threshold = edge_threshold
        self.exponent = exponent
        self.least_eigenvalue = least_eigenvalue
        self.largest = largest
        self.isotropic = isotropic


# --- gradients ---------------------------------------------------------------------------------


cdef struct Slope:
    Plane plane
    # Mean flux, first of the columns of (n_blocks, c, 16), and how many these are.
    const double* flux
    Py_ssize_t n_columns
    double u
    double v


def gradients(
    Photons photons, Sites sites, const Py_ssize_t[::1] order, double[:, ::1] out, int n_threads
):
    """Write the gradients of irradiance (m, 3), unit of flux / unit³, at sites named by `order`."""
    cdef Py_ssize_t i
    if out.shape[0] != sites.queries.shape[0] or out.shape[1] != 3 or not fit(photons, sites, 1):
        raise ValueError("gradients do not fit the sites")
    for i in prange(
        order.shape[0], nogil=True, schedule="dynamic", chunksize=64, num_threads=n_threads
    ):
        write_gradient(photons, sites, order[i], &out[order[i], 0])


cdef void write_gradient(
    Photons photons, Sites sites, Py_ssize_t row, double* out
) noexcept nogil:
    """Differentiate the Epanechnikov estimate at one site (SSO08 Eq. 13); write its row only.

    ∂/∂x of 2/(π h²) Σ (1 - |x - xᵢ|²/h²) Φᵢ is 4/(π h³) Σ (xᵢ - x)/h Φᵢ.
    """
    cdef Slope slope
    cdef double scale, units
    cdef Py_ssize_t axis
    open_plane(&slope.plane, photons, sites, row)
    slope.flux = &photons.carried[0, 0, 0]
    slope.n_columns = photons.carried.shape[1]
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


cdef struct Tensor:
    Plane plane
    # Mean flux and gradient, (n_blocks, 4, 16).
    const double* carried
    # Sums of the weights, of weighted flux, and of the weighted products of gradients.
    double weight
    double flux
    double uu
    double uv
    double vv
    # Across the structure, and the eigenvalues of the structure tensor and the diffusion tensor.
    double cosine
    double sine
    double edge
    double length
    double width


cdef void measure(Tensor* tensor, Photons photons, Sites sites, Py_ssize_t row) noexcept nogil:
    """Average the structure tensors around a site (SSO08 Eq. 14) and decompose the mean."""
    cdef Components components
    open_plane(&tensor.plane, photons, sites, row)
    tensor.carried = &photons.carried[0, 0, 0]
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
    cdef const double* carried = tensor.carried + 4 * BLOCK * block
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
        u = along(tensor.plane.frame, carried + BLOCK + lane)
        v = along(tensor.plane.frame + 3, carried + BLOCK + lane)
        tensor.weight += weight
        tensor.flux += weight * carried[lane]
        tensor.uu += weight * u * u
        tensor.uv += weight * u * v
        tensor.vv += weight * v * v


cdef void shape(Tensor* tensor, Photons photons, Shaping shaping) noexcept nogil:
    """Set the eigenvalues of the diffusion tensor (SSO08 Eq. 15–16).

    The edge is measured against the map's largest, or against what it would be if irradiance
    changed by as much as it is over the bandwidth: |∇E|·h/E squared, where E is 2 ΣwΦ / (π h²).
    """
    cdef double edge = tensor.edge, units
    tensor.length = tensor.width = 1.0
    if edge <= 0.0 or tensor.flux <= 0.0:
        return
    if shaping.largest > 0.0:
        edge /= shaping.largest
    else:
        units = tensor.plane.bandwidth / photons.unit
        units *= units * units * M_PI / (2.0 * tensor.flux)
        edge *= units * units
    tensor.width = 1.0 / (1.0 + pow(edge / shaping.edge_threshold, shaping.exponent))
    tensor.width = max(tensor.width, shaping.least_eigenvalue)
    if shaping.isotropic:
        tensor.length = tensor.width


def eigenvalues(
    Photons photons, Sites sites, const Py_ssize_t[::1] order, double[::1] out, int n_threads
):
    """Write the first eigenvalues of the structure tensors at the sites named by `order`.

    In the square of the unit of gradients.
    """
    cdef Py_ssize_t i
    if out.shape[0] != sites.queries.shape[0] or not fit(photons, sites, 4):
        raise ValueError("eigenvalues do not fit the sites")
    for i in prange(
        order.shape[0], nogil=True, schedule="dynamic", chunksize=64, num_threads=n_threads
    ):
        write_eigenvalue(photons, sites, order[i], out)


cdef void write_eigenvalue(
    Photons photons, Sites sites, Py_ssize_t row, double[::1] out
) noexcept nogil:
    """Measure the edge at one site; write its row only."""
    cdef Tensor tensor
    measure(&tensor, photons, sites, row)
    out[row] = tensor.edge


def half_axes(
    Photons photons, Sites sites, Shaping shaping, const Py_ssize_t[::1] order,
    double[:, :, ::1] out, *, int n_threads
):
    """Write the half-axes of the kernels' ellipses (m, 2, 3), m, along the structure and across."""
    cdef Py_ssize_t i
    if not (
        out.shape[0] == sites.queries.shape[0] and out.shape[1] == 2 and out.shape[2] == 3
        and fit(photons, sites, 4)
    ):
        raise ValueError("axes do not fit the sites")
    for i in prange(
        order.shape[0], nogil=True, schedule="dynamic", chunksize=64, num_threads=n_threads
    ):
        write_axes(photons, sites, shaping, order[i], out)


cdef void write_axes(
    Photons photons, Sites sites, Shaping shaping, Py_ssize_t row, double[:, :, ::1] out
) noexcept nogil:
    """Find the kernel's shape at one site; write its row only."""
    cdef Tensor tensor
    cdef double length, width
    cdef Py_ssize_t axis
    measure(&tensor, photons, sites, row)
    shape(&tensor, photons, shaping)
    length = sites.bandwidth[row] * sqrt(tensor.length)
    width = sites.bandwidth[row] * sqrt(tensor.width)
    for axis in range(3):
        out[row, 0, axis] = length * (
            tensor.cosine * tensor.plane.frame[3 + axis] - tensor.sine * tensor.plane.frame[axis]
        )
        out[row, 1, axis] = width * (
            tensor.cosine * tensor.plane.frame[axis] + tensor.sine * tensor.plane.frame[3 + axis]
        )


# --- estimates ---------------------------------------------------------------------------------


cdef class Values:
    """What is summed of photons, in the order of their tree.

    Parameters
    ----------
    values : (m, c) float64 array
    rows : (n,) intp array
        Row of the photon at each place.
    """

    cdef const double[:, :, ::1] blocks

    def __init__(self, values, rows, n_threads):
        self.blocks = to_soa_blocks(values, rows, n_threads)


cdef struct Gathered:
    const Tensor* tensor
    const double* values
    Py_ssize_t n_channels
    double* out


def densities(
    Photons photons, Values values, Sites sites, Shaping shaping, const Py_ssize_t[::1] order, *,
    double[:, ::1] out, int n_threads
):
    """Write the values per area at the sites named by `order` to their rows of `out`."""
    cdef Py_ssize_t i
    if not (
        out.shape[0] == sites.queries.shape[0] and out.shape[1] == values.blocks.shape[1]
        and values.blocks.shape[0] == photons.carried.shape[0] and fit(photons, sites, 4)
    ):
        raise ValueError("photons, values, sites and densities do not fit one another")
    for i in prange(
        order.shape[0], nogil=True, schedule="dynamic", chunksize=64, num_threads=n_threads
    ):
        gather_one(photons, values, sites, shaping, order[i], out)


cdef void gather_one(
    Photons photons, Values values, Sites sites, Shaping shaping, Py_ssize_t row,
    double[:, ::1] out
) noexcept nogil:
    """Estimate the densities at one site with a kernel of its own; write its row only.

    With d the way from the site to a photon, the sum of 2/(π h² √det D) (1 - dᵀD⁻¹d/h²)₊ Φ.
    """
    cdef Tensor tensor
    cdef Gathered gathered
    cdef double area
    cdef Py_ssize_t channel
    gathered.tensor = &tensor
    gathered.values = &values.blocks[0, 0, 0]
    gathered.n_channels = values.blocks.shape[1]
    gathered.out = &out[row, 0]
    for channel in range(gathered.n_channels):
        gathered.out[channel] = 0.0
    measure(&tensor, photons, sites, row)
    shape(&tensor, photons, shaping)
    visit_radius(photons.tree, &tensor.plane.bounds, gather, &gathered)
    area = M_PI * tensor.plane.bandwidth * tensor.plane.bandwidth
    area *= sqrt(tensor.length * tensor.width)
    for channel in range(gathered.n_channels):
        gathered.out[channel] *= 2.0 / area


cdef void gather(void* state, Tree tree, Py_ssize_t block, unsigned int lanes) noexcept nogil:
    cdef Gathered* gathered = <Gathered*> state
    cdef const Tensor* tensor = gathered.tensor
    cdef const double* values = gathered.values + BLOCK * gathered.n_channels * block
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
            for channel in range(gathered.n_channels):
                gathered.out[channel] += weight * values[BLOCK * channel + lane]
