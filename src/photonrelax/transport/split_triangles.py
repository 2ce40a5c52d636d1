"""Triangles split where float32 would displace them: large ones, near the origin of the frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats
from ..scene.meshes import face_bounds
from ..scene.resolution import MAX_SPREAD

# Halving an edge as often takes it from the largest to the least length that float32 tells apart
# from the coordinates around it, with room to spare.
_MAX_LEVELS = 64
# Barycentric coordinates u, v of the corners of the four quarters of a triangle.
_QUARTERS = np.array(
    [
        [[0.0, 0.0], [0.5, 0.0], [0.0, 0.5]],
        [[0.5, 0.0], [1.0, 0.0], [0.5, 0.5]],
        [[0.0, 0.5], [0.5, 0.5], [0.0, 1.0]],
        [[0.5, 0.5], [0.0, 0.5], [0.5, 0.0]],
    ]
)


@dataclass(frozen=True, eq=False)
class Pieces:
    """Parts of triangles.

    Attributes
    ----------
    face : (p,) intp
        The triangle that each is a part of.
    uv : (p, 3, 2)
        Barycentric coordinates of its corners in that triangle.
    """

    face: NDArray[np.intp]
    uv: Floats

    def __len__(self) -> int:
        return len(self.face)

    def corners(self, vertices: Floats, faces: NDArray) -> Floats:
        """Corners (p, 3, 3), given vertices (v, 3) and faces (f, 3)."""
        a, b, c = np.moveaxis(vertices[faces[self.face]], 1, 0)
        u, v = self.uv[..., 0, np.newaxis], self.uv[..., 1, np.newaxis]
        return a[:, None] + u * (b - a)[:, None] + v * (c - a)[:, None]


def split_triangles(vertices: Floats, faces: NDArray, radius: float) -> Pieces:
    """Return the pieces of the triangles that have to be split; none of the others.

    A piece reaches at most `MAX_SPREAD` times as far from the origin as the least distance of its
    bounding box, or as `radius`, so that rounding it to float32 displaces it no more than what is
    there.
    """
    reaches = np.abs(vertices).max(axis=1) > MAX_SPREAD * radius
    face = np.flatnonzero(reaches[faces].any(axis=1))
    face = face[_spreads(*face_bounds(vertices, faces[face]), radius)]
    whole = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    pieces = Pieces(face, np.broadcast_to(whole, (len(face), 3, 2)))
    done = []
    for _ in range(_MAX_LEVELS):
        corners = pieces.corners(vertices, faces)
        spreads = _spreads(corners.min(axis=1), corners.max(axis=1), radius)
        done.append(Pieces(pieces.face[~spreads], pieces.uv[~spreads]))
        pieces = _quarters(Pieces(pieces.face[spreads], pieces.uv[spreads]))
        if len(pieces.face) == 0:
            break
    done.append(pieces)
    return Pieces(*(np.concatenate([getattr(p, name) for p in done]) for name in ("face", "uv")))


def _spreads(low: Floats, high: Floats, radius: float) -> NDArray[np.bool_]:
    """True for boxes that reach too far for how close they come to the origin."""
    nearest = np.maximum(low, -high).max(axis=1)
    farthest = np.maximum(-low, high).max(axis=1)
    return farthest > MAX_SPREAD * np.maximum(nearest, radius)


def _quarters(pieces: Pieces) -> Pieces:
    a = pieces.uv[:, np.newaxis, :1]
    edges = pieces.uv[:, 1:] - pieces.uv[:, :1]
    uv = a + np.einsum("qce,pei->pqci", _QUARTERS, edges)
    return Pieces(np.repeat(pieces.face, 4), uv.reshape(-1, 3, 2))
