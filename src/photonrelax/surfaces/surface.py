"""The surface of an object: its two sides, and the solids that it encloses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats
from ..photons.axes import MIN_NORMAL_COSINE
from ..scene.meshes import (
    face_normals,
    in_unit_cube,
    nondegenerate_faces,
)
from ..scene.scene import SceneObject
from ..scene.welding import HalfEdges, weld
from ..scene.winding import closed_faces
from .segments import Segments
from .solid import Solid, corners_beyond
from .triangles import Triangles

# Rounding error of the cosine between normals: the sides of a hexagonal prism, at 60°, continue.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Side(Triangles):
    """Faces as light sees them that arrives on the side of their normals.

    Attributes
    ----------
    ends : (f, 3) bool
        True for edges at which the surface ends or turns.
    """

    ends: NDArray[np.bool_]

    def back(self) -> Side:
        """The other side of the faces."""
        # The edges of c, b, a are the second, the first and the third of a, b, c.
        return Side(self.corners[:, ::-1], -self.normals, self.ends[:, [1, 0, 2]])

    def rows(self, which: NDArray) -> Side:
        """The faces of a mask."""
        return Side(self.corners[which], self.normals[which], self.ends[which])

    def edges(self) -> Segments:
        """The edges at which the surface ends or turns."""
        face, j = np.nonzero(self.ends)
        ends = np.stack([self.corners[face, j], self.corners[face, (j + 1) % 3]], axis=1)
        return Segments(ends, self.normals[face])


@dataclass(frozen=True, eq=False)
class Surface:
    """The triangles of an object.

    Attributes
    ----------
    front : Side
        Faces by their windings, those of closed parts outwards.
    closed : (f,) bool
        True for faces of closed, consistently wound parts.
    solid : Solid or None
        The bodies that closed parts enclose, if there are any.
    """

    front: Side
    closed: NDArray[np.bool_]
    solid: Solid | None

    @classmethod
    def of(cls, item: SceneObject) -> Surface:
        """Surface of the faces of an object that have an area; vertices at one place are one."""
        vertices = np.asarray(item.mesh.vertices, dtype=np.float64)
        faces, half_edges = _welded(vertices, nondegenerate_faces(item.mesh)[1])
        closed, inside_out = closed_faces(vertices[faces], half_edges)
        if inside_out.any():
            faces = np.where(inside_out[:, np.newaxis], faces[:, ::-1], faces)
            half_edges = HalfEdges(faces)
        corners = vertices[faces]
        normals = face_normals(corners)
        front = Side(corners, normals, _ends(normals, half_edges))
        if not closed.any():
            return cls(front, closed, None)
        beyond = corners_beyond(corners, half_edges)
        return cls(front, closed, Solid(corners[closed], normals[closed], beyond[closed]))


def _welded(vertices: Floats, faces: NDArray) -> tuple[NDArray, HalfEdges]:
    """Faces with one vertex for all that are at one place, and their half-edges.

    Only vertices of open edges are compared: the others have their neighbours.
    """
    half_edges = HalfEdges(faces)
    single = np.bincount(half_edges.edge)[half_edges.edge] == 1
    rows = np.unique(half_edges.ids[single] // 3)
    used, compact = np.unique(faces[rows], return_inverse=True)
    place = weld(in_unit_cube(vertices)[used], compact.reshape(-1, 3)) if len(rows) else used
    first, place = np.unique(place, return_index=True, return_inverse=True)[1:]
    if len(first) == len(used):
        return faces, half_edges
    position = np.arange(len(vertices))
    position[used] = used[first][place]
    faces = position[faces]
    faces = faces[(faces != faces[:, [1, 2, 0]]).all(axis=1)]
    return faces, HalfEdges(faces)


def _ends(normals: Floats, half_edges: HalfEdges) -> NDArray[np.bool_]:
    """Mask (f, 3) of the half-edges at which the surface of a face ends or turns.

    It goes on across an edge in each other face there whose normal is within 60°, as if both wound
    alike: of three faces of an edge two may go on in each other while the third ends.
    """
    ends = np.zeros(3 * len(normals), dtype=bool)
    ends[half_edges.ids] = True
    for rows, others in half_edges.pairs():
        a, b = half_edges.ids[rows], half_edges.ids[others]
        cosine = np.einsum("ij,ij->i", normals[a // 3], normals[b // 3])
        alike = half_edges.forward[rows] != half_edges.forward[others]
        goes_on = np.where(alike, cosine, -cosine) >= MIN_NORMAL_COSINE - _ROUNDING
        ends[a[goes_on]] = ends[b[goes_on]] = False
    return ends.reshape(-1, 3)
