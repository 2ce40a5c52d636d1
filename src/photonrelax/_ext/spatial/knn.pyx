"""The search of search.pxd."""

from libc.float cimport DBL_MAX
from libc.math cimport INFINITY, sqrt
from libc.stdint cimport int32_t, int64_t

from .batch cimport LISTED, LISTED_STRIDE, Query, alike, candidates_before_drop, copy_found
from .float_blocks cimport copy_listed, set_frame, set_local
from .tree cimport fan_out, first_block, last_kept
from .simd.kernels cimport (
    BLOCK, OUTSIDE, TOGETHER, Found, Reach, count_bits, highest_bit, last_found, lowest_bit,
    prefetch_row,
)

cdef enum:
    # A depth-first search leaves at most 15 open groups a kept level, of which there are 7.
    STACK_SIZE = 128

# Queries look as far, squared, as the last batch found on the mean (of roots: a few radii may be
# much greater), and so much farther (over the root of k, as they scatter); if that is not enough,
# as far as it found at most, and so much farther. A query's own guess is nearer the truth.
cdef double FIRST = 5.0
cdef double THEN = 1.3
cdef double FIRST_GUESSED = 1.3
cdef double THEN_GUESSED = 1.6
# If even that was too little they look farther, squared, by at least and at most so much.
cdef double LEAST_WIDENING = 1.5
cdef double MOST_WIDENING = 16.0


cdef void find(Tree tree, Batch* batch) noexcept nogil:
    """Find the k nearest of all queries of the batch, ties by id, each in its `found`."""
    cdef Py_ssize_t i, n_open = batch.n_queries
    cdef double farthest = 0.0, mean = 0.0
    for i in range(batch.n_queries):
        start(batch, &batch.queries[i])
        batch.queries[i].alike = i > 0 and alike(tree, &batch.queries[i - 1], &batch.queries[i])
        if batch.queries[i].alike:
            batch.queries[i].done = True
            n_open -= 1
    while n_open > 0:
        set_outer_reach(tree, batch)
        traverse(tree, batch)
        n_open = close_queries(tree, batch)
    for i in range(batch.n_queries):
        if batch.queries[i].alike:
            copy_found(&batch.queries[i].found, &batch.queries[i - 1].found)
        mean += sqrt(sqrt(batch.queries[i].found.squared_radius)) / batch.n_queries
        farthest = max(farthest, batch.queries[i].found.squared_radius)
    batch.squared_first = (1.0 + FIRST / sqrt(batch.k)) * mean ** 4
    batch.squared_then = THEN * farthest


cdef void start(Batch* batch, Query* query) noexcept nogil:
    cdef double first = batch.squared_first
    cdef double then = max(batch.squared_then, first)
    if query.squared_guess >= 0.0:
        first = FIRST_GUESSED * query.squared_guess
        then = THEN_GUESSED * query.squared_guess
    query.done = False
    query.squared_wanted = min(then, query.squared_most)
    restart(query, min(first, query.squared_most))


cdef void restart(Query* query, double squared_limit) noexcept nogil:
    query.found.n_blocks = 0
    query.highest_id = -1
    query.reach.squared_limit = squared_limit


cdef void set_outer_reach(Tree tree, Batch* batch) noexcept nogil:
    """Let the batch reach what any of its open queries wants to."""
    cdef Py_ssize_t i, axis
    cdef const Query* query
    cdef bint any_unlimited = False
    for axis in range(tree.n_axes):
        batch.low[axis] = INFINITY
        batch.high[axis] = -INFINITY
    batch.reach.squared_limit = 0.0
    batch.reach.squared_range = -1.0
    batch.highest_id = -1
    for i in range(batch.n_queries):
        query = &batch.queries[i]
        if query.done:
            continue
        for axis in range(tree.n_axes):
            batch.low[axis] = min(batch.low[axis], query.reach.low[axis])
            batch.high[axis] = max(batch.high[axis], query.reach.low[axis])
        batch.reach.squared_limit = max(batch.reach.squared_limit, query.squared_wanted)
        batch.reach.squared_range = max(batch.reach.squared_range, query.reach.squared_range)
        any_unlimited = any_unlimited or query.reach.squared_range < 0.0
    set_half_range(tree, batch)
    set_frame(tree, batch)
    # Only now, as the frame suits those that have a range.
    if any_unlimited:
        batch.reach.squared_range = -1.0


cdef void set_half_range(Tree tree, Batch* batch) noexcept nogil:
    cdef Py_ssize_t i, axis
    batch.reach.half_range = NULL
    if batch.queries[0].reach.half_range == NULL:
        return
    batch.reach.half_range = batch.half_range
    for axis in range(tree.n_axes - tree.n_metric):
        batch.half_range[axis] = 0.0
        for i in range(batch.n_queries):
            if not batch.queries[i].done:
                batch.half_range[axis] = max(
                    batch.half_range[axis], batch.queries[i].reach.half_range[axis]
                )


