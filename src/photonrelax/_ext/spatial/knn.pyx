"""k-nearest-neighbour search; see knn.pxd."""

from libc.float cimport DBL_MAX
from libc.math cimport INFINITY, sqrt
from libc.stdint cimport int32_t, int64_t

from ..common.prefetch cimport prefetch_row
from .batch cimport (
    LISTED, LISTED_STRIDE, Query, candidates_before_drop, copy_neighbours, same_result,
)
from .float_blocks cimport quantise_listed, set_float_query, set_quantisation
from .tree cimport fan_out, first_block, last_kept
from .simd.kernels cimport (
    BLOCK, INTERLEAVED, OUTSIDE_KEY, Candidates, SearchBounds, count_bits, farthest_candidate,
    highest_bit, lowest_bit,
)

cdef enum:
    # Depth-first traversal leaves at most 15 open groups per kept level, of which there are 7.
    STACK_SIZE = 128

# Factors on squared radii. First attempt: 1 + FIRST / sqrt(k), for the scatter of distances to the
# k-th neighbour, times the mean of the last batch, averaged by fourth roots as a few may be much
# larger. Second attempt: RETRY times its maximum. A query's own guess is closer.
cdef double FIRST = 5.0
cdef double RETRY = 1.3
cdef double FIRST_GUESSED = 1.3
cdef double RETRY_GUESSED = 1.6
# Factors of further attempts.
cdef double MIN_WIDENING = 1.5
cdef double MAX_WIDENING = 16.0


cdef void query_batch(Tree tree, Batch* batch) noexcept nogil:
    """Select the k nearest of each query of the batch, ties by id, in its `candidates`."""
    cdef Py_ssize_t i, n_open = batch.n_queries
    cdef double farthest = 0.0, mean = 0.0
    for i in range(batch.n_queries):
        start(batch, &batch.queries[i])
        batch.queries[i].repeats_previous = i > 0 and same_result(
            tree, &batch.queries[i - 1], &batch.queries[i]
        )
        if batch.queries[i].repeats_previous:
            batch.queries[i].done = True
            n_open -= 1
    while n_open > 0:
        set_batch_bounds(tree, batch)
        traverse(tree, batch)
        n_open = finish_queries(tree, batch)
    for i in range(batch.n_queries):
        if batch.queries[i].repeats_previous:
            copy_neighbours(&batch.queries[i].candidates, &batch.queries[i - 1].candidates)
        mean += sqrt(sqrt(batch.queries[i].candidates.squared_radius)) / batch.n_queries
        farthest = max(farthest, batch.queries[i].candidates.squared_radius)
    batch.squared_first = (1.0 + FIRST / sqrt(batch.k)) * mean ** 4
    batch.squared_retry = RETRY * farthest


cdef void start(Batch* batch, Query* query) noexcept nogil:
    cdef double first = batch.squared_first
    cdef double retry = max(batch.squared_retry, first)
    if query.squared_guess >= 0.0:
        first = FIRST_GUESSED * query.squared_guess
        retry = RETRY_GUESSED * query.squared_guess
    query.done = False
    query.squared_retry = min(retry, query.squared_max)
    restart(query, min(first, query.squared_max))


cdef void restart(Query* query, double squared_limit) noexcept nogil:
    query.candidates.n_blocks = 0
    query.highest_id = -1
    query.bounds.squared_limit = squared_limit


cdef void set_batch_bounds(Tree tree, Batch* batch) noexcept nogil:
    """Enclose the bounds of all open queries."""
    cdef Py_ssize_t i, axis
    cdef const Query* query
    cdef bint any_unlimited = False
    for axis in range(tree.n_axes):
        batch.low[axis] = INFINITY
        batch.high[axis] = -INFINITY
    batch.bounds.squared_limit = 0.0
    batch.bounds.squared_range = -1.0
    batch.highest_id = -1
    for i in range(batch.n_queries):
        query = &batch.queries[i]
        if query.done:
            continue
        for axis in range(tree.n_axes):
            batch.low[axis] = min(batch.low[axis], query.bounds.low[axis])
            batch.high[axis] = max(batch.high[axis], query.bounds.low[axis])
        batch.bounds.squared_limit = max(batch.bounds.squared_limit, query.squared_retry)
        batch.bounds.squared_range = max(batch.bounds.squared_range, query.bounds.squared_range)
        any_unlimited = any_unlimited or query.bounds.squared_range < 0.0
    set_half_range(tree, batch)
    set_quantisation(tree, batch)
    # After `set_quantisation`, which needs the largest range of the queries that have one.
    if any_unlimited:
        batch.bounds.squared_range = -1.0


