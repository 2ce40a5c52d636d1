"""The largest of what photons carry within a radius: the loop body writes row i only."""

from cython.parallel cimport prange

from ..spatial.tree cimport Tree
from ..spatial.simd.kernels cimport BLOCK, SearchBounds, lowest_bit
from ..spatial.radius cimport visit_radius

from ..spatial.blocks import to_soa_blocks


cdef struct Largest:
    # What is compared, (n_blocks, n_channels, 16), and the largest so far.
    const double* values
    Py_ssize_t n_channels
    double* out


cdef void compare(void* state, Tree tree, Py_ssize_t block, unsigned int lanes) noexcept nogil:
    cdef Largest* largest = <Largest*> state
    cdef const double* values = largest.values + BLOCK * largest.n_channels * block
    cdef int lane
    cdef Py_ssize_t channel
    while lanes:
        lane = lowest_bit(lanes)
        lanes &= lanes - 1
        for channel in range(largest.n_channels):
            largest.out[channel] = max(largest.out[channel], values[BLOCK * channel + lane])


cdef class Bounds:
    """Photons and what is bounded of them around points.

    Parameters
    ----------
    tree : Tree
    values : (m, c) float64 array
        What is compared.
    rows : (n,) intp array
        Row of the photon at each place of the tree.
    normal_range : float
        Radius of the ball over the tree's range axes; negative for none.
    """

    cdef Tree tree
    cdef const double[:, :, ::1] values
    cdef double squared_range

    def __init__(self, tree, values, rows, *, normal_range, n_threads):
        self.tree = tree
        self.values = to_soa_blocks(values, rows, n_threads)
        self.squared_range = normal_range * normal_range if normal_range >= 0.0 else -1.0

    def raise_to(
        self, const double[:, ::1] queries, const Py_ssize_t[::1] order, const double[::1] radius,
        *, double[:, ::1] out, int n_threads
    ):
        """Raise `out` to the largest values within `radius` of the queries named by `order`.

        `radius` and `out` have a row for each of all queries.
        """
        cdef Py_ssize_t i
        if not (
            queries.shape[0] == radius.shape[0] == out.shape[0]
            and queries.shape[1] >= self.tree.n_metric
            and (self.squared_range < 0.0 or queries.shape[1] == self.tree.n_axes)
            and out.shape[1] == self.values.shape[1]
        ):
            raise ValueError("queries, radii and bounds do not fit one another")
        for i in prange(
            order.shape[0], nogil=True, schedule="dynamic", chunksize=256, num_threads=n_threads
        ):
            raise_one(self, queries, order[i], radius, out)


cdef void raise_one(
    Bounds photons, const double[:, ::1] queries, Py_ssize_t row, const double[::1] radius,
    double[:, ::1] out
) noexcept nogil:
    """Raise the bounds around one query; write its row only."""
    cdef Largest largest
    cdef SearchBounds bounds
    bounds.low = bounds.high = &queries[row, 0]
    bounds.squared_limit = radius[row] * radius[row]
    bounds.squared_range = photons.squared_range
    bounds.half_range = NULL
    bounds.n_metric = photons.tree.n_metric
    bounds.n_axes = photons.tree.n_axes
    # Of no points there are no values.
    largest.values = &photons.values[0, 0, 0] if photons.values.shape[0] > 0 else NULL
    largest.n_channels = photons.values.shape[1]
    largest.out = &out[row, 0]
    visit_radius(photons.tree, &bounds, compare, &largest)
