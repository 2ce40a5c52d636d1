"""The evaluation points, photons and planes of tangent_plane.pxd."""

from ..common.vec3 cimport orthonormal_frame
from ..spatial.radius cimport ball

from ..spatial.blocks import to_soa_blocks


cdef class EvaluationPoints:
    """Points that densities are estimated at, with their kernel bandwidths.

    Parameters
    ----------
    queries : (m, axes) float64 array
        Points on all axes of the tree, of which the first three are positions.
    rows : (r,) intp array
        Rows of those that are evaluated.
    normals : (r, 3) float64 array
        Their unit normals.
    bandwidth : (r,) float64 array
        Positive; m.
    surface : EdgeSearch, optional
        Edges of the surface, which without it has none.
    """

    def __init__(self, queries, rows, normals, bandwidth, surface=None):
        self.surface = surface
        self.queries = queries
        self.rows = rows
        self.normals = normals
        self.bandwidth = bandwidth
        if not (
            self.rows.shape[0] == self.normals.shape[0] == self.bandwidth.shape[0]
            and self.queries.shape[1] >= 3 and self.normals.shape[1] == 3
        ):
            raise ValueError("queries, normals and bandwidths do not fit one another")


cdef class TangentPhotons:
    """Photons of a tree in tree order, as they are projected onto planes.

    Parameters
    ----------
    tree : Tree
        Its first three axes are positions.
    rows : (n,) intp array
        Rows of the photons, in tree order.
    towards : (m, 3) float64 array or None
        Directions towards the origin of the light; None projects along the normal of the plane.
    columns : (m, c) float64 array
        Mean flux, and its gradient (c = 4) if that is known.
    range_radius : float
        Radius of the ball over the tree's range axes; negative for none.
    unit : float
        Unit of length, m: gradients are in the unit of flux over unit³.
    """

    def __init__(self, tree, rows, towards, columns, *, range_radius, unit, n_threads):
        if len(rows) != tree.n_points or tree.n_metric != 3:
            raise ValueError("photons should have a row for each point of a tree in space")
        if towards is not None and towards.shape[1] != 3:
            raise ValueError(f"towards should have shape (m, 3), but has {towards.shape}")
        self.tree = tree
        self.towards = None if towards is None else to_soa_blocks(towards, rows, n_threads)
        self.columns = to_soa_blocks(columns, rows, n_threads)
        self.range_radius = range_radius
        self.unit = unit


cdef bint fit(TangentPhotons photons, EvaluationPoints points, Py_ssize_t n_columns):
    """True if points have all axes of the photons' tree, and photons at least these columns."""
    return points.queries.shape[1] >= photons.tree.n_axes and (
        photons.columns.shape[1] in (n_columns, 4)
    )


cdef void open_plane(
    Plane* plane, TangentPhotons photons, EvaluationPoints points, Py_ssize_t i
) noexcept nogil:
    """Set the plane at one of the points."""
    cdef double bandwidth = points.bandwidth[i]
    cdef Py_ssize_t axis
    plane.at = &points.queries[points.rows[i], 0]
    orthonormal_frame(plane.frame, plane.frame + 3, &points.normals[i, 0])
    for axis in range(3):
        plane.frame[6 + axis] = points.normals[i, axis]
    plane.bandwidth = bandwidth
    plane.scale = 1.0 / bandwidth
    plane.towards = NULL if photons.towards is None else &photons.towards[0, 0, 0]
    plane.bounds = ball(photons.tree, plane.at, bandwidth, photons.range_radius)
