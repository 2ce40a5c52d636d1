"""Copies of blocks near a batch, in floats about an origin next to it, and queries among them."""

from .batch cimport Batch, Query
from .tree cimport Tree


cdef void set_frame(Tree tree, Batch* batch) noexcept nogil
cdef void set_local(Tree tree, Batch* batch, Query* query) noexcept nogil
cdef void copy_listed(Tree tree, Batch* batch) noexcept nogil
