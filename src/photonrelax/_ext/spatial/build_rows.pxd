"""Passes over rows, an id, one key per axis, and padding; see build.pyx.

A row is a whole number of quads, 16-byte vectors.
"""

from libc.stdint cimport int32_t, uint32_t

cdef enum:
    # Words of a quad.
    QUAD = 4
    MAX_BUCKET_BITS = 11
    MIN_BUCKET_BITS = 5
    MAX_BUCKETS = 1 << MAX_BUCKET_BITS
    # Number of keys left to nth_element.
    FEW = 16


cdef extern from "<algorithm>" namespace "std" nogil:
    void nth_element(int32_t* first, int32_t* nth, int32_t* last)


cdef extern from *:
    """
    static inline int bit_length(uint32_t x) { return x ? 32 - __builtin_clz(x) : 0; }
    typedef float Quad __attribute__((vector_size(16), aligned(4), may_alias));
    static inline Quad lesser(Quad a, Quad b) { return a < b ? a : b; }
    static inline Quad greater(Quad a, Quad b) { return a > b ? a : b; }
    """
    ctypedef struct Quad:
        pass
    int bit_length(uint32_t x) noexcept nogil
    Quad lesser(Quad a, Quad b) noexcept nogil
    Quad greater(Quad a, Quad b) noexcept nogil


cdef struct Cut:
    # The lower half has the rows whose key, in this word, is less, and the least `n_tied` of those
    # whose key is equal.
    int word
    int32_t key
    Py_ssize_t n_tied


cdef struct Keys:
    # Keys from `low` to `high`, every `step` words, and the rank of the key to find.
    const int32_t* first
    Py_ssize_t step
    Py_ssize_t count
    Py_ssize_t rank
    int32_t low
    int32_t high


