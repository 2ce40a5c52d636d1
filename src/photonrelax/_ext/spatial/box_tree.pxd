"""Tree of axis-aligned boxes: those near a point or near another box.

The boxes are sorted by the Morton codes of their centres. They are level 0; a node of the next
level bounds `FAN` in sequence of the level below, up to the root.
"""

from libc.stdint cimport int32_t

cdef enum:
    FAN = 4
    # That of the root, where there are as many boxes as ids have numbers.
    MAX_LEVEL = 16


cdef class BoxTree:
    cdef readonly Py_ssize_t n_boxes
    # Level of the root; -1 without boxes.
    cdef int root
    # Row of the first node of each level, and the end of the last.
    cdef Py_ssize_t[MAX_LEVEL + 2] first
    # (rows, 6): least and greatest coordinates.
    cdef const double[:, ::1] bounds
    # The caller's number of each box of level 0.
    cdef const int32_t[::1] ids


cdef struct BoxVisit:
    # The boxes within a distance of the box from `low` to `high`; both are one point for a ball.
    const double* low
    const double* high
    double squared_radius
    # The node to be tested next.
    int level
    Py_ssize_t row


cdef inline BoxVisit open_visit(
    BoxTree tree, const double* low, const double* high, double radius
) noexcept nogil:
    cdef BoxVisit visit
    visit.low, visit.high = low, high
    visit.squared_radius = radius * radius
    visit.level = tree.root
    visit.row = tree.first[tree.root] if tree.root >= 0 else 0
    return visit


cdef inline int32_t next_within(BoxTree tree, BoxVisit* visit) noexcept nogil:
    """The next box within the distance, in the order of the tree; -1 after the last."""
    cdef Py_ssize_t row
    while 0 <= visit.level <= tree.root:
        row = visit.row
        if squared_gap(&tree.bounds[row, 0], visit.low, visit.high) > visit.squared_radius:
            step_over(tree, visit)
        elif visit.level > 0:
            visit.level -= 1
            visit.row = tree.first[visit.level] + FAN * (row - tree.first[visit.level + 1])
        else:
            step_over(tree, visit)
            return tree.ids[row]
    return -1


cdef inline void step_over(BoxTree tree, BoxVisit* visit) noexcept nogil:
    """Go on to the next node that is not below this one; to a level above the root at the end."""
    cdef Py_ssize_t number = visit.row - tree.first[visit.level] + 1
    cdef Py_ssize_t size = tree.first[visit.level + 1] - tree.first[visit.level]
    while visit.level <= tree.root and (number % FAN == 0 or number == size):
        number = (number + FAN - 1) // FAN
        visit.level += 1
        if visit.level <= tree.root:
            size = tree.first[visit.level + 1] - tree.first[visit.level]
    if visit.level <= tree.root:
        visit.row = tree.first[visit.level] + number


cdef inline double squared_gap(
    const double* bounds, const double* low, const double* high
) noexcept nogil:
    """Squared distance between two boxes; it does not grow as either does, not even rounded."""
    cdef double gap, total = 0.0
    cdef int axis
    for axis in range(3):
        gap = max(max(bounds[axis] - high[axis], low[axis] - bounds[3 + axis]), 0.0)
        total += gap * gap
    return total


cdef inline Py_ssize_t boxes_within(
    BoxTree tree, const double* at, double radius, int32_t* out, Py_ssize_t capacity
) noexcept nogil:
    """Write the boxes within a distance of a point, in the order of the tree.

    Returns their number; of more than `capacity` the first are written.
    """
    cdef BoxVisit visit = open_visit(tree, at, at, radius)
    cdef int32_t box = next_within(tree, &visit)
    cdef Py_ssize_t n = 0
    while box >= 0:
        if n < capacity:
            out[n] = box
        n += 1
        box = next_within(tree, &visit)
    return n
