# distutils: language = c++
"""Build and search of the tree; see kdtree.pxd for how it is laid out.

Distances are sums of squared differences in axis order, for boxes as for points. Rounding is
monotone, so a box is never computed to be farther than a point in it: pruning is exact, and a
brute-force loop over the axes in the same order gives the same bits.
"""

from cython.parallel cimport prange, threadid
from libc.math cimport INFINITY, fabs, sqrt

import numpy as np

from .heap cimport Candidate, sift_down, sift_up, sort_heap, worse

cdef enum:
    LEAF_SIZE = 16
    # Levels above which nodes are split one after the other; below, subtrees side by side.
    SERIAL_LEVELS = 6
    # A depth-first search leaves at most one open node a level.
    STACK_SIZE = 64


cdef extern from "<algorithm>" namespace "std" nogil:
    void nth_element(KeyId* first, KeyId* nth, KeyId* last)


cdef extern from *:
    """
    struct KeyId {
        double key;
        Py_ssize_t id;
        bool operator<(const KeyId& other) const {
            return key < other.key || (key == other.key && id < other.id);
        }
    };
    """
    cdef cppclass KeyId:
        double key
        Py_ssize_t id


cdef void order(
    Tree tree, const double[:, ::1] points, const double[::1] axis_scale, int n_threads
):
    """Permute `ids` so that each node's points are contiguous."""
    cdef double[:, ::1] scratch = np.empty((tree.n_points, 2))
    cdef KeyId* keys = <KeyId*> &scratch[0, 0]
    cdef Py_ssize_t last = tree.n_levels - 1
    cdef Py_ssize_t serial = min(<Py_ssize_t> SERIAL_LEVELS, last)
    cdef Py_ssize_t level, node
    for level in range(serial):
        for node in range(1 << level):
            split(tree, points, axis_scale, keys, level, node)
    for node in prange(1 << serial, nogil=True, schedule="dynamic", num_threads=n_threads):
        split_subtree(tree, points, axis_scale, keys, serial, node)


cdef void split_subtree(
    Tree tree, const double[:, ::1] points, const double[::1] axis_scale, KeyId* keys,
    Py_ssize_t top, Py_ssize_t root
) noexcept nogil:
    cdef Py_ssize_t level, node
    for level in range(top, tree.n_levels - 1):
        for node in range(root << (level - top), (root + 1) << (level - top)):
            split(tree, points, axis_scale, keys, level, node)


cdef void split(
    Tree tree, const double[:, ::1] points, const double[::1] axis_scale, KeyId* keys,
    Py_ssize_t level, Py_ssize_t node
) noexcept nogil:
    """Put the lower half of the node's points, by the chosen axis and then by id, first."""
    cdef Py_ssize_t first = (node * tree.n_points) >> level
    cdef Py_ssize_t end = ((node + 1) * tree.n_points) >> level
    cdef Py_ssize_t middle = ((2 * node + 1) * tree.n_points) >> (level + 1)
    cdef Py_ssize_t axis = widest_axis(tree, points, axis_scale, first, end)
    cdef Py_ssize_t i
    for i in range(first, end):
        keys[i].id = tree.ids[i]
        keys[i].key = points[keys[i].id, axis]
    nth_element(keys + first, keys + middle, keys + end)
    for i in range(first, end):
        tree.ids[i] = keys[i].id


cdef Py_ssize_t widest_axis(
    Tree tree, const double[:, ::1] points, const double[::1] axis_scale, Py_ssize_t first,
    Py_ssize_t end
) noexcept nogil:
    cdef Py_ssize_t axis, i, widest = 0
    cdef double low, high, x, most = -1.0
    for axis in range(tree.n_axes):
        if axis_scale[axis] == 0.0:
            continue
        low = INFINITY
        high = -INFINITY
        for i in range(first, end):
            x = points[tree.ids[i], axis]
            low = min(low, x)
            high = max(high, x)
        if (high - low) * axis_scale[axis] > most:
            most = (high - low) * axis_scale[axis]
            widest = axis
    return widest


cdef void box_leaves(Tree tree, const double[:, ::1] points, int n_threads):
    cdef Py_ssize_t leaf
    cdef Py_ssize_t n_leaves = 1 << (tree.n_levels - 1)
    for leaf in prange(n_leaves, nogil=True, schedule="static", num_threads=n_threads):
        box_leaf(tree, points, leaf)


cdef void box_leaf(Tree tree, const double[:, ::1] points, Py_ssize_t leaf) noexcept nogil:
    """Copy the leaf's points into leaf order and box them."""
    cdef Py_ssize_t last = tree.n_levels - 1
    cdef Py_ssize_t node = (1 << last) - 1 + leaf
    cdef Py_ssize_t place, axis
    cdef double x
    for place in range((leaf * tree.n_points) >> last, ((leaf + 1) * tree.n_points) >> last):
        tree.lowest_id[node] = min(tree.lowest_id[node], tree.ids[place])
        for axis in range(tree.n_axes):
            x = points[tree.ids[place], axis]
            tree.points[place, axis] = x
            tree.low[node, axis] = min(tree.low[node, axis], x)
            tree.high[node, axis] = max(tree.high[node, axis], x)


