"""Float32 blocks; see float_blocks.pxd."""

from libc.math cimport sqrt

from .batch cimport LISTED_STRIDE
from .simd.kernels cimport LIMIT_KEY, MAX_FLOAT_AXES, FloatQuery

# Constants of `error_bound`, derived in docs/methods/neighbour-selection.md: coordinates are at
# most about 1, on up to MAX_FLOAT_AXES axes. The bound is ROUNDING * (r + r²) for small radii r,
# which is MAX_RANK_SLACK keys at r = MIN_RADIUS, and ROUNDING * 2 * MAX_SQUARED for all others.
cdef double ROUNDING = 1e-6
cdef double MIN_RADIUS = 1e-3
cdef double MAX_RANK_SLACK = 0.25
cdef double MAX_SQUARED = 1.1
# Smaller squares underflow in part.
cdef double MIN_SQUARED = 1e-280


cdef void set_quantisation(Tree tree, Batch* batch) noexcept nogil:
    """Choose origin and scale of float32 coordinates: the search bounds lie within [-1, 1]."""
    cdef Py_ssize_t axis
    cdef double half, widest = 0.0, widest_range = 0.0
    for axis in range(tree.n_axes):
        half = 0.5 * (batch.high[axis] - batch.low[axis])
        batch.origin[axis] = batch.low[axis] + half
        if axis < tree.n_metric:
            widest = max(widest, half)
        else:
            widest_range = max(widest_range, half)
    batch.quantisation.scale = 1.0 / (widest + sqrt(batch.bounds.squared_limit))
    batch.quantisation.range_scale = 1.0 / (
        widest_range + sqrt(max(batch.bounds.squared_range, 0.0))
    )


cdef void set_float_query(Tree tree, Batch* batch, Query* query) noexcept nogil:
    """Convert a query to float32; `exact` is set where float32 is too coarse for it."""
    cdef Py_ssize_t axis
    cdef FloatQuery* converted = &query.float_query
    cdef float* at = batch.float_at + tree.n_axes * (query - &batch.queries[0])
    cdef double limit = float_squared(query.bounds.squared_limit, batch.quantisation.scale)
    cdef double squared_range = -1.0
    query.exact = (
        limit < 0.0 or query.bounds.half_range != NULL or tree.n_axes > MAX_FLOAT_AXES
    )
    for axis in range(tree.n_metric):
        at[axis] = <float> (
            batch.quantisation.scale * (query.bounds.low[axis] - batch.origin[axis])
        )
    if query.bounds.squared_range >= 0.0:
        squared_range = float_squared(query.bounds.squared_range, batch.quantisation.range_scale)
        query.exact = query.exact or squared_range < 0.0
        for axis in range(tree.n_metric, tree.n_axes):
            at[axis] = <float> (
                batch.quantisation.range_scale * (query.bounds.low[axis] - batch.origin[axis])
            )
    converted.at = at
    converted.squared_limit = <float> limit
    converted.squared_range = <float> squared_range
    converted.limit_slack = <float> error_bound(limit)
    converted.range_slack = <float> error_bound(squared_range)
    if limit > 0.0:
        converted.rank_slack = <float> (LIMIT_KEY * error_bound(limit) / limit)
    else:
        converted.rank_slack = MAX_RANK_SLACK


cdef inline double float_squared(double squared, double scale) noexcept nogil:
    """Squared radius in float32 coordinates; -1 where they are too coarse or squares underflow."""
    cdef double scaled = squared * (scale * scale)
    if squared >= MIN_SQUARED and MIN_RADIUS * MIN_RADIUS <= scaled <= MAX_SQUARED:
        return scaled
    return -1.0


cdef inline double error_bound(double squared) noexcept nogil:
    """Bound on the error of the difference of two float32 squared distances up to `squared`."""
    if squared >= 0.01:
        return ROUNDING * 2.0 * MAX_SQUARED
    return ROUNDING * (sqrt(max(squared, 0.0)) + squared)


cdef void quantise_listed(Tree tree, Batch* batch) noexcept nogil:
    """Convert the listed blocks and their boxes to float32."""
    cdef Py_ssize_t highs = LISTED_STRIDE * tree.n_axes
    tree.simd.quantise_blocks(
        &tree.coords[0, 0, 0], batch.listed, batch.n_listed, &batch.quantisation, batch.float_blocks
    )
    tree.simd.quantise_rows(
        batch.boxes, LISTED_STRIDE, batch.n_listed, &batch.quantisation, batch.float_boxes
    )
    tree.simd.quantise_rows(
        batch.boxes + highs, LISTED_STRIDE, batch.n_listed, &batch.quantisation,
        batch.float_boxes + highs
    )
