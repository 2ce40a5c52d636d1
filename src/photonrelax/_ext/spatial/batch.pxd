"""Batches: up to 16 queries that are near one another, and room for what they find.

A batch lies in a row of `scratch`, a row a thread: it is opened with queries, searched with `find`,
and read or listed.
"""

from libc.stdint cimport int32_t, int64_t

from .tree cimport Tree
from .simd.kernels cimport BLOCK, Found, Frame, Local, Reach


cdef enum:
    # Blocks are listed up to so many before queries take their candidates. Rows of what is listed
    # of them are so far apart, as more is written behind them.
    LISTED = 48
    LISTED_STRIDE = 64


cdef struct Query:
    # From where, and how far it looks at present; the same among copies, unless those are too
    # coarse for it.
    Reach reach
    Local local
    bint exact
    # How far it looks if that is not enough, and what it never looks beyond; finite.
    double squared_wanted
    double squared_most
    # A guess of what it will find, or -1.
    double squared_guess
    # Whether it finds what the query before it does.
    bint alike
    # A place that is not to be found, or -1.
    int64_t excluded
    # Once k were found and the rest dropped, the highest id as far away as the farthest; else -1.
    int64_t highest_id
    bint done
    Found found


cdef struct Batch:
    Query[BLOCK] queries
    Py_ssize_t n_queries
    Py_ssize_t k
    # How far queries look, and how far if that is not enough; from what was found before.
    double squared_first
    double squared_then
    # What was found before as a share of the squared reach, for those who guess by it.
    double share
    # What any query wants to reach; the highest of their highest ids if all have one, else -1.
    Reach reach
    int64_t highest_id
    double* low
    double* high
    double* half_range
    # Coordinates of the queries, (16, n_axes), and among copies.
    double* at
    float* local_at
    # How copies are made, and where their origin is.
    Frame frame
    double* origin
    # Blocks in reach, what number they have among all boxes, and these; whether that is all.
    int32_t[LISTED] listed
    int32_t[LISTED] box_number
    double* boxes
    # Copies of blocks and boxes.
    float* copied_blocks
    float* copied_boxes
    Py_ssize_t n_listed
    bint listed_all
    # Lists of neighbours, `stride` apart: squared distances, ids, and both sorted; or, in the same
    # room, coordinates of three axes.
    Py_ssize_t stride
    double* squared
    int64_t* id
    double* sorted
    int64_t* sorted_id
    double* points


cdef unsigned char[:, ::1] scratch(Tree tree, Py_ssize_t k, int n_threads)

cdef void open_block(Tree tree, Batch* batch, Py_ssize_t block) noexcept nogil
cdef void open_query(Tree tree, Batch* batch, const double* at) noexcept nogil
cdef void limit_radius(Query* query, double squared) noexcept nogil
cdef void limit_range(Query* query, double radius) noexcept nogil
cdef bint alike(Tree tree, const Query* one, const Query* other) noexcept nogil
cdef void copy_found(Found* found, const Found* other) noexcept nogil
cdef void list_neighbours(Tree tree, Batch* batch) noexcept nogil
cdef void list_points(Tree tree, Batch* batch) noexcept nogil


cdef inline Py_ssize_t candidates_before_drop(Py_ssize_t k) noexcept nogil:
    """Return of how many blocks points are candidates before the farthest are dropped."""
    return k + 4 * BLOCK