cdef void set_half_range(Tree tree, Batch* batch) noexcept nogil:
    cdef Py_ssize_t i, axis
    batch.bounds.half_range = NULL
    if batch.queries[0].bounds.half_range == NULL:
        return
    batch.bounds.half_range = batch.half_range
    for axis in range(tree.n_axes - tree.n_metric):
        batch.half_range[axis] = 0.0
        for i in range(batch.n_queries):
            if not batch.queries[i].done:
                batch.half_range[axis] = max(
                    batch.half_range[axis], batch.queries[i].bounds.half_range[axis]
                )


cdef void traverse(Tree tree, Batch* batch) noexcept nogil:
    """List and scan all blocks that overlap the bounds of the batch, in tree order."""
    cdef Py_ssize_t[STACK_SIZE] open_level
    cdef Py_ssize_t[STACK_SIZE] open_group
    cdef Py_ssize_t n_open = 1, level, g, last = last_kept(tree)
    cdef unsigned int near, child
    open_level[0] = open_group[0] = 0
    batch.n_listed = 0
    batch.listed_all = True
    while n_open > 0:
        n_open -= 1
        level = open_level[n_open]
        g = open_group[n_open]
        near = overlapping_children(tree, batch, tree.first_group[level] + g)
        if level == last:
            list_blocks(tree, batch, g, near)
            continue
        while near:
            child = highest_bit(near)
            near ^= 1u << child
            open_level[n_open] = level + 1
            open_group[n_open] = g * fan_out(tree, level) + child
            n_open += 1
    if batch.listed_all:
        clamp_limits(tree, batch)
    flush_blocks(tree, batch)


cdef void clamp_limits(Tree tree, Batch* batch) noexcept nogil:
    """Clamp limits of range-limited queries to the extent of all listed blocks.

    Rank keys are fractions of the limit: one far beyond the candidates would make them coarse.
    """
    cdef double farthest = -1.0, limit = 0.0
    cdef Py_ssize_t i
    cdef Query* query
    for i in range(batch.n_queries):
        query = &batch.queries[i]
        if query.done:
            continue
        if query.squared_retry == query.squared_max and is_limited(query):
            if farthest < 0.0:
                farthest = squared_farthest_listed(tree, batch)
            query.squared_max = min(query.squared_max, farthest)
            query.squared_retry = query.squared_max
            query.bounds.squared_limit = min(query.bounds.squared_limit, farthest)
        limit = max(limit, query.squared_retry)
    if limit < batch.bounds.squared_limit:
        batch.bounds.squared_limit = limit
        set_quantisation(tree, batch)


cdef inline bint is_limited(const Query* query) noexcept nogil:
    """True if a query has limits on the range axes."""
    return query.bounds.squared_range >= 0.0 or query.bounds.half_range != NULL


cdef double squared_farthest_listed(Tree tree, const Batch* batch) noexcept nogil:
    """Upper bound on squared distances from any query to points of listed blocks."""
    cdef double[LISTED] squared
    cdef double gap, farthest = 0.0
    cdef const double* low
    cdef const double* high
    cdef Py_ssize_t i, axis
    for i in range(batch.n_listed):
        squared[i] = 0.0
    for axis in range(tree.n_metric):
        low = batch.boxes + LISTED_STRIDE * axis
        high = low + LISTED_STRIDE * tree.n_axes
        for i in range(batch.n_listed):
            gap = max(high[i] - batch.low[axis], batch.high[axis] - low[i])
            squared[i] += gap * gap
    for i in range(batch.n_listed):
        farthest = max(farthest, squared[i])
    # Rounding of this bound and of the distances.
    return min(farthest * (1.0 + 1e-14), DBL_MAX)


cdef inline unsigned int overlapping_children(
    Tree tree, Batch* batch, Py_ssize_t group
) noexcept nogil:
    """Bitmask of the nodes of a group that overlap the bounds of the batch."""
    cdef unsigned int near = tree.simd.overlapping_boxes(
        &tree.boxes[group, 0, 0, 0], BLOCK, &batch.bounds
    )
    cdef unsigned int child
    if batch.highest_id >= 0:
        for child in range(BLOCK):
            if near >> child & 1 and prunable(
                tree, <Py_ssize_t> (BLOCK * group + child), &batch.bounds, batch.highest_id
            ):
                near ^= 1u << child
    return near


