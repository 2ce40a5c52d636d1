"""A torus of glass and one of metal, linked, after SSO08 Fig. 1."""

from __future__ import annotations

import numpy as np

from ..scene.camera import Camera
from ..scene.emitters import CollimatedEmitter
from ..scene.environment import EnvironmentEmitter
from ..scene.materials import Dielectric, Diffuse, Mirror
from ..scene.scene import Scene, SceneObject
from .solids import placed, rotation, sheet, torus

_GOLD = (0.95, 0.68, 0.32)
_AQUA = (1.1, 0.16, 0.12)
_PAPER = (0.76, 0.75, 0.72)
_SURROUNDINGS = (0.20, 0.23, 0.28)
_GAP = 1e-3
# Of the glass from the horizontal, and of both about the vertical, degrees.
_LEAN, _TURN = 17.0, 24.0


def toruses(
    *,
    radius: float = 0.62,
    tube_radius: float = 0.17,
    ior: float = 1.5,
    irradiance: float = 2.6,
    elevation: float = 40.0,
    sections: int = 512,
    pixels: int = 600,
) -> Scene:
    """Glass torus that lies on the floor, and a golden one that stands through it.

    Parameters
    ----------
    radius, tube_radius : float
        Of both toruses: of the circle in the middle of the tube, and of the tube, m.
    ior : float
        Index of refraction of the glass.
    irradiance : float
        Of the light, on a plane facing it, W/m².
    elevation : float
        Of the light above the horizon, degrees.
    sections : int
        Facets around a torus; half as many are around its tube. Normals are exact.
    pixels : int
        Width and height of images.
    """
    ring = torus(radius, tube_radius, sections, sections // 2)
    # One side of the glass lies on the floor, the other in the metal.
    turn, lean = rotation([0, 0, 1], _TURN), rotation([0, 1, 0], -_LEAN)
    rise, run = radius * np.sin(np.radians(_LEAN)), radius * np.cos(np.radians(_LEAN))
    glass = placed(ring, (0.0, 0.0, rise + tube_radius + _GAP), turn @ lean)
    linked = turn @ [run, 0.0, radius + tube_radius + _GAP]
    metal = placed(ring, linked, turn @ rotation([1, 0, 0], 90.0))
    up = np.radians(elevation)
    eye, target = np.array([[-0.3, -3.9, 2.6], [0.10, -0.15, 0.42]])
    return Scene(
        [
            SceneObject(sheet((-5, -5, 0), (10, 0, 0), (0, 10, 0)), Diffuse(_PAPER), "floor"),
            SceneObject(glass, Dielectric(ior, absorption=_AQUA), "glass torus", smooth=True),
            SceneObject(metal, Mirror(_GOLD), "metal torus", smooth=True),
        ],
        [
            CollimatedEmitter((-0.5 * np.cos(up), -0.86 * np.cos(up), -np.sin(up)), irradiance),
            EnvironmentEmitter(_SURROUNDINGS),
        ],
        Camera(eye, target, vertical_fov=30.0, width=pixels, height=pixels),
        name="toruses",
    )
