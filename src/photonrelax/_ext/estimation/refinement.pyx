# distutils: language = c++
"""Kernel estimates from as many photons as suit each point; the rules are in adaptive.py."""

from cython.parallel cimport prange, threadid
from libc.math cimport M_PI, fabs, sqrt
from libc.stdint cimport int64_t

import numpy as np

from ..spatial.batch cimport Batch, Query, allocate_batches, limit_radius, limit_range, open_query
from ..spatial.tree cimport Tree
from ..spatial.simd.kernels cimport BLOCK
from ..spatial.knn cimport query_batch
from ..spatial.radius cimport weight_of

from ..spatial.blocks import to_soa_blocks

cdef enum Rule:
    CHECKING
    COMPENSATION

    # After so many rises, or falls, in a row the kernel stops growing.
    STEPS = 6

DIFFERENTIAL_CHECKING = <int> CHECKING
BIAS_COMPENSATION = <int> COMPENSATION

# By how much the number of photons grows from one look at the estimate to the next.
cdef double GROWTH = 1.2
# Deviations beyond so many standard deviations are too rare for noise: one in a hundred.
cdef double SIGNIFICANT = 2.576


cdef extern from "<algorithm>" namespace "std" nogil:
    void sort(Near* first, Near* last)


cdef extern from *:
    """
    struct Near {
        double squared;
        int64_t place;
        double flux, squared_flux;
        bool operator<(const Near& other) const {
            return squared < other.squared || (squared == other.squared && place < other.place);
        }
    };
    """
    cdef cppclass Near:
        # Squared distance and place of a photon; sums over all that are nearer.
        double squared
        int64_t place
        double flux
        double squared_flux


cdef class Gather:
    """Photons to gather from and how.

    Parameters
    ----------
    tree : Tree
    values : (m, c) float64 array
        What is summed.
    flux : (m,) float64 array
        What numbers of photons are chosen by, in a unit that leaves its squares finite.
    rows : (n,) intp array
        Row of the photon at each place of the tree.
    k_min, k : int
        The fewest and the most photons.
    rule : int
        DIFFERENTIAL_CHECKING or BIAS_COMPENSATION.
    kernel : int
        CONSTANT, CONE or EPANECHNIKOV of estimate.pyx.
    radius : float
        Where k_min photons are farther away, all up to here are gathered; may be infinite.
    normal_range : float
        Radius of the ball over the tree's range axes; negative for none.
    bias : (float, float)
        a, b: estimates of K photons are divided by 1 - a K^b.
    """

    cdef Tree tree
    # (n_blocks, c, 16), and by place.
    cdef const double[:, :, ::1] values
    cdef const double[::1] flux
    # The place of each place, with room for a whole last block.
    cdef const int64_t[::1] places
    cdef Py_ssize_t k_min
    cdef Py_ssize_t k
    cdef int rule
    cdef int kernel
    cdef double squared_radius
    # As many as k_min where photons are as dense as k are that much farther out.
    cdef double squared_reach
    cdef double normal_range
    cdef double bias_factor
    cdef double bias_exponent

    def __init__(
        self, tree, values, flux, rows, *, k_min, k, rule, kernel, radius, normal_range, bias,
        n_threads
    ):
        if len(rows) != tree.n_points:
            raise ValueError("photons should have a row for each point of the tree")
        self.tree = tree
        self.values = to_soa_blocks(values, rows, n_threads)
        self.flux = flux[rows]
        self.places = np.arange(BLOCK * tree.n_blocks)
        self.k_min = k_min
        self.k = min(k, len(rows))
        self.rule = rule
        self.kernel = kernel
        self.squared_radius = radius * radius
        self.squared_reach = self.squared_radius * k / k_min
        self.normal_range = normal_range
        self.bias_factor, self.bias_exponent = bias

    def densities(
        self, const double[:, ::1] queries, const Py_ssize_t[::1] order, double[:, ::1] out,
        int n_threads
    ):
        """Write the values per area around the queries named by `order` to their rows of `out`.

        Queries that follow each other there should be near each other.
        """
        cdef Py_ssize_t n_batches = (order.shape[0] + BLOCK - 1) // BLOCK
        cdef unsigned char[:, ::1] batches = allocate_batches(self.tree, self.k, n_threads)
        cdef unsigned char[:, ::1] lists = np.empty(
            (n_threads, max(self.k, 1) * sizeof(Near)), dtype=np.uint8
        )
        cdef Py_ssize_t i
        if not (
            queries.shape[0] == out.shape[0] and queries.shape[1] >= self.tree.n_axes
            and out.shape[1] == self.values.shape[1]
        ):
            raise ValueError("queries, densities and what photons carry do not fit one another")
        for i in prange(
            n_batches, nogil=True, schedule="dynamic", chunksize=16, num_threads=n_threads
        ):
            gather_batch(
                self, <Batch*> &batches[threadid(), 0], <Near*> &lists[threadid(), 0], queries,
                order, i, out
            )


