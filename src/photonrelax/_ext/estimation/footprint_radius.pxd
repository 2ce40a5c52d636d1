"""The radius of a footprint; the rule is that of `photonrelax.estimation.footprint`."""

from .footprint_photons cimport FootprintPhotons, Scratch
from .rectangle cimport Footprint


cdef double find_squared_radius(
    FootprintPhotons work, Footprint* footprint, Scratch* scratch
) noexcept nogil
