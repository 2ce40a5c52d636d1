"""Fixed-radius query: all points within a radius, block by block.

`visit_radius` calls a visitor with every block that holds any, in tree order, and the bitmask of
their lanes.
"""

from libc.math cimport sqrt

from .tree cimport Tree
from .simd.kernels cimport CONE_WEIGHTS, EPANECHNIKOV_WEIGHTS, SearchBounds

ctypedef void (*Visitor)(
    void* state, Tree tree, Py_ssize_t block, unsigned int lanes
) noexcept nogil

cdef void visit_radius(
    Tree tree, const SearchBounds* bounds, Visitor visit, void* state
) noexcept nogil


cdef inline double weight_of(int shape, double ratio) noexcept nogil:
    """Weight of a kernel at a ratio of squared distance to squared bandwidth; its mean is one."""
    if shape == EPANECHNIKOV_WEIGHTS:
        return 2.0 * (1.0 - ratio)
    if shape == CONE_WEIGHTS:
        return 3.0 * (1.0 - sqrt(ratio))
    return 1.0
