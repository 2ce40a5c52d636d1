"""All points within a radius of a query, block by block.

`visit_within` calls a visitor for every block that holds any, always in the same order, with the
lanes they are in as bits.
"""

from .kdtree cimport Tree
from .lanes cimport Reach

ctypedef void (*Visitor)(
    void* state, Tree tree, Py_ssize_t block, unsigned int lanes
) noexcept nogil

cdef void visit_within(
    Tree tree, const Reach* reach, Visitor visit, void* state
) noexcept nogil
