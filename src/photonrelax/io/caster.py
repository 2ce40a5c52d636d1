"""Scenes of a mesh alone: it stands in parallel light, before a screen."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._util.validation import Floats, check_choice, float_array, positive, unit_vectors
from ..scene.area_emitter import AreaEmitter
from ..scene.camera import Camera
from ..scene.emitters import CollimatedEmitter, Emitter
from ..scene.materials import Dielectric, Diffuse, Material, Mirror, Sensor
from ..scene.scene import Scene, SceneObject
from ..scene.shapes import Rectangle
from .objects import ObjectMaker
from .options import LoadOptions
from .parts import Part
from .substitutions import Substitutions

# Metres.
UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048}
MATERIALS = ("glass", "mirror", "diffuse")
SCREENS = ("diffuse", "sensor")
SCREEN = "screen"
_SCREEN_ALBEDO = 0.8
# Distances and heights of the camera over the size of mesh and screen.
_CAMERA_BACK, _CAMERA_UP = 2.2, 1.1

ReadParts = Callable[[Path, Substitutions], list[Part]]


@dataclass(frozen=True, eq=False)
class CasterSetup:
    """The light and the screen of a mesh.

    Parameters
    ----------
    material : str, optional
        ``glass``, ``mirror`` or ``diffuse``, of all parts; by default that of the file, or glass.
    ior : float
        Index of refraction of glass.
    units : str
        Of lengths in the file and of `distance`: m, cm, mm, um, in, ft.
    direction : (3,)
        Of the light; any length.
    distance : float, optional
        From the last point of the mesh along the light to the screen across it, in `units`; by
        default the diagonal of the mesh.
    rotate : (3,)
        Degrees by which the mesh is turned about x, then y, then z.
    sun_angular_radius : float
        Of the light, degrees; 0 is parallel light.
    irradiance : (3,) or float
        Of the light, W/m².
    screen : str
        ``diffuse``, or ``sensor``: seen by no camera, and nothing that light meets.
    """

    material: str | None = None
    ior: float = 1.5
    units: str = "m"
    direction: ArrayLike = (0.0, 0.0, -1.0)
    distance: float | None = None
    rotate: ArrayLike = (0.0, 0.0, 0.0)
    sun_angular_radius: float = 0.0
    irradiance: ArrayLike = 1.0
    screen: str = SCREENS[0]

    def __post_init__(self) -> None:
        if self.material is not None:
            check_choice(self.material, "material", MATERIALS)
        check_choice(self.units, "units", UNITS)
        check_choice(self.screen, "screen", SCREENS)

    @classmethod
    def of(cls, path: Path, arguments: Mapping[str, Any]) -> CasterSetup:
        """Setup of arguments by name; raises ValueError if one has no meaning."""
        known = [each.name for each in fields(cls)]
        for name in arguments:
            check_choice(name, f"argument of {path}", known)
        return cls(**arguments)


def load_caster(path: Path, options: LoadOptions, read: ReadParts) -> Scene:
    """Scene of the parts of a mesh file.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is damaged, or an argument has no meaning.
    """
    if options.camera is not None:
        raise ValueError(f"{path} has no camera, but camera is {options.camera!r}")
    setup = CasterSetup.of(path, options.arguments)
    substitutions = Substitutions()
    parts = read(path, substitutions)
    objects: list[SceneObject] = []
    emitters: list[Emitter] = []
    for part in parts:
        try:
            _add(objects, emitters, part, setup, options.maker)
        except ValueError as error:
            raise ValueError(f"{path}: {part.name}: {error}") from None
    if not objects:
        raise ValueError(f"{path} should have faces that emit no light, but has none")
    substitutions.report(path, options.strict)
    light = CollimatedEmitter(setup.direction, setup.irradiance, setup.sun_angular_radius)
    screen = _screen(objects, setup)
    camera = _camera(objects, screen)
    return Scene([*objects, screen], [light, *emitters], camera, path.stem)


def _add(
    objects: list[SceneObject],
    emitters: list[Emitter],
    part: Part,
    setup: CasterSetup,
    maker: ObjectMaker,
) -> None:
    mesh = part.mesh(UNITS[setup.units] * rotation(setup.rotate))
    material = _material(part, setup)
    if part.radiance.any() and setup.material is None:
        emitters.append(AreaEmitter(mesh, radiance=part.radiance, material=material))
    else:
        objects.append(maker.make(mesh, material, part.name, smooth=True))


def _material(part: Part, setup: CasterSetup) -> Material:
    if setup.material is None and part.material is not None:
        return part.material
    made: dict[str, Material] = {
        "glass": Dielectric(setup.ior),
        "mirror": Mirror(),
        "diffuse": Diffuse(),
    }
    return made[setup.material or MATERIALS[0]]


def rotation(degrees: ArrayLike) -> Floats:
    """Matrix (3, 3) that turns about x, then y, then z by angles (3,)."""
    x, y, z = np.radians(float_array(degrees, "rotate", (3,)))
    turns = []
    for axis, angle in enumerate((x, y, z)):
        turn = np.eye(3)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn[i, i] = turn[j, j] = np.cos(angle)
        turn[j, i], turn[i, j] = np.sin(angle), -np.sin(angle)
        turns.append(turn)
    whole: Floats = turns[2] @ turns[1] @ turns[0]
    return whole


def _screen(objects: list[SceneObject], setup: CasterSetup) -> SceneObject:
    """Square across the light behind the mesh; light that leaves it within 45° meets it."""
    direction = unit_vectors(setup.direction, "direction", (3,))
    vertices = np.concatenate([np.asarray(item.mesh.vertices) for item in objects])
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = float(np.linalg.norm(high - low))
    distance = size
    if setup.distance is not None:
        distance = UNITS[setup.units] * positive(setup.distance, "distance")
    middle = (low + high) / 2.0
    along = (vertices - middle) @ direction
    half_u, half_v = (size + distance) * _across(direction)
    centre = middle + (along.max() + distance) * direction
    material: Material = Diffuse(_SCREEN_ALBEDO) if setup.screen == SCREENS[0] else Sensor()
    return SceneObject(Rectangle(centre, half_u, half_v).mesh(), material, SCREEN)


def _across(direction: Floats) -> Floats:
    """Two unit vectors (2, 3) across the light: u × v is against it."""
    aside = np.eye(3)[1 if abs(direction[0]) > abs(direction[1]) else 0]
    u = aside - (aside @ direction) * direction
    u /= np.linalg.norm(u)
    return np.array([u, np.cross(u, direction)])


def _camera(objects: list[SceneObject], screen: SceneObject) -> Camera:
    """A look at the mesh and at where its light falls, from its side and the light's."""
    vertices = np.concatenate([np.asarray(item.mesh.vertices) for item in objects])
    corners = np.asarray(screen.mesh.vertices)
    middle, landing = vertices.mean(axis=0), corners.mean(axis=0)
    upstream = middle - landing
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)) + np.linalg.norm(upstream))
    aside = corners[0] - corners[1]
    aside /= np.linalg.norm(aside)
    up = upstream / np.linalg.norm(upstream)
    target = landing + 0.3 * upstream
    origin = target + size * (_CAMERA_BACK * aside + _CAMERA_UP * up)
    return Camera(origin, target, up, 35.0, 800, 600)
