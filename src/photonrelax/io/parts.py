"""Parts of mesh files: triangles with a material, if the file has one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._util.products import product
from .._util.validation import Floats
from ..scene.materials import Material

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True, eq=False)
class Part:
    """Triangles of one material.

    Attributes
    ----------
    name : str
    vertices : (v, 3)
        In the units of the file.
    faces : (f, 3)
    normals : (v, 3), optional
        Of the file.
    material : Material, optional
        Of the file.
    radiance : (3,)
        Emitted, W/(m² sr).
    uv : (v, 2), optional
        Texture coordinates of the file.
    """

    name: str
    vertices: Floats
    faces: NDArray
    normals: Floats | None
    material: Material | None
    radiance: Floats
    uv: Floats | None = None

    def mesh(self, linear: Floats) -> trimesh.Trimesh:
        """The mesh, turned and scaled by a matrix (3, 3)."""
        import trimesh

        vertices = product(self.vertices, linear.T)
        if self.normals is None:
            return trimesh.Trimesh(vertices, self.faces, process=False)
        length = np.linalg.norm(self.normals, axis=1, keepdims=True)
        if not (np.isfinite(length).all() and (length > 0.0).all()):
            return trimesh.Trimesh(vertices, self.faces, process=False)
        normals = product(self.normals, linear.T)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return trimesh.Trimesh(vertices, self.faces, vertex_normals=normals, process=False)
