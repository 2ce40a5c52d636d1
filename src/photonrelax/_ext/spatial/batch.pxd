"""Batches: up to 16 queries close to one another, and the memory their search needs.

A batch is a row of `allocate_batches`, one row per thread. It is opened with queries, searched
with `query_batch`, and its neighbours are read or gathered.
"""

from libc.stdint cimport int32_t, int64_t

from .tree cimport Tree
from .simd.kernels cimport BLOCK, Candidates, FloatQuery, Quantisation, SearchBounds


cdef enum:
    # Blocks listed before they are scanned for all queries, and the stride of rows of their boxes,
    # behind which kernels write up to a vector.
    LISTED = 48
    LISTED_STRIDE = 64


cdef struct Query:
    # Bounds of the current attempt, in float64 and in float32, unless that is too coarse.
    SearchBounds bounds
    FloatQuery float_query
    bint exact
    # Squared radius of the next attempt, and of the largest; finite.
    double squared_retry
    double squared_max
    # Estimate of the squared distance to the k-th neighbour, or -1.
    double squared_guess
    # The neighbours are those of the previous query.
    bint repeats_previous
    # Place of a point that is not a neighbour, or -1.
    int64_t excluded
    # After `drop_farthest`, the highest id at the distance of the k-th candidate; else -1.
    int64_t highest_id
    bint done
    Candidates candidates


cdef struct Batch:
    Query[BLOCK] queries
    Py_ssize_t n_queries
    Py_ssize_t k
    # Squared radii of the first and the second attempt, from the last batch.
    double squared_first
    double squared_retry
    # Squared radius as a share of the squared limit in the last batch, for callers that guess.
    double share
    # Bounds that enclose those of all open queries; the greatest of their highest ids if all have
    # one, else -1.
    SearchBounds bounds
    int64_t highest_id
    double* low
    double* high
    double* half_range
    # Coordinates of the queries, (16, n_axes), in float64 and float32.
    double* at
    float* float_at
    # Map to float32 coordinates, and its origin.
    Quantisation quantisation
    double* origin
    # Listed blocks, the numbers of their boxes in the tree, and the boxes; whether these are all
    # blocks within the bounds.
    int32_t[LISTED] listed
    int32_t[LISTED] box_number
    double* boxes
    # The listed blocks and boxes in float32.
    float* float_blocks
    float* float_boxes
    Py_ssize_t n_listed
    bint listed_all
    # Gathered neighbours, rows of `stride`: squared distances, ids, and both sorted; or, in the
    # same memory, coordinates of three axes.
    Py_ssize_t stride
    double* squared
    int64_t* id
    double* sorted
    int64_t* sorted_id
    double* points


cdef unsigned char[:, ::1] allocate_batches(Tree tree, Py_ssize_t k, int n_threads)

cdef void open_block(Tree tree, Batch* batch, Py_ssize_t block) noexcept nogil
cdef void open_query(Tree tree, Batch* batch, const double* at) noexcept nogil
cdef void limit_radius(Query* query, double squared) noexcept nogil
cdef void limit_range(Query* query, double radius) noexcept nogil
cdef bint same_result(Tree tree, const Query* one, const Query* other) noexcept nogil
cdef void copy_neighbours(Candidates* found, const Candidates* other) noexcept nogil
cdef void gather_neighbours(Tree tree, Batch* batch) noexcept nogil
cdef void gather_points(Tree tree, Batch* batch) noexcept nogil


cdef inline Py_ssize_t candidates_before_drop(Py_ssize_t k) noexcept nogil:
    """Number of candidate blocks above which all but the k nearest are dropped."""
    return k + 4 * BLOCK
