"""Split of one node; see build.pyx."""

from libc.float cimport DBL_MAX
from libc.math cimport INFINITY
from libc.stdint cimport int32_t, uint32_t

from .build_rows cimport QUAD, Cut, Keys, bound_rows, divide_marked, divide_rows, list_equal

cdef enum:
    FIRST_KEY = 1 << 23
    KEY_RANGE = 1 << 30
    # Extent, in units of the keys, below which a node gets new keys.
    COARSE = 1 << 12
    # Difference of extents, whose error is below two, up to which they are compared exactly.
    CLOSE = 4
    MAX_AXES = 255
    MAX_WORDS = 256


cdef extern from "<algorithm>" namespace "std" nogil:
    void nth_element(double* first, double* nth, double* last)


cdef struct Job:
    # Data of all nodes.
    const double* points
    Py_ssize_t n_points
    Py_ssize_t n_axes
    Py_ssize_t n_blocks
    # The axes to split on, and the factors of their extents.
    const Py_ssize_t* axes
    const double* scale
    int n_keys
    # Words of a row.
    int words
    # Rows of the nodes of even and of odd levels.
    int32_t* rows[2]
    Py_ssize_t* order
    # Set where points of equal coordinates on the axis of a split are on both sides of it.
    unsigned char* tied


cdef struct Node:
    int32_t* rows
    # Rows of the halves; scratch before these are written.
    int32_t* halves
    Py_ssize_t first
    Py_ssize_t count
    Py_ssize_t n_lower
    Py_ssize_t n_blocks


cdef inline Keys keys_of(
    const Job* job, const Node* node, int word, const int32_t* low, const int32_t* high
) noexcept nogil:
    cdef Keys keys
    keys.first = node.rows + word
    keys.step = job.words
    keys.count = node.count
    keys.rank = node.n_lower
    keys.low = low[word]
    keys.high = high[word]
    return keys


cdef inline void bound_keys(
    const Job* job, const Node* node, int32_t* low, int32_t* high
) noexcept nogil:
    # With a constant number of words passes are twice as fast.
    if job.words == QUAD:
        bound_rows(node.rows, node.count, QUAD, low, high)
    elif job.words == 2 * QUAD:
        bound_rows(node.rows, node.count, 2 * QUAD, low, high)
    else:
        bound_rows(node.rows, node.count, job.words, low, high)


cdef inline void divide(
    const Job* job, const Node* node, const Cut* cut, Py_ssize_t lower, Py_ssize_t upper
) noexcept nogil:
    if job.words == QUAD:
        divide_rows(node.rows, node.count, QUAD, cut, node.halves, lower, upper)
    elif job.words == 2 * QUAD:
        divide_rows(node.rows, node.count, 2 * QUAD, cut, node.halves, lower, upper)
    else:
        divide_rows(node.rows, node.count, job.words, cut, node.halves, lower, upper)


# The axis

cdef inline uint32_t extent(const int32_t* low, const int32_t* high, int word) noexcept nogil:
    return <uint32_t> high[word] - <uint32_t> low[word]


cdef inline uint32_t widest_extent(
    const Job* job, const int32_t* low, const int32_t* high
) noexcept nogil:
    cdef int word
    cdef uint32_t most = 0
    for word in range(1, job.n_keys + 1):
        most = max(most, extent(low, high, word))
    return most


cdef inline int widest(
    const Job* job, const Node* node, const int32_t* low, const int32_t* high
) noexcept nogil:
    """Word of the axis of greatest scaled extent."""
    cdef uint32_t most = widest_extent(job, low, high)
    cdef int word, n_close = 0, close = 0
    for word in range(1, job.n_keys + 1):
        if extent(low, high, word) + CLOSE >= most:
            n_close += 1
            close = word
    return close if n_close == 1 else exactly_widest(job, node, low, high)


cdef inline int exactly_widest(
    const Job* job, const Node* node, const int32_t* low, const int32_t* high
) noexcept nogil:
    cdef uint32_t most = widest_extent(job, low, high)
    cdef int word, best = 1
    cdef double scaled, greatest = -1.0
    for word in range(1, job.n_keys + 1):
        if extent(low, high, word) + CLOSE < most:
            continue
        scaled = exact_extent(job, node, word, low, high) * job.scale[word - 1]
        if scaled > greatest:
            greatest = scaled
            best = word
    return best


cdef inline double exact_extent(
    const Job* job, const Node* node, int word, const int32_t* low, const int32_t* high
) noexcept nogil:
    cdef double x, least = INFINITY, most = -INFINITY
    cdef Py_ssize_t i
    cdef Py_ssize_t n = list_equal(
        node.rows, node.count, job.words, word, low[word], high[word], node.halves
    )
    for i in range(n):
        x = coordinate(job, node.rows + node.halves[i] * job.words, word)
        least = min(least, x)
        most = max(most, x)
    return most - least


