"""Three boxes, a plane and two spheres: colour that bleeds, after Lehmer11."""

from __future__ import annotations

import numpy as np

from ..scene.area_emitter import AreaEmitter
from ..scene.camera import Camera
from ..scene.materials import Dielectric, Diffuse
from ..scene.scene import Scene, SceneObject
from ..scene.shapes import Disk
from .meshes import floor
from .solids import ball, cuboid

# Albedo of the boxes that are the walls, with their middles, on the floor, and sizes, m.
_RED, _BLUE, _WHITE = (0.85, 0.06, 0.04), (0.06, 0.16, 0.80), (0.85, 0.85, 0.85)
_BOXES = {
    "red box": (_RED, (-1.15, -0.7), (0.5, 3.0, 2.2)),
    "blue box": (_BLUE, (1.15, -0.7), (0.5, 3.0, 2.2)),
    "white box": (_WHITE, (0.0, 1.051), (2.8, 0.5, 2.2)),
}
# Above the floor, so that they share no face with it, m.
_GAP = 1e-3


def box(
    *,
    ball_radius: float = 0.36,
    ior: float = 1.5,
    power: float = 40.0,
    lamp_radius: float = 0.15,
    lamp_height: float = 2.6,
    subdivisions: int = 5,
    pixels: int = 600,
) -> Scene:
    """Walls of a red, a blue and a white box around a white ball and one of glass.

    Light comes from a round lamp above.

    Parameters
    ----------
    ball_radius : float
        Of both balls, m.
    ior : float
        Index of refraction of the glass.
    power : float
        Of the lamp, W.
    lamp_radius, lamp_height : float
        Of the lamp, a disk, and its height above the floor, m.
    subdivisions : int
        Fineness of the balls; each step quadruples their faces, 5 makes 20,480.
    pixels : int
        Width and height of images.
    """
    glass, white = (
        ball((x, y, ball_radius + _GAP), ball_radius, subdivisions)
        for x, y in ((0.28, -0.30), (-0.42, 0.22))
    )
    boxes = [
        SceneObject(cuboid((*middle, 0.5 * size[2] + _GAP), size), Diffuse(albedo), name)
        for name, (albedo, middle, size) in _BOXES.items()
    ]
    lamp = Disk((-0.15, 0.35, lamp_height), (0.0, 0.0, -1.0), lamp_radius)
    eye, target = np.array([[0.0, -2.75, 1.45], [0.0, 0.05, 0.50]])
    return Scene(
        [
            floor(3.0),
            *boxes,
            SceneObject(white, Diffuse(0.85), "white ball", smooth=True),
            SceneObject(glass, Dielectric(ior), "glass ball", smooth=True),
        ],
        [AreaEmitter(lamp, power=(power, 0.93 * power, 0.82 * power))],
        Camera(eye, target, vertical_fov=38.0, width=pixels, height=pixels),
        name="box",
    )
