"""The search of search.pxd."""

from libc.math cimport INFINITY, sqrt
from libc.stdint cimport int32_t, int64_t
from libc.string cimport memcpy

from .batch cimport LISTED, LISTED_STRIDE, Query, candidates_before_drop
from .kdtree cimport fan_out, first_block, last_kept
from .lanes cimport (
    BLOCK, FARTHEST, KEYS, MOST_COPIED_AXES, OUTSIDE, TOGETHER, Found, Local, Reach,
    count_bits, highest_bit, last_found, lowest_bit, prefetch_row,
)

cdef enum:
    # A depth-first search leaves at most 15 open groups a kept level, of which there are 7.
    STACK_SIZE = 128

# Queries look as far, squared, as the last batch found on the mean, and so much farther (divided
# by the root of k, as their radii scatter); if that is not enough, as far as it found at most, and
# so much farther. What is guessed for a query itself is nearer the truth.
cdef double FIRST = 5.0
cdef double THEN = 1.3
cdef double FIRST_GUESSED = 1.3
cdef double THEN_GUESSED = 1.6
# Copies are floats, of numbers up to 1: on up to MOST_COPIED_AXES axes two squared distances up to
# r² among them are off by at most ROUNDING * (r + r²) in all while r is small, which is MOST_DOUBT
# keys where r is COARSEST. Where r is near 1 the query is near the origin, which rounds nothing:
# ROUNDING * 2 * FARTHEST_COPIED is enough for all.
cdef double ROUNDING = 1e-6
cdef double COARSEST = 1e-3
cdef double MOST_DOUBT = 0.25
cdef double FARTHEST_COPIED = 1.1
# Lesser squares underflow in part.
cdef double LEAST_COPIED = 1e-280
# If even that was too little they look farther, squared, by at least and at most so much.
cdef double LEAST_WIDENING = 1.5
cdef double MOST_WIDENING = 16.0


cdef void find(Tree tree, Batch* batch) noexcept nogil:
    """Find the k nearest of all queries of the batch, ties by id, each in its `found`."""
    cdef Py_ssize_t i, n_open = batch.n_queries
    cdef double farthest = 0.0, total = 0.0
    for i in range(batch.n_queries):
        start(batch, &batch.queries[i])
        if i > 0 and alike(tree, &batch.queries[i - 1], &batch.queries[i]):
            batch.queries[i].done = True
            n_open -= 1
    while n_open > 0:
        set_outer_reach(tree, batch)
        traverse(tree, batch)
        n_open = close_queries(tree, batch)
    for i in range(batch.n_queries):
        if i > 0 and alike(tree, &batch.queries[i - 1], &batch.queries[i]):
            copy_found(&batch.queries[i].found, &batch.queries[i - 1].found)
        total += batch.queries[i].found.squared_radius
        farthest = max(farthest, batch.queries[i].found.squared_radius)
    batch.squared_first = (1.0 + FIRST / sqrt(batch.k)) * total / batch.n_queries
    batch.squared_then = THEN * farthest


cdef inline bint alike(Tree tree, const Query* one, const Query* other) noexcept nogil:
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


cdef void set_frame(Tree tree, Batch* batch) noexcept nogil:
    """Choose where copies have their origin, and their scale: what is in reach lies within 1."""
    cdef Py_ssize_t axis
    cdef double half, widest = 0.0, widest_range = 0.0
    for axis in range(tree.n_axes):
        half = 0.5 * (batch.high[axis] - batch.low[axis])
        batch.origin[axis] = batch.low[axis] + half
        if axis < tree.n_metric:
            widest = max(widest, half)
        else:
            widest_range = max(widest_range, half)
    batch.frame.scale = 1.0 / (widest + sqrt(batch.reach.squared_limit))
    batch.frame.range_scale = 1.0 / (widest_range + sqrt(max(batch.reach.squared_range, 0.0)))


cdef inline void set_local(Tree tree, Batch* batch, Query* query) noexcept nogil:
    """Find a query's reach among copies, and whether they are fine enough for it."""
    cdef Py_ssize_t axis
    cdef Local* local = &query.local
    cdef float* at = batch.local_at + tree.n_axes * (query - &batch.queries[0])
    cdef double limit = local_squared(query.reach.squared_limit, batch.frame.scale)
    cdef double within = -1.0
    query.exact = (
        limit < 0.0 or query.reach.half_range != NULL or tree.n_axes > MOST_COPIED_AXES
    )
    for axis in range(tree.n_metric):
        at[axis] = <float> (batch.frame.scale * (query.reach.low[axis] - batch.origin[axis]))
    if query.reach.squared_range >= 0.0:
        within = local_squared(query.reach.squared_range, batch.frame.range_scale)
        query.exact = query.exact or within < 0.0
        for axis in range(tree.n_metric, tree.n_axes):
            at[axis] = <float> (
                batch.frame.range_scale * (query.reach.low[axis] - batch.origin[axis])
            )
    local.at = at
    local.squared_limit = <float> limit
    local.squared_range = <float> within
    local.limit_slack = <float> rounding(limit)
    local.range_slack = <float> rounding(within)
    local.doubt = <float> (FARTHEST * rounding(limit) / limit) if limit > 0.0 else MOST_DOUBT


cdef inline double local_squared(double squared, double scale) noexcept nogil:
    """Return a squared radius among copies, -1 where they are too coarse or finer than exact."""
    cdef double local = squared * (scale * scale)
    if squared >= LEAST_COPIED and COARSEST * COARSEST <= local <= FARTHEST_COPIED:
        return local
    return -1.0


cdef inline double rounding(double squared) noexcept nogil:
    """Return by how much squared distances up to this may be off among copies.

    It is enough for the errors of two of them, by which a farther point may seem nearer.
    """
    if squared >= 0.01:
        return ROUNDING * 2.0 * FARTHEST_COPIED
    return ROUNDING * (sqrt(max(squared, 0.0)) + squared)


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
    serve(tree, batch)


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


cdef void copy_listed(Tree tree, Batch* batch) noexcept nogil:
    """Copy the listed blocks and their boxes."""
    cdef Py_ssize_t highs = LISTED_STRIDE * tree.n_axes
    tree.lanes.copy_blocks(
        &tree.coords[0, 0, 0], batch.listed, batch.n_listed, &batch.frame, batch.copied_blocks
    )
    tree.lanes.copy_rows(
        batch.boxes, LISTED_STRIDE, batch.n_listed, &batch.frame, batch.copied_boxes
    )
    tree.lanes.copy_rows(
        batch.boxes + highs, LISTED_STRIDE, batch.n_listed, &batch.frame,
        batch.copied_boxes + highs
    )


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
