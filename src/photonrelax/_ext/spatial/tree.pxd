"""k-d tree: points in blocks, and bounding boxes on all axes.

Points are stored in blocks of 16, see simd/kernels.h. The tree is implicit: node j of level l holds
the blocks [(j * n_blocks) >> l, ((j + 1) * n_blocks) >> l), so a median split fixes all counts
whatever the coordinates are, and coincident points cannot unbalance it. Every fourth level is
kept: there 16 nodes with one ancestor four levels above form a group, whose boxes are tested at
once. The first kept level has one group, of 16 nodes or fewer.

The point at position `place` in tree order is in lane `place % 16` of block `place // 16`.
"""

from libc.stdint cimport int64_t

from .simd.kernels cimport BLOCK, SimdKernels


cdef class Tree:
    cdef readonly Py_ssize_t n_points
    cdef readonly Py_ssize_t n_axes
    cdef readonly Py_ssize_t n_metric
    cdef readonly Py_ssize_t n_blocks
    cdef readonly Py_ssize_t n_levels
    # (n_blocks, n_axes, 16)
    cdef readonly double[:, :, ::1] coords
    # Ids, the caller's row of each point, in tree order.
    cdef readonly int64_t[::1] ids
    # False if no two points have the same coordinates on all axes; true if some may, or if two of a
    # block have on the metric axes.
    cdef readonly bint may_coincide
    # First group of each kept level, and the end of the last.
    cdef Py_ssize_t[::1] first_group
    # (groups, 2, n_axes, 16): least and greatest coordinates; (groups, 16): lowest id in each node.
    cdef double[:, :, :, ::1] boxes
    cdef int64_t[:, ::1] lowest_id
    # Bounding box of all points, (n_axes,) each, and its squared diagonal over the metric axes.
    cdef readonly double[::1] low
    cdef readonly double[::1] high
    cdef double squared_diagonal
    cdef const SimdKernels* simd

    cdef Py_ssize_t groups_of(self, Py_ssize_t level) noexcept nogil


cdef inline Py_ssize_t first_block(Tree tree, Py_ssize_t node) noexcept nogil:
    """First block of a node of the last level; of the node after the last, the end."""
    return (node * tree.n_blocks) >> tree.n_levels


cdef inline Py_ssize_t last_kept(Tree tree) noexcept nogil:
    return tree.first_group.shape[0] - 2


cdef inline Py_ssize_t fan_out(Tree tree, Py_ssize_t level) noexcept nogil:
    """Number of nodes in a group of a kept level."""
    if level > 0:
        return BLOCK
    return 1 << (tree.n_levels - 4 * last_kept(tree))


cdef inline Py_ssize_t points_of_block(Tree tree, Py_ssize_t block) noexcept nogil:
    return min(tree.n_points - BLOCK * block, <Py_ssize_t> BLOCK)
