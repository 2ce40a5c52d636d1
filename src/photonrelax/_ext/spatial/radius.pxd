"""Fixed-radius query: all points within a radius, block by block.

`visit_radius` calls a visitor with every block that holds any, in tree order, and the bitmask of
their lanes.
"""

from libc.math cimport exp, sqrt

from .tree cimport Tree
from .simd.kernels cimport (
    CONE_WEIGHTS, EPANECHNIKOV_WEIGHTS, GAUSSIAN_EXPONENT, GAUSSIAN_PEAK, GAUSSIAN_WEIGHTS,
    SearchBounds,
)

cdef enum:
    # Queries that a thread takes at a time, and after which it looks for signals.
    QUERY_GRAIN = 256
    LOOK_EVERY = 16

ctypedef void (*Visitor)(
    void* state, Tree tree, Py_ssize_t block, unsigned int lanes
) noexcept nogil

cdef void visit_radius(
    Tree tree, const SearchBounds* bounds, Visitor visit, void* state
) noexcept nogil


cdef inline SearchBounds ball(
    Tree tree, const double* at, double radius, double range_radius
) noexcept nogil:
    """Bounds of the ball around a point; a negative `range_radius` leaves range axes open."""
    cdef SearchBounds bounds
    bounds.low = bounds.high = at
    bounds.squared_limit = radius * radius
    bounds.squared_range = range_radius * range_radius if range_radius >= 0.0 else -1.0
    bounds.half_range = NULL
    bounds.n_metric = tree.n_metric
    bounds.n_axes = tree.n_axes
    return bounds


cdef inline double weight_of(int shape, double ratio) noexcept nogil:
    """Weight of a kernel at a ratio of squared distance to squared bandwidth; its mean is one."""
    if shape == EPANECHNIKOV_WEIGHTS:
        return 2.0 * (1.0 - ratio)
    if shape == CONE_WEIGHTS:
        return 3.0 * (1.0 - sqrt(ratio))
    if shape == GAUSSIAN_WEIGHTS:
        return GAUSSIAN_PEAK * exp(-GAUSSIAN_EXPONENT * ratio)
    return 1.0
