"""A bent strip of metal on the floor, after FPPM Fig. 1: a caustic beside smooth light."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats
from ..scene.camera import Camera
from ..scene.emitters import CollimatedEmitter
from ..scene.materials import Mirror
from ..scene.scene import Scene, SceneObject
from .meshes import floor, grid_faces, join

if TYPE_CHECKING:
    import trimesh


def reflector(
    *,
    length: float = 4.0,
    bend: float = 80.0,
    bend_length: float = 1.4,
    height: float = 0.9,
    thickness: float = 0.04,
    gap: float = 1e-3,
    elevation: float = 26.0,
    reflectance: float = 0.95,
    irradiance: float = 1.6,
    resolution: int = 1024,
    pixels: int = 600,
) -> Scene:
    """Strip that stands on the floor and opens towards the light, which comes from -x.

    Its middle is bent and makes a caustic; its ends are flat and reflect light of constant
    irradiance, reflectance · irradiance · sin(elevation).

    Parameters
    ----------
    length : float
        Of the strip, along it, m.
    bend : float
        Angle between its ends, degrees.
    bend_length : float
        Of the part between the ends that is bent, m; curvature rises and falls as cos².
    height, thickness : float
        Of the strip, m.
    gap : float
        Between strip and floor, so that they share no face, m.
    elevation : float
        Of the light above the horizon, degrees.
    reflectance : float
        Of the metal.
    irradiance : float
        Of the light, on a plane facing it, W/m².
    resolution : int
        Facets along the strip; normals are those of the exact curve.
    pixels : int
        Width and height of images.
    """
    if not 0.0 < bend_length < length:
        raise ValueError(f"bend_length should lie between 0 and length, but is {bend_length}")
    strip = _strip(length, np.radians(bend), bend_length, resolution)
    metal = _wall(*strip, thickness, (gap, gap + height))
    down = np.radians(elevation)
    eye, target = length / 4.0 * np.array([[-2.9, 0.0, 3.6], [-0.75, 0.0, 0.0]])
    return Scene(
        [floor(20.0 * length), SceneObject(metal, Mirror(reflectance), "strip", smooth=True)],
        [CollimatedEmitter((np.cos(down), 0.0, -np.sin(down)), irradiance)],
        Camera(eye, target, vertical_fov=36.0, width=pixels, height=pixels),
        name="reflector",
    )


def _strip(
    length: float, bend: float, bend_length: float, resolution: int
) -> tuple[Floats, Floats]:
    """Curve in the plane of the floor, its middle at the origin, and unit normals (n, 2)."""
    along = np.linspace(-0.5, 0.5, resolution + 1) * length
    inner = np.clip(along / bend_length, -0.5, 0.5)
    # The integral of curvature, which goes as cos².
    heading = np.pi / 2 + bend * (inner + np.sin(2 * np.pi * inner) / (2 * np.pi))
    tangent = np.column_stack([np.cos(heading), np.sin(heading)])
    between = 0.5 * (tangent[1:] + tangent[:-1])
    steps = (length / resolution) * between / np.linalg.norm(between, axis=1, keepdims=True)
    points = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    points -= points[resolution // 2]
    return points, np.column_stack([-tangent[:, 1], tangent[:, 0]])


def _wall(
    curve: Floats, normal: Floats, thickness: float, heights: tuple[float, float]
) -> trimesh.Trimesh:
    """Closed wall over a curve, of bands that share no vertices.

    Its ends are chamfered, so that only the front is lit.
    """
    tangent = np.column_stack([normal[:, 1], -normal[:, 0]])
    chamfer = np.linspace(-1.0, 1.0, len(curve))[:, np.newaxis] * tangent
    front, back = curve, curve - thickness * (normal + chamfer)
    low, high = heights
    flat = np.zeros((len(curve), 1))
    outwards = np.hstack([normal, flat])
    up = np.tile([0.0, 0.0, 1.0], (len(curve), 1))
    sides = [
        _band(_at(front, high), _at(front, low), outwards),
        _band(_at(back, low), _at(back, high), -outwards),
        _band(_at(back, high), _at(front, high), up),
        _band(_at(front, low), _at(back, low), -up),
    ]
    for end, sign in ((0, -1.0), (-1, 1.0)):
        corners = np.stack([back[end], front[end]])[:: int(sign)]
        aside = np.append(sign * tangent[end] - normal[end], 0.0) / np.sqrt(2.0)
        sides.append(_band(_at(corners, low), _at(corners, high), np.tile(aside, (2, 1))))
    return join(sides)


def _at(points: Floats, height: float) -> Floats:
    return np.column_stack([points, np.full(len(points), height)])


def _band(first: Floats, second: Floats, normals: Floats) -> tuple[Floats, Floats, NDArray]:
    """Surface between two curves, whose normal is (direction of curve) × (across)."""
    return np.concatenate([first, second]), np.tile(normals, (2, 1)), grid_faces(2, len(first))
