# distutils: sources = src/photonrelax/_ext/spatial/simd/dispatch.c
"""k-d tree: blocks of points and their bounding boxes; see tree.pxd."""

import math
import os

from cython.parallel cimport prange
from libc.float cimport DBL_MAX
from libc.math cimport INFINITY
from libc.string cimport memcpy

import numpy as np

from ..common.prefetch cimport prefetch_row
from ..common.threads cimport team_size
from .simd.kernels cimport simd_kernels_named

from .build import median_order

cdef enum:
    # Loads that straddle two cache lines take twice as long.
    CACHE_LINE = 64
    # Blocks of a thread, at least.
    BLOCKS_PER_THREAD = 1 << 10
    GROUPS_PER_THREAD = BLOCKS_PER_THREAD // BLOCK


def aligned(shape, dtype=np.float64):
    """Uninitialised array aligned to cache lines."""
    n_bytes = math.prod(shape) * np.dtype(dtype).itemsize
    memory = np.empty(n_bytes + CACHE_LINE - 1, dtype=np.uint8)
    first = -memory.ctypes.data % CACHE_LINE
    return memory[first : first + n_bytes].view(dtype).reshape(shape)


def instruction_set():
    """Name of the instruction set of searches, avx512, avx2 or portable: the widest there is.

    The environment variable PHOTONRELAX_SIMD selects another; results are the same.

    Raises
    ------
    ValueError
        If the processor does not have the one selected.
    """
    return selected_kernels().name.decode()


cdef const SimdKernels* selected_kernels() except NULL:
    wanted = os.environ.get("PHOTONRELAX_SIMD", "")
    cdef const SimdKernels* simd = simd_kernels_named(wanted.encode())
    if simd == NULL:
        raise ValueError(
            "PHOTONRELAX_SIMD should be avx512, avx2 or portable, and the processor should have "
            f"it, but is {wanted!r}; the widest here is {simd_kernels_named(b'').name.decode()}"
        )
    return simd


cdef bint comes_after(const double[:, ::1] points, int64_t a, int64_t b) noexcept nogil:
    """Lexicographic order of points: by coordinates, then by id."""
    cdef Py_ssize_t axis
    for axis in range(points.shape[1]):
        if points[a, axis] != points[b, axis]:
            return points[a, axis] > points[b, axis]
    return a > b


cdef bint coincide(
    const double[:, ::1] points, Py_ssize_t n_axes, int64_t a, int64_t b
) noexcept nogil:
    cdef Py_ssize_t axis
    for axis in range(n_axes):
        if points[a, axis] != points[b, axis]:
            return False
    return True


cdef void sort_block(Tree tree, const double[:, ::1] points, Py_ssize_t block) noexcept nogil:
    """Sort the points of a block by coordinates.

    Sums over neighbours then have the same bits in whatever order the caller gives the points.
    """
    cdef int64_t* ids = &tree.ids[BLOCK * block]
    cdef Py_ssize_t n = points_of_block(tree, block)
    cdef int64_t[BLOCK] unsorted
    cdef int64_t[BLOCK] rank
    cdef Py_ssize_t lane
    if not rank_lanes(points, ids, n, rank):
        sort_tied(tree, points, ids, n)
        return
    memcpy(unsorted, ids, n * sizeof(int64_t))
    for lane in range(n):
        ids[rank[lane]] = unsorted[lane]


cdef bint rank_lanes(
    const double[:, ::1] points, const int64_t* ids, Py_ssize_t n, int64_t* rank
) noexcept nogil:
    """Number of points whose first coordinate is less; return False if some have the same.

    Comparing all with all, in vectors, takes half the time of a sort, which has branches that
    cannot be predicted.
    """
    cdef double[BLOCK] x
    cdef Py_ssize_t lane, other
    cdef int64_t n_pairs = 0
    for lane in range(BLOCK):
        x[lane] = points[ids[lane], 0] if lane < n else INFINITY
        rank[lane] = 0
    for other in range(BLOCK):
        for lane in range(BLOCK):
            rank[lane] += x[other] < x[lane]
    for lane in range(n):
        n_pairs += rank[lane]
    return 2 * n_pairs == n * (n - 1)


cdef void sort_tied(
    Tree tree, const double[:, ::1] points, int64_t* ids, Py_ssize_t n
) noexcept nogil:
    cdef Py_ssize_t place, hole
    cdef int64_t own
    for place in range(1, n):
        own = ids[place]
        hole = place
        while hole > 0 and comes_after(points, ids[hole - 1], own):
            ids[hole] = ids[hole - 1]
            hole -= 1
        ids[hole] = own
        if hole > 0 and coincide(points, tree.n_metric, ids[hole - 1], own):
            tree.may_coincide = True


