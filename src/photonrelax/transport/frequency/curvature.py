"""Derivatives of interpolated normals along the faces of smooth objects."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..._util.validation import Floats
from ...scene.scene import SceneObject
from ..raycast import Intersections


class NormalDerivatives:
    """Derivatives dn/dx of the shading normals of objects; zero on flat-shaded ones."""

    def __init__(self, objects: Sequence[SceneObject]) -> None:
        self._smooth = {i: item for i, item in enumerate(objects) if item.smooth}

    def at(self, hits: Intersections) -> Floats:
        """Derivatives (n, 3, 3), 1/m: times a step along the face, the change of the normal."""
        derivative = np.zeros((len(hits), 3, 3))
        for object_id, item in self._smooth.items():
            rows = np.flatnonzero(hits.object_id == object_id)
            face = hits.face_id[rows]
            corners = np.asarray(item.mesh.vertices)[item.mesh.faces[face]]
            shading = item.shading_normals
            normals = shading.normal[shading.faces[face]]
            derivative[rows] = _on_faces(hits.position[rows], corners, normals)
        return derivative


def _on_faces(position: Floats, corners: Floats, normals: Floats) -> Floats:
    """Derivatives of n = N / |N|, N interpolated between corners (n, 3, 3) with their normals."""
    ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    cross = np.cross(ab, ac)
    # Of the parallelogram.
    squared_area = _dot(cross, cross)
    gradient_u = np.cross(ac, cross) / squared_area
    gradient_v = np.cross(cross, ab) / squared_area
    offset = position - corners[:, 0]
    to_b, to_c = normals[:, 1] - normals[:, 0], normals[:, 2] - normals[:, 0]
    normal = normals[:, 0] + _dot(gradient_u, offset) * to_b + _dot(gradient_v, offset) * to_c
    length = np.sqrt(_dot(normal, normal))
    slope = to_b[:, :, None] * gradient_u[:, None] + to_c[:, :, None] * gradient_v[:, None]
    unit = normal / length
    slope -= unit[:, :, None] * np.einsum("ni,nij->nj", unit, slope)[:, None]
    # The geometric normal, which is constant, serves where the interpolated one points behind.
    interpolated = _dot(normal, cross) > 0.0
    derivative: Floats = np.where(interpolated[:, :, None], slope / length[:, :, None], 0.0)
    return derivative


def _dot(a: Floats, b: Floats) -> NDArray:
    return (a * b).sum(axis=1, keepdims=True)
