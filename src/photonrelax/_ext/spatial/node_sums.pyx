"""Sums of values over the nodes of a tree."""

from cython.parallel cimport prange

import numpy as np

from ..common.threads cimport team_size
from .simd.kernels cimport BLOCK
from .tree cimport Tree, fan_out, first_block, last_kept

cdef enum:
    # Groups of a thread, at least.
    GROUPS_PER_THREAD = 1 << 6


def node_sums(Tree tree, const double[:, :, ::1] values, int n_threads):
    """Sums (groups, c, 16) of values (n_blocks, c, 16) over the nodes of each group of a tree.

    Sums are of those of the nodes below, in their order, whatever the number of threads is.
    """
    if values.shape[0] != tree.n_blocks:
        raise ValueError("values do not fit the tree")
    cdef Py_ssize_t last = last_kept(tree)
    cdef Py_ssize_t level, g, n_groups
    cdef double[:, :, ::1] sums = np.zeros((tree.first_group[last + 1], values.shape[1], BLOCK))
    for level in range(last, -1, -1):
        n_groups = tree.first_group[level + 1] - tree.first_group[level]
        for g in prange(
            n_groups, nogil=True, schedule="static",
            num_threads=team_size(n_threads, n_groups, GROUPS_PER_THREAD)
        ):
            sum_group(tree, values, level, g, sums)
    return np.asarray(sums)


cdef void sum_group(
    Tree tree, const double[:, :, ::1] values, Py_ssize_t level, Py_ssize_t g,
    double[:, :, ::1] sums
) noexcept nogil:
    """Sum over the blocks, or the groups, below the nodes of one group."""
    cdef Py_ssize_t group = tree.first_group[level] + g
    cdef Py_ssize_t child, node, block
    for child in range(fan_out(tree, level)):
        node = g * fan_out(tree, level) + child
        if level < last_kept(tree):
            add_lanes(sums, tree.first_group[level + 1] + node, sums, group, child)
            continue
        for block in range(first_block(tree, node), first_block(tree, node + 1)):
            add_lanes(values, block, sums, group, child)


cdef inline void add_lanes(
    const double[:, :, ::1] values, Py_ssize_t row, double[:, :, ::1] sums, Py_ssize_t group,
    Py_ssize_t child
) noexcept nogil:
    cdef Py_ssize_t channel, lane
    for channel in range(values.shape[1]):
        for lane in range(BLOCK):
            sums[group, channel, child] += values[row, channel, lane]
