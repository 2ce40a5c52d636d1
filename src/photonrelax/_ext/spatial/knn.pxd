"""Search of the tree: the k nearest on the metric axes, limited to a range on the others.

Up to 16 queries that are near one another, a batch, are answered in one traversal: blocks in
reach of any of them are listed, then each query takes its candidates from the list. How far a
query looks is a guess, made from what the last batch found or given with the query; one that has
found too little looks again, farther. What is found does not depend on the guess.

Distances are sums of squared differences in axis order, for boxes as for points. Rounding is
monotone, so a box is never computed to be farther than a point in it: pruning is exact, and a
brute-force loop over the axes in the same order gives the same bits.
"""

from .batch cimport Batch
from .tree cimport Tree


cdef void find(Tree tree, Batch* batch) noexcept nogil
