"""How normals turn along smooth surfaces: the derivative of what is interpolated on a face."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..._util.validation import Floats
from ...scene.meshes import vertex_normals
from ...scene.scene import SceneObject
from ..raycast import Intersections


class NormalGradients:
    """Derivatives of the shading normals of objects; flat faces have none."""

    def __init__(self, objects: Sequence[SceneObject]) -> None:
        self._meshes = {
            i: (np.asarray(item.mesh.vertices), item.mesh.faces, vertex_normals(item.mesh))
            for i, item in enumerate(objects)
            if item.smooth
        }

    def at(self, hits: Intersections) -> Floats:
        """Return (n, 3, 3): multiplied by a step along the face, the change of the unit normal."""
        gradient = np.zeros((len(hits), 3, 3))
        for object_id, (vertices, faces, normals) in self._meshes.items():
            rows = np.flatnonzero(hits.object_id == object_id)
            face = faces[hits.face_id[rows]]
            gradient[rows] = _on_faces(hits.position[rows], vertices[face], normals[face])
        return gradient


def _on_faces(position: Floats, corners: Floats, normals: Floats) -> Floats:
    """Differentiate n = N / |N|, N interpolated between corners (n, 3, 3) with their normals."""
    ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(ab, ac)
    # Of the parallelogram.
    squared_area = _dot(across, across)
    along_u = np.cross(ac, across) / squared_area
    along_v = np.cross(across, ab) / squared_area
    offset = position - corners[:, 0]
    to_b, to_c = normals[:, 1] - normals[:, 0], normals[:, 2] - normals[:, 0]
    normal = normals[:, 0] + _dot(along_u, offset) * to_b + _dot(along_v, offset) * to_c
    length = np.sqrt(_dot(normal, normal))
    slope = to_b[:, :, None] * along_u[:, None] + to_c[:, :, None] * along_v[:, None]
    unit = normal / length
    slope -= unit[:, :, None] * np.einsum("ni,nij->nj", unit, slope)[:, None]
    # Where the normal leans through its face, the face's own is used.
    used = _dot(normal, across) > 0.0
    turning: Floats = np.where(used[:, :, None], slope / length[:, :, None], 0.0)
    return turning


def _dot(a: Floats, b: Floats) -> NDArray:
    return (a * b).sum(axis=1, keepdims=True)
