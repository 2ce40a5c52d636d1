"""Collimated light through a dielectric with a wavy top onto a plane, after SJ13 Fig. 4."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._util.validation import Floats
from ..scene.camera import Camera
from ..scene.emitters import CollimatedEmitter
from ..scene.materials import Dielectric
from ..scene.scene import Scene, SceneObject
from .light import from_around
from .meshes import floor, grid_faces, join

if TYPE_CHECKING:
    import trimesh

# Waves per side of the slab along x and y, share of the amplitude, phase.
_WAVES = np.array(
    [
        [2.3, 0.9, 0.35, 0.0],
        [-1.4, 2.6, 0.30, 1.3],
        [3.7, -2.2, 0.20, 2.9],
        [0.6, 4.9, 0.15, 4.4],
    ]
)


def ripples(
    *,
    half_size: float = 1.0,
    thickness: float = 0.2,
    amplitude: float = 0.06,
    gap: float = 1.2,
    ior: float = 1.33,
    irradiance: float = 1.5,
    surroundings: ArrayLike = 0.0,
    resolution: int = 400,
    pixels: int = 600,
) -> Scene:
    """Wavy slab over the floor, lit from straight above, seen from below the slab.

    Parameters
    ----------
    half_size, thickness : float
        Half the side of the square slab, and its mean thickness, m.
    amplitude : float
        Of all waves together, m.
    gap : float
        Between slab and floor, m.
    ior : float
        Index of refraction of the slab.
    irradiance : float
        Of the light, W/m².
    surroundings : float or (3,)
        Radiance from all around, W/(m² sr); none by default.
    resolution : int
        Cells along each side of the wavy top.
    pixels : int
        Width and height of images.
    """
    if amplitude >= thickness:
        raise ValueError(
            f"amplitude should be less than thickness, {thickness}, but is {amplitude}"
        )
    slab = _wavy_slab(half_size, gap, gap + thickness, amplitude, resolution)
    eye = np.array([0.0, -2.1 * half_size, 0.9 * gap])
    return Scene(
        [
            floor(20.0 * half_size),
            SceneObject(slab, Dielectric(ior), "slab", smooth=True),
        ],
        [CollimatedEmitter((0.0, 0.0, -1.0), irradiance), *from_around(surroundings)],
        Camera(eye, (0.0, -0.1 * half_size, 0.0), vertical_fov=42.0, width=pixels, height=pixels),
        name="ripples",
    )


def _wavy_slab(
    half_size: float, bottom: float, top: float, amplitude: float, resolution: int
) -> trimesh.Trimesh:
    """Closed slab whose faces share no vertices, so that only its top is curved."""
    side = np.linspace(-half_size, half_size, resolution + 1)
    x, y = (a.ravel() for a in np.meshgrid(side, side))
    height, slope_x, slope_y = _waves(x, y, np.pi / half_size, amplitude)
    surface = np.column_stack([x, y, top + height])
    normals = np.column_stack([-slope_x, -slope_y, np.ones_like(x)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    faces = grid_faces(resolution + 1, resolution + 1)
    base = surface * [1, 1, 0] + [0, 0, bottom]
    flat = np.tile([0.0, 0.0, -1.0], (len(x), 1))
    rim = surface.reshape(resolution + 1, resolution + 1, 3)
    walls = [
        _wall(rim[0], bottom, (0.0, -1.0, 0.0)),
        _wall(rim[:, -1], bottom, (1.0, 0.0, 0.0)),
        _wall(rim[-1, ::-1], bottom, (0.0, 1.0, 0.0)),
        _wall(rim[::-1, 0], bottom, (-1.0, 0.0, 0.0)),
    ]
    return join([(surface, normals, faces), (base, flat, faces[:, ::-1]), *walls])


def _wall(
    edge: Floats, bottom: float, normal: tuple[float, float, float]
) -> tuple[Floats, Floats, NDArray[np.intp]]:
    """Wall below an edge of the top, whose right side is outside."""
    foot = edge * [1, 1, 0] + [0, 0, bottom]
    vertices = np.concatenate([foot, edge])
    return vertices, np.tile(normal, (len(vertices), 1)), grid_faces(2, len(edge))


def _waves(
    x: Floats, y: Floats, wavenumber: float, amplitude: float
) -> tuple[Floats, Floats, Floats]:
    """Height and slopes along x and y of a sum of plane waves."""
    kx, ky = wavenumber * _WAVES[:, :2].T
    share, shift = _WAVES[:, 2:].T
    phase = np.multiply.outer(x, kx) + np.multiply.outer(y, ky) + shift
    height, slope = amplitude * share * np.sin(phase), amplitude * share * np.cos(phase)
    return height.sum(axis=1), (slope * kx).sum(axis=1), (slope * ky).sum(axis=1)
