"""Light of the images of elements, and how much of it they misplace."""

from cython.parallel cimport prange, threadid
from libc.math cimport INFINITY, sqrt
from libc.stdint cimport uint8_t

from ..common.threads cimport Watch, close_watch, goes_on, open_watch, team_size

cdef enum:
    LOOK_EVERY = 1024
    GRAIN = 256


cdef struct Rules:
    # Misplaced distance over the misfit of a parent, and over the bend where there is no parent.
    double of_misfit
    double of_bend
    # Share of the flux of a torn image that is misplaced.
    double of_torn
    # Images that bend by more than this share of their longest side, and a footprint, jump.
    double jump
    # m.
    double footprint


cdef struct Image:
    double flux
    double score
    bint jumps


def measure(
    const double[:, ::1] position, const double[::1] luminance, const Py_ssize_t[:, ::1] arrival,
    const double[::1] area, const Py_ssize_t[:, ::1] parent, const Py_ssize_t[::1] part, *,
    const double[:, :, ::1] new_nodes, double of_misfit, double of_bend, double of_torn,
    double jump, double footprint, double[::1] flux, double[::1] score, uint8_t[::1] jumps,
    int n_threads,
):
    """Write the light of images, how much they misplace, and whether they jump.

    Parameters
    ----------
    position, luminance : (m, 3), (m,)
        Of the arrivals, m and W per area of the chart.
    arrival, parent : (p, 6) intp arrays
        Arrivals of the nodes of images, corners and then the middles of the sides opposite to them,
        -1 for none; and those of the images that they are part of, -1 first where that is not
        whole.
    area, part : (p,)
        Area of the elements, of the chart's 1, and which of the four parts they are.
    new_nodes : (4, 3, 6)
        Weights of a parent's nodes at the middles of the sides of its parts.
    of_misfit, of_bend, of_torn, jump, footprint : float
        As of `Rules`.
    flux, score : (p,) float64, jumps : (p,) uint8 arrays
        W. Whole images have the quadrature over the middles of their sides, exact for quadratic
        functions; others the light of the nodes that are seen.
    """
    cdef Rules rules = Rules(of_misfit, of_bend, of_torn, jump, footprint)
    cdef Py_ssize_t i, k, p = arrival.shape[0], m = position.shape[0]
    cdef Image image
    cdef Watch watch = open_watch()
    if not (
        m == luminance.shape[0] and position.shape[1] == 3
        and p == area.shape[0] == parent.shape[0] == part.shape[0]
        and p == flux.shape[0] == score.shape[0] == jumps.shape[0]
        and arrival.shape[1] == parent.shape[1] == 6
        and new_nodes.shape[0] == 4 and new_nodes.shape[1] == 3 and new_nodes.shape[2] == 6
    ):
        raise ValueError("images and arrivals do not fit one another")
    for i in range(p):
        for k in range(6):
            if not (arrival[i, k] < m and parent[i, k] < m):
                raise ValueError(f"image {i} should be of {m} arrivals")
        if not 0 <= part[i] < 4:
            raise ValueError(f"image {i} should be one of four parts, but is {part[i]}")
    for i in prange(
        p, nogil=True, schedule="static", chunksize=GRAIN,
        num_threads=team_size(n_threads, p, GRAIN)
    ):
        if goes_on(&watch, threadid() == 0 and i % LOOK_EVERY == 0):
            image = measured(
                position, luminance, &arrival[i, 0], area[i], &parent[i, 0],
                &new_nodes[part[i], 0, 0], &rules,
            )
            flux[i], score[i], jumps[i] = image.flux, image.score, image.jumps
    close_watch(&watch)


cdef Image measured(
    const double[:, ::1] position, const double[::1] luminance, const Py_ssize_t* arrival,
    double area, const Py_ssize_t* parent, const double* new_nodes, const Rules* rules,
) noexcept nogil:
    """Light of one image, and what it misplaces."""
    cdef Image image = Image(0.0, 0.0, False)
    cdef double of_middles = 0.0, bend, distance
    cdef int k, seen = 0
    for k in range(6):
        if arrival[k] >= 0:
            seen += 1
            image.flux += luminance[arrival[k]]
            if k >= 3:
                of_middles += luminance[arrival[k]]
    if seen < 6:
        image.flux *= area / 6.0
        distance = INFINITY if seen < 3 else size_of(position, arrival)
        image.score = rules.of_torn * image.flux * min(distance / rules.footprint, 1.0)
        return image
    image.flux = area * of_middles / 3.0
    bend = bend_of(position, arrival)
    image.jumps = bend > rules.footprint and bend > rules.jump * longest_of(position, arrival)
    if image.jumps:
        distance = INFINITY
    elif parent[0] >= 0:
        distance = rules.of_misfit * misfit_of(position, arrival, parent, new_nodes)
    else:
        distance = rules.of_bend * bend
    image.score = image.flux * min(distance / rules.footprint, 1.0)
    return image


cdef double size_of(const double[:, ::1] position, const Py_ssize_t* arrival) noexcept nogil:
    """Diagonal of the box around the nodes that are seen."""
    cdef double low, high, squared = 0.0
    cdef int k, c
    for c in range(3):
        low, high = INFINITY, -INFINITY
        for k in range(6):
            if arrival[k] >= 0:
                low = min(low, position[arrival[k], c])
                high = max(high, position[arrival[k], c])
        squared += (high - low) * (high - low)
    return sqrt(squared)


cdef double bend_of(const double[:, ::1] position, const Py_ssize_t* arrival) noexcept nogil:
    """Largest distance of the middle nodes from straight sides."""
    cdef double bend = 0.0, squared, off
    cdef Py_ssize_t a, b
    cdef int k, c
    for k in range(3):
        a, b, squared = arrival[(k + 1) % 3], arrival[(k + 2) % 3], 0.0
        for c in range(3):
            off = position[arrival[3 + k], c] - 0.5 * (position[a, c] + position[b, c])
            squared += off * off
        bend = max(bend, squared)
    return sqrt(bend)


cdef double longest_of(const double[:, ::1] position, const Py_ssize_t* arrival) noexcept nogil:
    """Longest side."""
    cdef double longest = 0.0, squared, off
    cdef int k, c
    for k in range(3):
        squared = 0.0
        for c in range(3):
            off = position[arrival[(k + 1) % 3], c] - position[arrival[k], c]
            squared += off * off
        longest = max(longest, squared)
    return sqrt(longest)


cdef double misfit_of(
    const double[:, ::1] position, const Py_ssize_t* arrival, const Py_ssize_t* parent,
    const double* new_nodes,
) noexcept nogil:
    """Distance of new nodes from where the image of the parent has them, root mean square."""
    cdef double squared = 0.0, off
    cdef int i, k, c
    for i in range(3):
        for c in range(3):
            off = position[arrival[3 + i], c]
            for k in range(6):
                off -= new_nodes[6 * i + k] * position[parent[k], c]
            squared += off * off
    return sqrt(squared / 3.0)
