"""A metal ring on the floor in slanting sunlight, after SSO08 Fig. 6: the nephroid.

SSO08 calls it a cardioid, which is that of a light on the ring; parallel light makes a nephroid.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._util.validation import Floats
from ..scene.camera import Camera
from ..scene.emitters import CollimatedEmitter
from ..scene.materials import Mirror
from ..scene.scene import Scene, SceneObject
from .light import from_around
from .meshes import floor, grid_faces, join

if TYPE_CHECKING:
    import trimesh


def ring(
    *,
    radius: float = 1.0,
    thickness: float = 0.04,
    height: float = 0.4,
    gap: float = 1e-3,
    elevation: float = 28.0,
    reflectance: float = 0.95,
    irradiance: float = 1.6,
    surroundings: ArrayLike = 0.0,
    sections: int = 1024,
    pixels: int = 600,
) -> Scene:
    """Polished ring around the origin, lit from -x over its rim.

    Parameters
    ----------
    radius, thickness, height : float
        Inner radius, width of the rim and height of the wall, m.
    gap : float
        Between the ring and the floor, so that they share no face, m.
    elevation : float
        Of the light above the horizon, degrees.
    reflectance : float
        Of the metal.
    irradiance : float
        Of the light, on a plane facing it, W/m².
    surroundings : float or (3,)
        Radiance from all around, W/(m² sr); none by default, as the exact irradiance has none.
    sections : int
        Facets around the ring; normals are those of the true cylinder.
    pixels : int
        Width and height of images.
    """
    metal = _tube(radius, radius + thickness, gap, gap + height, sections)
    down = np.radians(elevation)
    eye, target = radius * np.array([[-2.4, 0.0, 3.4], [0.0, 0.0, 0.0]])
    return Scene(
        [
            floor(20.0 * radius),
            SceneObject(metal, Mirror(reflectance), "ring", smooth=True),
        ],
        [
            CollimatedEmitter((np.cos(down), 0.0, -np.sin(down)), irradiance),
            *from_around(surroundings),
        ],
        Camera(eye, target, vertical_fov=36.0, width=pixels, height=pixels),
        name="ring",
    )


def _tube(inner: float, outer: float, bottom: float, top: float, sections: int) -> trimesh.Trimesh:
    """Tube of four bands that share no vertices, so that its edges stay sharp."""
    return join(
        [
            _band((inner, top), (inner, bottom), (-1.0, 0.0), sections),
            _band((inner, bottom), (outer, bottom), (0.0, -1.0), sections),
            _band((outer, bottom), (outer, top), (1.0, 0.0), sections),
            _band((outer, top), (inner, top), (0.0, 1.0), sections),
        ]
    )


def _band(
    start: tuple[float, float], end: tuple[float, float], normal: tuple[float, float], sections: int
) -> tuple[Floats, Floats, NDArray[np.intp]]:
    """Surface of revolution of a segment in the plane of (distance from the axis, height)."""
    azimuth = np.linspace(0.0, 2 * np.pi, sections + 1)
    spin = np.column_stack([np.cos(azimuth), np.sin(azimuth)])

    def sweep(point: tuple[float, float]) -> Floats:
        return np.column_stack([point[0] * spin, np.full(len(spin), point[1])])

    vertices = np.concatenate([sweep(start), sweep(end)])
    return vertices, np.tile(sweep(normal), (2, 1)), grid_faces(2, sections + 1)
