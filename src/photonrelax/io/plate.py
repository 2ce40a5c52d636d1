"""Plates in place of open surfaces of glass."""

from __future__ import annotations

import numpy as np

from .._util.validation import Floats
from ..scene.meshes import divided, face_normals
from ..scene.welding import HalfEdges, weld

# Thickness of a plate over the diagonal of its surface: thin, and more than rays resolve.
_THICKNESS = 1e-3


def plate(vertices: Floats, faces: np.ndarray) -> tuple[Floats, np.ndarray, float]:
    """Closed surface of a plate whose outer face is an open surface.

    Returns
    -------
    vertices : (2 v, 3)
    faces : (2 f + 2 b, 3)
        Outer and inner face, and two for each border edge.
    thickness : float
        m.
    """
    position = weld(vertices, faces)
    first = np.full(position.max() + 1, -1)
    first[position[::-1]] = np.arange(len(vertices))[::-1]
    points, outer = vertices[first], position[faces]
    thickness = _THICKNESS * float(np.linalg.norm(np.ptp(points, axis=0)))
    normal = np.zeros_like(points)
    of_face = face_normals(points[outer])
    for corner in outer.T:
        np.add.at(normal, corner, of_face)
    normal = divided(normal, np.linalg.norm(normal, axis=1, keepdims=True))
    n = len(points)
    start, end = _border(outer)
    sides = [np.column_stack([end, start, start + n]), np.column_stack([end, start + n, end + n])]
    closed = np.concatenate([outer, outer[:, ::-1] + n, *sides])
    return np.concatenate([points, points - thickness * normal]), closed, thickness


def _border(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and last vertices of the edges that have one face, in its direction."""
    half_edges = HalfEdges(faces)
    alone = np.bincount(half_edges.edge)[half_edges.edge] == 1
    ids = half_edges.ids[alone]
    return faces.ravel()[ids], faces[:, [1, 2, 0]].ravel()[ids]
