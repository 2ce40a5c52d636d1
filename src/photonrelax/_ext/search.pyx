"""The search of search.pxd."""

from libc.float cimport DBL_MAX
from libc.math cimport INFINITY
from libc.stdint cimport uint8_t

import numpy as np

from .kdtree cimport fan_out, first_block, last_kept
from .lanes cimport (
    FEW_CHUNKS, KEYS, LANES, OUTSIDE, TOGETHER, highest_bit, key_scale, lowest_bit,
)

cdef enum:
    # A depth-first search leaves at most 15 open groups a kept level, of which there are 8.
    STACK_SIZE = 128

# Queries look as far, squared, as the last batch found on the mean, and so much farther; if that
# is not enough, as far as it found at most, and so much farther. What is guessed for a query
# itself is nearer the truth.
cdef double FIRST = 1.5
cdef double THEN = 1.25
cdef double FIRST_GUESSED = 1.2
cdef double THEN_GUESSED = 1.5
# If even that was too little they look farther, squared, by at least and at most so much.
cdef double LEAST_WIDENING = 1.5
cdef double MOST_WIDENING = 16.0


cdef Py_ssize_t most_candidates(Tree tree, Py_ssize_t k) noexcept nogil:
    """Return of how many blocks points may be candidates of a query at a time."""
    return min(max(k, candidates_before_drop(k)) + BLOCK, tree.n_blocks) + 1


cdef inline Py_ssize_t candidates_before_drop(Py_ssize_t k) noexcept nogil:
    """Return of how many blocks points are candidates before the farthest are dropped."""
    return k // 4 + BLOCK


