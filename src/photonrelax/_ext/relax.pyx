"""One simultaneous move of every photon by the repulsion of its neighbours (SJ13 §4.4)."""

from cython.parallel cimport prange, threadid
from libc.math cimport sqrt

from .core cimport cross, dot
from .kdtree cimport Candidate, Limits, Tree, lift_limits

# A photon with fewer photons in range than this has no neighbourhood to spread out in.
cdef enum:
    FEWEST = 4


cdef class Sheet:
    """What a move reads of each photon: normal, constraint, limits of its search, largest step.

    `range_radius` and `reach` may be None for no limit.
    """

    cdef const double[:, ::1] normal
    cdef const double[:, :, ::1] basis
    cdef const double[::1] constraint
    cdef const double[::1] range_radius
    cdef const double[::1] reach
    cdef const double[::1] largest_step

    def __init__(self, normal, structure, *, range_radius, reach, largest_step):
        self.normal = normal
        self.basis = structure.basis
        self.constraint = structure.constraint
        self.range_radius = range_radius
        self.reach = reach
        self.largest_step = largest_step


def move(
    Tree tree, Py_ssize_t first, Py_ssize_t end, Sheet sheet, Py_ssize_t k, double step,
    double[:, ::1] moved, int n_threads
):
    """Write the new positions of the photons at places first … end of the tree to their rows.

    All positions read are the tree's, so the update is simultaneous: no order among photons.
    """
    cdef unsigned char[:, ::1] found = tree.scratch(k, n_threads)
    cdef Py_ssize_t place
    for place in prange(
        first, end, nogil=True, schedule="dynamic", chunksize=256, num_threads=n_threads
    ):
        move_one(tree, place, sheet, k, step, <Candidate*> &found[threadid(), 0], moved)


cdef void move_one(
    Tree tree, Py_ssize_t place, Sheet sheet, Py_ssize_t k, double step, Candidate* found,
    double[:, ::1] moved
) noexcept nogil:
    """Move one photon; write its row only."""
    cdef Py_ssize_t row = tree.ids[place]
    cdef Py_ssize_t axis, count
    cdef Limits limits
    cdef double[3] f
    lift_limits(&limits)
    if sheet.range_radius is not None:
        limits.squared_range = sheet.range_radius[row] * sheet.range_radius[row]
    if sheet.reach is not None:
        limits.squared_radius = sheet.reach[row] * sheet.reach[row]
    count = tree.search(&tree.points[place, 0], &limits, found, k)
    f[0] = f[1] = f[2] = 0.0
    if count >= FEWEST:
        force(f, tree, place, found, count)
        project(f, &sheet.normal[row, 0], &sheet.basis[row, 0, 0], sheet.constraint[row])
        shorten(f, step, sheet.largest_step[row])
    for axis in range(3):
        moved[row, axis] = tree.points[place, axis] + f[axis]


cdef void force(
    double* f, Tree tree, Py_ssize_t place, const Candidate* found, Py_ssize_t count
) noexcept nogil:
    """Write the repulsion f of SJ13 Eq. 8, m.

    A photon at the very same point repels in no direction; ε of Eq. 8 stands for that case alone.
    """
    cdef double radius = sqrt(found[count - 1].squared)
    cdef double distance, weight
    cdef Py_ssize_t j, axis
    f[0] = f[1] = f[2] = 0.0
    for j in range(count):
        distance = sqrt(found[j].squared)
        if distance == 0.0:
            continue
        weight = (radius / distance - 1.0) / count
        for axis in range(3):
            f[axis] += weight * (tree.points[place, axis] - tree.points[found[j].place, axis])


cdef void project(
    double* f, const double* normal, const double* basis, double constraint
) noexcept nogil:
    """Constrain f to the basis (SJ13 Eq. 9): u (u · f) + (1 − constraint) v (v · f).

    The basis was found where the photon landed; on a curved surface it is turned into the tangent
    plane of where the photon is now.
    """
    cdef double[3] u
    cdef double[3] v
    cdef double tilt = dot(basis, normal)
    cdef double length, along, across
    cdef Py_ssize_t axis
    for axis in range(3):
        u[axis] = basis[axis] - tilt * normal[axis]
    length = sqrt(dot(u, u))
    if length < 1e-6:
        # The surface has turned so far that the direction found says nothing any more.
        f[0] = f[1] = f[2] = 0.0
        return
    for axis in range(3):
        u[axis] /= length
    cross(v, normal, u)
    along = dot(u, f)
    across = (1.0 - constraint) * dot(v, f)
    for axis in range(3):
        f[axis] = along * u[axis] + across * v[axis]


cdef void shorten(double* f, double step, double largest) noexcept nogil:
    """Scale f by `step`, but to no more than `largest`."""
    cdef double length = step * sqrt(dot(f, f))
    cdef double scale = step
    cdef Py_ssize_t axis
    if length > largest:
        scale = step * largest / length
    for axis in range(3):
        f[axis] *= scale
