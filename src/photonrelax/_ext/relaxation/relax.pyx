"""One simultaneous move of every photon by the repulsion of its neighbours (SJ13 §4.4)."""

from cython cimport view
from cython.parallel cimport prange, threadid
from libc.math cimport INFINITY, sqrt

import numpy as np

from ..common.vec3 cimport cross, dot
from ..spatial.batch cimport (
    Batch, Query, allocate_batches, gather_points, limit_radius, limit_range, open_block,
)
from ..spatial.tree cimport Tree
from ..spatial.simd.kernels cimport BLOCK, prefetch_row
from ..spatial.knn cimport query_batch

# A photon with fewer photons in range than this has no neighbourhood to spread out in.
cdef enum:
    MIN_NEIGHBOURS = 4


cdef class RelaxInputs:
    """What a move reads of each photon: by place in the tree, or by row of the structure.

    Parameters
    ----------
    rows : (n,) intp array
        Row of the photon at each place.
    normal : (n, 3) float64 array
        Unit normals, by place.
    largest_step : (n,) float64 array
        By place.
    squared_radius : (n,) float64 array
        Squared distance to the farthest neighbour, or a guess of it, -1 for none; by place and
        set by moves.
    too_few : (n,) bool array, optional
        Whether fewer than k photons are in range, as a guess: such photons look as far as they may
        at once; by place and set by moves.
    basis : (m, 2, 3) float64 array
        Directions along the structure, in which the photon is free, and across, by row.
    constraint : (m,) float64 array
        Of the direction across, by row.
    range_radius, reach : (m,) float64 arrays or None
        Limits over the range axes and in space, by row; None for none.
    """

    cdef const Py_ssize_t[::1] rows
    cdef const double[:, ::view.contiguous] normal
    cdef const double[:, :, ::1] basis
    cdef const double[::1] constraint
    cdef const double[:] range_radius
    cdef const double[::1] reach
    cdef const double[::1] largest_step
    cdef double[::1] squared_radius
    cdef unsigned char[::1] too_few

    def __init__(
        self, *, rows, normal, largest_step, squared_radius, basis, constraint, range_radius,
        reach, too_few=None
    ):
        self.rows = rows
        self.normal = normal
        self.basis = basis
        self.constraint = constraint
        self.range_radius = range_radius
        self.reach = reach
        self.largest_step = largest_step
        self.squared_radius = squared_radius
        if too_few is None:
            too_few = np.zeros(len(rows), dtype=bool)
        self.too_few = too_few.view(np.uint8)


def move(
    Tree tree, Py_ssize_t first, Py_ssize_t end, RelaxInputs inputs, Py_ssize_t k, double step,
    double[:, ::1] moved, int n_threads
):
    """Write the new positions of the photons at places first … end, whole blocks, of the tree.

    All positions read are the tree's, so the update is simultaneous: no order among inputs.
    """
    cdef unsigned char[:, ::1] batches = allocate_batches(tree, k, n_threads)
    cdef Py_ssize_t block
    for block in prange(
        first // BLOCK, (end + BLOCK - 1) // BLOCK, nogil=True, schedule="dynamic", chunksize=16,
        num_threads=n_threads
    ):
        move_block(tree, <Batch*> &batches[threadid(), 0], block, inputs, step, moved)


cdef void move_block(
    Tree tree, Batch* batch, Py_ssize_t block, RelaxInputs inputs, double step,
    double[:, ::1] moved
) noexcept nogil:
    """Move the photons of a block; write their places only."""
    cdef Py_ssize_t lane, place, row
    cdef Query* query
    open_block(tree, batch, block)
    prefetch_limits(tree, block + 1, inputs)
    for lane in range(batch.n_queries):
        query = &batch.queries[lane]
        place = BLOCK * block + lane
        row = inputs.rows[place]
        prefetch_row(&inputs.basis[row, 0, 0], 3 * sizeof(double))
        prefetch_row(&inputs.constraint[row], sizeof(double))
        query.squared_guess = INFINITY if inputs.too_few[place] else inputs.squared_radius[place]
        if inputs.range_radius is not None:
            limit_range(query, inputs.range_radius[row])
        if inputs.reach is not None:
            limit_radius(query, inputs.reach[row] * inputs.reach[row])
    query_batch(tree, batch)
    gather_points(tree, batch)
    for lane in range(batch.n_queries):
        move_one(tree, batch, lane, BLOCK * block + lane, inputs, step, moved)


cdef inline void prefetch_limits(Tree tree, Py_ssize_t block, RelaxInputs inputs) noexcept nogil:
    """Have the limits that the next block reads brought into the cache."""
    cdef Py_ssize_t place
    for place in range(BLOCK * block, min(BLOCK * block + BLOCK, tree.n_points)):
        if inputs.range_radius is not None:
            prefetch_row(&inputs.range_radius[inputs.rows[place]], sizeof(double))
        if inputs.reach is not None:
            prefetch_row(&inputs.reach[inputs.rows[place]], sizeof(double))


cdef void move_one(
    Tree tree, Batch* batch, Py_ssize_t lane, Py_ssize_t place, RelaxInputs inputs, double step,
    double[:, ::1] moved
) noexcept nogil:
    """Move one photon by the repulsion of its neighbours; write its place only."""
    cdef const Query* query = &batch.queries[lane]
    cdef Py_ssize_t axis
    cdef Py_ssize_t row = inputs.rows[place]
    cdef double[3] f
    f[0] = f[1] = f[2] = 0.0
    if query.candidates.count >= MIN_NEIGHBOURS and query.candidates.squared_radius > 0.0:
        tree.simd.repulsion(
            batch.points + 3 * lane * batch.stride, query.candidates.count,
            query.candidates.squared_radius, query.bounds.low, f
        )
        project(f, &inputs.normal[place, 0], &inputs.basis[row, 0, 0], inputs.constraint[row])
        shorten(f, step, inputs.largest_step[place])
    inputs.squared_radius[place] = query.candidates.squared_radius
    inputs.too_few[place] = query.candidates.count < batch.k
    for axis in range(3):
        moved[place, axis] = query.bounds.low[axis] + f[axis]


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
