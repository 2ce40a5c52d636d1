"""Meshes of glTF files: triangles with normals, welded where seams split them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..._util.products import product
from ..._util.validation import Floats
from ...scene.meshes import divided, face_normals
from ...scene.shading import given_normals
from ..json_entry import JsonEntry
from .file import GltfFile

if TYPE_CHECKING:
    import trimesh

# By the mode of a primitive.
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
# Cosine above which the normal of a corner is that of its face: 0.8 degrees.
_FLAT_COSINE = 1.0 - 1e-4
# A crease angle that no edge exceeds.
_ALL_SMOOTH = 180.0


@dataclass(frozen=True, eq=False)
class Triangles:
    """Triangles of a primitive.

    Attributes
    ----------
    vertices : (v, 3)
    normals : (v, 3), optional
        Unit vectors; None for flat faces.
    faces : (f, 3)
    uv : (v, 2), optional
        Texture coordinates, v down.
    """

    vertices: Floats
    normals: Floats | None
    faces: NDArray[np.int64]
    uv: Floats | None = None

    def placed(self, to_world: Floats) -> Triangles:
        """The triangles in the world; those of mirrored nodes keep their outside."""
        linear = to_world[:3, :3]
        vertices = product(self.vertices, linear.T) + to_world[:3, 3]
        mirrored = np.linalg.det(linear) < 0.0
        faces = self.faces[:, ::-1] if mirrored else self.faces
        normals = self.normals
        if normals is not None:
            # Normals map by the cofactors, which turn with the outside.
            cofactors = np.cross(linear[[1, 2, 0]], linear[[2, 0, 1]])
            normals = product(normals, cofactors.T) * (-1.0 if mirrored else 1.0)
            normals = divided(normals, np.linalg.norm(normals, axis=1, keepdims=True))
        return Triangles(vertices, normals, np.ascontiguousarray(faces), self.uv)

    def mesh(self) -> tuple[trimesh.Trimesh, bool | float]:
        """The triangles as a mesh, and the ``smooth`` of its object."""
        import trimesh

        if self.normals is None:
            return trimesh.Trimesh(self.vertices, self.faces, process=False), False
        mesh = trimesh.Trimesh(
            self.vertices, self.faces, vertex_normals=self.normals, process=False
        )
        # Normals that are means over all faces around are computed anew, with better weights.
        return mesh, True if given_normals(mesh) is not None else _ALL_SMOOTH


def triangles_of(
    file: GltfFile, primitive: JsonEntry, uv_set: int | None = None
) -> Triangles | None:
    """Triangles of a primitive, None if it is of points or lines.

    With texture coordinates of the set of a number, if one is asked for.

    Raises
    ------
    ValueError
        If its arrays do not fit one another.
    """
    mode = primitive.count("mode", _TRIANGLES, high=_FAN)
    if mode < _TRIANGLES:
        return None
    n = len(file.entries("accessors"))
    attributes = primitive.entry("attributes")
    index = attributes.index("POSITION", n)
    if index is None:
        raise ValueError(f"{primitive.where} should have a POSITION, but has none")
    vertices = file.floats(index, 3)
    faces = _faces(file, primitive, mode, len(vertices))
    uv = None if uv_set is None else _uv(file, primitive, uv_set, len(vertices))
    index = attributes.index("NORMAL", n)
    if index is None:
        return _welded(Triangles(vertices, None, faces, uv))
    normals = file.floats(index, 3)
    if normals.shape != vertices.shape:
        raise ValueError(
            f"{primitive.where} should have as many normals as positions, but has {len(normals)} "
            f"and {len(vertices)}"
        )
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    given = Triangles(vertices, divided(normals, length), faces, uv)
    usable = (length > 0.0).all() and not _is_flat(given)
    return _welded(given if usable else replace(given, normals=None))


def _uv(file: GltfFile, primitive: JsonEntry, uv_set: int, n: int) -> Floats:
    """Texture coordinates (n, 2) of a set."""
    name = f"TEXCOORD_{uv_set}"
    index = primitive.entry("attributes").index(name, len(file.entries("accessors")))
    if index is None:
        raise ValueError(f"{primitive.where} should have {name} for its texture, but has none")
    uv = file.floats(index, 2)
    if len(uv) != n:
        raise ValueError(f"{primitive.where} should have {n} of {name}, but has {len(uv)}")
    return uv


def _faces(file: GltfFile, primitive: JsonEntry, mode: int, n: int) -> NDArray[np.int64]:
    index = primitive.index("indices", len(file.entries("accessors")))
    corners = np.arange(n) if index is None else file.array(index)
    if corners.ndim != 1 or corners.dtype.kind not in "iu":
        raise primitive.error("indices", "an accessor of unsigned integers")
    if len(corners) and corners.max() >= n:
        raise ValueError(
            f"{primitive.where}.indices should be below its {n} positions, "
            f"but one is {corners.max()}"
        )
    corners = corners.astype(np.int64)
    if mode == _TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    if len(corners) < 3:
        return np.empty((0, 3), np.int64)
    if mode == _FAN:
        first = np.full(len(corners) - 2, corners[0])
        return np.column_stack([first, corners[1:-1], corners[2:]])
    faces = np.column_stack([corners[:-2], corners[1:-1], corners[2:]])
    faces[1::2] = faces[1::2, [1, 0, 2]]
    return faces


def _is_flat(triangles: Triangles) -> bool:
    """True if the normals at all corners are those of the faces."""
    assert triangles.normals is not None
    of_face = face_normals(triangles.vertices[triangles.faces])
    cosine = np.einsum("fci,fi->fc", triangles.normals[triangles.faces], of_face)
    return bool((cosine[of_face.any(axis=1)] >= _FLAT_COSINE).all())


def _welded(triangles: Triangles) -> Triangles:
    """The triangles with vertices that are equal in position, normal and texture joined."""
    if not len(triangles.vertices):
        return triangles
    parts = [triangles.vertices]
    parts += [each for each in (triangles.normals, triangles.uv) if each is not None]
    # Zeros of both signs are one.
    rows = np.ascontiguousarray(np.hstack(parts) + 0.0)
    keys = rows.view(np.dtype((np.void, rows.itemsize * rows.shape[1])))[:, 0]
    _, first, of_vertex = np.unique(keys, return_index=True, return_inverse=True)
    # In the order of the file.
    rank = np.empty(len(first), np.int64)
    order = np.argsort(first)
    rank[order] = np.arange(len(first))
    kept = first[order]
    return Triangles(
        triangles.vertices[kept],
        None if triangles.normals is None else triangles.normals[kept],
        rank[of_vertex][triangles.faces],
        None if triangles.uv is None else triangles.uv[kept],
    )
