"""Checks of meshes, and the part of them that rays can hit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats, float_array, int_array

if TYPE_CHECKING:
    import trimesh


from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import trimesh

# A face whose height is below this fraction of its longest edge has no usable normal.
_SLIVER = 1e-12
# Share of the volumes its faces span that a mesh's own may miss by rounding.
_ROUNDING = 1e-12


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
    """Return which vertices belong to a face, (n_vertices,)."""
    used = np.zeros(n_vertices, dtype=bool)
    used[faces] = True
    return used


def check_mesh(mesh: trimesh.Trimesh) -> None:
    """Raise TypeError or ValueError unless the mesh is one that rays can hit."""
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

    Meshes refer to themselves: these would stay until garbage is collected.
    """
    mesh._data.clear()
    mesh._cache.clear()


def _is_closed(vertices: Floats, faces: NDArray) -> bool:
    """Return whether faces run along every edge as often one way as the other.

    Vertices at the same place count as one: meshes with normals of their own often split them.
    """
    merged = np.unique(vertices, axis=0, return_inverse=True)[1].reshape(-1)[faces]
    start, end = merged.ravel(), np.roll(merged, -1, axis=1).ravel()
    there, back = start * len(vertices) + end, end * len(vertices) + start
    return np.array_equal(np.sort(there), np.sort(back))


def _length(vectors: Floats) -> Floats:
    return np.linalg.norm(vectors, axis=-1)


# Vertex normals as near as this to what trimesh computes are not given but computed.
_OWN = 1e-6


def vertex_normals(mesh: trimesh.Trimesh) -> Floats:
    """Return the normals (v, 3) that came with a mesh, or trimesh's from a copy of unit size.

    trimesh takes the faces of tiny meshes for degenerate. What it was given it keeps where it
    keeps what it was asked for: the latter is told by its values, so that looking at a mesh does
    not change what is made of it.
    """
    vertices = np.asarray(mesh.vertices)
    if "vertex_normals" in mesh._cache:
        kept = np.asarray(mesh.vertex_normals)
        if np.abs(kept - _own_normals(mesh, vertices)).max() > _OWN:
            return kept
    low = vertices.min(axis=0)
    return _own_normals(mesh, (vertices - low) / (vertices - low).max())


def _own_normals(mesh: trimesh.Trimesh, vertices: Floats) -> Floats:
    own = type(mesh)(vertices, mesh.faces, process=False)
    normals = np.asarray(own.vertex_normals)
    release_arrays(own)
    return normals
