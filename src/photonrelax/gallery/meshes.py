"""Meshes that more than one scene uses. Normals, where given, are those of the exact surface."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats
from ..scene.materials import Diffuse
from ..scene.scene import SceneObject

if TYPE_CHECKING:
    import trimesh

Field = Callable[[Floats], tuple[Floats, Floats]]

# Newton's method doubles the digits each time once it is near.
_NEWTON_STEPS = 12


def make_mesh(
    vertices: Floats, faces: NDArray[np.intp], normals: Floats | None = None
) -> trimesh.Trimesh:
    """Return a mesh as given, without trimesh's merging of vertices."""
    import trimesh

    return trimesh.Trimesh(vertices, faces, vertex_normals=normals, process=False)


def floor(half_size: float, albedo: float = 0.8) -> SceneObject:
    """Return a square diffuse floor at z = 0 around the origin."""
    s = half_size
    corners = np.array([[-s, -s, 0.0], [s, -s, 0.0], [s, s, 0.0], [-s, s, 0.0]])
    return SceneObject(
        make_mesh(corners, np.array([[0, 1, 2], [0, 2, 3]])), Diffuse(albedo), "floor"
    )


def grid_faces(rows: int, columns: int) -> NDArray[np.intp]:
    """Return the triangles of a grid of rows × columns vertices numbered row by row.

    They wind so that the normal is (direction of columns) × (direction of rows).
    """
    corner = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    triangles = np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)], axis=2)
    return triangles.reshape(-1, 3)


def join(parts: list[tuple[Floats, Floats, NDArray[np.intp]]]) -> trimesh.Trimesh:
    """Return one mesh of several (vertices, normals, faces), none of whose vertices are shared."""
    vertices, normals, faces = zip(*parts, strict=True)
    first = np.cumsum([0, *(len(v) for v in vertices)])
    renumbered = [f + start for f, start in zip(faces, first, strict=False)]
    return make_mesh(np.concatenate(vertices), np.concatenate(renumbered), np.concatenate(normals))


def level_set(field: Field, reach: Floats, subdivisions: int) -> trimesh.Trimesh:
    """Return the closed surface field = 0 around the origin, seen whole from there.

    Parameters
    ----------
    field : callable
        Maps points (n, 3) to values (n,), negative inside and all but convex, and gradients (n, 3).
    reach : (3,) array
        Half-axes of an ellipsoid outside the surface, m; vertices are spread as on it.
    subdivisions : int
        Of the icosphere behind the mesh; 7 makes 327,680 faces.
    """
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    # Newton from outside along the line to the origin never overshoots a convex surface.
    points = np.asarray(ball.vertices) * reach
    for _ in range(_NEWTON_STEPS):
        value, gradient = field(points)
        slope = (gradient * points).sum(axis=1)
        points = points * (1 - value / slope)[:, None]
    gradient = field(points)[1]
    normals = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
    return make_mesh(points, np.asarray(ball.faces), normals)