cdef void place_block(Tree tree, const double[:, ::1] points, Py_ssize_t block) noexcept nogil:
    """Copy the coordinates of a block's points from their rows."""
    cdef Py_ssize_t lane, axis, place
    # Rows of the next block, which are scattered over the table.
    for place in range(BLOCK * block + BLOCK, min(BLOCK * block + 2 * BLOCK, tree.n_points)):
        prefetch_row(&points[tree.ids[place], 0], tree.n_axes * sizeof(double))
    sort_block(tree, points, block)
    for lane in range(points_of_block(tree, block)):
        for axis in range(tree.n_axes):
            tree.coords[block, axis, lane] = points[tree.ids[BLOCK * block + lane], axis]
    fill_lanes(tree, block)


cdef void move_block(
    Tree tree, const double[:, ::1] moved, Py_ssize_t first_axis, double scale, Py_ssize_t block
) noexcept nogil:
    """Overwrite some axes of a block with `moved`, stored in tree order, times `scale`."""
    cdef Py_ssize_t lane, axis
    for lane in range(points_of_block(tree, block)):
        for axis in range(moved.shape[1]):
            tree.coords[block, first_axis + axis, lane] = scale * moved[BLOCK * block + lane, axis]


cdef void fill_lanes(Tree tree, Py_ssize_t block) noexcept nogil:
    """Set lanes without a point to infinity."""
    cdef Py_ssize_t lane, axis
    for axis in range(tree.n_axes):
        for lane in range(points_of_block(tree, block), BLOCK):
            tree.coords[block, axis, lane] = INFINITY


cdef void fill_leaf_group(Tree tree, const double[:, ::1] points, Py_ssize_t g) noexcept nogil:
    """Coordinates, boxes and lowest ids of the blocks of one group of the last kept level."""
    cdef Py_ssize_t node = g * fan_out(tree, last_kept(tree))
    cdef Py_ssize_t end = node + fan_out(tree, last_kept(tree))
    cdef Py_ssize_t block
    for block in range(first_block(tree, node), first_block(tree, end)):
        place_block(tree, points, block)
    box_leaf_group(tree, g)
    set_lowest_ids(tree, last_kept(tree), g)


cdef void box_leaf_group(Tree tree, Py_ssize_t g) noexcept nogil:
    """Bounding boxes of the blocks of one group of the last kept level."""
    cdef Py_ssize_t last = last_kept(tree)
    cdef Py_ssize_t node = g * fan_out(tree, last)
    cdef Py_ssize_t group = tree.first_group[last] + g
    cdef Py_ssize_t child, block, axis
    for child in range(fan_out(tree, last)):
        block = first_block(tree, node + child)
        if block == first_block(tree, node + child + 1):
            continue
        for axis in range(tree.n_axes):
            box_lanes(
                tree, group, child, axis, &tree.coords[block, axis, 0],
                &tree.coords[block, axis, 0], points_of_block(tree, block)
            )


cdef void box_inner_group(Tree tree, Py_ssize_t level, Py_ssize_t g) noexcept nogil:
    """Bounding boxes of the groups below one group of an inner kept level."""
    cdef Py_ssize_t group = tree.first_group[level] + g
    cdef Py_ssize_t child, below, axis
    for child in range(fan_out(tree, level)):
        below = tree.first_group[level + 1] + g * fan_out(tree, level) + child
        for axis in range(tree.n_axes):
            box_lanes(
                tree, group, child, axis, &tree.boxes[below, 0, axis, 0],
                &tree.boxes[below, 1, axis, 0], BLOCK
            )


cdef inline void box_lanes(
    Tree tree, Py_ssize_t group, Py_ssize_t child, Py_ssize_t axis, const double* least,
    const double* most, Py_ssize_t count
) noexcept nogil:
    cdef double low = INFINITY
    cdef double high = -INFINITY
    cdef Py_ssize_t lane
    for lane in range(count):
        low = min(low, least[lane])
        high = max(high, most[lane])
    tree.boxes[group, 0, axis, child] = low
    tree.boxes[group, 1, axis, child] = high


cdef void set_lowest_ids(Tree tree, Py_ssize_t level, Py_ssize_t g) noexcept nogil:
    """Set the lowest id of each node of one group; those of the groups below are set."""
    cdef Py_ssize_t child, node
    for child in range(fan_out(tree, level)):
        node = g * fan_out(tree, level) + child
        tree.lowest_id[tree.first_group[level] + g, child] = (
            lowest_of_block(tree, node) if level == last_kept(tree)
            else lowest_of_group(tree, tree.first_group[level + 1] + node)
        )


