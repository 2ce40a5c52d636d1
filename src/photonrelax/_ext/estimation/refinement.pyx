# distutils: language = c++
"""Density estimates from a number of nearest photons that suits each point.

The rules are those of `photonrelax.estimation.refinement`.
"""

from cython cimport final
from libc.math cimport M_PI, fabs, sqrt
from libc.stdint cimport int64_t

import numpy as np

from ..spatial.batch cimport Batch, Query
from ..spatial.query_loop cimport BatchWork, search_queries
from ..spatial.radius cimport weight_of
from ..spatial.simd.kernels cimport BLOCK
from ..spatial.tree cimport Tree

cdef enum Rule:
    CHECKING
    COMPENSATION

    # Consecutive rises, or falls, of the estimate at which the kernel stops growing.
    MAX_STEPS = 6

DIFFERENTIAL_CHECKING = <int> CHECKING
BIAS_COMPENSATION = <int> COMPENSATION

# Factor of the number of photons from one step to the next.
cdef double GROWTH = 1.2
# Number of standard deviations that noise exceeds in one of a hundred cases.
cdef double SIGNIFICANT = 2.576


cdef extern from "<algorithm>" namespace "std" nogil:
    void sort(NearPhoton* first, NearPhoton* last)


cdef extern from *:
    """
    struct NearPhoton {
        double squared;
        int64_t place;
        double flux, squared_flux;
        bool operator<(const NearPhoton& other) const {
            return squared < other.squared || (squared == other.squared && place < other.place);
        }
    };
    """
    cdef cppclass NearPhoton:
        # Squared distance and tree position of a photon; sums over all nearer ones.
        double squared
        int64_t place
        double flux
        double squared_flux


