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
from .solids import Curve, placed, revolved, sheet

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
# Radius of the bends, dm, on which half of a facet's length is for bending.
_RADIUS = 0.2
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
        parts of it have so many in proportion, and all are finer where it bends. Normals are those
        of the exact surface.
    pixels : int
        Width and height of images.
    """
    profile, normals = _glass_profile(rings)
    glass = placed(revolved(profile, sections, normals), (0.0, 0.0, _GAP))
    liquid = placed(_liquid(fill, agitation, sections, rings), (0.0, 0.0, _GAP))
    eye, target = np.array([[0.50, -2.9, 2.1], [0.10, -0.33, 0.28]])
    return Scene(
        [
            SceneObject(sheet((-6, -6, 0), (12, 0, 0), (0, 12, 0)), Diffuse(_TABLE), "table"),
            SceneObject(glass, Dielectric(glass_ior, priority=1), "glass", smooth=True),
            SceneObject(liquid, Dielectric(liquid_ior, absorption=_COGNAC), "cognac", smooth=True),
        ],
        [PointEmitter((-1.5, 3.0, 2.0), power), EnvironmentEmitter(_SURROUNDINGS)],
        Camera(eye, target, vertical_fov=28.0, width=pixels, height=pixels),
        name="cognac",
    )


def _glass_profile(rings: int) -> tuple[Floats, Floats]:
    """Points (n, 2) of foot, stem and bowl, rim, and the inside of the bowl, and their normals.

    The parts share tangents where they join: no crease, whose width would be that of a facet.
    """
    outside, inside = Curve.through(_OUTSIDE), _inside()
    up, down = outside.tangents([0.0, outside.length])
    foot = Curve.through(_FOOT, (1.0, 0.0), up)
    rim = Curve.through(_RIM, down, inside.tangents([0.0])[0])
    parts = [(np.array([[0.0, _FOOT[0][1]]]), np.array([[0.0, -1.0]]))]
    for part, share in ((foot, 0.125), (outside, 1.0), (rim, 0.125), (inside, 0.75)):
        points, normals = part.even(max(int(share * rings), 4), _RADIUS)
        # The next part begins with the last point.
        parts.append((points[:-1], normals[:-1]))
    parts.append((np.array([_INSIDE[-1]]), np.array([[0.0, 1.0]])))
    points, normals = (np.concatenate(each) for each in zip(*parts, strict=True))
    return points, normals


def _inside() -> Curve:
    """The inside of the bowl, level on the axis."""
    return Curve.through(_INSIDE, end=(-1.0, 0.0))


def _liquid(fill: float, agitation: float, sections: int, rings: int) -> trimesh.Trimesh:
    """The liquid: what is below its waves, out to within the glass."""
    wall, outwards = (each[::-1] for each in _inside().even(rings, _RADIUS))
    wall = wall - _OVERLAP * outwards
    # Below all troughs, so that the edge of the surface does not fold over the side.
    below = wall[:, 1] < fill - agitation
    reach = np.interp(fill, wall[:, 1], wall[:, 0])
    top = np.linspace(reach, 0.0, rings + 1)
    profile = np.concatenate([wall[below], np.column_stack([top, np.full(len(top), fill)])])
    normals = np.concatenate([-outwards[below], np.tile([0.0, 1.0], (len(top), 1))])
    # On the axis, to the bit.
    profile[0, 0], normals[0] = 0.0, (0.0, -1.0)
    body = revolved(profile, sections, normals)
    vertices, normal = np.array(body.vertices), np.array(body.vertex_normals)
    surface = vertices[:, 2] == fill
    vertices[surface, 2], normal[surface] = _waves(vertices[surface], agitation)
    # The edge of the surface is rounded: it lies within the glass, which rules there.
    side, edge = ((below.sum() + i) * sections + np.arange(sections) for i in (-2, -1))
    normal[edge] = (normal[edge] + normal[side]) / np.linalg.norm(
        normal[edge] + normal[side], axis=1, keepdims=True
    )
    return make_mesh(vertices, body.faces, normal)


def _waves(points: Floats, agitation: float) -> tuple[Floats, Floats]:
    """Heights (n,) of the waves on points (n, 3) of the surface at rest, and normals (n, 3)."""
    numbers, height = 2 * np.pi * _WAVES[:, :2], agitation * _WAVES[:, 2]
    phase = product(points[:, :2], numbers.T) + _WAVES[:, 3]
    slope = product(np.cos(phase) * height, numbers)
    normal = np.column_stack([-slope, np.ones(len(points))])
    return points[:, 2] + np.sin(phase) @ height, normal / np.linalg.norm(
        normal, axis=1, keepdims=True
    )
