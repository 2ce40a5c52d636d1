"""The batches of batch.pxd."""

from libc.float cimport DBL_MAX
from libc.math cimport INFINITY
from libc.stdint cimport int32_t, int64_t, uint8_t
from libc.string cimport memcpy

import numpy as np

from .tree cimport points_of_block
from .simd.kernels cimport FEW_CHUNKS, KEYS, LANES

from .tree import aligned


cdef Py_ssize_t most_candidates(Tree tree, Py_ssize_t k) noexcept nogil:
    """Return of how many blocks points may be candidates of a query at a time."""
    return min(max(k, candidates_before_drop(k)) + BLOCK, tree.n_blocks) + 1


cdef unsigned char[:, ::1] scratch(Tree tree, Py_ssize_t k, int n_threads):
    """Return a batch in each row, a row a thread."""
    cdef Py_ssize_t thread
    k = min(k, tree.n_points)
    n_bytes = lay_out(tree, NULL, k)
    room = aligned((n_threads, 64 * (n_bytes // 64 + 1)), np.uint8)
    cdef unsigned char[:, ::1] rows = room
    for thread in range(n_threads):
        lay_out(tree, &rows[thread, 0], k)
    return rows


cdef Py_ssize_t lay_out(Tree tree, unsigned char* room, Py_ssize_t k):
    """Lay a batch out in the room, unless that is NULL; return the bytes it takes."""
    cdef Batch nowhere
    cdef Batch* batch = &nowhere if room == NULL else <Batch*> room
    cdef unsigned char* free = room + 64 * ((sizeof(Batch) + 63) // 64)
    cdef Py_ssize_t i, points = BLOCK * most_candidates(tree, k)
    cdef Found* found
    cdef double* spare
    batch.k = k
    # As if points were spread evenly over a plane.
    batch.squared_first = batch.squared_then = tree.squared_diagonal * k / (4 * tree.n_points + 1)
    batch.share = 0.1
    batch.at = <double*> take(&free, 8 * BLOCK * tree.n_axes)
    batch.low = <double*> take(&free, 8 * tree.n_axes)
    batch.high = <double*> take(&free, 8 * tree.n_axes)
    batch.half_range = <double*> take(&free, 8 * tree.n_axes)
    batch.local_at = <float*> take(&free, 4 * BLOCK * tree.n_axes)
    batch.frame.origin = batch.origin = <double*> take(&free, 8 * tree.n_axes)
    batch.frame.n_metric = tree.n_metric
    batch.frame.n_axes = tree.n_axes
    batch.boxes = <double*> take(&free, 16 * tree.n_axes * LISTED_STRIDE)
    batch.copied_boxes = <float*> take(&free, 8 * tree.n_axes * LISTED_STRIDE)
    batch.copied_blocks = <float*> take(&free, 4 * BLOCK * tree.n_axes * LISTED)
    batch.stride = k + LANES
    batch.squared = <double*> take(&free, 32 * BLOCK * batch.stride)
    batch.id = <int64_t*> (batch.squared + BLOCK * batch.stride)
    batch.sorted = batch.squared + 2 * BLOCK * batch.stride
    batch.sorted_id = <int64_t*> (batch.squared + 3 * BLOCK * batch.stride)
    batch.points = batch.squared
    spare = <double*> take(&free, 8 * points)
    set_axes(tree, &batch.reach, batch.low, batch.high)
    for i in range(BLOCK):
        found = &batch.queries[i].found
        found.squared = <double*> take(&free, 8 * points)
        found.spare = spare
        found.keys = <uint8_t*> take(&free, points + FEW_CHUNKS * KEYS)
        found.heights = <float*> take(&free, 4 * points)
        found.blocks = <int32_t*> take(&free, 4 * points // BLOCK)
        found.few = <int32_t*> take(&free, 4 * points)
        set_axes(tree, &batch.queries[i].reach, NULL, NULL)
    return free - room


cdef unsigned char* take(unsigned char** free, Py_ssize_t n_bytes) noexcept nogil:
    cdef unsigned char* taken = free[0]
    free[0] += 64 * ((n_bytes + 63) // 64)
    return taken


cdef void set_axes(Tree tree, Reach* reach, const double* low, const double* high) noexcept nogil:
    reach.low = low
    reach.high = high
    reach.n_metric = tree.n_metric
    reach.n_axes = tree.n_axes


cdef void open_block(Tree tree, Batch* batch, Py_ssize_t block) noexcept nogil:
    """Start a batch of queries from the points of a block, without limits."""
    cdef Py_ssize_t lane, axis
    cdef Py_ssize_t n_queries = points_of_block(tree, block)
    for axis in range(tree.n_axes):
        for lane in range(n_queries):
            batch.at[lane * tree.n_axes + axis] = tree.coords[block, axis, lane]
    batch.n_queries = 0
    for lane in range(n_queries):
        add_query(batch, batch.at + lane * tree.n_axes, tree.squared_diagonal)


cdef void open_query(Tree tree, Batch* batch, const double* at) noexcept nogil:
    """Add a query, without limits, to the batch; the caller keeps its coordinates."""
    add_query(batch, at, squared_farthest(tree, at))


cdef inline void add_query(Batch* batch, const double* at, double squared_most) noexcept nogil:
    cdef Query* query = &batch.queries[batch.n_queries]
    query.reach.low = query.reach.high = at
    query.reach.squared_range = -1.0
    query.reach.half_range = NULL
    query.squared_guess = -1.0
    query.excluded = -1
    query.squared_most = squared_most
    batch.n_queries += 1


cdef double squared_farthest(Tree tree, const double* at) noexcept nogil:
    """Return a squared distance that no point is beyond: the diagonal, for points within."""
    cdef double squared = 0.0, gap
    cdef Py_ssize_t axis
    cdef bint inside = True
    for axis in range(tree.n_metric):
        inside = inside and tree.low[axis] <= at[axis] <= tree.high[axis]
    if inside:
        return tree.squared_diagonal
    for axis in range(tree.n_metric):
        gap = max(at[axis] - tree.low[axis], tree.high[axis] - at[axis])
        squared += gap * gap
    return min(squared, DBL_MAX)


cdef void limit_radius(Query* query, double squared) noexcept nogil:
    """Let a query find nothing beyond a squared distance."""
    query.squared_most = min(query.squared_most, squared)


cdef void limit_range(Query* query, double radius) noexcept nogil:
    """Let a query find nothing outside of a ball over the range axes."""
    cdef double squared = radius * radius
    query.reach.squared_range = squared if squared < INFINITY else -1.0


cdef void list_neighbours(Tree tree, Batch* batch) noexcept nogil:
    """List the neighbours of all queries."""
    cdef Py_ssize_t i
    for i in range(batch.n_queries):
        tree.lanes.list(
            &tree.coords[0, 0, 0], &batch.queries[i].reach, &batch.queries[i].found,
            &tree.ids[0], batch.squared + i * batch.stride, batch.id + i * batch.stride
        )


cdef void list_points(Tree tree, Batch* batch) noexcept nogil:
    """List the coordinates of the neighbours of all queries."""
    cdef Py_ssize_t i
    for i in range(batch.n_queries):
        tree.lanes.list_points(
            &tree.coords[0, 0, 0], tree.n_axes, &batch.queries[i].found,
            batch.points + 3 * i * batch.stride
        )


cdef bint alike(Tree tree, const Query* one, const Query* other) noexcept nogil:
    """Tell whether two queries find the same, as those from coincident points do."""
    cdef Py_ssize_t axis
    for axis in range(tree.n_axes):
        if one.reach.low[axis] != other.reach.low[axis]:
            return False
    return (
        one.squared_most == other.squared_most
        and one.reach.squared_range == other.reach.squared_range
        and one.reach.half_range == NULL and other.reach.half_range == NULL
        and one.excluded < 0 and other.excluded < 0
    )


cdef void copy_found(Found* found, const Found* other) noexcept nogil:
    """Copy what was found, for those who read it."""
    found.n_blocks = other.n_blocks
    found.count = other.count
    found.squared_radius = other.squared_radius
    found.key = other.key
    found.n_few = other.n_few
    memcpy(found.blocks, other.blocks, other.n_blocks * sizeof(int32_t))
    # What lies behind is out of reach, for those who read many keys at a time.
    memcpy(found.keys, other.keys, BLOCK * other.n_blocks + KEYS)
    memcpy(found.few, other.few, other.n_few * sizeof(int32_t))
    memcpy(found.squared, other.squared, other.n_few * sizeof(double))