cdef void traverse(Tree tree, Batch* batch) noexcept nogil:
    """Visit all blocks in reach of the batch, in their order."""
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
        near = near_children(tree, batch, tree.first_group[level] + g)
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
        reach_no_farther(tree, batch)
    serve(tree, batch)


cdef void reach_no_farther(Tree tree, Batch* batch) noexcept nogil:
    """Let queries that look as far as they may look no farther than all listed blocks.

    What is in their range is often near: limits far beyond would make for coarse keys.
    """
    cdef double farthest = -1.0, limit = 0.0
    cdef Py_ssize_t i
    cdef Query* query
    for i in range(batch.n_queries):
        query = &batch.queries[i]
        if query.done:
            continue
        if query.squared_wanted == query.squared_most and is_limited(query):
            if farthest < 0.0:
                farthest = squared_farthest_listed(tree, batch)
            query.squared_most = min(query.squared_most, farthest)
            query.squared_wanted = query.squared_most
            query.reach.squared_limit = min(query.reach.squared_limit, farthest)
        limit = max(limit, query.squared_wanted)
    if limit < batch.reach.squared_limit:
        batch.reach.squared_limit = limit
        set_frame(tree, batch)


cdef inline bint is_limited(const Query* query) noexcept nogil:
    """Tell whether a query finds only what is in some range."""
    return query.reach.squared_range >= 0.0 or query.reach.half_range != NULL


cdef double squared_farthest_listed(Tree tree, const Batch* batch) noexcept nogil:
    """Return a squared distance that no point of a listed block is beyond from any query."""
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
    # By the roundings of these and of the distances themselves.
    return min(farthest * (1.0 + 1e-14), DBL_MAX)


cdef inline unsigned int near_children(Tree tree, Batch* batch, Py_ssize_t group) noexcept nogil:
    """Return which nodes of a group are in reach of the batch, as bits."""
    cdef unsigned int near = tree.lanes.boxes_near(
        &tree.boxes[group, 0, 0, 0], BLOCK, &batch.reach
    )
    cdef unsigned int child
    if batch.highest_id >= 0:
        for child in range(BLOCK):
            if near >> child & 1 and hopeless(
                tree, <Py_ssize_t> (BLOCK * group + child), &batch.reach, batch.highest_id
            ):
                near ^= 1u << child
    return near


