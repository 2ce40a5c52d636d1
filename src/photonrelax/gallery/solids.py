"""Solids and sheets that more than one scene is built of."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._util.products import product
from .._util.validation import Floats
from .meshes import grid_faces, make_mesh

if TYPE_CHECKING:
    import trimesh

# Faces of a box whose corners are numbered in binary, x first: two triangles a side.
_BOX_QUADS = np.array(
    [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
)

# Points of a curve that its bends are looked at, for each that is taken of it.
_FINE = 8


def sheet(corner: ArrayLike, first: ArrayLike, second: ArrayLike) -> trimesh.Trimesh:
    """Parallelogram spanned by two sides from a corner; its normal is first × second."""
    start, u, v = np.asarray(corner), np.asarray(first), np.asarray(second)
    corners = np.array([start, start + u, start + u + v, start + v], dtype=np.float64)
    return make_mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))


def cuboid(center: ArrayLike, size: ArrayLike, turn: float = 0.0) -> trimesh.Trimesh:
    """Closed box, turned about the vertical through its centre, degrees."""
    low_or_high = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)]) - 0.5
    corners = (low_or_high * np.asarray(size)) @ rotation([0, 0, 1], turn).T
    quads = _BOX_QUADS
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return make_mesh(corners + np.asarray(center), faces)


def ball(center: ArrayLike, radius: float, subdivisions: int) -> trimesh.Trimesh:
    """Ball with the normals of the exact sphere; 5 subdivisions make 20,480 faces."""
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
    normals = np.asarray(sphere.vertices)
    return make_mesh(np.asarray(center) + radius * normals, np.asarray(sphere.faces), normals)


def torus(radius: float, tube_radius: float, sections: int, tube_sections: int) -> trimesh.Trimesh:
    """Torus around the z axis with the normals of the exact surface."""
    around = np.linspace(0.0, 2 * np.pi, sections + 1)[:, np.newaxis]
    along = np.linspace(0.0, 2 * np.pi, tube_sections + 1)
    out, up = np.cos(along), np.sin(along)
    normal = np.stack(
        [np.cos(around) * out, np.sin(around) * out, np.broadcast_to(up, (sections + 1, len(up)))],
        axis=-1,
    )
    middle = radius * np.stack([np.cos(around), np.sin(around), np.zeros_like(around)], axis=-1)
    vertices = middle + tube_radius * normal
    # Ends meet to the bit, so that the surface is closed.
    for grid in (vertices, normal):
        grid[-1], grid[:, -1] = grid[0], grid[:, 0]
    faces = grid_faces(sections + 1, tube_sections + 1)[:, ::-1]
    return make_mesh(vertices.reshape(-1, 3), faces, normal.reshape(-1, 3))


def revolved(profile: Floats, sections: int, normals: Floats | None = None) -> trimesh.Trimesh:
    """Closed solid of revolution about the z axis.

    Parameters
    ----------
    profile : (n, 2) array
        Points (distance from the axis, height), the first and the last on the axis, with the
        outside to the right.
    sections : int
        Facets around the axis.
    normals : (n, 2) array, optional
        Unit normals of the exact surface at these points, those of the first and last along the
        axis.
    """
    n = (len(profile) - 2) * sections
    rim = np.arange(sections)
    following = np.roll(rim, -1)
    bottom = np.column_stack([np.full(sections, n), following, rim])
    top = np.column_stack([np.full(sections, n + 1), n - sections + rim, n - sections + following])
    sides = _between_rings(len(profile) - 2, sections)
    faces = np.concatenate([sides, bottom, top])
    vertices = _rings_and_ends(profile, sections)
    return make_mesh(
        vertices, faces, None if normals is None else _rings_and_ends(normals, sections)
    )


def _rings_and_ends(profile: Floats, sections: int) -> Floats:
    """Vertices around the axis, then the first and the last on it."""
    ends = np.array([[0.0, 0.0, profile[0, 1]], [0.0, 0.0, profile[-1, 1]]])
    return np.concatenate([_rings(profile[1:-1], sections), ends])


def swept(profile: Floats, sections: int) -> trimesh.Trimesh:
    """Closed ring about the z axis, of a closed profile (n, 2) that keeps its outside right."""
    faces = _between_rings(len(profile) + 1, sections) % (len(profile) * sections)
    return make_mesh(_rings(profile, sections), faces)


def lathed(profile: Floats, sections: int) -> trimesh.Trimesh:
    """Open surface of revolution about the z axis; its outside is right of the profile (n, 2)."""
    return make_mesh(_rings(profile, sections), _between_rings(len(profile), sections))


def _rings(profile: Floats, sections: int) -> Floats:
    """Vertices around the axis, ring by ring."""
    azimuth = 2 * np.pi * np.arange(sections) / sections
    spin = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(sections)])
    rings: Floats = profile[:, :1, np.newaxis] * spin + profile[:, 1:, np.newaxis] * [0, 0, 1]
    return rings.reshape(-1, 3)


def _between_rings(n: int, sections: int) -> NDArray[np.intp]:
    """Faces between n rings of vertices."""
    here = np.arange((n - 1) * sections)
    there = here - here % sections + (here + 1) % sections
    lower = np.column_stack([here, there, there + sections])
    return np.concatenate([lower, np.column_stack([here, there + sections, here + sections])])


class Curve(NamedTuple):
    """Smooth curve in the plane through points, and its lengths along their chords."""

    at: Callable[..., Floats]
    length: float

    @classmethod
    def through(
        cls, points: ArrayLike, start: ArrayLike | None = None, end: ArrayLike | None = None
    ) -> Curve:
        """Cubic spline through points (m, 2), with unit tangents (2,) at its ends if given."""
        from scipy.interpolate import CubicSpline

        through = np.asarray(points, dtype=np.float64)
        chords = np.linalg.norm(np.diff(through, axis=0), axis=1)
        at = np.concatenate([[0.0], np.cumsum(chords)])
        ends = tuple("not-a-knot" if each is None else (1, each) for each in (start, end))
        return cls(CubicSpline(at, through, bc_type=ends), float(at[-1]))

    def tangents(self, at: ArrayLike) -> Floats:
        """Unit tangents (n, 2) at lengths (n,)."""
        slope = self.at(at, 1)
        unit: Floats = slope / np.linalg.norm(slope, axis=-1, keepdims=True)
        return unit

    def even(self, n: int, radius: float) -> tuple[Floats, Floats]:
        """Points (n + 1, 2) and normals to their right, finer where the curve bends.

        Steps are even in the sum of their length and of `radius` times the angle that they turn by.
        """
        fine = np.linspace(0.0, self.length, _FINE * n + 1)
        step = np.linalg.norm(np.diff(self.at(fine), axis=0), axis=1)
        bend = np.linalg.norm(np.diff(self.tangents(fine), axis=0), axis=1)
        done = np.concatenate([[0.0], np.cumsum(step + radius * bend)])
        at = np.interp(np.linspace(0.0, done[-1], n + 1), done, fine)
        tangent = self.tangents(at)
        return self.at(at), np.column_stack([tangent[:, 1], -tangent[:, 0]])


def placed(mesh: trimesh.Trimesh, offset: ArrayLike, turn: Floats | None = None) -> trimesh.Trimesh:
    """Mesh turned by a rotation matrix, then moved, with the normals that it came with."""
    matrix = np.eye(3) if turn is None else turn
    normals = product(mesh.vertex_normals, matrix.T) if "vertex_normals" in mesh._cache else None
    return make_mesh(product(mesh.vertices, matrix.T) + np.asarray(offset), mesh.faces, normals)


def rotation(axis: ArrayLike, degrees: float) -> Floats:
    """Matrix (3, 3) of a rotation about an axis through the origin."""
    from trimesh.transformations import rotation_matrix

    matrix: Floats = rotation_matrix(np.radians(degrees), axis)[:3, :3]
    return matrix
