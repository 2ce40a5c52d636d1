"""The traversal of footprint_photons.pxd."""

from libc.math cimport INFINITY, M_PI, fabs, fmax, sqrt
from libc.stdint cimport int32_t, int64_t

from ..spatial.simd.kernels cimport BLOCK, Rectangle, highest_bit, lowest_bit
from ..spatial.tree cimport Tree, fan_out, first_block, last_kept
from .rectangle cimport Footprint, largest_stretch

cdef enum:
    # Depth-first traversal leaves at most 15 open groups per kept level, of which there are 7.
    STACK_SIZE = 128


cdef class FootprintPhotons:
    """Photons in a tree, and how far those of a footprint may be."""


cdef double spacing_near(Tree tree, const double* at) noexcept nogil:
    """Guess of the squared radius that a photon near a point has to itself."""
    cdef Py_ssize_t level, child, nearest = 0, group = 0, axis
    cdef double least, squared, diagonal = 0.0
    for level in range(last_kept(tree) + 1):
        group = tree.first_group[level] + nearest
        least = INFINITY
        child = 0
        for child in range(fan_out(tree, level)):
            squared = squared_gap(tree, group, child, at)
            if squared < least:
                least = squared
                nearest = (group - tree.first_group[level]) * fan_out(tree, level) + child
    child = nearest % fan_out(tree, last_kept(tree))
    for axis in range(3):
        least = tree.boxes[group, 1, axis, child] - tree.boxes[group, 0, axis, child]
        diagonal += least * least
    # A square of 16 photons, whose diagonal this is, is 16 discs of this radius.
    return diagonal / (2.0 * M_PI * BLOCK)


cdef inline double squared_gap(
    Tree tree, Py_ssize_t group, Py_ssize_t child, const double* at
) noexcept nogil:
    """Squared distance of a node's box, infinite for one without points."""
    cdef double gap, squared = 0.0
    cdef Py_ssize_t axis
    for axis in range(3):
        gap = fmax(
            tree.boxes[group, 0, axis, child] - at[axis],
            fmax(at[axis] - tree.boxes[group, 1, axis, child], 0.0)
        )
        squared += gap * gap
    return squared


cdef double squared_reach(Tree tree, const Rectangle* rectangle) noexcept nogil:
    """Squared radius around a footprint, in its metric, beyond which there is no photon."""
    cdef const double* at = rectangle.at
    cdef double squared = 0.0, gap, stretch = largest_stretch(rectangle)
    cdef int axis
    for axis in range(3):
        gap = fmax(fabs(tree.high[axis] - at[axis]), fabs(at[axis] - tree.low[axis]))
        squared += gap * gap
    return stretch * stretch * squared * (1.0 + 1e-9)


cdef void find_band(
    FootprintPhotons work, const Footprint* footprint, Scratch* scratch, Bracket* bracket
) noexcept nogil:
    """Count the photons of a bracket, and write the squared distances between its ends.

    Only as far as there is room.
    """
    # A list made for a much larger radius takes longer to look through than a new one to make.
    if not bracket.high <= scratch.squared_listed <= 4.0 * bracket.high:
        scratch.with_sums = False
        list_blocks(work, footprint, scratch, bracket.high)
    scratch.n_single += BLOCK * scratch.n_blocks
    bracket.n_low = scratch.n_deep
    bracket.n_band = work.tree.simd.rectangle_band(
        &work.tree.coords[0, 0, 0], scratch.blocks, scratch.n_blocks, &footprint.rectangle,
        bracket.low, bracket.high, scratch.band, BAND, &bracket.n_low
    )


cdef void list_blocks(
    FootprintPhotons work, const Footprint* footprint, Scratch* scratch, double squared
) noexcept nogil:
    """List the blocks within a squared radius, in tree order, and count nodes deep inside."""
    scratch.squared_listed = squared
    scratch.margin = deep_margin(footprint, squared)
    scratch.n_blocks = scratch.n_deep = 0
    visit_nodes(work, work.tree, footprint, scratch)


cdef void visit_nodes(
    FootprintPhotons work, Tree tree, const Footprint* footprint, Scratch* scratch
) noexcept nogil:
    """Visit the nodes within the radius of the list, depth first."""
    cdef Py_ssize_t[STACK_SIZE] open_level
    cdef Py_ssize_t[STACK_SIZE] open_group
    cdef Py_ssize_t n_open = 1, level, g
    cdef double limit = sqrt(scratch.squared_listed) * (1.0 + 1e-9) + work.slack
    cdef unsigned int near, child, deep
    open_level[0] = open_group[0] = 0
    while n_open > 0:
        n_open -= 1
        level = open_level[n_open]
        g = open_group[n_open]
        near = tree.simd.boxes_near_rectangle(
            &tree.boxes[tree.first_group[level] + g, 0, 0, 0], &footprint.rectangle,
            limit * limit, scratch.margin, &deep
        )
        if deep:
            add_deep(work, scratch, level, g, deep)
            near &= ~deep
        if level == last_kept(tree):
            append_blocks(tree, g * fan_out(tree, level), near, scratch)
            continue
        while near:
            child = highest_bit(near)
            near ^= 1u << child
            open_level[n_open] = level + 1
            open_group[n_open] = g * fan_out(tree, level) + child
            n_open += 1


cdef inline void append_blocks(
    Tree tree, Py_ssize_t node, unsigned int near, Scratch* scratch
) noexcept nogil:
    while near:
        scratch.blocks[scratch.n_blocks] = <int32_t> first_block(tree, node + lowest_bit(near))
        scratch.n_blocks += 1
        near &= near - 1


cdef void add_deep(
    FootprintPhotons work, Scratch* scratch, Py_ssize_t level, Py_ssize_t g, unsigned int deep
) noexcept nogil:
    """Count the photons of nodes of a group, and add their values."""
    cdef Py_ssize_t group = work.tree.first_group[level] + g
    cdef Py_ssize_t child, channel
    while deep:
        child = lowest_bit(deep)
        deep &= deep - 1
        scratch.n_deep += points_of_node(work.tree, level, g * fan_out(work.tree, level) + child)
        if scratch.with_sums:
            for channel in range(work.sums.shape[1]):
                scratch.deep[channel] += work.sums[group, channel, child]


cdef inline int64_t points_of_node(Tree tree, Py_ssize_t level, Py_ssize_t node) noexcept nogil:
    """Number of points of a node of a kept level."""
    cdef Py_ssize_t bits = tree.n_levels - 4 * (last_kept(tree) - level)
    cdef Py_ssize_t first = (node * tree.n_blocks) >> bits
    cdef Py_ssize_t end = ((node + 1) * tree.n_blocks) >> bits
    return min(BLOCK * end, tree.n_points) - BLOCK * first
