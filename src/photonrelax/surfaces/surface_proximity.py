"""Points that have surface near them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._ext.surfaces.surface_proximity import Faces
from .._util import validation
from .._util.parallel import thread_count
from ..photons.axes import MIN_NORMAL_COSINE
from ..scene.meshes import face_normals, nondegenerate_triangles, triangle_bounds
from ..scene.scene import SceneObject
from ..spatial.box_tree import BoxTree


class SurfaceProximity:
    """The faces of objects on which photons are stored: diffuse ones and sensors.

    Parameters
    ----------
    objects : sequence of SceneObject
        Others among them do not count.
    """

    def __init__(self, objects: Sequence[SceneObject]) -> None:
        meshes = [item.mesh for item in objects if not item.material.is_specular]
        corners = np.empty((0, 3, 3))
        if meshes:
            vertices, faces = nondegenerate_triangles(meshes)
            corners = np.ascontiguousarray(vertices[faces], dtype=np.float64)
        tree = BoxTree(*triangle_bounds(corners))
        normals = face_normals(corners)
        self._faces = Faces(tree.kernel, corners, normals, min_cosine=MIN_NORMAL_COSINE)

    def within(
        self,
        points: ArrayLike,
        normals: ArrayLike,
        radius: ArrayLike,
        *,
        n_threads: int | None = None,
    ) -> NDArray[np.bool_]:
        """Mask (m,) of the points with a face within a radius.

        Parameters
        ----------
        points, normals : (m, 3) array_like
            m, and unit normals: a face counts if that of either of its sides is within 60° of it.
        radius : scalar or (m,) array_like
            m, bound included; may be infinite.
        n_threads : int, optional
            Threads; all available by default. The result does not depend on it.

        Raises
        ------
        TypeError, ValueError
            If a shape is wrong, or a value is not finite, a normal zero or a radius negative.
        """
        points = validation.float_array(points, "points", (None, 3))
        threads = thread_count(n_threads)
        normals = validation.unit_vectors(normals, "normals", points.shape, threads)
        radii = validation.distances(radius, "radius", (len(points),))
        found: NDArray[np.bool_] = self._faces.within(points, normals, radii, threads)
        return found
