"""All points within a radius of a query, block by block.

`visit_within` calls a visitor for every block that holds any, always in the same order, with the
lanes they are in as bits.
"""

from libc.math cimport sqrt

from .tree cimport Tree
from .simd.kernels cimport CONE_WEIGHTS, EPANECHNIKOV_WEIGHTS, Reach

ctypedef void (*Visitor)(
    void* state, Tree tree, Py_ssize_t block, unsigned int lanes
) noexcept nogil

cdef void visit_within(
    Tree tree, const Reach* reach, Visitor visit, void* state
) noexcept nogil


cdef inline double weight_of(int shape, double ratio) noexcept nogil:
    """Return a kernel's weight at a squared distance over that of its edge; its mean is one."""
    if shape == EPANECHNIKOV_WEIGHTS:
        return 2.0 * (1.0 - ratio)
    if shape == CONE_WEIGHTS:
        return 3.0 * (1.0 - sqrt(ratio))
    return 1.0
