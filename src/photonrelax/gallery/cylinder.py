"""A translucent cylinder on a plane, after SSO08 Fig. 5."""

from __future__ import annotations

import numpy as np

from ..scene.camera import Camera
from ..scene.emitters import CollimatedEmitter
from ..scene.environment import EnvironmentEmitter
from ..scene.materials import Dielectric, Diffuse
from ..scene.scene import Scene, SceneObject
from .solids import placed, revolved, sheet

_GREEN = (0.9, 0.06, 0.32)
_PAPER = (0.80, 0.77, 0.70)
_SURROUNDINGS = (0.10, 0.11, 0.13)
_GAP = 1e-3
# Edges that turn by more stay sharp, degrees.
_CREASE = 40.0


def cylinder(
    *,
    radius: float = 0.4,
    height: float = 0.75,
    bevel: float = 0.03,
    ior: float = 1.5,
    irradiance: float = 2.8,
    elevation: float = 30.0,
    sections: int = 1024,
    pixels: int = 600,
) -> Scene:
    """Upright cylinder of green glass in slanting light.

    Parameters
    ----------
    radius, height : float
        Of the cylinder, m.
    bevel : float
        Width of its bevelled edges, m.
    ior : float
        Index of refraction of the glass.
    irradiance : float
        Of the light, on a plane facing it, W/m².
    elevation : float
        Of the light above the horizon, degrees.
    sections : int
        Facets around the cylinder.
    pixels : int
        Width and height of images.
    """
    flat, low, high = radius - bevel, bevel, height - bevel
    profile = np.array(
        [(0, 0), (flat, 0), (radius, low), (radius, high), (flat, height), (0, height)]
    )
    glass = placed(revolved(profile, sections), (0.0, 0.0, _GAP))
    down = np.radians(elevation)
    heading = np.array([-0.42, -0.91]) * np.cos(down)
    eye, target = np.array([[0.9, -3.3, 2.6], [-0.17, -0.42, 0.14]])
    return Scene(
        [
            SceneObject(sheet((-6, -6, 0), (12, 0, 0), (0, 12, 0)), Diffuse(_PAPER), "floor"),
            SceneObject(glass, Dielectric(ior, absorption=_GREEN), "cylinder", smooth=_CREASE),
        ],
        [
            CollimatedEmitter((*heading, -np.sin(down)), irradiance),
            EnvironmentEmitter(_SURROUNDINGS),
        ],
        Camera(eye, target, vertical_fov=27.0, width=pixels, height=pixels),
        name="cylinder",
    )