cdef inline double coordinate(const Job* job, const int32_t* row, int word) noexcept nogil:
    return job.points[row[0] * job.n_axes + job.axes[word - 1]]


# The keys

cdef inline bint renew_keys(const Job* job, const Node* node) noexcept nogil:
    """Compute keys relative to the node's bounds; return False if all points coincide."""
    cdef double[MAX_AXES] least
    cdef double[MAX_AXES] most
    bound_points(job, node, least, most)
    if coincide(job, least, most):
        return False
    write_keys(job, node, least, keys_per_extent(job, least, most))
    return True


cdef inline void bound_points(
    const Job* job, const Node* node, double* least, double* most
) noexcept nogil:
    cdef Py_ssize_t i
    cdef int axis
    cdef double x
    for axis in range(job.n_keys):
        least[axis] = INFINITY
        most[axis] = -INFINITY
    for i in range(node.count):
        for axis in range(job.n_keys):
            x = coordinate(job, node.rows + i * job.words, axis + 1)
            least[axis] = min(least[axis], x)
            most[axis] = max(most[axis], x)


cdef inline bint coincide(const Job* job, const double* least, const double* most) noexcept nogil:
    cdef int axis
    for axis in range(job.n_keys):
        if least[axis] < most[axis]:
            return False
    return True


cdef inline double keys_per_extent(
    const Job* job, const double* least, const double* most
) noexcept nogil:
    cdef int axis
    cdef double widest = 0.0
    for axis in range(job.n_keys):
        widest = max(widest, (most[axis] - least[axis]) * job.scale[axis])
    return min(KEY_RANGE / widest, DBL_MAX) if widest > 0.0 else 1.0


cdef inline void write_keys(
    const Job* job, const Node* node, const double* least, double unit
) noexcept nogil:
    cdef Py_ssize_t i
    cdef int axis
    cdef int32_t* row
    for i in range(node.count):
        row = node.rows + i * job.words
        for axis in range(job.n_keys):
            row[axis + 1] = key_of(
                (coordinate(job, row, axis + 1) - least[axis]) * job.scale[axis] * unit
            )


cdef inline int32_t key_of(double position) noexcept nogil:
    # Clamps NaN as well: keys are indices.
    position = position if position > 0.0 else 0.0
    return FIRST_KEY + <int32_t> (position if position < KEY_RANGE else <double> KEY_RANGE)


# Equal keys

cdef inline void divide_tied(const Job* job, const Node* node, const Cut* cut) noexcept nogil:
    """Divide where only some of the rows whose key is that of the cut belong to the lower half."""
    cdef int32_t* tied = node.halves
    cdef Py_ssize_t n = list_equal(
        node.rows, node.count, job.words, cut.word, cut.key, cut.key, tied
    )
    mark_lower(job, node, cut, tied, n)
    if job.words == QUAD:
        divide_marked(node.rows, node.count, QUAD, cut, node.halves, node.n_lower)
    else:
        divide_marked(node.rows, node.count, job.words, cut, node.halves, node.n_lower)


cdef inline void mark_lower(
    const Job* job, const Node* node, const Cut* cut, const int32_t* tied, Py_ssize_t n
) noexcept nogil:
    """Complement the ids of the tied rows that belong to the lower half."""
    cdef double* x = <double*> (tied + (n + 1) // 2 * 2)
    cdef Py_ssize_t n_coincident = cut.n_tied
    cdef Py_ssize_t i
    cdef double median
    cdef bint is_equal, is_lower
    if not read_tied(job, node, cut, tied, n, x):
        job.tied[0] = True
        for i in range(cut.n_tied):
            node.rows[tied[i] * job.words] ^= -1
        return
    nth_element(x, x + cut.n_tied, x + n)
    median = x[cut.n_tied]
    for i in range(cut.n_tied):
        n_coincident -= x[i] < median
    if n_coincident > 0:
        job.tied[0] = True
    for i in range(n):
        x[0] = coordinate(job, node.rows + tied[i] * job.words, cut.word)
        is_equal = x[0] == median
        is_lower = (x[0] < median) | (is_equal & (n_coincident > 0))
        n_coincident -= is_equal
        node.rows[tied[i] * job.words] ^= -<int32_t> is_lower


cdef inline bint read_tied(
    const Job* job, const Node* node, const Cut* cut, const int32_t* tied, Py_ssize_t n, double* x
) noexcept nogil:
    """Read the coordinates of the tied rows; return False if they are all the same."""
    cdef double least = INFINITY, most = -INFINITY
    cdef Py_ssize_t i
    for i in range(n):
        x[i] = coordinate(job, node.rows + tied[i] * job.words, cut.word)
        least = min(least, x[i])
        most = max(most, x[i])
    return least < most
