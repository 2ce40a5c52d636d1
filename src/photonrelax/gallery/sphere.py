"""A glass sphere over a plane, in collimated light along the plane's normal."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..scene.camera import Camera
from ..scene.emitters import CollimatedEmitter
from ..scene.materials import Dielectric
from ..scene.scene import Scene, SceneObject
from .light import from_around
from .meshes import floor, make_mesh


def sphere(
    *,
    radius: float = 1.0,
    gap: float = 0.2,
    ior: float = 1.5,
    irradiance: float = 0.8,
    surroundings: ArrayLike = 0.0,
    floor_half_size: float = 20.0,
    subdivisions: int = 7,
    pixels: int = 600,
) -> Scene:
    """Glass sphere over the floor, lit from straight above.

    The caustic is known by one-dimensional quadrature: a bright spot inside a fold, and faint
    rings of light reflected inside the glass, out to infinity.

    Parameters
    ----------
    radius : float
        Of the sphere, m.
    gap : float
        Between the sphere's lowest point and the floor, m.
    ior : float
        Index of refraction of the glass.
    irradiance : float
        Of the light, W/m².
    surroundings : float or (3,)
        Radiance from all around, W/(m² sr); none by default, as the exact irradiance has none.
    floor_half_size : float
        Half the side of the square floor, m.
    subdivisions : int
        Fineness of the mesh; each step quadruples its faces, 7 makes 327,680.
    pixels : int
        Width and height of images.
    """
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    normals = np.asarray(ball.vertices)
    centre = np.array([0.0, 0.0, radius + gap])
    glass = make_mesh(centre + radius * normals, np.asarray(ball.faces), normals)
    eye, target = radius * np.array([[0.0, -5.6, 2.0], [0.0, 0.0, 0.7]])
    return Scene(
        [
            floor(floor_half_size),
            SceneObject(glass, Dielectric(ior), "sphere", smooth=True),
        ],
        [CollimatedEmitter((0.0, 0.0, -1.0), irradiance), *from_around(surroundings)],
        Camera(eye, target, vertical_fov=35.0, width=pixels, height=pixels),
        name="sphere",
    )
