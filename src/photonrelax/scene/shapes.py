"""Shapes of area emitters: triangles that stand for rectangles, disks and spheres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from .._util.frozen import frozen, set_field
from .._util.validation import float_array, positive, unit_vectors

if TYPE_CHECKING:
    import trimesh

# Corners of a disk, and times that the faces of an icosahedron are divided.
_CORNERS = 128
_SUBDIVISIONS = 4


@dataclass(frozen=True, eq=False)
class Rectangle:
    """Rectangle, or parallelogram, with the normal half_u × half_v.

    Parameters
    ----------
    center : (3,)
        m.
    half_u, half_v : (3,)
        From the centre to the middles of two sides, m.
    """

    center: ArrayLike
    half_u: ArrayLike
    half_v: ArrayLike

    def __post_init__(self) -> None:
        for name in ("center", "half_u", "half_v"):
            set_field(self, name, frozen(float_array(getattr(self, name), name, (3,))))

    def mesh(self) -> trimesh.Trimesh:
        """Two triangles."""
        u, v = np.asarray(self.half_u), np.asarray(self.half_v)
        corners = np.array([-u - v, u - v, u + v, v - u])
        return _mesh(corners + np.asarray(self.center), [[0, 1, 2], [0, 2, 3]])


@dataclass(frozen=True, eq=False)
class Disk:
    """Disk: a polygon of 128 corners with its area.

    Parameters
    ----------
    center, normal : (3,)
        m; any length.
    radius : float
        m.
    """

    center: ArrayLike
    normal: ArrayLike
    radius: float

    def __post_init__(self) -> None:
        set_field(self, "center", frozen(float_array(self.center, "center", (3,))))
        set_field(self, "normal", frozen(unit_vectors(self.normal, "normal", (3,))))
        set_field(self, "radius", positive(self.radius, "radius"))

    def mesh(self) -> trimesh.Trimesh:
        """Triangles around the centre."""
        w = np.asarray(self.normal)
        u = np.cross(w, np.eye(3)[np.abs(w).argmin()])
        u /= np.linalg.norm(u)
        turn = 2.0 * np.pi / _CORNERS
        azimuth = turn * np.arange(_CORNERS)
        rim = self.radius * np.sqrt(turn / np.sin(turn))
        aside = np.outer(np.cos(azimuth), u) + np.outer(np.sin(azimuth), np.cross(w, u))
        corner = np.arange(_CORNERS)
        faces = np.column_stack(
            [np.full(_CORNERS, _CORNERS), corner, np.roll(corner, -1)],
        )
        return _mesh(np.vstack([rim * aside, np.zeros(3)]) + np.asarray(self.center), faces)


@dataclass(frozen=True, eq=False)
class Sphere:
    """Sphere: 5120 triangles with its area, and in the mean over all directions its outline.

    Parameters
    ----------
    center : (3,)
        m.
    radius : float
        m.
    """

    center: ArrayLike
    radius: float

    def __post_init__(self) -> None:
        set_field(self, "center", frozen(float_array(self.center, "center", (3,))))
        set_field(self, "radius", positive(self.radius, "radius"))

    def mesh(self) -> trimesh.Trimesh:
        """Faces of a divided icosahedron."""
        import trimesh

        unit = trimesh.creation.icosphere(_SUBDIVISIONS)
        scale = self.radius * np.sqrt(4.0 * np.pi / unit.area)
        return _mesh(scale * np.asarray(unit.vertices) + np.asarray(self.center), unit.faces)


def _mesh(vertices: ArrayLike, faces: ArrayLike) -> trimesh.Trimesh:
    import trimesh

    return trimesh.Trimesh(vertices, faces, process=False)
