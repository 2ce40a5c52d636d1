"""Positions that vertices of a mesh share, and the faces on both sides of its edges."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats

Ids = NDArray[np.intp]

# Vertices are one position where they are nearer than both of these: a fraction of the diagonal of
# the mesh, some rounding errors of float32, and one of the length of each face at either vertex, so
# that no small part of a large mesh collapses.
_OF_SIZE = 1e-6
_OF_FACE = 1e-2
# Positions compared with each: seams and poles have few that differ by rounding.
_N_NEAREST = 8
# Pairs are formed among the faces of an edge that are no more than this far apart in its list:
# two faces are the rule, and a fan of thousands around one edge has no smooth side.
_MAX_FACES_AT_EDGE = 16


def weld(vertices: Floats, faces: NDArray) -> Ids:
    """Numbers (v,) of the positions of vertices; vertices at one place have one number.

    Places are the same up to the rounding of files and of seams: sin 2π is not 0.
    """
    first, position = _distinct(vertices)
    points = vertices[first]
    near = _near_pairs(points, _tolerance(points, position[faces]))
    return position if near is None else components(len(points), *near)[position]


def components(n: int, a: Ids, b: Ids) -> Ids:
    """Number of the connected component of each of n nodes, with edges from a to b."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    edges = coo_array((np.ones(len(a), dtype=np.int8), (a, b)), shape=(n, n))
    return connected_components(edges, directed=False)[1].astype(np.intp)


class HalfEdges:
    """The edges of each face, one after the other in its direction.

    Half-edge 3 i + j runs from corner j of face i to the next.

    Parameters
    ----------
    faces : (f, 3)
        Three vertices of each face, welded.

    Attributes
    ----------
    ids : (h,)
        The half-edges that have a length, sorted by their edges.
    edge : (h,)
        The number of the edge of each, from 0.
    forward : (h,)
        True where a half-edge runs towards the vertex of the greater number.
    """

    def __init__(self, faces: NDArray) -> None:
        start, end = faces.ravel(), faces[:, [1, 2, 0]].ravel()
        key = np.minimum(start, end) * np.int64(faces.max() + 1) + np.maximum(start, end)
        order = np.argsort(key, kind="stable")
        self.ids: Ids = order[(start != end)[order]]
        key = key[self.ids]
        self.edge: Ids = np.cumsum(np.diff(key, prepend=key[:1]) != 0)
        self.forward: NDArray[np.bool_] = (start < end)[self.ids]

    def pairs(self) -> Iterator[tuple[Ids, Ids]]:
        """Yield rows of `ids` of two half-edges of one edge."""
        for step in range(1, _MAX_FACES_AT_EDGE):
            rows = np.flatnonzero(self.edge[step:] == self.edge[:-step])
            if len(rows) == 0:
                return
            yield rows, rows + step


def _distinct(vertices: Floats) -> tuple[Ids, Ids]:
    """Return a vertex for each distinct position, and the number of the position of each vertex."""
    order = np.lexsort(vertices.T)
    sorted_vertices = vertices[order]
    new = np.ones(len(order), dtype=bool)
    new[1:] = (sorted_vertices[1:] != sorted_vertices[:-1]).any(axis=1)
    position = np.empty(len(order), dtype=np.intp)
    position[order] = np.cumsum(new) - 1
    return order[new], position


def _tolerance(points: Floats, faces: NDArray) -> Floats:
    """Return the distance (p,) below which another point is the same position."""
    a, b, c = np.moveaxis(points[faces], 1, 0)
    longest = np.sqrt(np.max([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], 0))
    extended = longest > 0.0
    detail = np.full(len(points), np.inf)
    for corner in faces[extended].T:
        np.minimum.at(detail, corner, longest[extended])
    size = np.linalg.norm(np.ptp(points[faces].reshape(-1, 3), axis=0))
    return np.minimum(_OF_FACE * detail, _OF_SIZE * size)


def _near_pairs(points: Floats, tolerance: Floats) -> tuple[Ids, Ids] | None:
    """Return pairs of points that are nearer than the tolerance of both, or None."""
    from scipy.spatial import cKDTree

    n_nearest = min(_N_NEAREST, len(points))
    distance, other = cKDTree(points).query(
        points, k=n_nearest, distance_upper_bound=tolerance.max()
    )
    a, column = np.nonzero(np.isfinite(distance))
    b = other[a, column]
    near = (a != b) & (distance[a, column] <= np.minimum(tolerance[a], tolerance[b]))
    return (a[near], b[near]) if near.any() else None
