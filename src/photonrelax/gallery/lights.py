"""Red, green and blue lights through clear and coloured glass, after Lehmer11."""

from __future__ import annotations

import numpy as np

from ..scene.camera import Camera
from ..scene.emitters import SpotEmitter
from ..scene.materials import Dielectric
from ..scene.scene import Scene, SceneObject
from .meshes import floor
from .solids import ball, placed, rotation, torus

# Colours of the lights, and the azimuths that they come from, degrees.
_LIGHTS = (((1.0, 0.18, 0.10), 60.0), ((0.15, 1.0, 0.22), 90.0), ((0.16, 0.28, 1.0), 120.0))
# Absorption of green and of amber glass, 1/m.
_GREEN, _AMBER = (3.2, 0.25, 2.2), (0.15, 1.4, 5.5)
_GAP = 1e-3


def lights(
    *,
    radius: float = 0.42,
    ior: float = 1.5,
    power: float = 17.0,
    distance: float = 4.0,
    elevation: float = 38.0,
    subdivisions: int = 6,
    pixels: int = 600,
) -> Scene:
    """Three lights behind a ball of clear glass, an amber one and a green ring.

    Parameters
    ----------
    radius : float
        Of the clear ball, m.
    ior : float
        Index of refraction of all glass.
    power : float
        Of each light, W.
    distance, elevation : float
        Of the lights from the origin, m, and above the floor, degrees.
    subdivisions : int
        Fineness of the balls; each step quadruples their faces, 6 makes 81,920.
    pixels : int
        Width and height of images.
    """
    up = np.radians(elevation)
    emitters = []
    for colour, azimuth in _LIGHTS:
        a = np.radians(azimuth)
        away = np.array([np.cos(a) * np.cos(up), np.sin(a) * np.cos(up), np.sin(up)])
        emitters.append(
            SpotEmitter(
                distance * away, -away, power * np.array(colour), inner_angle=18.0, outer_angle=34.0
            )
        )
    clear = ball((0.0, 0.0, radius + _GAP), radius, subdivisions)
    amber = ball((0.95, 0.15, 0.7 * radius + _GAP), 0.7 * radius, subdivisions)
    tilted = placed(torus(0.30, 0.10, 256, 128), (-0.95, 0.1, 0.40 + _GAP), rotation([1, 0, 0], 90))
    eye, target = np.array([[0.0, -3.2, 2.8], [0.0, -0.42, 0.08]])
    return Scene(
        [
            floor(3.0, 0.7),
            SceneObject(clear, Dielectric(ior), "clear ball", smooth=True),
            SceneObject(amber, Dielectric(ior, absorption=_AMBER), "amber ball", smooth=True),
            SceneObject(tilted, Dielectric(ior, absorption=_GREEN), "green ring", smooth=True),
        ],
        emitters,
        Camera(eye, target, vertical_fov=37.0, width=pixels, height=pixels),
        name="lights",
    )