cdef inline bint hopeless(
    Tree tree, Py_ssize_t number, const Reach* reach, int64_t highest_id
) noexcept nogil:
    """Tell whether points in a box are too far away or lose, by their ids, to those found.

    Without this test many coincident points would all be visited by each of their queries.
    """
    cdef const double* box = &tree.boxes[number // BLOCK, 0, 0, number % BLOCK]
    cdef double squared = 0.0, gap
    cdef Py_ssize_t axis
    if tree.lowest_id[number // BLOCK, number % BLOCK] <= highest_id:
        return False
    for axis in range(tree.n_metric):
        gap = max(
            box[BLOCK * axis] - reach.high[axis],
            reach.low[axis] - box[BLOCK * (tree.n_axes + axis)]
        )
        gap = max(gap, 0.0)
        squared += gap * gap
    return squared >= reach.squared_limit


cdef void list_blocks(Tree tree, Batch* batch, Py_ssize_t g, unsigned int near) noexcept nogil:
    """List the blocks of some children of a group of the last kept level."""
    cdef Py_ssize_t last = last_kept(tree)
    cdef Py_ssize_t node = g * fan_out(tree, last)
    cdef Py_ssize_t group = tree.first_group[last] + g
    cdef unsigned int child
    if batch.n_listed + count_bits(near) > LISTED:
        serve(tree, batch)
        batch.n_listed = 0
        batch.listed_all = False
    tree.lanes.list_boxes(
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


cdef void serve(Tree tree, Batch* batch) noexcept nogil:
    """Let all open queries take candidates from the listed blocks."""
    cdef Py_ssize_t i
    cdef Query* query
    cdef bint all_full = True
    copy_listed(tree, batch)
    batch.reach.squared_limit = 0.0
    for i in range(batch.n_queries):
        query = &batch.queries[i]
        if query.done:
            continue
        take_candidates(tree, batch, query)
        all_full = all_full and query.highest_id >= 0
        batch.highest_id = max(batch.highest_id, query.highest_id)
        batch.reach.squared_limit = max(batch.reach.squared_limit, query.squared_wanted)
    if not all_full:
        batch.highest_id = -1


cdef void take_candidates(Tree tree, Batch* batch, Query* query) noexcept nogil:
    """Make the points of listed blocks candidates of a query."""
    cdef Py_ssize_t group, first
    cdef unsigned int near
    set_local(tree, batch, query)
    for group in range((batch.n_listed + BLOCK - 1) // BLOCK):
        first = BLOCK * group
        near = listed_near(tree, batch, query, first)
        if query.exact:
            tree.lanes.scan(
                &tree.coords[0, 0, 0], &batch.listed[first], near, &query.reach, &query.found
            )
        else:
            tree.lanes.scan_copies(
                &tree.coords[0, 0, 0], batch.copied_blocks + BLOCK * tree.n_axes * first,
                &batch.listed[first], near, &query.reach, &query.local, &query.found
            )
        exclude(query)
        if query.found.n_blocks > candidates_before_drop(batch.k):
            drop_farthest(tree, batch, query)


cdef inline unsigned int listed_near(
    Tree tree, const Batch* batch, const Query* query, Py_ssize_t first
) noexcept nogil:
    """Return which of 16 listed blocks may hold neighbours of a query, as bits."""
    cdef unsigned int near, i
    if query.exact:
        near = tree.lanes.boxes_near(batch.boxes + first, LISTED_STRIDE, &query.reach)
    else:
        near = tree.lanes.copies_near(
            batch.copied_boxes + first, LISTED_STRIDE, &query.reach, &query.local
        )
    near &= (1u << min(batch.n_listed - first, <Py_ssize_t> BLOCK)) - 1
    if query.highest_id >= 0:
        for i in range(BLOCK):
            if near >> i & 1 and hopeless(
                tree, batch.box_number[first + i], &query.reach, query.highest_id
            ):
                near ^= 1u << i
    return near


cdef void exclude(Query* query) noexcept nogil:
    """Put the excluded place, if its block is among the candidates, out of reach."""
    cdef int64_t block, candidate
    if query.excluded < 0:
        return
    for block in range(query.found.n_blocks):
        if query.found.blocks[block] == query.excluded // BLOCK:
            candidate = BLOCK * block + query.excluded % BLOCK
            query.found.keys[candidate] = OUTSIDE


cdef void drop_farthest(Tree tree, Batch* batch, Query* query) noexcept nogil:
    """Keep the k nearest found so far, and look no farther than the farthest of them."""
    cdef Found* found = &query.found
    cdef int64_t last
    find_nearest(tree, batch, query)
    if found.count == batch.k:
        last = last_found(found, &tree.ids[0])
        query.highest_id = tree.ids[BLOCK * found.blocks[last // BLOCK] + last % BLOCK]
        query.squared_wanted = query.reach.squared_limit = found.squared_radius
    tree.lanes.compact(found)
    tree.lanes.rescan(&tree.coords[0, 0, 0], &query.reach, found)
    exclude(query)
    set_local(tree, batch, query)


cdef inline void find_nearest(Tree tree, const Batch* batch, Query* query) noexcept nogil:
    cdef Found* found = &query.found
    cdef const Reach* reach = &query.reach
    tree.lanes.nearest(
        &tree.coords[0, 0, 0], &reach, &query.local.doubt, &found, 1, batch.k, &tree.ids[0]
    )


cdef Py_ssize_t close_queries(Tree tree, Batch* batch) noexcept nogil:
    """Find the k nearest of all open queries; return how many have to look farther."""
    cdef Found* found[TOGETHER]
    cdef const Reach* reach[TOGETHER]
    cdef float[TOGETHER] doubt
    cdef Query* query[TOGETHER]
    cdef Py_ssize_t i, j, n = 0, n_open = 0
    for i in range(batch.n_queries):
        if not batch.queries[i].done:
            query[n] = &batch.queries[i]
            found[n] = &query[n].found
            reach[n] = &query[n].reach
            doubt[n] = query[n].local.doubt
            n += 1
        if n == TOGETHER or (n > 0 and i == batch.n_queries - 1):
            tree.lanes.nearest(
                &tree.coords[0, 0, 0], reach, doubt, found, <int> n, batch.k, &tree.ids[0]
            )
            for j in range(n):
                n_open += not close_query(tree, batch, query[j])
            n = 0
    return n_open


cdef bint close_query(Tree tree, Batch* batch, Query* query) noexcept nogil:
    """Tell whether the k nearest are found; if not, set the query to look farther."""
    cdef Found* found = &query.found
    if found.count < batch.k and query.reach.squared_limit < query.squared_wanted:
        restart(query, query.squared_wanted)
        if not batch.listed_all:
            return False
        take_candidates(tree, batch, query)
        find_nearest(tree, batch, query)
    if found.count < batch.k and query.reach.squared_limit < query.squared_most:
        query.squared_wanted = wider(query, batch.k)
        restart(query, query.squared_wanted)
        return False
    query.done = True
    return True


cdef double wider(const Query* query, Py_ssize_t k) noexcept nogil:
    """Return how far to look, by what the number found suggests."""
    cdef double factor = MOST_WIDENING
    cdef double farther
    if query.found.count > 1:
        factor = min(max(1.5 * k / query.found.count, LEAST_WIDENING), MOST_WIDENING)
    farther = max(query.squared_wanted * factor, query.squared_most * 1e-24)
    # Where squared distances underflow, steps would too.
    if farther <= query.squared_wanted:
        return query.squared_most
    return min(farther, query.squared_most)
