# distutils: sources = src/photonrelax/_ext/spatial/simd/kernels.c
"""The tree: its points in blocks, boxes around them; see kdtree.pxd."""

import math
import os

from cython.parallel cimport prange
from libc.float cimport DBL_MAX
from libc.math cimport INFINITY

import numpy as np

from .simd.kernels cimport lanes_named, prefetch_row

from .build import median_order

cdef enum:
    # Vectors that straddle two lines of the cache take twice as long to load.
    LINE = 64


def aligned(shape, dtype=np.float64):
    """Return an array with anything in it that starts where a line of the cache does."""
    n_bytes = math.prod(shape) * np.dtype(dtype).itemsize
    room = np.empty(n_bytes + LINE - 1, dtype=np.uint8)
    first = -room.ctypes.data % LINE
    return room[first : first + n_bytes].view(dtype).reshape(shape)


def instruction_set():
    """Return which of avx512, avx2 and portable searches use: the widest the processor has.

    The environment variable PHOTONRELAX_SIMD asks for another; results are the same.

    Raises
    ------
    ValueError
        If the processor does not have what the variable asks for.
    """
    return chosen_lanes().name.decode()


cdef const Lanes* chosen_lanes() except NULL:
    wanted = os.environ.get("PHOTONRELAX_SIMD", "")
    cdef const Lanes* lanes = lanes_named(wanted.encode())
    if lanes == NULL:
        raise ValueError(
            "PHOTONRELAX_SIMD should be avx512, avx2 or portable, and the processor should have "
            f"it, but is {wanted!r}; the widest here is {lanes_named(b'').name.decode()}"
        )
    return lanes


cdef bint comes_after(const double[:, ::1] points, int64_t a, int64_t b) noexcept nogil:
    """Order by the first coordinate that differs, points of equal coordinates by id."""
    cdef Py_ssize_t axis
    for axis in range(points.shape[1]):
        if points[a, axis] != points[b, axis]:
            return points[a, axis] > points[b, axis]
    return a > b


cdef void sort_block(Tree tree, const double[:, ::1] points, Py_ssize_t block) noexcept nogil:
    """Put the block's points in an order that is that of their coordinates, not of their rows.

    Sums over neighbours then have the same bits in whatever order the points come.
    """
    cdef Py_ssize_t first = BLOCK * block
    cdef Py_ssize_t place, hole
    cdef int64_t own
    for place in range(first + 1, first + points_of_block(tree, block)):
        own = tree.ids[place]
        hole = place
        while hole > first and comes_after(points, tree.ids[hole - 1], own):
            tree.ids[hole] = tree.ids[hole - 1]
            hole -= 1
        tree.ids[hole] = own


cdef void place_block(Tree tree, const double[:, ::1] points, Py_ssize_t block) noexcept nogil:
    """Copy the coordinates of the block's points from their rows."""
    cdef Py_ssize_t lane, axis, place
    # The rows of the next block are all over the table.
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
    """Copy some coordinates, multiplied by `scale`, of the block's points from their places."""
    cdef Py_ssize_t lane, axis
    for lane in range(points_of_block(tree, block)):
        for axis in range(moved.shape[1]):
            tree.coords[block, first_axis + axis, lane] = scale * moved[BLOCK * block + lane, axis]


cdef void fill_lanes(Tree tree, Py_ssize_t block) noexcept nogil:
    """Put lanes without a point at infinity."""
    cdef Py_ssize_t lane, axis
    for axis in range(tree.n_axes):
        for lane in range(points_of_block(tree, block), BLOCK):
            tree.coords[block, axis, lane] = INFINITY


cdef void box_leaf_group(Tree tree, Py_ssize_t g) noexcept nogil:
    """Box the blocks of one group of the last kept level."""
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
    """Box the groups below one group of an inner kept level."""
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


cdef void find_lowest_ids(Tree tree) noexcept nogil:
    """Note the lowest id of each node, from the blocks upwards."""
    cdef Py_ssize_t last = last_kept(tree)
    cdef Py_ssize_t level, g, child, node
    for level in range(last, -1, -1):
        for g in range(tree.first_group[level + 1] - tree.first_group[level]):
            for child in range(fan_out(tree, level)):
                node = g * fan_out(tree, level) + child
                tree.lowest_id[tree.first_group[level] + g, child] = (
                    lowest_of_block(tree, node) if level == last
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
    """The compiled tree behind `photonrelax.KDTree`, which checks what comes in."""

    def __init__(
        self, const double[:, ::1] points, Py_ssize_t n_metric, const double[::1] axis_scale,
        int n_threads
    ):
        """Build; a node is split across the axis on which extent times `axis_scale` is largest."""
        cdef Py_ssize_t block
        self.lanes = chosen_lanes()
        self.n_points = points.shape[0]
        self.n_axes = points.shape[1]
        self.n_metric = n_metric
        self.n_blocks = (self.n_points + BLOCK - 1) // BLOCK
        # First, as it takes more memory for itself than anything that is kept.
        self.ids = median_order(points, axis_scale, n_threads)
        self.allocate()
        if self.n_points == 0:
            return
        for block in prange(self.n_blocks, nogil=True, schedule="static", num_threads=n_threads):
            place_block(self, points, block)
        find_lowest_ids(self)
        self.box(n_threads)

    def allocate(self):
        """Make room for points and boxes; empty ones for nodes without points."""
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
        """Give points, by place, new coordinates from an axis on; `box` has to follow."""
        cdef Py_ssize_t block
        if moved.shape[0] != self.n_points or first_axis + moved.shape[1] > self.n_axes:
            raise ValueError("coordinates do not fit the tree")
        for block in prange(self.n_blocks, nogil=True, schedule="static", num_threads=n_threads):
            move_block(self, moved, first_axis, scale, block)

    def box(self, int n_threads):
        """Box all nodes, from the blocks upwards; which points they hold stays as it is."""
        cdef Py_ssize_t last = last_kept(self)
        cdef Py_ssize_t g, level
        for g in prange(
            self.first_group[last + 1] - self.first_group[last], nogil=True, schedule="static",
            num_threads=n_threads
        ):
            box_leaf_group(self, g)
        for level in range(last - 1, -1, -1):
            for g in range(self.first_group[level + 1] - self.first_group[level]):
                box_inner_group(self, level, g)
        self.box_all()

    def box_all(self):
        cdef double squared = 0.0
        cdef Py_ssize_t axis
        boxes = np.asarray(self.boxes)[0]
        self.low = boxes[0].min(axis=1)
        self.high = boxes[1].max(axis=1)
        for axis in range(self.n_metric):
            squared += (self.high[axis] - self.low[axis]) * (self.high[axis] - self.low[axis])
        self.squared_diagonal = min(squared, DBL_MAX)
