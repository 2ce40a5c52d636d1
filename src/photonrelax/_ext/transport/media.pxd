"""Stacks of the media that a ray is in, innermost first, as inline functions for kernels.

A medium is a number: 0 is the surroundings of all objects, others are dielectrics of the scene. A
stack packs media into one integer, `bits` each, the last entered in the lowest; the surroundings
are not stored. A full stack loses its outermost medium. `docs/methods/media.md` has the rules.
"""

from libc.stdint cimport uint64_t


cdef inline uint64_t current(uint64_t media, int bits) noexcept nogil:
    """Medium that rules where a stack holds: the one entered last."""
    return media & ((<uint64_t>1 << bits) - 1)


cdef inline uint64_t entered(uint64_t media, uint64_t medium, int bits) noexcept nogil:
    """Stack with a medium on top."""
    return media << bits | medium


cdef inline bint is_full(uint64_t media, int bits) noexcept nogil:
    return media >> (64 - bits) != 0


cdef inline uint64_t left(uint64_t media, uint64_t medium, int bits) noexcept nogil:
    """Stack without a medium, wherever in it that was; unchanged if it was not."""
    cdef uint64_t rest = media
    cdef int shift = 0
    if current(media, bits) == medium:
        return media >> bits
    while rest:
        if current(rest, bits) == medium:
            return rest >> bits << shift | media & ((<uint64_t>1 << shift) - 1)
        rest >>= bits
        shift += bits
    return media
