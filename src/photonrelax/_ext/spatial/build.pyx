# distutils: language = c++
"""Build of the k-d tree: the order of its leaves, by median splits.

Nodes are split by keys of 30 bits, not by coordinates. Rows of an id and its keys are smaller than
points: they are moved at every level, which makes all passes sequential, and lower levels run in
the cache. A key is the scaled distance from the lower bound of the node, rounded down. Keys are
monotone in the coordinates; where they are ambiguous (equal keys on both sides of a split, extents
a few units apart), coordinates are compared.

Partitions are stable, so ids ascend in every node. Hence the first of equal coordinates have the
lowest ids, and no split has to compare ids.
"""

from cython.parallel cimport prange, threadid
from libc.math cimport INFINITY
from libc.stdint cimport INT32_MAX, INT32_MIN, int32_t
from libc.string cimport memcpy, memset

from ..common.threads cimport Watch, check_signals, close_watch, goes_on, open_watch, team_size
from .simd.kernels cimport BLOCK
from .build_node cimport (
    COARSE, FIRST_KEY, MAX_AXES, MAX_WORDS, Job, Node, bound_keys, bound_points, coincide, divide,
    divide_tied, key_of, keys_of, keys_per_extent, renew_keys, widest, widest_extent, write_keys,
)
from .build_rows cimport QUAD, Cut, Keys, count_less, find_key, gather_keys

import numpy as np

cdef enum:
    # Subtrees per thread, for an even load; nodes of fewer points are not split any further before
    # threads take subtrees.
    SUBTREES = 4
    MIN_POINTS = 1 << 14
    # Blocks of a node before whose split signals are looked for.
    WATCHED_BLOCKS = 1 << 9


cdef struct ThreadPartial:
    # Bounds and counts of a thread's range of a node.
    double[MAX_AXES] least
    double[MAX_AXES] most
    int32_t[MAX_WORDS] low
    int32_t[MAX_WORDS] high
    Py_ssize_t n_lower


cdef struct Workers:
    # Threads that split one node together, and their partial results.
    const Job* job
    ThreadPartial* partials
    int n_threads
    Watch watch


