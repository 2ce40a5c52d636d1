"""A prism that throws a rainbow on a wall: Newton's dark room."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from .._util.validation import Floats
from ..scene.camera import Camera
from ..scene.dispersion import Dispersion, Sellmeier
from ..scene.emitters import CollimatedEmitter, PointEmitter
from ..scene.materials import Dielectric, Diffuse
from ..scene.scene import Scene, SceneObject
from .meshes import make_mesh
from .solids import sheet

if TYPE_CHECKING:
    import trimesh

DENSE_FLINT = Sellmeier(
    (1.73759695, 0.313747346, 1.89878101), (0.013188707, 0.0623068142, 155.23629)
)
"""N-SF11 of Schott's catalogue: n_d = 1.78472, V_d = 25.68."""

# Above the table, so that the prism shares no face with it, m.
_GAP = 1e-3
# Of the room, m: the way from the shutter to the prism, its width, how far it goes on before and
# behind the prism, and its height.
_LEFT, _WIDTH, _FRONT, _DEPTH, _HEIGHT = 0.35, 1.4, 1.5, 0.6, 0.8
_LAMP = (0.1, -0.9, 1.0)


def spectrum(
    *,
    side: float = 0.05,
    height: float = 0.12,
    ior: float | Dispersion = DENSE_FLINT,
    slit: float = 0.003,
    slope: float = 0.05,
    irradiance: float = 30.0,
    power: float = 4.0,
    pixels: int = 600,
) -> Scene:
    """Sunlight through a slit in a shutter and a prism, whose rainbow falls on the wall behind.

    The prism stands at the origin, turned so that light of the d line passes at the angle of
    minimum deviation, and leaves it along y.

    Parameters
    ----------
    side, height : float
        Of the prism, whose section is an equilateral triangle, m.
    ior : float or Dispersion
        Its index of refraction.
    slit : float
        Width of the slit, m.
    slope : float
        By which the light comes down.
    irradiance : float
        Of the sunlight, on a plane that faces it, W/m².
    power : float
        Of a lamp that lights the room, W.
    pixels : int
        Width and height of images.
    """
    glass = Dielectric(ior)
    deviation = least_deviation(glass.row().ior, slope)
    along = np.array([np.sin(deviation), np.cos(deviation)])
    # Light of the d line enters in the middle of a face, and leaves in that of the next one.
    x, y = side / np.sqrt(12.0) * _unit(-0.5 * deviation - np.pi / 3)
    middle = y - (x + _LEFT) * along[1] / along[0]
    # The light stays above the bottom of the prism, which would mirror it.
    sill = _GAP + slope * (_LEFT / along[0] + 2.0 * side)
    across = (_WIDTH, 0.0, 0.0)
    table = sheet((-_LEFT, -_FRONT, 0.0), across, (0.0, _FRONT + _DEPTH, 0.0))
    wall = sheet((-_LEFT, _DEPTH, 0.0), across, (0.0, 0.0, _HEIGHT))
    eye, target = np.array([[0.17, -0.46, 0.33], [0.0, 0.24, 0.035]])
    return Scene(
        [
            SceneObject(table, Diffuse(0.6), "table"),
            SceneObject(wall, Diffuse(0.8), "wall"),
            *_shutter((middle - 0.5 * slit, middle + 0.5 * slit), (sill, 0.9 * height)),
            SceneObject(_prism(side, height, -0.5 * deviation), glass, "prism"),
        ],
        [CollimatedEmitter((*along, -slope), irradiance), PointEmitter(_LAMP, power)],
        Camera(eye, target, vertical_fov=29.0, width=pixels, height=pixels),
        name="spectrum",
    )


def least_deviation(index: float, slope: float) -> float:
    """Least angle, seen from above, by which a prism of 60° turns light that comes down by a slope.

    Across the edges of the prism light follows Snell's law with an index that is larger by the
    slope (Bravais).
    """
    across = np.sqrt(index**2 + (index**2 - 1.0) * slope**2)
    return float(2.0 * np.arcsin(0.5 * across) - np.pi / 3)


def _prism(side: float, height: float, turn: float) -> trimesh.Trimesh:
    """Upright prism whose edge points to x, turned counter-clockwise by an angle."""
    corners = side / np.sqrt(3.0) * _unit(turn + np.radians([0.0, 120.0, 240.0]))
    bottom, top = (np.insert(corners, 2, z, axis=1) for z in (_GAP, _GAP + height))
    faces = [[0, 2, 1], [3, 4, 5]]
    for i in range(3):
        j = (i + 1) % 3
        faces += [[i, j, 3 + j], [i, 3 + j, 3 + i]]
    return make_mesh(np.concatenate([bottom, top]), np.array(faces))


def _unit(angle: ArrayLike) -> Floats:
    """Unit vectors (…, 2) at angles from the x axis."""
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _shutter(width: tuple[float, float], rise: tuple[float, float]) -> list[SceneObject]:
    """Wall at the left, with a slit between two places along y and two heights."""
    (low, high), (sill, lintel) = width, rise
    parts = {
        "before": ((-_FRONT, low), (0.0, _HEIGHT)),
        "behind": ((high, _DEPTH), (0.0, _HEIGHT)),
        "below": (width, (0.0, sill)),
        "above": (width, (lintel, _HEIGHT)),
    }
    return [
        SceneObject(_panel(*ends), Diffuse(0.5), f"shutter {where} the slit")
        for where, ends in parts.items()
    ]


def _panel(along: tuple[float, float], up: tuple[float, float]) -> trimesh.Trimesh:
    corner: Floats = np.array([-_LEFT, along[0], up[0]])
    return sheet(corner, (0.0, along[1] - along[0], 0.0), (0.0, 0.0, up[1] - up[0]))