cdef void box_inner_nodes(Tree tree):
    cdef Py_ssize_t node, child, axis
    for node in range((1 << (tree.n_levels - 1)) - 2, -1, -1):
        for child in range(2 * node + 1, 2 * node + 3):
            tree.lowest_id[node] = min(tree.lowest_id[node], tree.lowest_id[child])
            for axis in range(tree.n_axes):
                tree.low[node, axis] = min(tree.low[node, axis], tree.low[child, axis])
                tree.high[node, axis] = max(tree.high[node, axis], tree.high[child, axis])


cdef inline bint pruned(
    Tree tree, Py_ssize_t node, double squared, const Limits* limits, const Candidate* found,
    Py_ssize_t k, Py_ssize_t count
) noexcept nogil:
    """Tell whether nothing in the node can be among the k nearest within the limits."""
    if squared > limits.squared_radius or squared == INFINITY:
        return True
    if count < k:
        return False
    # Among equally distant points the lowest ids win; without this test many coincident
    # points would all be visited by each of their queries.
    return squared > found[0].squared or (
        squared == found[0].squared and tree.lowest_id[node] > found[0].id
    )


cdef double box_distance(
    Tree tree, Py_ssize_t node, const double* query, const Limits* limits
) noexcept nogil:
    """Return the squared distance to the box, infinite where it is out of range."""
    cdef double squared = 0.0
    cdef double squared_range = 0.0
    cdef double gap
    cdef Py_ssize_t axis
    for axis in range(tree.n_axes):
        gap = max(tree.low[node, axis] - query[axis], query[axis] - tree.high[node, axis])
        gap = max(gap, 0.0)
        if axis < tree.n_metric:
            squared += gap * gap
        elif limits.half_range != NULL and gap > limits.half_range[axis - tree.n_metric]:
            return INFINITY
        elif limits.squared_range >= 0.0:
            squared_range += gap * gap
            if squared_range > limits.squared_range:
                return INFINITY
        elif limits.half_range == NULL:
            break
    return squared


cdef Py_ssize_t scan_leaf(
    Tree tree, Py_ssize_t leaf, const double* query, const Limits* limits, Candidate* found,
    Py_ssize_t k, Py_ssize_t count
) noexcept nogil:
    """Offer the leaf's points to the heap of the k nearest; return its new size."""
    cdef Py_ssize_t last = tree.n_levels - 1
    cdef Py_ssize_t place, axis
    cdef Candidate candidate
    cdef double gap
    for place in range((leaf * tree.n_points) >> last, ((leaf + 1) * tree.n_points) >> last):
        candidate.squared = 0.0
        for axis in range(tree.n_metric):
            gap = tree.points[place, axis] - query[axis]
            candidate.squared += gap * gap
        candidate.id = tree.ids[place]
        candidate.place = place
        if candidate.squared > limits.squared_radius or candidate.id == limits.excluded:
            continue
        if count == k and not worse(&found[0], &candidate):
            continue
        if not in_range(tree, place, query, limits):
            continue
        if count < k:
            found[count] = candidate
            sift_up(found, count)
            count += 1
        else:
            found[0] = candidate
            sift_down(found, k, 0)
    return count


cdef bint in_range(
    Tree tree, Py_ssize_t place, const double* query, const Limits* limits
) noexcept nogil:
    cdef double squared_range = 0.0
    cdef double gap
    cdef Py_ssize_t axis
    if limits.half_range == NULL and limits.squared_range < 0.0:
        return True
    for axis in range(tree.n_metric, tree.n_axes):
        gap = tree.points[place, axis] - query[axis]
        if limits.half_range != NULL and fabs(gap) > limits.half_range[axis - tree.n_metric]:
            return False
        squared_range += gap * gap
    return limits.squared_range < 0.0 or squared_range <= limits.squared_range


cdef void query_row(
    Tree tree, const double* query, Py_ssize_t row, const double[:, ::1] half_range,
    const double[::1] range_radius, bint exclude_self, Candidate* found,
    Py_ssize_t[:, ::1] ids, double[:, ::1] distance
) noexcept nogil:
    """Search for one query; write its row only."""
    cdef Limits limits
    cdef Py_ssize_t slot, count
    lift_limits(&limits)
    if exclude_self:
        limits.excluded = row
    if range_radius is not None:
        limits.squared_range = range_radius[row] * range_radius[row]
    if half_range is not None:
        limits.half_range = &half_range[row, 0]
    count = tree.search(query, &limits, found, ids.shape[1])
    for slot in range(count):
        ids[row, slot] = found[slot].id
        distance[row, slot] = sqrt(found[slot].squared)


cdef double farthest_distance(
    Tree tree, Py_ssize_t place, Py_ssize_t k, const double[::1] range_radius, Candidate* found
) noexcept nogil:
    """Return the distance to the farthest of the k nearest points, the point itself counted."""
    cdef Py_ssize_t row = tree.ids[place]
    cdef Limits limits
    lift_limits(&limits)
    if range_radius is not None:
        limits.squared_range = range_radius[row] * range_radius[row]
    return sqrt(found[tree.search(&tree.points[place, 0], &limits, found, k) - 1].squared)