cdef int64_t lowest_of_block(Tree tree, Py_ssize_t node) noexcept nogil:
    cdef int64_t lowest = tree.n_points
    cdef Py_ssize_t block, place
    for block in range(first_block(tree, node), first_block(tree, node + 1)):
        for place in range(BLOCK * block, BLOCK * block + points_of_block(tree, block)):
            lowest = min(lowest, tree.ids[place])
    return lowest


cdef int64_t lowest_of_group(Tree tree, Py_ssize_t group) noexcept nogil:
    cdef int64_t lowest = tree.n_points
    cdef Py_ssize_t child
    for child in range(BLOCK):
        lowest = min(lowest, tree.lowest_id[group, child])
    return lowest


cdef class Tree:
    """Compiled part of `photonrelax.KDTree`, which validates the arguments."""

    def __init__(
        self, const double[:, ::1] points, Py_ssize_t n_metric, const double[::1] axis_scale,
        int n_threads
    ):
        """Build the tree; nodes are split on the axis of largest extent times `axis_scale`."""
        cdef Py_ssize_t g, level, n_groups
        self.simd = selected_kernels()
        self.n_points = points.shape[0]
        self.n_axes = points.shape[1]
        self.n_metric = n_metric
        self.n_blocks = (self.n_points + BLOCK - 1) // BLOCK
        # First: its temporaries are larger than any array of the tree.
        tied = np.zeros(1, np.uint8)
        self.ids = median_order(points, axis_scale, n_threads, tied)
        self.may_coincide = tied[0]
        self.allocate()
        if self.n_points == 0:
            return
        n_groups = self.groups_of(last_kept(self))
        for g in prange(
            n_groups, nogil=True, schedule="static",
            num_threads=team_size(n_threads, n_groups, GROUPS_PER_THREAD)
        ):
            fill_leaf_group(self, points, g)
        for level in range(last_kept(self) - 1, -1, -1):
            for g in range(self.groups_of(level)):
                set_lowest_ids(self, level, g)
        self.box_above()

    def allocate(self):
        """Allocate blocks and boxes; boxes of nodes without points are empty."""
        self.n_levels = max(self.n_blocks - 1, 0).bit_length()
        inner = max((self.n_levels - 1) // 4, 0)
        first = self.n_levels - 4 * inner
        sizes = [1] + [1 << (first + 4 * level) for level in range(inner)]
        self.first_group = np.cumsum([0] + sizes, dtype=np.intp)
        self.coords = aligned((self.n_blocks, self.n_axes, BLOCK))
        boxes = aligned((sum(sizes), 2, self.n_axes, BLOCK))
        boxes[:, 0] = np.inf
        boxes[:, 1] = -np.inf
        self.boxes = boxes
        self.lowest_id = np.empty((sum(sizes), BLOCK), dtype=np.int64)
        self.low = np.full(self.n_axes, np.inf)
        self.high = np.full(self.n_axes, -np.inf)

    def move(self, const double[:, ::1] moved, Py_ssize_t first_axis, double scale, int n_threads):
        """Set coordinates, given in tree order, from an axis on; call `box` afterwards."""
        cdef Py_ssize_t block
        if moved.shape[0] != self.n_points or first_axis + moved.shape[1] > self.n_axes:
            raise ValueError("coordinates do not fit the tree")
        for block in prange(
            self.n_blocks, nogil=True, schedule="static",
            num_threads=team_size(n_threads, self.n_blocks, BLOCKS_PER_THREAD)
        ):
            move_block(self, moved, first_axis, scale, block)

    def box(self, int n_threads):
        """Recompute the bounding boxes of all nodes, from the blocks upwards."""
        cdef Py_ssize_t n_groups = self.groups_of(last_kept(self))
        cdef Py_ssize_t g
        for g in prange(
            n_groups, nogil=True, schedule="static",
            num_threads=team_size(n_threads, n_groups, GROUPS_PER_THREAD)
        ):
            box_leaf_group(self, g)
        self.box_above()

    def box_above(self):
        """Recompute the bounding boxes of the nodes above those of the last kept level."""
        cdef Py_ssize_t g, level
        for level in range(last_kept(self) - 1, -1, -1):
            for g in range(self.groups_of(level)):
                box_inner_group(self, level, g)
        self.box_all()

    cdef Py_ssize_t groups_of(self, Py_ssize_t level) noexcept nogil:
        return self.first_group[level + 1] - self.first_group[level]

    def box_all(self):
        cdef double squared = 0.0
        cdef Py_ssize_t axis
        boxes = np.asarray(self.boxes)[0]
        self.low = boxes[0].min(axis=1)
        self.high = boxes[1].max(axis=1)
        for axis in range(self.n_metric):
            squared += (self.high[axis] - self.low[axis]) * (self.high[axis] - self.low[axis])
        self.squared_diagonal = min(squared, DBL_MAX)
