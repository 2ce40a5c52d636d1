"""Gradients of irradiance at photons, and estimates whose kernel follows the structure (SSO08 §6).

Everything around a point happens in its tangent plane, where photons are put by projecting them
along the direction they came from (SSO08 Appendix A).
"""

from cython.parallel cimport prange, threadid
from libc.math cimport M_PI, pow, sqrt

from .batch cimport Batch, Query, limit_radius, limit_range, open_query, scratch
from .core cimport orthonormal_frame
from .kdtree cimport Tree
from .lanes cimport BLOCK, Reach, lowest_bit
from .search cimport find
from .structure cimport Components, decompose
from .within cimport visit_within

from .columns import in_blocks

# What the distance to the k-th photon is multiplied by: whether that photon itself, on the rim, is
# within must not hang on roundings, and an estimate from those within is unbiased without it.
cdef double WITHOUT_LAST = 1.0 - 1e-9

# Photons that come in flatter than this are moved no farther than if they came so.
cdef double LEAST_COSINE = 0.1


cdef class Sites:
    """Where something is estimated, and from how far around.

    Parameters
    ----------
    queries : (m, axes) float64 array
        On all axes of the tree.
    normals : (m, 3) float64 array
        Unit normals.
    bandwidth : (m,) float64 array
        Positive; m.
    """

    cdef const double[:, ::1] queries
    cdef const double[:, ::1] normals
    cdef const double[::1] bandwidth

    def __init__(self, queries, normals, bandwidth):
        self.queries = queries
        self.normals = normals
        self.bandwidth = bandwidth
        if not self.queries.shape[0] == self.normals.shape[0] == self.bandwidth.shape[0]:
            raise ValueError("queries, normals and bandwidths do not fit one another")


cdef class Photons:
    """Photons of a tree, in its order.

    Parameters
    ----------
    tree : Tree
        Its first three axes are positions.
    rows : (n,) intp array
        Row of the photon at each place.
    towards : (m, 3) float64 array or None
        From the surface to where light came from; None projects along the normal of the plane.
    carried : (m, c) float64 array
        What is looked at of them: mean flux, and gradient (c = 4) if there is one yet.
    normal_range : float
        Radius of the ball over the tree's range axes; negative for none.
    """

    cdef Tree tree
    cdef const double[:, :, ::1] towards
    cdef const double[:, :, ::1] carried
    cdef double normal_range

    def __init__(self, tree, rows, towards, carried, *, normal_range, n_threads):
        self.tree = tree
        self.towards = None if towards is None else in_blocks(towards, rows, n_threads)
        self.carried = in_blocks(carried, rows, n_threads)
        self.normal_range = normal_range


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
        What eigenvalues of structure tensors are divided by; zero for the square of irradiance
        over bandwidth at the point.
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


cdef struct Plane:
    # A tangent plane: a point of it, two axes and the normal; and how far photons are looked for.
    const double* at
    double[9] frame
    double squared_bandwidth
    # Of the photons, NULL if they are projected along the normal.
    const double* towards
    Reach reach


cdef void open_plane(Plane* plane, Photons photons, Sites sites, Py_ssize_t row) noexcept nogil:
    cdef double bandwidth = sites.bandwidth[row]
    cdef double wide = photons.normal_range
    cdef Py_ssize_t axis
    plane.at = &sites.queries[row, 0]
    orthonormal_frame(plane.frame, plane.frame + 3, &sites.normals[row, 0])
    for axis in range(3):
        plane.frame[6 + axis] = sites.normals[row, axis]
    plane.squared_bandwidth = bandwidth * bandwidth
    plane.towards = NULL if photons.towards is None else &photons.towards[0, 0, 0]
    plane.reach.low = plane.reach.high = plane.at
    plane.reach.squared_limit = plane.squared_bandwidth
    plane.reach.squared_range = wide * wide if wide >= 0.0 else -1.0
    plane.reach.half_range = NULL
    plane.reach.n_metric = photons.tree.n_metric
    plane.reach.n_axes = photons.tree.n_axes


