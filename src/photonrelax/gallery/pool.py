"""A swimming pool in the sun: gravity–capillary waves over a light blue floor.

After SSO08 Fig. 7, whose caustics cross from the floor to the walls, and the water of Lehmer11.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .._util.products import product
from .._util.validation import Floats
from ..scene.camera import Camera
from ..scene.emitters import CollimatedEmitter
from ..scene.environment import EnvironmentEmitter
from ..scene.materials import Dielectric, Diffuse
from ..scene.scene import Scene, SceneObject
from .meshes import grid_faces, join, make_mesh
from .solids import ball

if TYPE_CHECKING:
    import trimesh

# Gravity, m/s², and surface tension over density of water, m³/s².
_GRAVITY, _TENSION = 9.81, 7.28e-5
# Lengths of the waves, m; their spread about the direction of the wind, degrees; the power of
# their length that slopes grow with.
_SHORTEST, _LONGEST, _SPREAD, _GROWTH = 0.18, 1.2, 90.0, 0.2
# Steps of a sequence that fills the unit cube evenly (Roberts).
_STEPS = 1.2207440846 ** -np.arange(1.0, 4.0)
_TILES, _BALL = (0.36, 0.68, 0.82), (0.95, 0.10, 0.04)
_STONE = (0.60, 0.46, 0.33)
_WATER = (0.16, 0.03, 0.02)
_SKY = (0.10, 0.16, 0.26)
# How far the body of water reaches into walls and floor, over its size.
_OVERLAP = 0.01


def pool(
    *,
    time: float = 0.0,
    size: float = 4.0,
    depth: float = 1.2,
    freeboard: float = 0.12,
    waves: int = 40,
    slope: float = 0.10,
    wind: float = 35.0,
    seed: int = 0,
    irradiance: float = 5.0,
    resolution: int = 256,
    pixels: int = 600,
) -> Scene:
    """A corner of a square pool, seen from above the water.

    Parameters
    ----------
    time : float
        At which the moving water is shown, s.
    size, depth : float
        Side of the pool, and depth of the water at rest, m.
    freeboard : float
        From the water at rest up to the rim, m.
    waves : int
        Plane waves that make up the water's surface.
    slope : float
        Root of the mean squared slope of the surface.
    wind : float
        Direction in which most waves travel, degrees from +x.
    seed : int
        Of the lengths, directions and phases of the waves.
    irradiance : float
        Of the sun, on a plane facing it, W/m².
    resolution : int
        Cells along each side of the surface; 256 makes 2¹⁷ triangles.
    pixels : int
        Width and height of images.
    """
    water = _Waves.drawn(waves, slope, wind, seed)
    body = _body(water, size, depth, time, resolution)
    eye, target = np.array([[-0.55, -0.85, 1.45], [1.13, 1.20, -0.52]])
    return Scene(
        [
            SceneObject(_basin(size, depth, freeboard), Diffuse(_TILES), "basin"),
            SceneObject(_ground(size, depth, freeboard), Diffuse(_STONE), "ground"),
            SceneObject(_ball(size, depth), Diffuse(_BALL), "ball", smooth=True),
            SceneObject(body, Dielectric(1.33, absorption=_WATER), "water", smooth=True),
        ],
        [
            CollimatedEmitter((0.95, 0.62, -1.0), irradiance),
            EnvironmentEmitter(_SKY),
        ],
        Camera(eye, target, vertical_fov=42.0, width=pixels, height=pixels),
        name="pool",
    )


class _Waves(NamedTuple):
    """Plane waves: wave vectors (n, 2), 1/m, heights (n,), m, and phases (n,)."""

    vector: Floats
    height: Floats
    phase: Floats

    @classmethod
    def drawn(cls, n: int, slope: float, wind: float, seed: int) -> _Waves:
        length, aside, phase = ((np.arange(n)[:, np.newaxis] + 97 * seed + 0.5) * _STEPS % 1.0).T
        length = _SHORTEST * (_LONGEST / _SHORTEST) ** length
        azimuth = np.radians(wind + _SPREAD * (2.0 * aside - 1.0))
        number = 2 * np.pi / length
        steepness = length**_GROWTH
        steepness *= slope / np.sqrt(0.5 * np.square(steepness).sum())
        vector = number[:, np.newaxis] * np.column_stack([np.cos(azimuth), np.sin(azimuth)])
        return cls(vector, steepness / number, 2 * np.pi * phase)

    def at(self, xy: Floats, time: float, depth: float) -> tuple[Floats, Floats]:
        """Heights (m,) and gradients (m, 2) at points (m, 2) of water of a depth."""
        number = np.linalg.norm(self.vector, axis=1)
        stiffness = _GRAVITY * number + _TENSION * number**3
        frequency = np.sqrt(stiffness * np.tanh(number * depth))
        phase = product(xy, self.vector.T) + (self.phase - frequency * time)
        return np.sin(phase) @ self.height, product(
            np.cos(phase), self.height[:, None] * self.vector
        )


def _body(
    waves: _Waves, size: float, depth: float, time: float, resolution: int
) -> trimesh.Trimesh:
    """The water, a closed body whose sides share no vertices with its surface."""
    half, bottom = (0.5 + _OVERLAP) * size, depth * (1.0 + _OVERLAP)
    side = np.linspace(-half, half, resolution + 1)
    xy = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    height, gradient = waves.at(xy, time, depth)
    surface = np.column_stack([xy, height])
    normal = np.column_stack([-gradient, np.ones(len(xy))])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    rim = surface.reshape(resolution + 1, resolution + 1, 3)
    edge = np.concatenate([rim[0, :-1], rim[:-1, -1], rim[-1, :0:-1], rim[::-1, 0]])
    foot = edge * [1, 1, 0] - [0, 0, bottom]
    n = len(edge)
    hull = np.concatenate([foot, edge, [[0.0, 0.0, -bottom]]])
    around = np.arange(n - 1)
    below = np.column_stack([np.full(n - 1, 2 * n), around + 1, around])
    outwards = hull - [0.0, 0.0, -0.5 * bottom]
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    return join(
        [
            (surface, normal, grid_faces(resolution + 1, resolution + 1)),
            (hull, outwards, np.concatenate([grid_faces(2, n), below])),
        ]
    )


def _basin(size: float, depth: float, freeboard: float) -> trimesh.Trimesh:
    """Floor and four walls, whose normals point into the pool."""
    s = 0.5 * size
    square = np.array([[-s, -s], [s, -s], [s, s], [-s, s]])
    levels = [np.full((4, 1), -depth), np.full((4, 1), freeboard)]
    corners = np.concatenate([np.hstack([square, level]) for level in levels])
    walls = [
        face
        for i, j in ((0, 1), (1, 2), (2, 3), (3, 0))
        for face in ((i, i + 4, j), (j, i + 4, j + 4))
    ]
    return make_mesh(corners, np.array([(0, 1, 2), (0, 2, 3), *walls]))


def _ball(size: float, depth: float) -> trimesh.Trimesh:
    """Ball on the floor, a millimetre above it."""
    radius = 0.05 * size
    return ball((0.22 * size, 0.19 * size, radius + 1e-3 - depth), radius, 5)


def _ground(size: float, depth: float, height: float, width: float = 0.6) -> trimesh.Trimesh:
    """Deck around the pool, a rim of some width, m, and the earth's outside below it.

    That keeps light of the surroundings from the underside of the pool.
    """
    inner = 0.5 * size * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    outer = (1.0 + 2.0 * width / size) * inner
    levels = (height, height, -1.1 * depth)
    corners = [
        np.column_stack([square, np.full(4, level)])
        for square, level in zip((inner, outer, outer), levels, strict=True)
    ]
    sides = [
        face
        for first in (0, 4)
        for i, j in ((0, 1), (1, 2), (2, 3), (3, 0))
        for face in (
            (first + i, first + i + 4, first + j),
            (first + j, first + i + 4, first + j + 4),
        )
    ]
    return make_mesh(np.concatenate(corners), np.array([*sides, (8, 10, 9), (8, 11, 10)]))
