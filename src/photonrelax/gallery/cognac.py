"""A balloon glass of cognac that was shaken, after Jensen's and SJ13 Fig. 1."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .._util.products import product
from .._util.validation import Floats
from ..scene.camera import Camera
from ..scene.emitters import PointEmitter
from ..scene.environment import EnvironmentEmitter
from ..scene.materials import Dielectric, Diffuse
from ..scene.scene import Scene, SceneObject
from .meshes import make_mesh
from .solids import curve, placed, revolved, sheet

if TYPE_CHECKING:
    import trimesh

# Profile of the glass, dm: (distance from the axis, height) from the middle of the foot outwards
# and up to the rim, then down the inside of the bowl.
_FOOT = [(0.34, 0.008), (0.352, 0.014), (0.345, 0.021)]
_OUTSIDE = [
    *((0.345, 0.021), (0.22, 0.032), (0.105, 0.058), (0.060, 0.11), (0.056, 0.19), (0.075, 0.262)),
    *((0.20, 0.325), (0.37, 0.47), (0.455, 0.70), (0.44, 0.92), (0.38, 1.13), (0.335, 1.26)),
]
_INSIDE = [
    *((0.319, 1.26), (0.362, 1.13), (0.421, 0.92), (0.436, 0.70), (0.352, 0.488), (0.19, 0.352)),
    *((0.09, 0.315), (0.0, 0.306)),
]
_RIM = [(0.335, 1.26), (0.332, 1.267), (0.327, 1.2695), (0.322, 1.267), (0.319, 1.26)]
# Plane waves of the liquid's surface: waves per dm along x and y, share, phase.
_WAVES = np.array(
    [
        [1.3, 0.4, 0.34, 0.4],
        [-0.7, 1.9, 0.26, 2.1],
        [2.4, -1.6, 0.17, 4.0],
        [-2.0, -2.5, 0.13, 5.3],
        [3.9, 1.1, 0.10, 1.0],
    ]
)
_COGNAC = (0.25, 1.9, 7.0)
_TABLE = (0.80, 0.70, 0.58)
_SURROUNDINGS = (0.10, 0.095, 0.09)
_GAP = 1e-3
_CREASE = 40.0
# How far the liquid reaches into its glass, dm; the glass rules there.
_OVERLAP = 0.008


def cognac(
    *,
    fill: float = 0.66,
    agitation: float = 0.02,
    glass_ior: float = 1.5,
    liquid_ior: float = 1.36,
    power: float = 330.0,
    sections: int = 512,
    rings: int = 256,
    pixels: int = 600,
) -> Scene:
    """Glass of revolution on a table, lit from behind, with the golden caustic beside it.

    Lengths are in dm.

    Parameters
    ----------
    fill : float
        Height of the liquid at rest above the table, dm.
    agitation : float
        Amplitude of all its waves together, dm.
    glass_ior, liquid_ior : float
        Indices of refraction.
    power : float
        Of the point light, W.
    sections, rings : int
        Facets around the glass and the liquid, and along the outside of the profile; the other
        parts of it have so many in proportion. Normals are means over the faces around a vertex.
    pixels : int
        Width and height of images.
    """
    glass = placed(revolved(_glass_profile(rings), sections), (0.0, 0.0, _GAP))
    liquid = placed(_liquid(fill, agitation, sections, rings), (0.0, 0.0, _GAP))
    eye, target = np.array([[0.50, -2.9, 2.1], [0.10, -0.33, 0.28]])
    return Scene(
        [
            SceneObject(sheet((-6, -6, 0), (12, 0, 0), (0, 12, 0)), Diffuse(_TABLE), "table"),
            SceneObject(glass, Dielectric(glass_ior, priority=1), "glass", smooth=_CREASE),
            SceneObject(
                liquid, Dielectric(liquid_ior, absorption=_COGNAC), "cognac", smooth=_CREASE
            ),
        ],
        [PointEmitter((-1.5, 3.0, 2.0), power), EnvironmentEmitter(_SURROUNDINGS)],
        Camera(eye, target, vertical_fov=28.0, width=pixels, height=pixels),
        name="cognac",
    )


def _glass_profile(rings: int) -> Floats:
    """The outside of foot, stem and bowl, the rim, and the inside of the bowl."""
    parts = [
        np.array([(0.0, 0.008), (0.34, 0.008)]),
        curve(_FOOT, max(rings // 16, 4)),
        curve(_OUTSIDE, rings),
        curve(_RIM, max(rings // 16, 4)),
        curve(_INSIDE, rings // 2),
    ]
    return np.concatenate([parts[0], *(part[1:] for part in parts[1:])])


def _liquid(fill: float, agitation: float, sections: int, rings: int) -> trimesh.Trimesh:
    """The liquid: what is below its waves, out to within the glass."""
    wall = curve(_INSIDE, 4 * rings)[::-1]
    wall = wall + _OVERLAP * _outwards(wall)
    wall[0, 0] = 0.0
    # Below all troughs, so that the edge of the surface does not fold over the side.
    inside = wall[wall[:, 1] < fill - agitation][:: max(8 * rings // 256, 1)]
    reach = np.interp(fill, wall[:, 1], wall[:, 0])
    top = np.linspace(reach, 0.0, rings + 1)
    profile = np.concatenate([inside, np.column_stack([top, np.full(len(top), fill)])])
    body = revolved(profile, sections)
    vertices = np.array(body.vertices)
    surface = vertices[:, 2] == fill
    vertices[surface, 2] += _waves(vertices[surface, :2], agitation)
    return make_mesh(vertices, body.faces)


def _outwards(wall: Floats) -> Floats:
    """Unit normals (n, 2) of a profile from the axis upwards."""
    along = np.gradient(wall, axis=0)
    normal = np.column_stack([along[:, 1], -along[:, 0]])
    unit: Floats = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    return unit


def _waves(xy: Floats, agitation: float) -> Floats:
    phase = product(2 * np.pi * xy, _WAVES[:, :2].T) + _WAVES[:, 3]
    height: Floats = np.sin(phase) @ (agitation * _WAVES[:, 2])
    return height
