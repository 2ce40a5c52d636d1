"""Stacks of the media that a ray is in, as inline functions for kernels.

A medium is a number: 0 is the surroundings of all objects, others are dielectrics of the scene. A
stack packs media into one integer, `bits` each, by rank: the medium that rules is in the lowest,
and of equal ranks the last entered lies lowest. The surroundings, of the least rank, are not
stored. A full stack loses its highest medium. `docs/methods/media.md` has the rules.
"""

from libc.stdint cimport int32_t, uint64_t


cdef inline uint64_t current(uint64_t media, int bits) noexcept nogil:
    """Medium that rules where a stack holds."""
    return media & ((<uint64_t>1 << bits) - 1)


cdef inline uint64_t entered(
    uint64_t media, uint64_t medium, int bits, const int32_t* rank
) noexcept nogil:
    """Stack with a medium more, below those of larger rank; `rank` is that of each medium."""
    cdef int shift = 0
    while shift < 64 and rank[current(media >> shift, bits)] > rank[medium]:
        shift += bits
    if shift == 0:
        return media << bits | medium
    if shift == 64:
        return media
    return (media >> shift << bits | medium) << shift | media & ((<uint64_t>1 << shift) - 1)


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
