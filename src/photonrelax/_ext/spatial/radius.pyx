"""Fixed-radius query, and weighted sums over the points it finds; see radius.pxd."""

from cython.parallel cimport prange, threadid
from libc.float cimport DBL_MAX
from libc.stdint cimport int64_t

from ..common.threads cimport Watch, close_watch, goes_on, open_watch, team_size
from .tree cimport Tree, fan_out, first_block, last_kept
from .simd.kernels cimport BLOCK, SearchBounds, highest_bit, lowest_bit

from .blocks import to_soa_blocks

cdef enum:
    # Depth-first traversal leaves at most 15 open groups per kept level, of which there are 7.
    STACK_SIZE = 128


cdef void visit_radius(
    Tree tree, const SearchBounds* bounds, Visitor visit, void* state
) noexcept nogil:
    cdef Py_ssize_t[STACK_SIZE] open_level
    cdef Py_ssize_t[STACK_SIZE] open_group
    cdef Py_ssize_t n_open = 1, level, g, last = last_kept(tree)
    cdef SearchBounds finite = bounds[0]
    cdef unsigned int near, child
    if tree.n_points == 0:
        return
    # Lanes and boxes without a point are at infinity, and must stay outside.
    finite.squared_limit = min(finite.squared_limit, DBL_MAX)
    open_level[0] = open_group[0] = 0
    while n_open > 0:
        n_open -= 1
        level = open_level[n_open]
        g = open_group[n_open]
        near = tree.simd.overlapping_boxes(
            &tree.boxes[tree.first_group[level] + g, 0, 0, 0], BLOCK, &finite
        )
        if level == last:
            visit_blocks(tree, &finite, g * fan_out(tree, last), near, visit, state)
            continue
        while near:
            child = highest_bit(near)
            near ^= 1u << child
            open_level[n_open] = level + 1
            open_group[n_open] = g * fan_out(tree, level) + child
            n_open += 1


cdef void visit_blocks(
    Tree tree, const SearchBounds* bounds, Py_ssize_t node, unsigned int near, Visitor visit,
    void* state
) noexcept nogil:
    """Visit the blocks of those of 16 nodes that overlap the bounds."""
    cdef Py_ssize_t block
    cdef unsigned int lanes
    while near:
        block = first_block(tree, node + lowest_bit(near))
        near &= near - 1
        lanes = lanes_in_radius(tree, block, bounds)
        if lanes:
            visit(state, tree, block, lanes)


cdef unsigned int lanes_in_radius(
    Tree tree, Py_ssize_t block, const SearchBounds* bounds
) noexcept nogil:
    cdef double[BLOCK] squared
    cdef double[BLOCK] squared_range
    cdef unsigned int lanes = 0
    cdef Py_ssize_t lane
    squared_distances(tree, block, bounds.low, 0, tree.n_metric, squared)
    for lane in range(BLOCK):
        lanes |= <unsigned int> (squared[lane] <= bounds.squared_limit) << lane
    if bounds.squared_range >= 0.0 and lanes:
        squared_distances(tree, block, bounds.low, tree.n_metric, tree.n_axes, squared_range)
        for lane in range(BLOCK):
            if squared_range[lane] > bounds.squared_range:
                lanes &= ~(1u << lane)
    return lanes


cdef inline void squared_distances(
    Tree tree, Py_ssize_t block, const double* at, Py_ssize_t first, Py_ssize_t end,
    double* squared
) noexcept nogil:
    """Write the squared distances of the points of a block over a range of axes."""
    cdef const double* x
    cdef Py_ssize_t axis, lane
    for lane in range(BLOCK):
        squared[lane] = 0.0
    for axis in range(first, end):
        x = &tree.coords[block, axis, 0]
        for lane in range(BLOCK):
            squared[lane] += (x[lane] - at[axis]) * (x[lane] - at[axis])


cdef struct Sums:
    # Summands, (n_blocks, n_channels, 16).
    const double* values
    Py_ssize_t n_channels
    const double* at
    int shape
    double squared_radius
    # Photons that each of the tree's stands for, NULL where that is one.
    const int64_t* numbers
    int64_t count
    double* out


