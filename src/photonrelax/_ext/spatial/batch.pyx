"""Batches of queries; see batch.pxd."""

from libc.float cimport DBL_MAX
from libc.math cimport INFINITY
from libc.stdint cimport int32_t, int64_t, uint8_t
from libc.string cimport memcpy

import numpy as np

from .tree cimport points_of_block
from .simd.kernels cimport MAX_UNROLLED_CHUNKS, KEY_CHUNK, LANES

from .tree import aligned


cdef Py_ssize_t max_candidate_blocks(Tree tree, Py_ssize_t k) noexcept nogil:
    """Largest number of blocks whose points are candidates of a query at a time."""
    return min(max(k, candidates_before_drop(k)) + BLOCK, tree.n_blocks) + 1


cdef unsigned char[:, ::1] allocate_batches(Tree tree, Py_ssize_t k, int n_threads):
    """Batches, one row per thread."""
    cdef Py_ssize_t thread
    k = min(k, tree.n_points)
    n_bytes = lay_out(tree, NULL, k)
    cdef unsigned char[:, ::1] rows = aligned((n_threads, 64 * (n_bytes // 64 + 1)), np.uint8)
    for thread in range(n_threads):
        lay_out(tree, &rows[thread, 0], k)
    return rows


cdef Py_ssize_t lay_out(Tree tree, unsigned char* memory, Py_ssize_t k):
    """Lay out a batch in `memory`, unless that is NULL; return its size in bytes."""
    cdef Batch measured
    cdef Batch* batch = &measured if memory == NULL else <Batch*> memory
    cdef unsigned char* free = memory + 64 * ((sizeof(Batch) + 63) // 64)
    cdef Py_ssize_t i, points = BLOCK * max_candidate_blocks(tree, k)
    cdef Candidates* found
    cdef double* scratch
    batch.k = k
    # First guess: points spread evenly over a plane.
    batch.squared_first = batch.squared_retry = tree.squared_diagonal * k / (4 * tree.n_points + 1)
    batch.share = 0.1
    batch.at = <double*> take(&free, 8 * BLOCK * tree.n_axes)
    batch.low = <double*> take(&free, 8 * tree.n_axes)
    batch.high = <double*> take(&free, 8 * tree.n_axes)
    batch.half_range = <double*> take(&free, 8 * tree.n_axes)
    batch.float_at = <float*> take(&free, 4 * BLOCK * tree.n_axes)
    batch.quantisation.origin = batch.origin = <double*> take(&free, 8 * tree.n_axes)
    batch.quantisation.n_metric = tree.n_metric
    batch.quantisation.n_axes = tree.n_axes
    batch.boxes = <double*> take(&free, 16 * tree.n_axes * LISTED_STRIDE)
    batch.float_boxes = <float*> take(&free, 8 * tree.n_axes * LISTED_STRIDE)
    batch.float_blocks = <float*> take(&free, 4 * BLOCK * tree.n_axes * LISTED)
    batch.stride = k + LANES
    batch.squared = <double*> take(&free, 32 * BLOCK * batch.stride)
    batch.id = <int64_t*> (batch.squared + BLOCK * batch.stride)
    batch.sorted = batch.squared + 2 * BLOCK * batch.stride
    batch.sorted_id = <int64_t*> (batch.squared + 3 * BLOCK * batch.stride)
    batch.points = batch.squared
    scratch = <double*> take(&free, 8 * points)
    set_axes(tree, &batch.bounds, batch.low, batch.high)
    for i in range(BLOCK):
        found = &batch.queries[i].candidates
        found.tie_squared = <double*> take(&free, 8 * points)
        found.scratch = scratch
        found.rank_keys = <uint8_t*> take(&free, points + MAX_UNROLLED_CHUNKS * KEY_CHUNK)
        found.scaled_distances = <float*> take(&free, 4 * points)
        found.blocks = <int32_t*> take(&free, 4 * points // BLOCK)
        found.ties = <int32_t*> take(&free, 4 * points)
        set_axes(tree, &batch.queries[i].bounds, NULL, NULL)
    return free - memory


cdef unsigned char* take(unsigned char** free, Py_ssize_t n_bytes) noexcept nogil:
    cdef unsigned char* taken = free[0]
    free[0] += 64 * ((n_bytes + 63) // 64)
    return taken


cdef void set_axes(
    Tree tree, SearchBounds* bounds, const double* low, const double* high
) noexcept nogil:
    bounds.low = low
    bounds.high = high
    bounds.n_metric = tree.n_metric
    bounds.n_axes = tree.n_axes


cdef void open_block(Tree tree, Batch* batch, Py_ssize_t block) noexcept nogil:
    """Start a batch: a query at each point of a block, without limits."""
    cdef Py_ssize_t lane, axis
    cdef Py_ssize_t n_queries = points_of_block(tree, block)
    for axis in range(tree.n_axes):
        for lane in range(n_queries):
            batch.at[lane * tree.n_axes + axis] = tree.coords[block, axis, lane]
    batch.n_queries = 0
    for lane in range(n_queries):
        add_query(batch, batch.at + lane * tree.n_axes, tree.squared_diagonal)


cdef void open_query(Tree tree, Batch* batch, const double* at) noexcept nogil:
    """Add a query, without limits, to the batch; the caller keeps its coordinates alive."""
    add_query(batch, at, squared_farthest(tree, at))


cdef inline void add_query(Batch* batch, const double* at, double squared_max) noexcept nogil:
    cdef Query* query = &batch.queries[batch.n_queries]
    query.bounds.low = query.bounds.high = at
    query.bounds.squared_range = -1.0
    query.bounds.half_range = NULL
    query.squared_guess = -1.0
    query.excluded = -1
    query.squared_max = squared_max
    batch.n_queries += 1


cdef double squared_farthest(Tree tree, const double* at) noexcept nogil:
    """Upper bound on squared distances to points; the diagonal for queries in the box."""
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
    """Limit the neighbours of a query to a squared distance."""
    query.squared_max = min(query.squared_max, squared)


cdef void limit_range(Query* query, double radius) noexcept nogil:
    """Limit the neighbours of a query to a ball over the range axes."""
    cdef double squared = radius * radius
    query.bounds.squared_range = squared if squared < INFINITY else -1.0


cdef void gather_neighbours(Tree tree, Batch* batch) noexcept nogil:
    """Write squared distances and ids of the neighbours of all queries."""
    cdef Py_ssize_t i
    for i in range(batch.n_queries):
        tree.simd.gather_neighbours(
            &tree.coords[0, 0, 0], &batch.queries[i].bounds, &batch.queries[i].candidates,
            &tree.ids[0], batch.squared + i * batch.stride, batch.id + i * batch.stride
        )


cdef void gather_points(Tree tree, Batch* batch) noexcept nogil:
    """Write the coordinates of the neighbours of all queries."""
    cdef Py_ssize_t i
    for i in range(batch.n_queries):
        tree.simd.gather_points(
            &tree.coords[0, 0, 0], tree.n_axes, &batch.queries[i].candidates,
            batch.points + 3 * i * batch.stride
        )


cdef bint same_result(Tree tree, const Query* one, const Query* other) noexcept nogil:
    """True if two queries have the same neighbours, as those at coincident points have."""
    cdef Py_ssize_t axis
    for axis in range(tree.n_axes):
        if one.bounds.low[axis] != other.bounds.low[axis]:
            return False
    return (
        one.squared_max == other.squared_max
        and one.bounds.squared_range == other.bounds.squared_range
        and one.bounds.half_range == NULL and other.bounds.half_range == NULL
        and one.excluded < 0 and other.excluded < 0
    )


cdef void copy_neighbours(Candidates* found, const Candidates* other) noexcept nogil:
    """Copy the selected neighbours."""
    found.n_blocks = other.n_blocks
    found.count = other.count
    found.squared_radius = other.squared_radius
    found.max_rank_key = other.max_rank_key
    found.n_ties = other.n_ties
    memcpy(found.blocks, other.blocks, other.n_blocks * sizeof(int32_t))
    # Kernels read keys in whole chunks: those behind the last block are OUTSIDE_KEY.
    memcpy(found.rank_keys, other.rank_keys, BLOCK * other.n_blocks + KEY_CHUNK)
    memcpy(found.ties, other.ties, other.n_ties * sizeof(int32_t))
    memcpy(found.tie_squared, other.tie_squared, other.n_ties * sizeof(double))