def median_order(
    const double[:, ::1] points, const double[::1] axis_scale, int n_threads,
    unsigned char[::1] tied=None,
):
    """Order points as the leaves of a tree of median splits.

    Leaves are blocks of 16 points, the last of which may hold fewer. Node j of level l has the
    blocks from ``(j * n_blocks) >> l`` to ``((j + 1) * n_blocks) >> l``; its first half is that of
    node 2j of the next level. That half has the least points by (coordinate, id) on the axis
    where the extent of the node's points times `axis_scale` is greatest, the first of several
    such. In a block, ids ascend.

    Parameters
    ----------
    points : (n, d) float array
        Coordinates, finite; n < 2**31.
    axis_scale : (d,) float array
        Factors that make extents comparable, finite and not negative; on axes of scale zero
        nothing is split. At most 255 may be positive, and scaled extents have to be finite.
    n_threads : int
        Threads; the order does not depend on it.
    tied : (1,) uint8 array, optional
        Set to one if a split has equal coordinates on both sides. If not, coincident points are
        in the same block.

    Returns
    -------
    (n,) intp array
        Ids, the rows of `points`, in the order of the leaves. The memory behind them extends to
        a whole block, so that ids can be read in vectors.

    Raises
    ------
    ValueError
        If there are too many points or axes, or not as many scales as axes.
    """
    cdef Py_ssize_t n = points.shape[0]
    cdef Py_ssize_t[::1] axes = np.flatnonzero(axis_scale)
    cdef double[::1] scale = np.take(axis_scale, axes)
    check(n, points.shape[1], axis_scale.shape[0], axes.shape[0])
    order = np.zeros((n + BLOCK - 1) // BLOCK * BLOCK, np.intp)[:n]
    if n <= BLOCK or axes.shape[0] == 0:
        order[:] = np.arange(n)
        if tied is not None and n > BLOCK:
            tied[0] = True
        return order
    any_tied = np.zeros(1, np.uint8) if tied is None else tied
    build_order(points, axes, scale, order, any_tied, n_threads)
    return order


cdef object build_order(
    const double[:, ::1] points, const Py_ssize_t[::1] axes, const double[::1] scale,
    Py_ssize_t[::1] order, unsigned char[::1] tied, int n_threads,
):
    """Write the order of more than one block of points, split on some axes."""
    cdef Py_ssize_t n = points.shape[0]
    cdef Job job
    cdef Workers workers
    job.n_keys = <int> axes.shape[0]
    job.words = (job.n_keys + QUAD) // QUAD * QUAD
    cdef int32_t[:, :, ::1] rows = np.empty((2, n, job.words), np.int32)
    workers.n_threads = team_size(n_threads, n, MIN_POINTS)
    cdef unsigned char[:, ::1] found = np.zeros(
        (workers.n_threads, sizeof(ThreadPartial)), np.uint8
    )
    job.points = &points[0, 0]
    job.n_points = n
    job.n_axes = points.shape[1]
    job.n_blocks = (n + BLOCK - 1) // BLOCK
    job.axes = &axes[0]
    job.scale = &scale[0]
    job.rows[0] = &rows[0, 0, 0]
    job.rows[1] = &rows[1, 0, 0]
    job.order = &order[0]
    job.tied = &tied[0]
    workers.job = &job
    workers.partials = <ThreadPartial*> &found[0, 0]
    workers.watch = open_watch()
    with nogil:
        build(&workers)
    close_watch(&workers.watch)


cdef object check(
    Py_ssize_t n_points, Py_ssize_t n_axes, Py_ssize_t n_scales, Py_ssize_t n_positive
):
    if n_scales != n_axes:
        raise ValueError(f"axis_scale should have {n_axes} numbers, but has {n_scales}")
    if n_points > INT32_MAX:
        raise ValueError(f"points should have at most {INT32_MAX} rows, but have {n_points}")
    if n_positive > MAX_AXES:
        raise ValueError(
            f"axis_scale should have at most {MAX_AXES} positive numbers, but has {n_positive}"
        )


cdef void build(Workers* workers) noexcept nogil:
    cdef int level = 1, top
    cdef Py_ssize_t index
    split_root(workers)
    while (1 << level) < workers.n_threads and goes_deeper(workers, level):
        for index in range(1 << level):
            split_parallel(workers, level, index)
        level += 1
    top = level
    while workers.n_threads > 1 and (1 << level) < SUBTREES * workers.n_threads and (
        goes_deeper(workers, level)
    ):
        level += 1
    for index in prange(1 << top, schedule="dynamic", num_threads=workers.n_threads):
        split_down(workers.job, top, level, index)
    for index in prange(1 << level, schedule="dynamic", num_threads=workers.n_threads):
        descend(workers, level, index)


cdef bint goes_deeper(Workers* workers, int level) noexcept nogil:
    """Whether the nodes of a level are split before threads take subtrees."""
    return workers.job.n_points >> level >= MIN_POINTS and check_signals(&workers.watch)


cdef void split_down(const Job* job, int level, int last, Py_ssize_t index) noexcept nogil:
    """Split a node and those below it, down to the level before the last."""
    if level < last:
        split_serial(job, level, index)
        split_down(job, level + 1, last, 2 * index)
        split_down(job, level + 1, last, 2 * index + 1)


cdef void split_serial(const Job* job, int level, Py_ssize_t index) noexcept nogil:
    cdef Node node = node_at(job, level, index)
    if not split(job, &node):
        job.tied[0] = True
        copy_node(job, &node)


cdef void copy_node(const Job* job, const Node* node) noexcept nogil:
    """Copy coincident points, whose ids ascend already, as the halves."""
    memcpy(node.halves, node.rows, node.count * job.words * sizeof(int32_t))


cdef Node node_at(const Job* job, int level, Py_ssize_t index) noexcept nogil:
    cdef Node node
    cdef Py_ssize_t first = (index * job.n_blocks) >> level
    cdef Py_ssize_t middle = ((2 * index + 1) * job.n_blocks) >> (level + 1)
    cdef Py_ssize_t end = ((index + 1) * job.n_blocks) >> level
    node.first = BLOCK * first
    node.count = min(BLOCK * end, job.n_points) - node.first
    node.n_lower = BLOCK * (middle - first)
    node.n_blocks = end - first
    node.rows = job.rows[level & 1] + node.first * job.words
    node.halves = job.rows[(level + 1) & 1] + node.first * job.words
    return node


cdef void descend(Workers* workers, int level, Py_ssize_t index) noexcept nogil:
    """Order the points of a node."""
    cdef const Job* job = workers.job
    cdef Node node = node_at(job, level, index)
    if node.n_blocks >= WATCHED_BLOCKS and not goes_on(&workers.watch, threadid() == 0):
        return
    if node.n_blocks < 2:
        write_ids(job, &node)
        return
    if not split(job, &node):
        job.tied[0] = True
        write_ids(job, &node)
        return
    descend(workers, level + 1, 2 * index)
    descend(workers, level + 1, 2 * index + 1)


cdef void write_ids(const Job* job, const Node* node) noexcept nogil:
    cdef Py_ssize_t i
    for i in range(node.count):
        job.order[node.first + i] = node.rows[i * job.words]


cdef bint split(const Job* job, const Node* node) noexcept nogil:
    """Write the halves of a node; return False, and write nothing, if all points coincide."""
    cdef int32_t[MAX_WORDS] low
    cdef int32_t[MAX_WORDS] high
    cdef Cut cut
    cdef Keys keys
    bound_keys(job, node, low, high)
    if widest_extent(job, low, high) < COARSE:
        if not renew_keys(job, node):
            return False
        bound_keys(job, node, low, high)
    cut.word = widest(job, node, low, high)
    keys = keys_of(job, node, cut.word, low, high)
    find_key(keys, node.halves, &cut)
    if cut.n_tied:
        divide_tied(job, node, &cut)
    else:
        divide(job, node, &cut, 0, node.n_lower)
    return True


# All threads at one node

cdef Node thread_range(const Workers* workers, const Node* node, int thread) noexcept nogil:
    """A thread's range of a node's rows."""
    cdef Node part = node[0]
    cdef Py_ssize_t first = thread * node.count // workers.n_threads
    part.first += first
    part.count = (thread + 1) * node.count // workers.n_threads - first
    part.rows += first * workers.job.words
    part.halves += first * workers.job.words
    return part


cdef void split_root(const Workers* workers) noexcept nogil:
    """Write the rows of all points, and split them; bounds of their keys need no pass."""
    cdef Node root = node_at(workers.job, 0, 0)
    cdef double[MAX_AXES] least
    cdef double[MAX_AXES] most
    cdef double unit, extent, greatest = 0.0
    cdef Keys keys
    cdef int thread, axis, word = 1
    bound_root(workers, &root, least, most)
    unit = keys_per_extent(workers.job, least, most)
    for axis in range(workers.job.n_keys):
        extent = (most[axis] - least[axis]) * workers.job.scale[axis]
        if extent > greatest:
            greatest = extent
            word = axis + 1
    for thread in prange(workers.n_threads, num_threads=workers.n_threads):
        write_range(workers, &root, thread, least, unit, word)
    if coincide(workers.job, least, most):
        workers.job.tied[0] = True
        copy_node(workers.job, &root)
        return
    keys = gathered(&root, FIRST_KEY, key_of(greatest * unit))
    cut_parallel(workers, &root, keys, word)


cdef void bound_root(
    const Workers* workers, const Node* root, double* least, double* most
) noexcept nogil:
    cdef int thread, axis
    for thread in prange(workers.n_threads, num_threads=workers.n_threads):
        number_range(workers, root, thread)
    for axis in range(workers.job.n_keys):
        least[axis] = INFINITY
        most[axis] = -INFINITY
        for thread in range(workers.n_threads):
            least[axis] = min(least[axis], workers.partials[thread].least[axis])
            most[axis] = max(most[axis], workers.partials[thread].most[axis])


cdef void number_range(const Workers* workers, const Node* root, int thread) noexcept nogil:
    cdef Node part = thread_range(workers, root, thread)
    cdef Py_ssize_t i
    memset(part.rows, 0, part.count * workers.job.words * sizeof(int32_t))
    for i in range(part.count):
        part.rows[i * workers.job.words] = <int32_t> (part.first + i)
    bound_points(workers.job, &part, workers.partials[thread].least, workers.partials[thread].most)


cdef void write_range(
    const Workers* workers, const Node* root, int thread, const double* least, double unit, int word
) noexcept nogil:
    cdef Node part = thread_range(workers, root, thread)
    write_keys(workers.job, &part, least, unit)
    gather_range(workers, root, thread, word)


cdef void split_parallel(const Workers* workers, int level, Py_ssize_t index) noexcept nogil:
    """Split a node as `split` does, all threads together but for the selection of the key."""
    cdef Node node = node_at(workers.job, level, index)
    cdef int32_t[MAX_WORDS] low
    cdef int32_t[MAX_WORDS] high
    cdef int thread, word
    bound_parallel(workers, &node, low, high)
    if widest_extent(workers.job, low, high) < COARSE:
        if not renew_keys(workers.job, &node):
            workers.job.tied[0] = True
            copy_node(workers.job, &node)
            return
        bound_parallel(workers, &node, low, high)
    word = widest(workers.job, &node, low, high)
    for thread in prange(workers.n_threads, num_threads=workers.n_threads):
        gather_range(workers, &node, thread, word)
    cut_parallel(workers, &node, gathered(&node, low[word], high[word]), word)


cdef Keys gathered(const Node* node, int32_t low, int32_t high) noexcept nogil:
    """Keys from `low` to `high`, in the place of the halves."""
    cdef Keys keys
    keys.first = node.halves
    keys.step = 1
    keys.count = node.count
    keys.rank = node.n_lower
    keys.low = low
    keys.high = high
    return keys


cdef void cut_parallel(
    const Workers* workers, const Node* node, Keys keys, int word
) noexcept nogil:
    """Write the halves of a node whose keys, of one word, have been gathered."""
    cdef Cut cut
    cut.word = word
    find_key(keys, node.halves, &cut)
    if cut.n_tied:
        divide_tied(workers.job, node, &cut)
    else:
        divide_parallel(workers, node, &cut)


cdef void bound_parallel(
    const Workers* workers, const Node* node, int32_t* low, int32_t* high
) noexcept nogil:
    cdef int thread, word
    for thread in prange(workers.n_threads, num_threads=workers.n_threads):
        bound_range(workers, node, thread)
    for word in range(workers.job.words):
        low[word] = INT32_MAX
        high[word] = INT32_MIN
        for thread in range(workers.n_threads):
            low[word] = min(low[word], workers.partials[thread].low[word])
            high[word] = max(high[word], workers.partials[thread].high[word])


cdef void bound_range(const Workers* workers, const Node* node, int thread) noexcept nogil:
    cdef Node part = thread_range(workers, node, thread)
    bound_keys(workers.job, &part, workers.partials[thread].low, workers.partials[thread].high)


cdef void gather_range(
    const Workers* workers, const Node* node, int thread, int word
) noexcept nogil:
    cdef Node part = thread_range(workers, node, thread)
    gather_keys(
        part.rows, part.count, workers.job.words, word, node.halves + part.first - node.first
    )


cdef void divide_parallel(const Workers* workers, const Node* node, const Cut* cut) noexcept nogil:
    cdef int thread
    for thread in prange(workers.n_threads, num_threads=workers.n_threads):
        count_range(workers, node, thread, cut)
    for thread in prange(workers.n_threads, num_threads=workers.n_threads):
        divide_range(workers, node, thread, cut)


cdef void count_range(
    const Workers* workers, const Node* node, int thread, const Cut* cut
) noexcept nogil:
    cdef Node part = thread_range(workers, node, thread)
    workers.partials[thread].n_lower = count_less(
        part.rows, part.count, workers.job.words, cut
    )


cdef void divide_range(
    const Workers* workers, const Node* node, int thread, const Cut* cut
) noexcept nogil:
    cdef Node part = thread_range(workers, node, thread)
    cdef Py_ssize_t lower = 0
    cdef int before
    for before in range(thread):
        lower += workers.partials[before].n_lower
    part.halves = node.halves
    divide(
        workers.job, &part, cut, lower, node.n_lower + part.first - node.first - lower
    )
