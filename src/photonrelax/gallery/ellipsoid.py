"""An ellipsoid of coloured glass and the caustic that it throws, after Lehmer11."""

from __future__ import annotations

import numpy as np

from ..scene.camera import Camera
from ..scene.emitters import PointEmitter
from ..scene.environment import EnvironmentEmitter
from ..scene.materials import Dielectric, Diffuse
from ..scene.scene import Scene, SceneObject
from .meshes import make_mesh
from .solids import ball, placed, rotation, sheet

_ABSORPTION = (0.08, 2.4, 1.5)
_PAPER = (0.80, 0.76, 0.68)
_SURROUNDINGS = (0.13, 0.14, 0.16)
_GAP = 1e-3


def ellipsoid(
    *,
    half_axes: tuple[float, float, float] = (0.75, 0.42, 0.36),
    turn: float = 28.0,
    tilt: float = 12.0,
    ior: float = 1.52,
    power: float = 190.0,
    subdivisions: int = 7,
    pixels: int = 600,
) -> Scene:
    """Rose ellipsoid that lies on the floor before a wall, lit by a point from behind.

    Parameters
    ----------
    half_axes : three floats
        Of the ellipsoid, m.
    turn, tilt : float
        About the vertical, and out of the horizontal, degrees.
    ior : float
        Index of refraction of the glass.
    power : float
        Of the light, W.
    subdivisions : int
        Fineness of the ellipsoid; each step quadruples its faces, 7 makes 327,680.
    pixels : int
        Width and height of images.
    """
    sphere = ball((0.0, 0.0, 0.0), 1.0, subdivisions)
    axes = np.asarray(half_axes)
    normals = np.asarray(sphere.vertices) / axes
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    lying = make_mesh(sphere.vertices * axes, sphere.faces, normals)
    matrix = rotation([0, 0, 1], turn) @ rotation([0, 1, 0], tilt)
    height = float(np.linalg.norm(matrix[2] * axes))
    body = placed(lying, (0.0, 0.0, height + _GAP), matrix)
    eye, target = np.array([[0.25, -3.3, 2.6], [0.20, -0.40, 0.10]])
    return Scene(
        [
            SceneObject(sheet((-4, -4, 0), (8, 0, 0), (0, 8, 0)), Diffuse(_PAPER), "floor"),
            SceneObject(body, Dielectric(ior, absorption=_ABSORPTION), "ellipsoid", smooth=True),
        ],
        [PointEmitter((-0.9, 2.4, 2.2), power), EnvironmentEmitter(_SURROUNDINGS)],
        Camera(eye, target, vertical_fov=32.0, width=pixels, height=pixels),
        name="ellipsoid",
    )
