"""Float32 blocks: listed blocks and queries of a batch, relative to an origin near it."""

from .batch cimport Batch, Query
from .tree cimport Tree


cdef void set_quantisation(Tree tree, Batch* batch) noexcept nogil
cdef void set_float_query(Tree tree, Batch* batch, Query* query) noexcept nogil
cdef void quantise_listed(Tree tree, Batch* batch) noexcept nogil
