"""Tables over wavelength, as inline functions for kernels."""

cdef enum:
    # nm, and the number of wavelengths from one to the other, evenly spaced.
    SHORTEST = 380
    LONGEST = 720
    N_NODES = 1025


cdef inline double at_wavelength(
    const double* table, int stride, double wavelength
) noexcept nogil:
    """Value between the nodes of a table, `stride` numbers apart, at a wavelength, nm."""
    cdef double place = (wavelength - SHORTEST) * ((N_NODES - 1.0) / (LONGEST - SHORTEST))
    cdef int cell = min(max(<int> place, 0), N_NODES - 2)
    cdef const double* node = table + stride * cell
    return node[0] + (place - cell) * (node[stride] - node[0])
