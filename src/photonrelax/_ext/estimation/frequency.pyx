"""Maxima of photon values within a radius."""

from cython.parallel cimport prange, threadid

from ..common.threads cimport Watch, close_watch, goes_on, open_watch, team_size
from ..spatial.tree cimport Tree
from ..spatial.simd.kernels cimport BLOCK, SearchBounds, lowest_bit
from ..spatial.radius cimport LOOK_EVERY, QUERY_GRAIN, ball, visit_radius


cdef struct Largest:
    # (n_blocks, n_channels, 16), and the maxima so far.
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


cdef class MaxInRadius:
    """Maxima of photon values within a radius of points.

    Parameters
    ----------
    tree : Tree
    values : (n_blocks, c, 16) float64 array
        Values of the photons, in tree order.
    range_radius : float
        Radius of the ball over the tree's range axes; negative for none.
    """

    cdef Tree tree
    cdef const double[:, :, ::1] values
    cdef double range_radius

    def __init__(self, tree, values, *, range_radius):
        self.tree = tree
        self.values = values
        self.range_radius = range_radius
        if self.values.shape[0] != self.tree.n_blocks or self.values.shape[2] != BLOCK:
            raise ValueError("photon values do not fit the blocks of the tree")

    def update(
        self, const double[:, ::1] queries, const Py_ssize_t[::1] rows, const double[::1] radius,
        *, double[:, ::1] out, int n_threads
    ):
        """Raise `out` (m, c) to the maxima within `radius` (m,) of the queries named by `rows`."""
        cdef Py_ssize_t i
        if not (
            queries.shape[0] == radius.shape[0] == out.shape[0]
            and queries.shape[1] >= self.tree.n_metric
            and (self.range_radius < 0.0 or queries.shape[1] == self.tree.n_axes)
            and out.shape[1] == self.values.shape[1]
        ):
            raise ValueError("queries, radii and maxima do not fit one another")
        cdef Watch watch = open_watch()
        for i in prange(
            rows.shape[0], nogil=True, schedule="dynamic", chunksize=QUERY_GRAIN,
            num_threads=team_size(n_threads, rows.shape[0], QUERY_GRAIN)
        ):
            if goes_on(&watch, threadid() == 0 and i % LOOK_EVERY == 0):
                update_one(self, queries, rows[i], radius, out)
        close_watch(&watch)


cdef void update_one(
    MaxInRadius photons, const double[:, ::1] queries, Py_ssize_t row, const double[::1] radius,
    double[:, ::1] out
) noexcept nogil:
    """Raise the maxima around one query; write its row only."""
    cdef Largest largest
    cdef SearchBounds bounds = ball(
        photons.tree, &queries[row, 0], radius[row], photons.range_radius
    )
    # An empty tree has no values.
    largest.values = &photons.values[0, 0, 0] if photons.values.shape[0] > 0 else NULL
    largest.n_channels = photons.values.shape[1]
    largest.out = &out[row, 0]
    visit_radius(photons.tree, &bounds, compare, &largest)