cdef inline bint prunable(
    Tree tree, Py_ssize_t number, const SearchBounds* bounds, int64_t highest_id
) noexcept nogil:
    """True if no point of a box can be nearer, ties by id, than the k candidates kept.

    Without the ids, each query at one of many coincident points would visit all of them.
    """
    cdef const double* box = &tree.boxes[number // BLOCK, 0, 0, number % BLOCK]
    cdef double squared = 0.0, gap
    cdef Py_ssize_t axis
    if tree.lowest_id[number // BLOCK, number % BLOCK] <= highest_id:
        return False
    for axis in range(tree.n_metric):
        gap = max(
            box[BLOCK * axis] - bounds.high[axis],
            bounds.low[axis] - box[BLOCK * (tree.n_axes + axis)]
        )
        gap = max(gap, 0.0)
        squared += gap * gap
    return squared >= bounds.squared_limit


cdef void list_blocks(Tree tree, Batch* batch, Py_ssize_t g, unsigned int near) noexcept nogil:
    """List the blocks of children of a group of the last kept level."""
    cdef Py_ssize_t last = last_kept(tree)
    cdef Py_ssize_t node = g * fan_out(tree, last)
    cdef Py_ssize_t group = tree.first_group[last] + g
    cdef unsigned int child
    if batch.n_listed + count_bits(near) > LISTED:
        flush_blocks(tree, batch)
        batch.n_listed = 0
        batch.listed_all = False
    tree.simd.pack_boxes(
        &tree.boxes[group, 0, 0, 0], tree.n_axes, near, batch.boxes + batch.n_listed, LISTED_STRIDE
    )
    while near:
        child = lowest_bit(near)
        near &= near - 1
        batch.listed[batch.n_listed] = <int32_t> first_block(tree, node + child)
        prefetch_row(
            &tree.coords[batch.listed[batch.n_listed], 0, 0], 8 * BLOCK * tree.n_metric
        )
        batch.box_number[batch.n_listed] = <int32_t> (BLOCK * group + child)
        batch.n_listed += 1


cdef void flush_blocks(Tree tree, Batch* batch) noexcept nogil:
    """Scan the listed blocks for all open queries."""
    cdef Py_ssize_t i
    cdef Query* query
    cdef bint all_full = True
    quantise_listed(tree, batch)
    batch.bounds.squared_limit = 0.0
    for i in range(batch.n_queries):
        query = &batch.queries[i]
        if query.done:
            continue
        add_candidates(tree, batch, query)
        all_full = all_full and query.highest_id >= 0
        batch.highest_id = max(batch.highest_id, query.highest_id)
        batch.bounds.squared_limit = max(batch.bounds.squared_limit, query.squared_retry)
    if not all_full:
        batch.highest_id = -1


cdef void add_candidates(Tree tree, Batch* batch, Query* query) noexcept nogil:
    """Add the points of listed blocks to the candidates of a query."""
    cdef Py_ssize_t group, first
    cdef unsigned int near
    set_float_query(tree, batch, query)
    for group in range((batch.n_listed + BLOCK - 1) // BLOCK):
        first = BLOCK * group
        near = overlapping_blocks(tree, batch, query, first)
        if query.exact:
            tree.simd.scan_blocks(
                &tree.coords[0, 0, 0], &batch.listed[first], near, &query.bounds, &query.candidates
            )
        else:
            tree.simd.scan_float_blocks(
                &tree.coords[0, 0, 0], batch.float_blocks + BLOCK * tree.n_axes * first,
                &batch.listed[first], near, &query.bounds, &query.float_query, &query.candidates
            )
        exclude_place(query)
        if query.candidates.n_blocks > candidates_before_drop(batch.k):
            drop_farthest(tree, batch, query)


cdef inline unsigned int overlapping_blocks(
    Tree tree, const Batch* batch, const Query* query, Py_ssize_t first
) noexcept nogil:
    """Bitmask of the 16 listed blocks that may hold neighbours of a query."""
    cdef unsigned int near, i
    if query.exact:
        near = tree.simd.overlapping_boxes(batch.boxes + first, LISTED_STRIDE, &query.bounds)
    else:
        near = tree.simd.overlapping_float_boxes(
            batch.float_boxes + first, LISTED_STRIDE, &query.bounds, &query.float_query
        )
    near &= (1u << min(batch.n_listed - first, <Py_ssize_t> BLOCK)) - 1
    if query.highest_id >= 0:
        for i in range(BLOCK):
            if near >> i & 1 and prunable(
                tree, batch.box_number[first + i], &query.bounds, query.highest_id
            ):
                near ^= 1u << i
    return near


cdef void exclude_place(Query* query) noexcept nogil:
    """Remove the point at the excluded tree position from the candidates."""
    cdef int64_t block, candidate
    if query.excluded < 0:
        return
    for block in range(query.candidates.n_blocks):
        if query.candidates.blocks[block] == query.excluded // BLOCK:
            candidate = BLOCK * block + query.excluded % BLOCK
            query.candidates.rank_keys[candidate] = OUTSIDE_KEY


cdef void drop_farthest(Tree tree, Batch* batch, Query* query) noexcept nogil:
    """Keep the k nearest candidates so far, and limit the search to the farthest of them."""
    cdef Candidates* found = &query.candidates
    cdef int64_t farthest
    select_nearest(tree, batch, query)
    if found.count == batch.k:
        farthest = farthest_candidate(found, &tree.ids[0])
        query.highest_id = tree.ids[BLOCK * found.blocks[farthest // BLOCK] + farthest % BLOCK]
        query.squared_retry = query.bounds.squared_limit = found.squared_radius
    tree.simd.compact(found)
    tree.simd.rescan(&tree.coords[0, 0, 0], &query.bounds, found)
    exclude_place(query)
    set_float_query(tree, batch, query)


cdef inline void select_nearest(Tree tree, const Batch* batch, Query* query) noexcept nogil:
    cdef Candidates* found = &query.candidates
    cdef const SearchBounds* bounds = &query.bounds
    tree.simd.select_nearest(
        &tree.coords[0, 0, 0], &bounds, &query.float_query.rank_slack, &found, 1, batch.k,
        &tree.ids[0]
    )


cdef Py_ssize_t finish_queries(Tree tree, Batch* batch) noexcept nogil:
    """Select the k nearest of all open queries; the number that needs another attempt."""
    cdef Candidates* found[INTERLEAVED]
    cdef const SearchBounds* bounds[INTERLEAVED]
    cdef float[INTERLEAVED] rank_slack
    cdef Query* query[INTERLEAVED]
    cdef Py_ssize_t i, j, n = 0, n_open = 0
    for i in range(batch.n_queries):
        if not batch.queries[i].done:
            query[n] = &batch.queries[i]
            found[n] = &query[n].candidates
            bounds[n] = &query[n].bounds
            rank_slack[n] = query[n].float_query.rank_slack
            n += 1
        if n == INTERLEAVED or (n > 0 and i == batch.n_queries - 1):
            tree.simd.select_nearest(
                &tree.coords[0, 0, 0], bounds, rank_slack, found, <int> n, batch.k, &tree.ids[0]
            )
            for j in range(n):
                n_open += not finish_query(tree, batch, query[j])
            n = 0
    return n_open


cdef bint finish_query(Tree tree, Batch* batch, Query* query) noexcept nogil:
    """True if the k nearest are selected; if not, restart the query with a larger radius."""
    cdef Candidates* found = &query.candidates
    if found.count < batch.k and query.bounds.squared_limit < query.squared_retry:
        restart(query, query.squared_retry)
        if not batch.listed_all:
            return False
        add_candidates(tree, batch, query)
        select_nearest(tree, batch, query)
    if found.count < batch.k and query.bounds.squared_limit < query.squared_max:
        query.squared_retry = widened_radius(query, batch.k)
        restart(query, query.squared_retry)
        return False
    query.done = True
    return True


cdef double widened_radius(const Query* query, Py_ssize_t k) noexcept nogil:
    """Squared radius of the next attempt, by the number of candidates found."""
    cdef double factor = MAX_WIDENING
    cdef double squared
    if query.candidates.count > 1:
        factor = min(max(1.5 * k / query.candidates.count, MIN_WIDENING), MAX_WIDENING)
    squared = max(query.squared_retry * factor, query.squared_max * 1e-24)
    # Squares underflow: further steps would not widen.
    if squared <= query.squared_retry:
        return query.squared_max
    return min(squared, query.squared_max)
