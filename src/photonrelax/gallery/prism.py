"""A glass prism lit from behind by a strong point light, after SJ13 Fig. 6."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .._util.products import product
from .._util.validation import Floats
from ..scene.camera import Camera
from ..scene.emitters import PointEmitter
from ..scene.materials import Dielectric, Diffuse
from ..scene.scene import Scene, SceneObject
from .meshes import Field, floor, level_set, make_mesh

if TYPE_CHECKING:
    import trimesh

_LIGHT = np.array([-3.0, 0.0, 2.5])
# Angles of the prism, degrees: tilt away from the light, then rotation about the vertical.
_TILT, _ROTATION = 8.0, 15.0
# Directions and phases of the ripples.
_DIRECTIONS = np.array(
    [[-0.36, -0.10, 0.93], [0.37, -0.93, 0.0], [-0.36, 0.09, -0.93], [0.15, 0.15, 0.98]]
)
_PHASES = np.array([2.70, 4.95, 6.18, 2.32])


def prism(
    *,
    inradius: float = 0.4,
    height: float = 1.4,
    bevel: float = 0.03,
    ripple: float = 0.0022,
    ripple_length: float = 0.28,
    ior: float = 1.5,
    power: float = 400.0,
    subdivisions: int = 7,
    pixels: int = 600,
) -> Scene:
    """Upright triangular prism, and a close-up of its caustic on the floor.

    The faces are slightly rippled, so that every path through the glass (two refractions, with
    internal reflections between them) makes a folded sheet of its own on the floor. A screen with a
    window before the prism blocks all other light.

    Parameters
    ----------
    inradius, height : float
        Of the prism, m.
    bevel : float
        Width of the rounded edges between faces, m.
    ripple, ripple_length : float
        Amplitude and wavelength of the ripples, m.
    ior : float
        Index of refraction of the glass.
    power : float
        Of the point light, W.
    subdivisions : int
        Fineness of the mesh; each step quadruples its faces, 7 makes 327,680.
    pixels : int
        Width and height of images.
    """
    field = _rippled_prism(inradius, height, bevel, ripple, 2 * np.pi / ripple_length)
    # Beyond the corners of the triangle, at twice its inradius, and beyond the ends.
    half_axes = np.array([3 * inradius, 3 * inradius, height])
    glass = _placed(level_set(field, half_axes, subdivisions))
    return Scene(
        [
            floor(20.0),
            SceneObject(glass, Dielectric(ior), "prism", smooth=True),
            SceneObject(_screen(glass), Diffuse(0.2), "screen"),
        ],
        [PointEmitter(_LIGHT, power)],
        Camera((2.5, 1.55, 3.2), (1.44, 0.95, 0.0), vertical_fov=31.0, width=pixels, height=pixels),
        name="prism",
    )


def _rippled_prism(
    inradius: float, height: float, bevel: float, ripple: float, wavenumber: float
) -> Field:
    """Field of the prism: smooth maximum of the distances to five planes, plus plane waves."""
    azimuth = 2 * np.pi * np.arange(3) / 3 - np.pi / 6
    sides = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(3)])
    normals = np.vstack([sides, [[0, 0, 1], [0, 0, -1]]])
    offsets = np.array([inradius] * 3 + [height / 2] * 2)
    waves = wavenumber * _DIRECTIONS

    def field(points: Floats) -> tuple[Floats, Floats]:
        distance = product(points, normals.T) - offsets
        nearest = distance.max(axis=1, keepdims=True)
        share = np.exp((distance - nearest) / bevel)
        total = share.sum(axis=1, keepdims=True)
        phase = product(points, waves.T) + _PHASES
        value = nearest[:, 0] + bevel * np.log(total[:, 0]) + ripple * np.sin(phase).sum(axis=1)
        gradient = product(share / total, normals) + product(ripple * np.cos(phase), waves)
        return value, gradient

    return field


def _placed(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Mesh tilted, rotated and moved to 1 mm above the floor."""
    from trimesh.transformations import rotation_matrix

    tilt = rotation_matrix(np.radians(_TILT), [0, 1, 0])
    spin = rotation_matrix(np.radians(_ROTATION), [0, 0, 1])
    rotation = (spin @ tilt)[:3, :3]
    vertices = product(mesh.vertices, rotation.T)
    vertices[:, 2] += 1e-3 - vertices[:, 2].min()
    return make_mesh(vertices, mesh.faces, product(mesh.vertex_normals, rotation.T))


def _screen(glass: trimesh.Trimesh, margin: float = 0.05) -> trimesh.Trimesh:
    """Upright screen with a window, slightly smaller than the glass as seen from the light."""
    x = glass.vertices[:, 0].min() - 0.1
    seen = glass.vertices - _LIGHT
    on_screen = _LIGHT[1:] + seen[:, 1:] * ((x - _LIGHT[0]) / seen[:, :1])
    (left, bottom), (right, top) = on_screen.min(axis=0) + margin, on_screen.max(axis=0) - margin
    outer = [(-4.0, 0.0), (4.0, 0.0), (4.0, 3.0), (-4.0, 3.0)]
    inner = [(left, bottom), (right, bottom), (right, top), (left, top)]
    vertices = np.array([(x, y, z) for y, z in outer + inner])
    faces = [
        f
        for i in range(4)
        for f in ((i, (i + 1) % 4, 4 + i), ((i + 1) % 4, 4 + (i + 1) % 4, 4 + i))
    ]
    return make_mesh(vertices, np.array(faces))