@final
cdef class RefinedGather(BatchWork):
    """Numbers of nearest photons that are chosen for each query, or weighted sums over them."""

    # (n_blocks, c, 16) and (n,), in tree order.
    cdef const double[:, :, ::1] values
    cdef const double[::1] flux
    # Stand-ins for ids: tree positions, to whole blocks.
    cdef const int64_t[::1] places
    # A row per thread.
    cdef unsigned char[:, ::1] lists
    cdef Py_ssize_t k_min
    cdef int rule
    cdef int kernel
    cdef double squared_gather_radius
    cdef double bias_factor
    cdef double bias_exponent
    cdef const Py_ssize_t[::1] rows
    # Densities, or numbers alone.
    cdef double[:, ::1] out
    cdef double[::1] numbers
    cdef bint only_numbers

    cdef void finish(self, Batch* batch, Py_ssize_t first, int thread) noexcept nogil:
        """Write the densities at the queries of a batch, or the numbers chosen."""
        cdef Py_ssize_t i, count
        cdef NearPhoton* near = <NearPhoton*> &self.lists[thread, 0]
        for i in range(batch.n_queries):
            count = self.list_nearest(batch, i, near)
            if self.only_numbers:
                self.numbers[self.rows[first + i]] = self.chosen_number(near, count)
            else:
                self.write_densities(near, count, &self.out[self.rows[first + i], 0])

    cdef Py_ssize_t list_nearest(self, Batch* batch, Py_ssize_t i, NearPhoton* near) noexcept nogil:
        """Write the neighbours of a query, nearest first, with sums; return their number."""
        cdef const Query* query = &batch.queries[i]
        cdef Py_ssize_t j, count = query.candidates.count
        cdef double own, flux = 0.0, squared_flux = 0.0
        self.tree.simd.gather_neighbours(
            &self.tree.coords[0, 0, 0], &query.bounds, &query.candidates, &self.places[0],
            batch.squared, batch.id
        )
        for j in range(count):
            near[j].squared = batch.squared[j]
            near[j].place = batch.id[j]
        sort(near, near + count)
        for j in range(count):
            near[j].flux = flux
            near[j].squared_flux = squared_flux
            own = self.flux[near[j].place]
            flux += own
            squared_flux += own * own
        return count

    cdef void write_densities(
        self, const NearPhoton* near, Py_ssize_t count, double* out
    ) noexcept nogil:
        """Write the densities at one query from its neighbours.

        The bandwidth is the distance to the last of the number chosen, or the radius where that
        holds fewer than k_min, or k_min are at the query itself, as in nearest.pyx.
        """
        cdef Py_ssize_t n = self.chosen_number(near, count) - 1, channel
        cdef double squared = self.squared_gather_radius, scale = 1.0
        if n >= 0:
            squared = near[n].squared
            scale = 1.0 / (1.0 - self.bias_factor * (n + 1.0) ** self.bias_exponent)
        else:
            n = count_within(near, count, squared)
        self.write_sums(near, n, squared, out)
        for channel in range(self.values.shape[1]):
            out[channel] *= scale / (M_PI * squared)

    cdef Py_ssize_t chosen_number(self, const NearPhoton* near, Py_ssize_t count) noexcept nogil:
        """Number of photons that suits a query; zero where the bandwidth is the radius."""
        cdef Py_ssize_t last = self.k_min - 1
        if count <= last or not 0.0 < near[last].squared <= self.squared_gather_radius:
            return 0
        if self.rule == CHECKING:
            return check_differentials(near, self.k_min, count)
        return compensate_bias(near, self.k_min, count)

    cdef void write_sums(
        self, const NearPhoton* near, Py_ssize_t n, double squared, double* out
    ) noexcept nogil:
        """Write the weighted sums over the n nearest."""
        cdef Py_ssize_t i, channel
        cdef double weight
        cdef const double* values
        for channel in range(self.values.shape[1]):
            out[channel] = 0.0
        for i in range(n):
            weight = weight_of(self.kernel, near[i].squared / squared)
            values = &self.values[near[i].place // BLOCK, 0, near[i].place % BLOCK]
            for channel in range(self.values.shape[1]):
                out[channel] += weight * values[BLOCK * channel]


def gather(
    Tree tree, const double[:, :, ::1] values, const double[:, ::1] queries,
    const Py_ssize_t[::1] rows, double[:, ::1] out, *, const double[::1] flux, Py_ssize_t k_min,
    Py_ssize_t k, int rule, int kernel, double radius, double range_radius, bias, int n_threads
):
    """Write densities around the queries named by `rows`, close ones in sequence, to `out`.

    Parameters
    ----------
    tree, values, queries, rows, out, kernel, range_radius
        See `nearest.gather`.
    flux : (n,) float64 array
        Flux in tree order, which the numbers of photons follow from, in a unit that leaves its
        squares finite.
    k_min, k : int
        Least and largest number of photons.
    rule : int
        DIFFERENTIAL_CHECKING or BIAS_COMPENSATION.
    radius : float
        Bandwidth where k_min photons are farther away; may be infinite.
    bias : (float, float)
        a, b: estimates of K photons are divided by 1 - a K^b.
    """
    cdef RefinedGather work = RefinedGather(
        tree, k=min(k, tree.n_points), radius=radius, range_radius=range_radius
    )
    set_rule(work, flux, k_min, k, rule, n_threads)
    if not (
        queries.shape[0] == out.shape[0] and queries.shape[1] >= tree.n_axes
        and values.shape[0] == tree.n_blocks and values.shape[1] == out.shape[1]
    ):
        raise ValueError("queries, densities and photon values do not fit one another")
    work.values = values
    work.kernel = kernel
    work.bias_factor, work.bias_exponent = bias
    work.rows = rows
    work.out = out
    search_queries(work, queries, rows, n_threads)


def write_numbers(
    Tree tree, const double[:, ::1] queries, const Py_ssize_t[::1] rows, double[::1] out, *,
    const double[::1] flux, Py_ssize_t k_min, Py_ssize_t k, int rule, double radius,
    double range_radius, int n_threads
):
    """Write the numbers of photons chosen for the queries named by `rows` to `out` (m,).

    They are zero where the bandwidth is the radius. See `gather` for the arguments.
    """
    cdef RefinedGather work = RefinedGather(
        tree, k=min(k, tree.n_points), radius=radius, range_radius=range_radius
    )
    set_rule(work, flux, k_min, k, rule, n_threads)
    if queries.shape[0] != out.shape[0] or queries.shape[1] < tree.n_axes:
        raise ValueError("queries and numbers do not fit one another")
    work.rows = rows
    work.numbers = out
    work.only_numbers = True
    search_queries(work, queries, rows, n_threads)


cdef set_rule(
    RefinedGather work, const double[::1] flux, Py_ssize_t k_min, Py_ssize_t k, int rule,
    int n_threads
):
    """Set what numbers are chosen by; raises ValueError if there is no flux for each photon."""
    if flux.shape[0] != work.tree.n_points:
        raise ValueError("flux and photons do not fit one another")
    work.squared_gather_radius = work.squared_radius
    # As far as k photons are if they are as dense as k_min within the gather radius.
    work.squared_radius = work.squared_radius * k / k_min
    work.flux = flux
    work.places = np.arange(BLOCK * work.tree.n_blocks)
    work.lists = np.empty((n_threads, max(work.k, 1) * sizeof(NearPhoton)), dtype=np.uint8)
    work.k_min = k_min
    work.rule = rule


cdef Py_ssize_t count_within(
    const NearPhoton* near, Py_ssize_t count, double squared
) noexcept nogil:
    """Number of the photons within a squared radius."""
    while count > 0 and near[count - 1].squared > squared:
        count -= 1
    return count


cdef inline double estimate(const NearPhoton* near, Py_ssize_t k) noexcept nogil:
    """π times the estimate of k photons by a constant kernel, π E_k."""
    return near[k - 1].flux / near[k - 1].squared


cdef Py_ssize_t check_differentials(
    const NearPhoton* near, Py_ssize_t k_min, Py_ssize_t k
) noexcept nogil:
    """Number at which the estimate has kept rising or falling: differential checking."""
    cdef Py_ssize_t number = k_min
    cdef int rises = 0, falls = 0
    cdef double last = estimate(near, k_min), now
    while number < k and rises < MAX_STEPS and falls < MAX_STEPS:
        number = min(max(<Py_ssize_t> (GROWTH * number), number + 1), k)
        now = estimate(near, number)
        rises = rises + 1 if now > last else 0
        falls = falls + 1 if now < last else 0
        last = now
    return number


cdef Py_ssize_t compensate_bias(
    const NearPhoton* near, Py_ssize_t k_min, Py_ssize_t k
) noexcept nogil:
    """Greatest number, by binary search, whose deviation may be noise: bias compensation."""
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


cdef inline double deviation(
    const NearPhoton* near, Py_ssize_t low, Py_ssize_t high
) noexcept nogil:
    """Standard deviation between estimates of `low` and `high` photons, over their mean."""
    cdef const NearPhoton* last = &near[high - 1]
    cdef double unevenness
    if last.flux == 0.0:
        return 0.0
    unevenness = (high - 1.0) * last.squared_flux / (last.flux * last.flux)
    return sqrt(unevenness * (1.0 / (low - 1.0) - 1.0 / (high - 1.0)))