cdef class Tree:
    """The compiled tree behind `photonrelax.KDTree`, which checks what comes in."""

    def __init__(
        self, const double[:, ::1] points, Py_ssize_t n_metric, const double[::1] axis_scale,
        int n_threads
    ):
        """Build; a node is split across the axis on which extent times `axis_scale` is largest."""
        self.n_points = points.shape[0]
        self.n_axes = points.shape[1]
        self.n_metric = n_metric
        self.n_levels = 1
        while (self.n_points >> (self.n_levels - 1)) > LEAF_SIZE:
            self.n_levels += 1
        cdef Py_ssize_t n_nodes = (1 << self.n_levels) - 1
        self.points = np.empty((self.n_points, self.n_axes))
        self.ids = np.arange(self.n_points, dtype=np.intp)
        self.low = np.full((n_nodes, self.n_axes), np.inf)
        self.high = np.full((n_nodes, self.n_axes), -np.inf)
        self.lowest_id = np.full(n_nodes, self.n_points, dtype=np.intp)
        if self.n_points:
            order(self, points, axis_scale, n_threads)
            box_leaves(self, points, n_threads)
            box_inner_nodes(self)

    cdef unsigned char[:, ::1] scratch(self, Py_ssize_t k, int n_threads):
        """Return room for what `search` finds, a row a thread; it finds no more than n points."""
        n_found = max(min(k, self.n_points), 1)
        return np.empty((n_threads, n_found * sizeof(Candidate)), dtype=np.uint8)

    cdef Py_ssize_t search(
        self, const double* query, const Limits* limits, Candidate* found, Py_ssize_t k
    ) noexcept nogil:
        """Write the k nearest points within the limits, nearest first; return how many."""
        cdef Py_ssize_t[STACK_SIZE] open_nodes
        cdef double[STACK_SIZE] open_squared
        cdef Py_ssize_t n_open = 1
        cdef Py_ssize_t count = 0
        cdef Py_ssize_t first_leaf = (1 << (self.n_levels - 1)) - 1
        cdef Py_ssize_t node, near, far
        cdef double squared, near_squared, far_squared
        open_nodes[0] = 0
        open_squared[0] = box_distance(self, 0, query, limits)
        while n_open > 0:
            n_open -= 1
            node = open_nodes[n_open]
            squared = open_squared[n_open]
            if pruned(self, node, squared, limits, found, k, count):
                continue
            if node >= first_leaf:
                count = scan_leaf(self, node - first_leaf, query, limits, found, k, count)
                continue
            near = 2 * node + 1
            far = near + 1
            near_squared = box_distance(self, near, query, limits)
            far_squared = box_distance(self, far, query, limits)
            if far_squared < near_squared:
                near, far = far, near
                near_squared, far_squared = far_squared, near_squared
            open_nodes[n_open] = far
            open_squared[n_open] = far_squared
            open_nodes[n_open + 1] = near
            open_squared[n_open + 1] = near_squared
            n_open += 2
        sort_heap(found, count)
        return count

    def query(
        self, const double[:, ::1] queries, const Py_ssize_t[::1] rows, Py_ssize_t k, *,
        const double[:, ::1] half_range, const double[::1] range_radius, bint exclude_self,
        int n_threads
    ):
        """Return ids (m, k) and distances (m, k); see `photonrelax.KDTree.query`.

        Query i is answered in row ``rows[i]``, which also tells its ranges and the point to
        exclude; so queries can come in an order in which neighbours follow each other.
        """
        cdef Py_ssize_t n_queries = queries.shape[0]
        ids = np.full((n_queries, k), self.n_points, dtype=np.intp)
        distance = np.full((n_queries, k), np.inf)
        cdef Py_ssize_t[:, ::1] ids_view = ids
        cdef double[:, ::1] distance_view = distance
        cdef unsigned char[:, ::1] found = self.scratch(k, n_threads)
        cdef Py_ssize_t i
        if self.n_points:
            for i in prange(
                n_queries, nogil=True, schedule="dynamic", chunksize=256, num_threads=n_threads
            ):
                query_row(
                    self, &queries[i, 0], rows[i], half_range, range_radius, exclude_self,
                    <Candidate*> &found[threadid(), 0], ids_view, distance_view
                )
        return ids, distance

    def farthest(
        self, const Py_ssize_t[::1] places, Py_ssize_t k, *, const double[::1] range_radius,
        int n_threads
    ):
        """Return the distance of some of the tree's points to the farthest of their k nearest.

        Row i belongs to the point at ``places[i]``; `range_radius` goes by the points' ids.
        """
        cdef Py_ssize_t n = places.shape[0]
        distance = np.empty(n)
        cdef double[::1] distance_view = distance
        cdef unsigned char[:, ::1] found = self.scratch(k, n_threads)
        cdef Py_ssize_t i
        for i in prange(
            n, nogil=True, schedule="dynamic", chunksize=256, num_threads=n_threads
        ):
            distance_view[i] = farthest_distance(
                self, places[i], k, range_radius, <Candidate*> &found[threadid(), 0]
            )
        return distance