cdef inline void bound_rows(
    const int32_t* rows, Py_ssize_t count, int words, int32_t* low, int32_t* high
) noexcept nogil:
    """Bounds of each word."""
    cdef const Quad* quads
    cdef Quad least, most, a, b
    cdef Py_ssize_t i
    cdef int quad
    for quad in range(words // QUAD):
        quads = <const Quad*> rows + quad
        least = quads[0]
        most = quads[0]
        for i in range(count % 2, count, 2):
            a = quads[i * (words // QUAD)]
            b = quads[(i + 1) * (words // QUAD)]
            least = lesser(least, lesser(a, b))
            most = greater(most, greater(a, b))
        (<Quad*> low)[quad] = least
        (<Quad*> high)[quad] = most


cdef inline void gather_keys(
    const int32_t* rows, Py_ssize_t count, int words, int word, int32_t* keys
) noexcept nogil:
    cdef Py_ssize_t i
    for i in range(count):
        keys[i] = rows[i * words + word]


cdef inline Py_ssize_t count_less(
    const int32_t* rows, Py_ssize_t count, int words, const Cut* cut
) noexcept nogil:
    """Number of rows whose key is less than that of a cut."""
    cdef Py_ssize_t i, n = 0
    for i in range(count):
        n += rows[i * words + cut.word] < cut.key
    return n


cdef inline int bucket_shift(const Keys* keys) noexcept nogil:
    """Number of low bits to drop, so that there is about one bucket per key."""
    cdef int bits = bit_length(<uint32_t> keys.count) - 1
    bits = min(max(bits, <int> MIN_BUCKET_BITS), <int> MAX_BUCKET_BITS)
    return max(bit_length(<uint32_t> keys.high - <uint32_t> keys.low) - bits, 0)


cdef inline void count_keys(const Keys* keys, int shift, uint32_t* sizes) noexcept nogil:
    """Count the keys of each bucket."""
    cdef int n_buckets = ((<uint32_t> keys.high - <uint32_t> keys.low) >> shift) + 1
    cdef Py_ssize_t i
    for i in range(n_buckets):
        sizes[i] = 0
    for i in range(keys.count):
        sizes[(<uint32_t> keys.first[i * keys.step] - <uint32_t> keys.low) >> shift] += 1


cdef inline void enter_bucket(Keys* keys, int shift, const uint32_t* sizes) noexcept nogil:
    """Narrow the bounds to the bucket that holds the rank."""
    cdef int bucket = 0
    while keys.rank >= sizes[bucket]:
        keys.rank -= sizes[bucket]
        bucket += 1
    keys.low += bucket << shift
    keys.high = keys.low + (1 << shift) - 1


cdef inline Py_ssize_t take_keys(const Keys* keys, int32_t* taken) noexcept nogil:
    """Copy the keys within the bounds, possibly in place; their number."""
    cdef uint32_t width = <uint32_t> keys.high - <uint32_t> keys.low
    cdef Py_ssize_t i, n_taken = 0
    cdef int32_t key
    for i in range(keys.count):
        key = keys.first[i * keys.step]
        taken[n_taken] = key
        n_taken += (<uint32_t> key - <uint32_t> keys.low) <= width
    return n_taken


cdef inline void find_key(Keys keys, int32_t* scratch, Cut* cut) noexcept nogil:
    """Set the key of the cut by radix selection; `scratch` has room for all keys."""
    cdef uint32_t[MAX_BUCKETS] sizes
    cdef int shift
    cdef Py_ssize_t i
    while keys.count > FEW and keys.low < keys.high:
        shift = bucket_shift(&keys)
        count_keys(&keys, shift, sizes)
        enter_bucket(&keys, shift, sizes)
        keys.count = take_keys(&keys, scratch)
        keys.first = scratch
        keys.step = 1
    cut.key = keys.low
    cut.n_tied = keys.rank
    if keys.low < keys.high:
        take_keys(&keys, scratch)
        nth_element(scratch, scratch + keys.rank, scratch + keys.count)
        cut.key = scratch[keys.rank]
        for i in range(keys.rank):
            cut.n_tied -= scratch[i] < cut.key


cdef inline void copy_row(int32_t* target, const int32_t* row, int words) noexcept nogil:
    cdef int quad
    for quad in range(words // QUAD):
        (<Quad*> target)[quad] = (<const Quad*> row)[quad]


cdef inline void divide_rows(
    const int32_t* rows, Py_ssize_t count, int words, const Cut* cut, int32_t* halves,
    Py_ssize_t lower, Py_ssize_t upper
) noexcept nogil:
    """Move rows to the halves, the next free places of which are `lower` and `upper`."""
    cdef Py_ssize_t i, place, is_lower
    for i in range(count):
        is_lower = rows[i * words + cut.word] < cut.key
        # Halves are hard to predict: a branch would cost more than all else here.
        place = upper + ((lower - upper) & -is_lower)
        copy_row(halves + place * words, rows + i * words, words)
        lower += is_lower
        upper += 1 - is_lower


cdef inline Py_ssize_t list_equal(
    const int32_t* rows, Py_ssize_t count, int words, int word, int32_t key, int32_t other,
    int32_t* places
) noexcept nogil:
    """List the rows whose key is one of two; their number."""
    cdef Py_ssize_t i, n = 0
    for i in range(count):
        places[n] = <int32_t> i
        n += (rows[i * words + word] == key) | (rows[i * words + word] == other)
    return n


cdef inline void divide_marked(
    const int32_t* rows, Py_ssize_t count, int words, const Cut* cut, int32_t* halves,
    Py_ssize_t upper
) noexcept nogil:
    """Move rows as `divide_rows` does; rows with a complemented id belong to the lower half."""
    cdef Py_ssize_t i, is_lower, lower = 0
    cdef const int32_t* row
    cdef int32_t* target
    for i in range(count):
        row = rows + i * words
        is_lower = (row[cut.word] < cut.key) | (row[0] < 0)
        target = halves + (upper + ((lower - upper) & -is_lower)) * words
        copy_row(target, row, words)
        target[0] = row[0] ^ (row[0] >> 31)
        lower += is_lower
        upper += 1 - is_lower