cdef void gather_batch(
    Gather photons, Batch* batch, Near* near, const double[:, ::1] queries,
    const Py_ssize_t[::1] order, Py_ssize_t number, double[:, ::1] out
) noexcept nogil:
    """Estimate the densities at 16 queries that follow each other; write their rows only."""
    cdef Py_ssize_t i, count
    cdef Query* query
    batch.n_queries = 0
    for i in range(BLOCK * number, min(BLOCK * number + BLOCK, order.shape[0])):
        query = &batch.queries[batch.n_queries]
        open_query(photons.tree, batch, &queries[order[i], 0])
        limit_radius(query, photons.squared_reach)
        if photons.normal_range >= 0.0:
            limit_range(query, photons.normal_range)
    query_batch(photons.tree, batch)
    for i in range(batch.n_queries):
        count = list_nearest(photons, batch, i, near)
        gather_one(photons, near, count, &out[order[BLOCK * number + i], 0])


cdef Py_ssize_t list_nearest(
    Gather photons, Batch* batch, Py_ssize_t i, Near* near
) noexcept nogil:
    """List what a query of the batch found, nearest first, and sums; return how many."""
    cdef const Query* query = &batch.queries[i]
    cdef Py_ssize_t j, count = query.candidates.count
    cdef double own, flux = 0.0, squared_flux = 0.0
    photons.tree.simd.gather_neighbours(
        &photons.tree.coords[0, 0, 0], &query.bounds, &query.candidates, &photons.places[0],
        batch.squared, batch.id
    )
    for j in range(count):
        near[j].squared = batch.squared[j]
        near[j].place = batch.id[j]
    sort(near, near + count)
    for j in range(count):
        near[j].flux = flux
        near[j].squared_flux = squared_flux
        own = photons.flux[near[j].place]
        flux += own
        squared_flux += own * own
    return count


cdef void gather_one(
    Gather photons, const Near* near, Py_ssize_t count, double* out
) noexcept nogil:
    """Estimate the densities at one query from its neighbours.

    The bandwidth is the distance to the last of those chosen, or the radius where that holds
    fewer than k_min, or k_min are at the query itself, as in estimate.pyx.
    """
    cdef Py_ssize_t k_min = photons.k_min, n, channel
    cdef double squared = photons.squared_radius, scale = 1.0
    if count >= k_min and 0.0 < near[k_min - 1].squared <= squared:
        n = chosen_number(photons, near, count) - 1
        squared = near[n].squared
        scale = 1.0 / (1.0 - photons.bias_factor * (n + 1.0) ** photons.bias_exponent)
    else:
        n = count_within(near, count, squared)
    weigh(photons, near, n, squared, out)
    for channel in range(photons.values.shape[1]):
        out[channel] *= scale / (M_PI * squared)


cdef Py_ssize_t count_within(const Near* near, Py_ssize_t count, double squared) noexcept nogil:
    while count > 0 and near[count - 1].squared > squared:
        count -= 1
    return count


cdef void weigh(
    Gather photons, const Near* near, Py_ssize_t n, double squared, double* out
) noexcept nogil:
    """Write the weighted sums over the n nearest."""
    cdef Py_ssize_t i, channel
    cdef double weight
    cdef const double* values
    for channel in range(photons.values.shape[1]):
        out[channel] = 0.0
    for i in range(n):
        weight = weight_of(photons.kernel, near[i].squared / squared)
        values = &photons.values[near[i].place // BLOCK, 0, near[i].place % BLOCK]
        for channel in range(photons.values.shape[1]):
            out[channel] += weight * values[BLOCK * channel]


cdef Py_ssize_t chosen_number(
    Gather photons, const Near* near, Py_ssize_t count
) noexcept nogil:
    """Return how many photons suit a query that has found at least k_min."""
    if photons.rule == CHECKING:
        return check(near, photons.k_min, count)
    return compensate(near, photons.k_min, count)


cdef inline double estimate(const Near* near, Py_ssize_t k) noexcept nogil:
    """Return π times the estimate of k photons by a constant kernel."""
    return near[k - 1].flux / near[k - 1].squared


cdef Py_ssize_t check(const Near* near, Py_ssize_t k_min, Py_ssize_t k) noexcept nogil:
    """Return at which number the estimate has kept rising or falling; differential checking."""
    cdef Py_ssize_t number = k_min
    cdef int rises = 0, falls = 0
    cdef double last = estimate(near, k_min), now
    while number < k and rises < STEPS and falls < STEPS:
        number = min(max(<Py_ssize_t> (GROWTH * number), number + 1), k)
        now = estimate(near, number)
        rises = rises + 1 if now > last else 0
        falls = falls + 1 if now < last else 0
        last = now
    return number


cdef Py_ssize_t compensate(const Near* near, Py_ssize_t k_min, Py_ssize_t k) noexcept nogil:
    """Return the greatest number, by binary search, not known for bias; bias compensation."""
    cdef Py_ssize_t low = k_min, high = k, middle
    cdef double now, mean = estimate(near, k_min), weight = k_min
    while low < high:
        middle = (low + high + 1) // 2
        now = estimate(near, middle)
        if fabs(now - mean) > SIGNIFICANT * fabs(mean) * deviation(near, low, middle):
            high = middle - 1
        else:
            mean = (weight * mean + middle * now) / (weight + middle)
            weight += middle
            low = middle
    return low


cdef inline double deviation(const Near* near, Py_ssize_t low, Py_ssize_t high) noexcept nogil:
    """Return how far estimates of `low` and `high` photons deviate, relative to their mean."""
    cdef const Near* last = &near[high - 1]
    cdef double unevenness
    if last.flux == 0.0:
        return 0.0
    unevenness = (high - 1.0) * last.squared_flux / (last.flux * last.flux)
    return sqrt(unevenness * (1.0 / (low - 1.0) - 1.0 / (high - 1.0)))
