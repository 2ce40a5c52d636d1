"""Derivatives of interpolated normals along the faces of smooth objects."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .._ext.transport.curvature import normal_derivatives
from .._util.validation import Floats
from ..scene.scene import SceneObject
from .raycast import Intersections


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
            out = np.empty((len(rows), 3, 3))
            normal_derivatives(hits.position[rows], corners, normals, out)
            derivative[rows] = out
        return derivative
