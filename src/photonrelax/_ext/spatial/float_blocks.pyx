"""The copies of copies.pxd."""

from libc.math cimport sqrt

from .batch cimport LISTED_STRIDE
from .simd.kernels cimport FARTHEST, MOST_COPIED_AXES, Local

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


cdef void set_local(Tree tree, Batch* batch, Query* query) noexcept nogil:
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