cdef inline double along(const double* axis, const double* lane) noexcept nogil:
    """Return the product of a vector with that of one lane of a block."""
    return axis[0] * lane[0] + axis[1] * lane[BLOCK] + axis[2] * lane[2 * BLOCK]


cdef inline bint project(
    const Plane* plane, Tree tree, Py_ssize_t block, int lane, double* offset
) noexcept nogil:
    """Write where on the plane the light of a photon would have landed (SSO08 Eq. A1–A2).

    Return whether it would: light from behind the plane would not.
    """
    cdef const double* x = &tree.coords[block, 0, lane]
    cdef const double* towards
    cdef double[3] apart
    cdef double height, cosine
    apart[0] = x[0] - plane.at[0]
    apart[1] = x[BLOCK] - plane.at[1]
    apart[2] = x[2 * BLOCK] - plane.at[2]
    offset[0] = product(plane.frame, apart)
    offset[1] = product(plane.frame + 3, apart)
    if plane.towards == NULL:
        return True
    towards = plane.towards + 3 * BLOCK * block + lane
    cosine = along(plane.frame + 6, towards)
    if cosine <= 0.0:
        return False
    height = product(plane.frame + 6, apart) / max(cosine, LEAST_COSINE)
    offset[0] -= height * along(plane.frame, towards)
    offset[1] -= height * along(plane.frame + 3, towards)
    return True


cdef inline double product(const double* a, const double* b) noexcept nogil:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


# --- bandwidths --------------------------------------------------------------------------------


def bandwidths(
    Tree tree, const double[:, ::1] queries, const Py_ssize_t[::1] order, double[::1] radius, *,
    Py_ssize_t k, double normal_range, int n_threads
):
    """Lower radii to the distance of the k-th nearest photon, of the queries named by `order`.

    Where fewer than k are within the radius, or all are at the query, it stays.
    """
    cdef Py_ssize_t n_batches = (order.shape[0] + BLOCK - 1) // BLOCK
    cdef unsigned char[:, ::1] room = scratch(tree, k, n_threads)
    cdef Py_ssize_t i
    if queries.shape[0] != radius.shape[0] or queries.shape[1] < tree.n_axes:
        raise ValueError("queries do not fit the tree and the radii")
    for i in prange(
        n_batches, nogil=True, schedule="dynamic", chunksize=16, num_threads=n_threads
    ):
        open_batch(
            tree, <Batch*> &room[threadid(), 0], queries, order, BLOCK * i, radius, normal_range
        )
        close_batch(tree, <Batch*> &room[threadid(), 0], order, BLOCK * i, radius)


cdef void open_batch(
    Tree tree, Batch* batch, const double[:, ::1] queries, const Py_ssize_t[::1] order,
    Py_ssize_t first, const double[::1] radius, double normal_range
) noexcept nogil:
    """Open 16 queries that follow each other, from `first` on."""
    cdef Py_ssize_t i
    cdef Query* query
    batch.n_queries = 0
    for i in range(first, min(first + BLOCK, order.shape[0])):
        query = &batch.queries[batch.n_queries]
        open_query(tree, batch, &queries[order[i], 0])
        limit_radius(query, radius[order[i]] * radius[order[i]])
        if normal_range >= 0.0:
            limit_range(query, normal_range)


cdef void close_batch(
    Tree tree, Batch* batch, const Py_ssize_t[::1] order, Py_ssize_t first, double[::1] radius
) noexcept nogil:
    """Search, and write how far the queries reach; write their rows only."""
    cdef Py_ssize_t i
    cdef const Query* query
    find(tree, batch)
    for i in range(batch.n_queries):
        query = &batch.queries[i]
        if query.found.count == batch.k and query.found.squared_radius > 0.0:
            radius[order[first + i]] = WITHOUT_LAST * sqrt(query.found.squared_radius)


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
    """Write the gradients of irradiance (m, 3), W/m³, at the sites named by `order`."""
    cdef Py_ssize_t i
    if out.shape[0] != sites.queries.shape[0] or out.shape[1] != 3:
        raise ValueError("gradients do not fit the sites")
    for i in prange(
        order.shape[0], nogil=True, schedule="dynamic", chunksize=64, num_threads=n_threads
    ):
        write_gradient(photons, sites, order[i], &out[order[i], 0])


