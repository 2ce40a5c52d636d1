"""k-nearest-neighbour search on the metric axes, limited to a range on the others.

Up to 16 queries close to one another, a batch, are answered in one traversal: blocks that overlap
the bounds of any query are listed, then scanned for each query. The radius of the first attempt is
a guess, from the last batch or given with the query; a query with too few candidates is repeated
with a larger radius. The neighbours do not depend on the guess.

Distances are sums of squared differences in axis order, for boxes as for points. Rounding is
monotone, so a box is never computed to be farther than a point in it: pruning is exact, and a
brute-force loop over the axes in the same order gives the same bits.
"""

from .batch cimport Batch
from .tree cimport Tree


cdef void query_batch(Tree tree, Batch* batch) noexcept nogil