cdef unsigned char[:, ::1] scratch(Tree tree, Py_ssize_t k, int n_threads):
    """Return a batch in each row, a row a thread."""
    cdef Py_ssize_t thread
    k = min(k, tree.n_points)
    n_bytes = lay_out(tree, NULL, k)
    room = np.empty((n_threads, 64 * (n_bytes // 64 + 1)), dtype=np.uint8)
    cdef unsigned char[:, ::1] rows = room
    for thread in range(n_threads):
        lay_out(tree, &rows[thread, 0], k)
    return rows


cdef Py_ssize_t lay_out(Tree tree, unsigned char* room, Py_ssize_t k):
    """Lay a batch out in the room, unless that is NULL; return the bytes it takes."""
    cdef Batch nowhere
    cdef Batch* batch = &nowhere if room == NULL else <Batch*> room
    cdef unsigned char* free = room + sizeof(Batch)
    cdef Py_ssize_t i, points = BLOCK * most_candidates(tree, k)
    cdef Found* found
    batch.k = k
    # As if points were spread evenly over a plane.
    batch.squared_first = batch.squared_then = tree.squared_diagonal * k / (4 * tree.n_points + 1)
    batch.share = 0.1
    batch.at = <double*> take(&free, 8 * BLOCK * tree.n_axes)
    batch.low = <double*> take(&free, 8 * tree.n_axes)
    batch.high = <double*> take(&free, 8 * tree.n_axes)
    batch.half_range = <double*> take(&free, 8 * tree.n_axes)
    batch.boxes = <double*> take(&free, 16 * tree.n_axes * LISTED)
    batch.stride = k + LANES
    batch.squared = <double*> take(&free, 8 * BLOCK * batch.stride)
    batch.place = <int64_t*> take(&free, 8 * BLOCK * batch.stride)
    batch.points = <double*> take(&free, 24 * BLOCK * batch.stride)
    set_axes(tree, &batch.reach, batch.low, batch.high)
    for i in range(BLOCK):
        found = &batch.queries[i].found
        found.squared = <double*> take(&free, 16 * points)
        found.keys = <uint8_t*> take(&free, points + FEW_CHUNKS * KEYS)
        found.blocks = <int32_t*> take(&free, 4 * points // BLOCK)
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
    cdef double* at
    batch.n_queries = 0
    for lane in range(min(tree.n_points - BLOCK * block, <Py_ssize_t> BLOCK)):
        at = batch.at + lane * tree.n_axes
        for axis in range(tree.n_axes):
            at[axis] = tree.coords[block, axis, lane]
        open_query(tree, batch, at)


cdef void open_query(Tree tree, Batch* batch, const double* at) noexcept nogil:
    """Add a query, without limits, to the batch; the caller keeps its coordinates."""
    cdef Query* query = &batch.queries[batch.n_queries]
    query.reach.low = query.reach.high = at
    query.reach.squared_range = -1.0
    query.reach.half_range = NULL
    query.squared_guess = -1.0
    query.excluded = -1
    query.squared_most = squared_farthest(tree, at)
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
    query.reach.squared_range = radius * radius


cdef void find(Tree tree, Batch* batch) noexcept nogil:
    """Find the k nearest of all queries of the batch, ties by id, each in its `found`."""
    cdef Py_ssize_t i, n_open = batch.n_queries
    cdef double farthest = 0.0, total = 0.0
    cdef Query* query
    for i in range(batch.n_queries):
        start(batch, &batch.queries[i])
    while n_open > 0:
        set_outer_reach(tree, batch)
        traverse(tree, batch)
        n_open = close_queries(tree, batch)
    for i in range(batch.n_queries):
        total += batch.queries[i].found.squared_radius
        farthest = max(farthest, batch.queries[i].found.squared_radius)
    batch.squared_first = FIRST * total / batch.n_queries
    batch.squared_then = THEN * farthest


cdef void list_places(Tree tree, Batch* batch) noexcept nogil:
    """List the neighbours of all queries, by place."""
    cdef Py_ssize_t i
    for i in range(batch.n_queries):
        tree.lanes.list(
            &batch.queries[i].found, batch.squared + i * batch.stride,
            batch.place + i * batch.stride
        )


cdef void list_points(Tree tree, Batch* batch) noexcept nogil:
    """List the neighbours of all queries with their coordinates, each as far apart as they are."""
    cdef Py_ssize_t i
    for i in range(batch.n_queries):
        tree.lanes.list_points(
            &tree.coords[0, 0, 0], tree.n_axes, &batch.queries[i].found,
            batch.squared + i * batch.stride, batch.points + 3 * i * batch.stride
        )


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
    look_as_far(query, squared_limit)


cdef inline void look_as_far(Query* query, double squared_limit) noexcept nogil:
    query.reach.squared_limit = squared_limit
    query.reach.key_scale = key_scale(squared_limit)


cdef void set_outer_reach(Tree tree, Batch* batch) noexcept nogil:
    """Let the batch reach what any of its open queries wants to."""
    cdef Py_ssize_t i, axis
    cdef const Query* query
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
    set_half_range(tree, batch)


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
    cdef unsigned int near = tree.lanes.boxes_near(&tree.boxes[group, 0, 0, 0], &batch.reach)
    cdef unsigned int child
    if batch.highest_id >= 0:
        for child in range(BLOCK):
            if near >> child & 1 and hopeless(
                tree, &tree.boxes[group, 0, 0, child], tree.lowest_id[group, child], &batch.reach,
                batch.highest_id
            ):
                near ^= 1u << child
    return near


cdef inline bint hopeless(
    Tree tree, const double* box, int64_t lowest_id, const Reach* reach, int64_t highest_id
) noexcept nogil:
    """Tell whether points in a box are too far away or lose, by their ids, to those found.

    Without this test many coincident points would all be visited by each of their queries.
    """
    cdef double squared = 0.0, gap
    cdef Py_ssize_t axis
    if highest_id < 0 or lowest_id <= highest_id:
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
    cdef unsigned int child
    while near:
        child = lowest_bit(near)
        near &= near - 1
        if batch.n_listed == LISTED:
            serve(tree, batch)
            batch.n_listed = 0
            batch.listed_all = False
        list_block(
            tree, batch, tree.first_group[last] + g, child, first_block(tree, node + child)
        )


cdef void list_block(
    Tree tree, Batch* batch, Py_ssize_t group, Py_ssize_t child, Py_ssize_t block
) noexcept nogil:
    """Note a block in reach, its lowest id and its box."""
    cdef Py_ssize_t row, n = batch.n_listed
    cdef double* to = batch.boxes + 2 * tree.n_axes * (n - n % BLOCK) + n % BLOCK
    cdef const double* box = &tree.boxes[group, 0, 0, child]
    for row in range(2 * tree.n_axes):
        to[BLOCK * row] = box[BLOCK * row]
    batch.listed[n] = <int32_t> block
    batch.lowest_id[n] = tree.lowest_id[group, child]
    batch.n_listed = n + 1


cdef void serve(Tree tree, Batch* batch) noexcept nogil:
    """Let all open queries take candidates from the listed blocks."""
    cdef Py_ssize_t i
    cdef Query* query
    cdef bint all_full = True
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
    cdef Py_ssize_t group, n, listed, n_axes = tree.n_axes
    cdef const double* boxes
    cdef unsigned int near
    cdef int32_t[BLOCK] blocks
    for group in range((batch.n_listed + BLOCK - 1) // BLOCK):
        boxes = batch.boxes + 2 * n_axes * BLOCK * group
        near = tree.lanes.boxes_near(boxes, &query.reach)
        near &= (1u << min(batch.n_listed - BLOCK * group, <Py_ssize_t> BLOCK)) - 1
        n = 0
        while near:
            listed = lowest_bit(near)
            near &= near - 1
            blocks[n] = batch.listed[BLOCK * group + listed]
            n += not hopeless(
                tree, boxes + listed, batch.lowest_id[BLOCK * group + listed], &query.reach,
                query.highest_id
            )
        tree.lanes.scan(&tree.coords[0, 0, 0], blocks, n, &query.reach, &query.found)
        exclude(query)
        if query.found.n_blocks > candidates_before_drop(batch.k):
            drop_farthest(tree, batch, query)


cdef void exclude(Query* query) noexcept nogil:
    """Put the excluded place, if its block is among the candidates, out of reach."""
    cdef int64_t block, candidate
    if query.excluded < 0:
        return
    for block in range(query.found.n_blocks):
        if query.found.blocks[block] == query.excluded // BLOCK:
            candidate = BLOCK * block + query.excluded % BLOCK
            query.found.squared[candidate] = INFINITY
            query.found.keys[candidate] = OUTSIDE


cdef void drop_farthest(Tree tree, Batch* batch, Query* query) noexcept nogil:
    """Keep the k nearest found so far, and look no farther than the farthest of them."""
    cdef Found* found = &query.found
    cdef int64_t j
    tree.lanes.nearest(&found, 1, batch.k, &tree.ids[0])
    if found.count < batch.k:
        tree.lanes.compact(found, query.reach.key_scale)
        return
    look_as_far(query, found.squared_radius)
    tree.lanes.compact(found, query.reach.key_scale)
    query.squared_wanted = found.squared_radius
    query.highest_id = -1
    for j in range(BLOCK * found.n_blocks):
        if found.squared[j] == found.squared_radius:
            query.highest_id = max(
                query.highest_id, tree.ids[BLOCK * found.blocks[j // BLOCK] + j % BLOCK]
            )


cdef Py_ssize_t close_queries(Tree tree, Batch* batch) noexcept nogil:
    """Find the k nearest of all open queries; return how many have to look farther."""
    cdef Found* found[TOGETHER]
    cdef Query* query[TOGETHER]
    cdef Py_ssize_t i, j, n = 0, n_open = 0
    for i in range(batch.n_queries):
        if not batch.queries[i].done:
            query[n] = &batch.queries[i]
            found[n] = &query[n].found
            n += 1
        if n == TOGETHER or (n > 0 and i == batch.n_queries - 1):
            tree.lanes.nearest(found, <int> n, batch.k, &tree.ids[0])
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
        tree.lanes.nearest(&found, 1, batch.k, &tree.ids[0])
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
    return min(farther, query.squared_most) if farther > query.squared_wanted else query.squared_most
