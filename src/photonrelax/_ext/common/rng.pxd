"""Counter-based random numbers: inline helpers shared by the kernels."""

from libc.stdint cimport uint64_t


cdef inline uint64_t mix(uint64_t z) noexcept nogil:
    """The finaliser of SplitMix64 (Steele et al. 2014): a bijection that scatters bits."""
    z = (z ^ (z >> 30)) * <uint64_t>0xBF58476D1CE4E5B9
    z = (z ^ (z >> 27)) * <uint64_t>0x94D049BB133111EB
    return z ^ (z >> 31)


cdef inline uint64_t hash_next(uint64_t key, uint64_t number) noexcept nogil:
    """The key of one more number, after those of a key."""
    return mix(key + number + <uint64_t>0x9E3779B97F4A7C15)


cdef inline uint64_t hash_key(uint64_t seed, uint64_t stream, uint64_t index) noexcept nogil:
    """A key that depends on all three; the same wherever and whenever it is computed."""
    return hash_next(hash_next(hash_next(0, seed), stream), index)


cdef inline double uniform(uint64_t key, uint64_t counter) noexcept nogil:
    """Number `counter` of the sequence of `key`, in [0, 1)."""
    return (mix(key + counter * <uint64_t>0x9E3779B97F4A7C15) >> 11) * (1.0 / 9007199254740992.0)
