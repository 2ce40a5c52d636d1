"""Rings and coins of gold and silver on a table, after SJ13 Fig. 9."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..scene.camera import Camera
from ..scene.emitters import PointEmitter
from ..scene.environment import EnvironmentEmitter
from ..scene.materials import Diffuse, Mirror
from ..scene.scene import Scene, SceneObject
from .solids import placed, revolved, rotation, sheet, swept

if TYPE_CHECKING:
    import trimesh

_GOLD, _SILVER, _COPPER = (0.96, 0.70, 0.34), (0.94, 0.93, 0.90), (0.93, 0.55, 0.40)
_TABLE = (0.42, 0.33, 0.27)
_SURROUNDINGS = (0.22, 0.24, 0.27)
_GAP = 1e-3
_CREASE = 50.0
# Rings: radius and height, cm, middle on the table, metal.
_RINGS = (
    (1.05, 0.62, (-0.55, 0.35), _GOLD),
    (0.95, 0.36, (1.35, 0.95), _SILVER),
    (0.78, 0.50, (0.95, -1.15), _GOLD),
)
# Coins: radius, cm, middle on the table, level in a pile, metal.
_COINS = (
    (1.10, (-2.55, 1.15), 0, _SILVER),
    (1.00, (-2.35, 1.05), 1, _COPPER),
    (0.95, (-2.62, -0.95), 0, _GOLD),
    (1.05, (3.30, -0.30), 0, _COPPER),
)
_THICKNESS = 0.16
# That the light comes from, degrees.
_AZIMUTH = 200.0


def rings(
    *,
    power: float = 9500.0,
    elevation: float = 31.0,
    distance: float = 14.0,
    sections: int = 1024,
    pixels: int = 600,
) -> Scene:
    """Wedding rings that lie and stand on a table among coins, lit by a point from one side.

    Lengths are in cm.

    Parameters
    ----------
    power : float
        Of the light, W.
    elevation, distance : float
        Of the light above the table, degrees, and from its middle, cm.
    sections : int
        Facets around a ring or coin.
    pixels : int
        Width and height of images.
    """
    objects = [SceneObject(sheet((-25, -25, 0), (50, 0, 0), (0, 50, 0)), Diffuse(_TABLE), "table")]
    for number, (radius, height, (x, y), metal) in enumerate(_RINGS):
        mesh = placed(_band(radius, height, sections), (x, y, 0.5 * height + _GAP))
        objects.append(SceneObject(mesh, Mirror(metal), f"ring {number}", smooth=_CREASE))
    standing = rotation([0, 0, 1], 38.0) @ rotation([1, 0, 0], 82.0)
    mesh = placed(_band(0.9, 0.4, sections), (0.0, 0.0, 0.0), standing)
    mesh = placed(mesh, (0.55, 2.45, _GAP - mesh.vertices[:, 2].min()))
    objects.append(SceneObject(mesh, Mirror(_SILVER), "standing ring", smooth=_CREASE))
    for number, (radius, (x, y), level, metal) in enumerate(_COINS):
        bottom = (level + 1) * _GAP + level * _THICKNESS
        mesh = placed(_coin(radius, sections), (x, y, bottom))
        objects.append(SceneObject(mesh, Mirror(metal), f"coin {number}", smooth=_CREASE))
    up, azimuth = np.radians(elevation), np.radians(_AZIMUTH)
    light = distance * np.array(
        [np.cos(up) * np.cos(azimuth), np.cos(up) * np.sin(azimuth), np.sin(up)]
    )
    eye, target = np.array([[0.9, -8.0, 9.0], [0.25, 0.55, 0.1]])
    return Scene(
        objects,
        [PointEmitter(light, power), EnvironmentEmitter(_SURROUNDINGS)],
        Camera(eye, target, vertical_fov=27.0, width=pixels, height=pixels),
        name="rings",
    )


def _band(radius: float, height: float, sections: int) -> trimesh.Trimesh:
    """Ring with a flat inside and a domed outside, its middle at the origin."""
    wall = 0.16
    bend = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 33)
    dome = np.column_stack([radius + wall * np.cos(bend) ** 0.6, 0.5 * height * np.sin(bend)])
    inner = np.column_stack([np.full(2, radius - 0.02), 0.46 * height * np.array([1.0, -1.0])])
    return swept(np.concatenate([dome, inner]), sections)


def _coin(radius: float, sections: int) -> trimesh.Trimesh:
    """Coin with a raised rim, its underside at z = 0."""
    t, rim, edge = _THICKNESS, 0.12, 0.025
    profile = [
        *((0.0, 0.0), (radius - edge, 0.0), (radius, edge), (radius, t - edge)),
        *((radius - edge, t), (radius - rim, t), (radius - rim - 0.04, t - 0.04), (0.0, t - 0.04)),
    ]
    return revolved(np.array(profile), sections)