cdef void add(void* state, Tree tree, Py_ssize_t block, unsigned int lanes) noexcept nogil:
    cdef Sums* sums = <Sums*> state
    cdef double[BLOCK] squared
    cdef const double* values = sums.values + BLOCK * sums.n_channels * block
    cdef double weight
    cdef int lane
    cdef Py_ssize_t channel
    squared_distances(tree, block, sums.at, 0, tree.n_metric, squared)
    while lanes:
        lane = lowest_bit(lanes)
        lanes &= lanes - 1
        weight = weight_of(sums.shape, squared[lane] / sums.squared_radius)
        sums.count += 1 if sums.numbers == NULL else sums.numbers[BLOCK * block + lane]
        for channel in range(sums.n_channels):
            sums.out[channel] += weight * values[BLOCK * channel + lane]


cdef class RadiusGather:
    """Weighted sums of photon values within a radius of points.

    Parameters
    ----------
    tree : Tree
    values : (m, c) float64 array
        Summands.
    rows : (n,) intp array
        Rows of the photons, in tree order.
    kernel : int
        CONSTANT, CONE or EPANECHNIKOV of nearest.pyx.
    normal_range : float
        Radius of the ball over the tree's range axes; negative for none.
    numbers : (n,) int64 array, optional
        Photons that each of these stands for, in tree order.
    """

    cdef Tree tree
    cdef const double[:, :, ::1] values
    cdef const int64_t[::1] numbers
    cdef int kernel
    cdef double normal_range

    def __init__(self, tree, values, rows, kernel, *, normal_range, n_threads, numbers=None):
        self.tree = tree
        numbered = rows if numbers is None else numbers
        if not len(rows) == len(numbered) == self.tree.n_points:
            raise ValueError("photons should have a row for each point of the tree")
        self.numbers = numbers
        self.values = to_soa_blocks(values, rows, n_threads)
        self.kernel = kernel
        self.normal_range = normal_range

    def sums(
        self, const double[:, ::1] queries, const Py_ssize_t[::1] order, const double[::1] radius,
        *, double[:, ::1] out, int64_t[::1] counts, int n_threads
    ):
        """Write weighted sums, and photon counts, within `radius` of queries.

        `order` has the rows of the queries, close ones in sequence; `radius`, `out` and `counts`
        have a row for every query. Divided by π radius² sums are densities. Radii have to be
        positive and their squares finite.
        """
        cdef Py_ssize_t i
        if not (
            queries.shape[0] == radius.shape[0] == out.shape[0] == counts.shape[0]
            and queries.shape[1] >= self.tree.n_metric
            and (self.normal_range < 0.0 or queries.shape[1] == self.tree.n_axes)
            and out.shape[1] == self.values.shape[1]
        ):
            raise ValueError("queries, radii, sums and counts do not fit one another")
        cdef Watch watch = open_watch()
        for i in prange(
            order.shape[0], nogil=True, schedule="dynamic", chunksize=QUERY_GRAIN,
            num_threads=team_size(n_threads, order.shape[0], QUERY_GRAIN)
        ):
            if goes_on(&watch, threadid() == 0 and i % LOOK_EVERY == 0):
                counts[order[i]] = sum_one(
                    self, &queries[order[i], 0], radius[order[i]], &out[order[i], 0]
                )
        close_watch(&watch)


cdef int64_t sum_one(
    RadiusGather photons, const double* at, double radius, double* out
) noexcept nogil:
    """Write the sums around one query; return the number of photons."""
    cdef Sums sums
    cdef SearchBounds bounds = ball(photons.tree, at, radius, photons.normal_range)
    cdef Py_ssize_t channel
    sums.at = at
    sums.squared_radius = bounds.squared_limit
    # An empty tree has no values.
    sums.values = &photons.values[0, 0, 0] if photons.values.shape[0] > 0 else NULL
    sums.n_channels = photons.values.shape[1]
    sums.shape = photons.kernel
    sums.numbers = NULL
    if photons.numbers is not None and photons.numbers.shape[0] > 0:
        sums.numbers = &photons.numbers[0]
    sums.count = 0
    sums.out = out
    for channel in range(sums.n_channels):
        out[channel] = 0.0
    visit_radius(photons.tree, &bounds, add, &sums)
    return sums.count
