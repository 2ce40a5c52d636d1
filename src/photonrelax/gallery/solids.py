"""Solids and sheets that more than one scene is built of."""

from __future__ import annotations

from typing import TYPE_CHECKING

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


def revolved(profile: Floats, sections: int) -> trimesh.Trimesh:
    """Closed solid of revolution about the z axis.

    Parameters
    ----------
    profile : (n, 2) array
        Points (distance from the axis, height), the first and the last on the axis, with the
        outside to the right.
    sections : int
        Facets around the axis.
    """
    n = (len(profile) - 2) * sections
    rim = np.arange(sections)
    following = np.roll(rim, -1)
    bottom = np.column_stack([np.full(sections, n), following, rim])
    top = np.column_stack([np.full(sections, n + 1), n - sections + rim, n - sections + following])
    ends = np.array([[0.0, 0.0, profile[0, 1]], [0.0, 0.0, profile[-1, 1]]])
    sides = _between_rings(len(profile) - 2, sections)
    vertices = np.concatenate([_rings(profile[1:-1], sections), ends])
    return make_mesh(vertices, np.concatenate([sides, bottom, top]))


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


def curve(points: ArrayLike, n: int) -> Floats:
    """Smooth curve of n + 1 points, (n + 1, 2), through points (m, 2), evenly by their chords."""
    from scipy.interpolate import CubicSpline

    through = np.asarray(points, dtype=np.float64)
    lengths = np.linalg.norm(np.diff(through, axis=0), axis=1)
    at = np.concatenate([[0.0], np.cumsum(lengths)])
    drawn: Floats = CubicSpline(at, through)(np.linspace(0.0, at[-1], n + 1))
    drawn[0], drawn[-1] = through[0], through[-1]
    return drawn


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
