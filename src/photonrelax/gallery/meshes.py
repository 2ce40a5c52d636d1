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
"""Maps points (n, 3) to values (n,) and gradients (n, 3)."""

# Converged: Newton's method doubles the digits in every step.
_NEWTON_STEPS = 12


def make_mesh(
    vertices: Floats, faces: NDArray[np.intp], normals: Floats | None = None
) -> trimesh.Trimesh:
    """Mesh of exactly these vertices: trimesh does not merge them."""
    import trimesh

    return trimesh.Trimesh(vertices, faces, vertex_normals=normals, process=False)


def floor(half_size: float, albedo: float = 0.8) -> SceneObject:
    """Square diffuse floor at z = 0 around the origin."""
    s = half_size
    corners = np.array([[-s, -s, 0.0], [s, -s, 0.0], [s, s, 0.0], [-s, s, 0.0]])
    return SceneObject(
        make_mesh(corners, np.array([[0, 1, 2], [0, 2, 3]])), Diffuse(albedo), "floor"
    )


def grid_faces(rows: int, columns: int) -> NDArray[np.intp]:
    """Triangles of a grid of rows × columns vertices numbered row by row.

    They wind so that the normal is (direction of columns) × (direction of rows).
    """
    corner = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    triangles = np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)], axis=2)
    return triangles.reshape(-1, 3)


def join(parts: list[tuple[Floats, Floats, NDArray[np.intp]]]) -> trimesh.Trimesh:
    """Mesh of several (vertices, normals, faces), none of whose vertices are shared."""
    vertices, normals, faces = zip(*parts, strict=True)
    first = np.cumsum([0, *(len(v) for v in vertices)])
    renumbered = [f + start for f, start in zip(faces, first, strict=False)]
    return make_mesh(np.concatenate(vertices), np.concatenate(renumbered), np.concatenate(normals))


def level_set(field: Field, half_axes: Floats, subdivisions: int) -> trimesh.Trimesh:
    """Closed surface field = 0, star-shaped about the origin.

    Parameters
    ----------
    field : callable
        Maps points (n, 3) to values (n,), negative inside and nearly convex, and gradients (n, 3).
    half_axes : (3,) array
        Of an ellipsoid around the surface, m, whose vertices are moved towards the origin.
    subdivisions : int
        Of the icosphere that the ellipsoid is made of; 7 makes 327,680 faces.
    """
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    # Newton's method on the line to the origin does not overshoot a convex surface from outside.
    points = np.asarray(ball.vertices) * half_axes
    for _ in range(_NEWTON_STEPS):
        value, gradient = field(points)
        slope = (gradient * points).sum(axis=1)
        points = points * (1 - value / slope)[:, None]
    gradient = field(points)[1]
    normals = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
    return make_mesh(points, np.asarray(ball.faces), normals)
