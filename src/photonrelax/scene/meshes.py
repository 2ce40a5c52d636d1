"""Validation of meshes, and their faces with an area."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats, float_array, int_array

if TYPE_CHECKING:
    import trimesh

# A face whose height is below this fraction of its longest edge has no usable normal.
_SLIVER = 1e-12


def nondegenerate_faces(mesh: trimesh.Trimesh) -> tuple[NDArray[np.intp], NDArray]:
    """Return ids (f,) and vertex indices (f, 3) of the faces that have an area."""
    faces = np.asarray(mesh.faces)
    a, b, c = corners_by_axis(np.asarray(mesh.vertices), faces)
    longest = np.sqrt(longest_squared(a, b, c))
    doubled_area = np.sqrt(squared(cross(b - a, c - a)))
    ids = np.flatnonzero(doubled_area > _SLIVER * longest**2)
    return ids, faces[ids]


def corners_by_axis(vertices: Floats, faces: NDArray) -> tuple[Floats, Floats, Floats]:
    """First, second and third corners of faces, (3, f) each: arithmetic runs along its rows."""
    by_axis = np.ascontiguousarray(vertices.T)
    a, b, c = (by_axis[:, faces[:, i]] for i in range(3))
    return a, b, c


def longest_squared(a: Floats, b: Floats, c: Floats) -> Floats:
    """Squares of the longest edges of triangles by their corners (3, f), (f,)."""
    return np.maximum(np.maximum(squared(b - a), squared(c - b)), squared(a - c))


def squared(vectors: Floats) -> Floats:
    """Squared lengths (n,) of vectors (3, n)."""
    return dot(vectors, vectors)


def dot(u: Floats, v: Floats) -> Floats:
    """Scalar products (n,) of vectors (3, n)."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def cross(u: Floats, v: Floats) -> Floats:
    """Vector products (3, n) of vectors (3, n)."""
    product = np.empty_like(u)
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        product[axis] = u[i] * v[j] - u[j] * v[i]
    return product


def nondegenerate_vertices(mesh: trimesh.Trimesh) -> Floats:
    """Return the vertices (v, 3) that belong to a face with an area."""
    vertices = np.asarray(mesh.vertices)
    return vertices[vertices_of(nondegenerate_faces(mesh)[1], len(vertices))]


def nondegenerate_triangles(meshes: Iterable[trimesh.Trimesh]) -> tuple[Floats, NDArray]:
    """Return vertices (v, 3) of meshes, and vertex indices (f, 3) of faces that have an area."""
    vertices, faces, first = [], [], 0
    for mesh in meshes:
        vertices.append(np.asarray(mesh.vertices))
        faces.append(nondegenerate_faces(mesh)[1] + first)
        first += len(vertices[-1])
    return np.concatenate(vertices), np.concatenate(faces)


def face_bounds(vertices: Floats, faces: NDArray) -> tuple[Floats, Floats]:
    """Return the lowest and highest coordinates of faces, (f, 3) each."""
    return _bounds(*(vertices[faces[:, i]] for i in range(3)))


def triangle_bounds(corners: Floats) -> tuple[Floats, Floats]:
    """The lowest and highest coordinates, (n, 3) both, of triangles (n, 3, 3)."""
    return _bounds(*np.moveaxis(corners, 1, 0))


def _bounds(a: Floats, b: Floats, c: Floats) -> tuple[Floats, Floats]:
    return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


def bounding_box(corners: Floats) -> tuple[Floats, Floats]:
    """The lowest and highest coordinates, (3,) both, of all triangles (n, 3, 3).

    Infinity and minus infinity if there are none.
    """
    # By axis: NumPy is slow where the last axis is short.
    columns = corners.reshape(-1, 3).T
    low, high = [x.min(initial=np.inf) for x in columns], [x.max(initial=-np.inf) for x in columns]
    return np.array(low), np.array(high)


def face_normals(corners: Floats) -> Floats:
    """Unit normals (f, 3) by the winding of faces (f, 3, 3); zero for faces without an area."""
    a, b, c = np.moveaxis(corners, 1, 0)
    normal = np.cross(b - a, c - a)
    return divided(normal, np.linalg.norm(normal, axis=1, keepdims=True))


def divided(vectors: Floats, divisor: Floats) -> Floats:
    """Vectors over numbers, and zero over zero."""
    return np.divide(vectors, divisor, out=np.zeros_like(vectors), where=divisor > 0.0)


def vertices_of(faces: NDArray, n_vertices: int) -> NDArray[np.bool_]:
    """Mask of the vertices that belong to a face, (n_vertices,)."""
    used = np.zeros(n_vertices, dtype=bool)
    used[faces] = True
    return used


def check_mesh(mesh: trimesh.Trimesh) -> None:
    """Raise TypeError or ValueError unless the mesh has a face with an area."""
    if not hasattr(mesh, "vertices") or not hasattr(mesh, "faces"):
        raise TypeError(f"mesh should be a trimesh.Trimesh, but is {type(mesh).__name__}")
    vertices = float_array(mesh.vertices, "mesh.vertices", (None, 3))
    faces = int_array(mesh.faces, "mesh.faces", (None, 3))
    if len(faces) == 0:
        raise ValueError("mesh should have faces, but has none")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(
            f"mesh.faces should be indices of its {len(vertices)} vertices, "
            f"but range from {faces.min()} to {faces.max()}"
        )
    if len(nondegenerate_faces(mesh)[0]) == 0:
        raise ValueError(
            f"mesh should have a face with an area, but none of its {len(faces)} faces has"
        )


def release_arrays(mesh: trimesh.Trimesh) -> None:
    """Free the arrays of a mesh that is not needed any more.

    Meshes refer to themselves, so their arrays would stay until garbage is collected.
    """
    mesh._data.clear()
    mesh._cache.clear()


def in_unit_cube(vertices: Floats) -> Floats:
    """Vertices moved and scaled to coordinates from 0 to 1."""
    low = vertices.min(axis=0)
    return (vertices - low) / (vertices - low).max()
