"""A halogen reading lamp above a chair, after SJ13 Fig. 8: every bit of light is caustic."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .._util.validation import Floats
from ..scene.camera import Camera
from ..scene.emitters import PointEmitter
from ..scene.materials import Dielectric, Diffuse, Mirror
from ..scene.scene import Scene, SceneObject
from .meshes import grid_faces, make_mesh
from .solids import cuboid, lathed, placed, revolved, sheet

if TYPE_CHECKING:
    import trimesh

_WOOD, _WALL, _FLOOR = (0.66, 0.36, 0.16), (0.74, 0.72, 0.68), (0.52, 0.44, 0.36)
_HOUSING = (0.10, 0.10, 0.10)
_ALUMINIUM = (0.90, 0.90, 0.88)
_LIGHT = np.array([1.0, 0.84, 0.62])
# Boxes of the chair: middle and size, m; the seat's front is towards -y.
_CHAIR = (
    ((0.0, 0.0, 0.45), (0.46, 0.44, 0.04)),
    *(((x, y, 0.2145), (0.04, 0.04, 0.427)) for x in (-0.2, 0.2) for y in (-0.19, 0.19)),
    *(((x, 0.21, 0.70), (0.04, 0.03, 0.456)) for x in (-0.2, 0.2)),
    *(((0.0, 0.21, z), (0.355, 0.02, 0.09)) for z in (0.62, 0.75, 0.88)),
)


def lamp(
    *,
    focal_length: float = 0.018,
    aperture: float = 0.055,
    defocus: float = 0.004,
    rows: int = 9,
    facets: int = 28,
    ior: float = 1.5,
    power: float = 15.0,
    pixels: int = 600,
) -> Scene:
    """Bulb in a faceted parabolic reflector, behind a glass shield, over a chair by a wall.

    Parameters
    ----------
    focal_length, aperture : float
        Of the paraboloid that the reflector's facets are inscribed in, and its radius, m.
    defocus : float
        From the focus to the bulb, towards the shield, m.
    rows, facets : int
        Rings of flat facets, and their number around the axis.
    ior : float
        Index of refraction of the shield.
    power : float
        Of the bulb, a point, W.
    pixels : int
        Width and height of images.
    """
    head, target = np.array([-0.62, -0.85, 1.62]), np.array([0.0, 0.02, 0.48])
    turn = _towards(target - head)
    depth = aperture**2 / (4.0 * focal_length)

    def in_head(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
        return placed(mesh, head, turn)

    reflector = in_head(_paraboloid(focal_length, aperture, rows, facets))
    shield = in_head(_shield(aperture + 0.004, depth + 0.004))
    housing = in_head(_housing(aperture + 0.006, depth + 0.012))
    bulb = head + turn @ [0.0, 0.0, focal_length + defocus]
    chair = [
        SceneObject(placed(cuboid(middle, size), (0.0, 0.0, 0.0)), Diffuse(_WOOD), f"chair {i}")
        for i, (middle, size) in enumerate(_CHAIR)
    ]
    eye, look_at = np.array([[1.75, -1.95, 1.45], [-0.03, 0.12, 0.48]])
    return Scene(
        [
            SceneObject(sheet((-4, -2.5, 0), (8, 0, 0), (0, 3.3, 0)), Diffuse(_FLOOR), "floor"),
            SceneObject(sheet((-4, 0.8, 0), (8, 0, 0), (0, 0, 2.6)), Diffuse(_WALL), "wall"),
            *chair,
            SceneObject(housing, Diffuse(_HOUSING), "housing"),
            SceneObject(reflector, Mirror(_ALUMINIUM), "reflector"),
            SceneObject(shield, Dielectric(ior), "shield", smooth=40.0),
        ],
        [PointEmitter(bulb, power * _LIGHT)],
        Camera(eye, look_at, vertical_fov=33.0, width=pixels, height=pixels),
        name="lamp",
    )


def _towards(direction: Floats) -> Floats:
    """Rotation that takes the z axis to a direction."""
    z = direction / np.linalg.norm(direction)
    x = np.cross([0.0, 0.0, 1.0], z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _paraboloid(focal_length: float, aperture: float, rows: int, facets: int) -> trimesh.Trimesh:
    """Facets between points of a paraboloid that opens towards +z, staggered from row to row."""
    distance = aperture * np.linspace(0.0, 1.0, rows + 1)[1:]
    azimuth = 2 * np.pi * (np.arange(facets + 1) + 0.5 * np.arange(rows)[:, None]) / facets
    points = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)], axis=-1)
    points *= distance[:, None, None]
    points[..., 2] = (distance**2 / (4.0 * focal_length))[:, None]
    apex = np.arange(facets)
    first = np.column_stack([np.full(facets, rows * (facets + 1)), apex, apex + 1])
    vertices = np.concatenate([points.reshape(-1, 3), np.zeros((1, 3))])
    return make_mesh(vertices, np.concatenate([grid_faces(rows, facets + 1), first]))


def _shield(radius: float, height: float, thickness: float = 0.003) -> trimesh.Trimesh:
    """Disc of glass whose outside is slightly domed."""
    out = np.linspace(0.0, radius, 33)
    dome = height + thickness + 0.004 * (1.0 - (out[::-1] / radius) ** 2)
    profile = np.concatenate(
        [[(0.0, height), (radius, height)], np.column_stack([out[::-1], dome])]
    )
    return revolved(profile, 256)


def _housing(radius: float, depth: float) -> trimesh.Trimesh:
    """Opaque shell behind the reflector, open where the shield is."""
    profile = [(0.0, -0.012), (0.4 * radius, -0.012), (radius, 0.5 * depth), (radius, depth)]
    return lathed(np.array(profile), 64)