cdef void write_gradient(
    Photons photons, Sites sites, Py_ssize_t row, double* out
) noexcept nogil:
    """Differentiate the Epanechnikov estimate at one site (SSO08 Eq. 13); write its row only.

    ∂/∂x of 2/(π h²) Σ (1 - |x - xᵢ|²/h²) Φᵢ is 4/(π h⁴) Σ (xᵢ - x) Φᵢ.
    """
    cdef Slope slope
    cdef double scale
    cdef Py_ssize_t axis
    open_plane(&slope.plane, photons, sites, row)
    slope.flux = &photons.carried[0, 0, 0]
    slope.n_columns = photons.carried.shape[1]
    slope.u = slope.v = 0.0
    visit_within(photons.tree, &slope.plane.reach, add_slope, &slope)
    scale = 4.0 / (M_PI * slope.plane.squared_bandwidth * slope.plane.squared_bandwidth)
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
        if offset[0] * offset[0] + offset[1] * offset[1] < slope.plane.squared_bandwidth:
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
    visit_within(photons.tree, &tensor.plane.reach, add_tensor, tensor)
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
        weight = offset[0] * offset[0] + offset[1] * offset[1]
        weight = 1.0 - weight / tensor.plane.squared_bandwidth
        if weight <= 0.0:
            continue
        u = along(tensor.plane.frame, carried + BLOCK + lane)
        v = along(tensor.plane.frame + 3, carried + BLOCK + lane)
        tensor.weight += weight
        tensor.flux += weight * carried[lane]
        tensor.uu += weight * u * u
        tensor.uv += weight * u * v
        tensor.vv += weight * v * v


cdef void shape(Tensor* tensor, Shaping shaping) noexcept nogil:
    """Set the eigenvalues of the diffusion tensor (SSO08 Eq. 15–16).

    The edge is measured against the map's largest, or against what it would be if irradiance
    changed by as much as it is over the bandwidth: |∇E|·h/E squared.
    """
    cdef double edge = tensor.edge, irradiance
    tensor.length = tensor.width = 1.0
    if edge <= 0.0 or tensor.flux <= 0.0:
        return
    if shaping.largest > 0.0:
        edge /= shaping.largest
    else:
        irradiance = 2.0 * tensor.flux / (M_PI * tensor.plane.squared_bandwidth)
        edge *= tensor.plane.squared_bandwidth / (irradiance * irradiance)
    tensor.width = 1.0 / (1.0 + pow(edge / shaping.edge_threshold, shaping.exponent))
    tensor.width = max(tensor.width, shaping.least_eigenvalue)
    if shaping.isotropic:
        tensor.length = tensor.width


def eigenvalues(
    Photons photons, Sites sites, const Py_ssize_t[::1] order, double[::1] out, int n_threads
):
    """Write the first eigenvalues of the structure tensors at the sites named by `order`."""
    cdef Py_ssize_t i
    if out.shape[0] != sites.queries.shape[0]:
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
    """Write the half-axes of the kernels' ellipses (m, 2, 3), along the structure and across."""
    cdef Py_ssize_t i
    if not (out.shape[0] == sites.queries.shape[0] and out.shape[1] == 2 and out.shape[2] == 3):
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
    shape(&tensor, shaping)
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
        self.blocks = in_blocks(values, rows, n_threads)


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
        and values.blocks.shape[0] == photons.carried.shape[0] and photons.carried.shape[1] == 4
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
    shape(&tensor, shaping)
    visit_within(photons.tree, &tensor.plane.reach, gather, &gathered)
    area = M_PI * tensor.plane.squared_bandwidth * sqrt(tensor.length * tensor.width)
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
        weight = across * across / tensor.width + forth * forth / tensor.length
        weight = 1.0 - weight / tensor.plane.squared_bandwidth
        if weight > 0.0:
            for channel in range(gathered.n_channels):
                gathered.out[channel] += weight * values[BLOCK * channel + lane]
