"""The k best candidates of a search as a binary heap, the worst at its root."""


cdef struct Candidate:
    # One neighbour found: squared distance, the caller's id, and the place in leaf order.
    double squared
    Py_ssize_t id
    Py_ssize_t place


cdef inline bint worse(const Candidate* a, const Candidate* b) noexcept nogil:
    """Order by distance, ties by id."""
    return a.squared > b.squared or (a.squared == b.squared and a.id > b.id)


cdef inline void sift_down(Candidate* heap, Py_ssize_t count, Py_ssize_t hole) noexcept nogil:
    """Restore the heap (worst at the root) after its entry at `hole` became better."""
    cdef Candidate moved = heap[hole]
    cdef Py_ssize_t child = 2 * hole + 1
    while child < count:
        if child + 1 < count and worse(&heap[child + 1], &heap[child]):
            child += 1
        if not worse(&heap[child], &moved):
            break
        heap[hole] = heap[child]
        hole = child
        child = 2 * hole + 1
    heap[hole] = moved


cdef inline void sift_up(Candidate* heap, Py_ssize_t hole) noexcept nogil:
    """Restore the heap after an entry was added at `hole`."""
    cdef Candidate moved = heap[hole]
    cdef Py_ssize_t parent
    while hole > 0:
        parent = (hole - 1) // 2
        if not worse(&moved, &heap[parent]):
            break
        heap[hole] = heap[parent]
        hole = parent
    heap[hole] = moved


cdef inline void sort_heap(Candidate* heap, Py_ssize_t count) noexcept nogil:
    """Turn the heap into a list, nearest first."""
    cdef Candidate worst
    while count > 1:
        count -= 1
        worst = heap[0]
        heap[0] = heap[count]
        sift_down(heap, count, 0)
        heap[count] = worst
