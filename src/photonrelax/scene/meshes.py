"""Validation of meshes, faces with an area, and vertex normals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats, float_array, int_array

if TYPE_CHECKING:
    import trimesh

# A face whose height is below this fraction of its longest edge has no usable normal.
_SLIVER = 1e-12
# Rounding error of a mesh's volume over the sum of the volumes its faces span.
_ROUNDING = 1e-12
# Vertex normals within this of those trimesh computes were not given with the mesh.
_SAME_NORMAL = 1e-6


def nondegenerate_faces(mesh: trimesh.Trimesh) -> tuple[NDArray[np.intp], NDArray]:
    """Return ids (f,) and vertex indices (f, 3) of the faces that have an area."""
    faces = np.asarray(mesh.faces)
    a, b, c = np.moveaxis(np.asarray(mesh.vertices)[faces], 1, 0)
    longest = np.max([_length(b - a), _length(c - b), _length(a - c)], axis=0)
    doubled_area = _length(np.cross(b - a, c - a))
    ids = np.flatnonzero(doubled_area > _SLIVER * longest**2)
    return ids, faces[ids]


def nondegenerate_vertices(mesh: trimesh.Trimesh) -> Floats:
    """Return the vertices (v, 3) that belong to a face with an area."""
    vertices = np.asarray(mesh.vertices)
    return vertices[vertices_of(nondegenerate_faces(mesh)[1], len(vertices))]


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


def check_winding(mesh: trimesh.Trimesh) -> None:
    """Raise ValueError if the mesh is closed and inside out: its volume is negative."""
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    a, b, c = np.moveaxis((vertices - vertices[faces[0, 0]])[faces], 1, 0)
    volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
    if volumes.sum() < -_ROUNDING * np.abs(volumes).sum() and _is_closed(vertices, faces):
        raise ValueError(
            "mesh of a Dielectric should wind outwards, but its faces wind inwards "
            f"(volume {volumes.sum():.3g}): turn them with mesh.invert()"
        )


def release_arrays(mesh: trimesh.Trimesh) -> None:
    """Free the arrays of a mesh that is not needed any more.

    Meshes refer to themselves, so their arrays would stay until garbage is collected.
    """
    mesh._data.clear()
    mesh._cache.clear()


def vertex_normals(mesh: trimesh.Trimesh) -> Floats:
    """Return the normals (v, 3) given with a mesh, else trimesh's for a copy of unit size.

    trimesh treats the faces of tiny meshes as degenerate. It caches given and computed normals
    alike; computed ones are recognised by their values, so that reading `mesh.vertex_normals`
    does not change the result.
    """
    vertices = np.asarray(mesh.vertices)
    if "vertex_normals" in mesh._cache:
        cached = np.asarray(mesh.vertex_normals)
        if np.abs(cached - _computed_normals(mesh, vertices)).max() > _SAME_NORMAL:
            return cached
    low = vertices.min(axis=0)
    return _computed_normals(mesh, (vertices - low) / (vertices - low).max())


def _computed_normals(mesh: trimesh.Trimesh, vertices: Floats) -> Floats:
    copy = type(mesh)(vertices, mesh.faces, process=False)
    normals = np.asarray(copy.vertex_normals)
    release_arrays(copy)
    return normals


def _is_closed(vertices: Floats, faces: NDArray) -> bool:
    """True if faces run along every edge equally often in both directions.

    Vertices at the same position count as one: meshes with vertex normals often split them.
    """
    merged = np.unique(vertices, axis=0, return_inverse=True)[1].reshape(-1)[faces]
    start, end = merged.ravel(), np.roll(merged, -1, axis=1).ravel()
    forward, backward = start * len(vertices) + end, end * len(vertices) + start
    return np.array_equal(np.sort(forward), np.sort(backward))


def _length(vectors: Floats) -> Floats:
    return np.linalg.norm(vectors, axis=-1)
