"""Mitsuba 3 scenes, of what photonrelax models."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..._util.validation import Floats, positive
from ...scene.area_emitter import AreaEmitter
from ...scene.camera import Camera
from ...scene.emitters import CollimatedEmitter, Emitter, PointEmitter, SpotEmitter
from ...scene.environment import EnvironmentEmitter
from ...scene.materials import Diffuse
from ...scene.scene import Scene, SceneObject
from ..gltf.cameras import chosen_camera
from ..gltf.lights import spot_solid_angle
from ..options import LoadOptions
from ..sources import read_whole
from ..substitutions import Substitutions
from .materials import material_of
from .nodes import Plugin, parse_dict, parse_xml
from .shapes import mesh_of
from .textures import BitmapReader

# Mitsuba's own size of a film.
_WIDTH, _HEIGHT = 768.0, 576.0
# Height of the film of 50 mm, and its width, of which the diagonal is that of 35 mm film.
_DIAGONAL = 43.266615305567875


def load_mitsuba(path: Path, options: LoadOptions) -> Scene:
    """Scene of Mitsuba's XML; arguments are the values of its defaults.

    Raises
    ------
    OSError
        If the file, or one that it names, cannot be read.
    ValueError
        If it is damaged, or has shapes, transforms or values that are not read; with ``strict``,
        if it holds what a scene cannot.
    """
    content = read_whole(path)
    try:
        root = parse_xml(content, options.arguments)
        return _scene(root, path, options)
    except (ET.ParseError, ValueError) as error:
        text = str(error)
        raise ValueError(text if str(path) in text else f"{path}: {text}") from None


def load_mitsuba_dict(value: Mapping[str, Any], options: LoadOptions) -> Scene:
    """Scene of a dictionary as ``mitsuba.load_dict`` takes it; files are below this folder."""
    return _scene(parse_dict(value), Path.cwd() / "scene", options)


def _scene(root: Plugin, path: Path, options: LoadOptions) -> Scene:
    substitutions = Substitutions()
    bitmaps = BitmapReader(path, substitutions)
    shapes = _Shapes(path, options, bitmaps)
    for shape in root.all_of("shape"):
        shapes.add(shape)
    emitters = shapes.emitters
    for emitter in root.all_of("emitter"):
        emitters += _emitter(emitter, bitmaps)
    for other in root.all_of("plugin"):
        substitutions.add(other.label, f"type {other.kind!r}", "nothing of it")
    cameras = {
        sensor.identifier or f"sensor {i}": _camera(sensor, substitutions)
        for i, sensor in enumerate(root.all_of("sensor"))
    }
    if not shapes.objects:
        raise ValueError(f"{path} should have a shape that emits no light, but has none")
    if not emitters:
        raise ValueError(f"{path} should have an emitter, but has none")
    camera = chosen_camera(path, cameras, options.camera)
    substitutions.report(path, options.strict)
    return Scene(shapes.objects, emitters, camera, path.stem)


class _Shapes:
    """Objects, and emitters with a surface, of shapes so far."""

    def __init__(self, path: Path, options: LoadOptions, bitmaps: BitmapReader) -> None:
        self._path, self._maker, self._bitmaps = path, options.maker, bitmaps
        self.objects: list[SceneObject] = []
        self.emitters: list[Emitter] = []

    def add(self, shape: Plugin) -> None:
        """Add a shape; raises ValueError, which names it, if its mesh is none of its material."""
        mesh, smooth, uv = mesh_of(shape, self._path)
        material = material_of(shape.first_of("bsdf"), uv, self._bitmaps)
        lamp = shape.first_of("emitter")
        try:
            if lamp is not None:
                surface = material if isinstance(material, Diffuse) else Diffuse(0.0)
                radiance = lamp.colour("radiance", 1.0)
                self.emitters.append(AreaEmitter(mesh, radiance=radiance, material=surface))
            elif material is not None:
                name = shape.identifier or shape.kind
                self.objects.append(self._maker.make(mesh, material, name, smooth))
        except ValueError as error:
            raise ValueError(f"{self._path}: {shape.label}: {error}") from None


def _emitter(emitter: Plugin, bitmaps: BitmapReader) -> list[Emitter]:
    substitutions = bitmaps.substitutions
    to_world = emitter.transform()
    if emitter.kind == "constant":
        return [EnvironmentEmitter(emitter.colour("radiance", 1.0))]
    if emitter.kind == "envmap":
        return [bitmaps.environment(emitter)]
    if emitter.kind == "directional":
        direction = emitter.vector("direction", tuple(to_world[:3, 2]))
        return [CollimatedEmitter(direction, emitter.colour("irradiance", 1.0))]
    position = emitter.vector("position", tuple(to_world[:3, 3]))
    if emitter.kind == "point":
        return [PointEmitter(position, 4.0 * np.pi * emitter.colour("intensity", 1.0))]
    if emitter.kind == "spot":
        return [_spot(emitter, position, to_world[:3, 2], substitutions)]
    substitutions.add(emitter.label, f"emitter {emitter.kind!r}", "nothing of it")
    return []


def _spot(
    emitter: Plugin, position: Floats, direction: Floats, substitutions: Substitutions
) -> SpotEmitter:
    """Spot of the same intensity on the axis and of the same cones."""
    cutoff = emitter.number("cutoff_angle", 20.0)
    beam = emitter.number("beam_width", 0.75 * cutoff)
    substitutions.add(emitter.label, "falloff linear in the angle", "squared in the cosine")
    on_axis = emitter.colour("intensity", 1.0)
    power = on_axis * spot_solid_angle(*np.radians([beam, cutoff]))
    return SpotEmitter(position, direction, power, beam, cutoff)


def _camera(sensor: Plugin, substitutions: Substitutions) -> Camera:
    to_world = sensor.transform()
    film = sensor.first_of("film") or Plugin("film", "hdrfilm", "")
    width, height = film.number("width", _WIDTH), film.number("height", _HEIGHT)
    if sensor.kind == "thinlens":
        substitutions.add(sensor.label, "aperture_radius", "a pinhole")
    elif sensor.kind not in ("perspective", "orthographic"):
        raise ValueError(f"{sensor.label}: a sensor of type {sensor.kind!r} is not read")
    origin, forward, up = to_world[:3, 3], to_world[:3, 2], to_world[:3, 1]
    orthographic = None
    fov = 45.0
    if sensor.kind == "orthographic":
        orthographic = float(2.0 * np.linalg.norm(to_world[:3, 0]) * height / width)
    else:
        fov = _vertical_fov(sensor, width, height)
    size = int(positive(width, "width")), int(positive(height, "height"))
    return Camera(origin, origin + forward, up, fov, *size, orthographic_height=orthographic)


def _vertical_fov(sensor: Plugin, width: float, height: float) -> float:
    """Vertical field of view, degrees, by the axis that the file's is along."""
    diagonal = float(np.hypot(width, height))
    if "fov" in sensor.values:
        fov = sensor.number("fov", 0.0)
        if not 0.0 < fov < 180.0:
            raise ValueError(f"{sensor.label}: fov should be between 0 and 180, but is {fov}")
        half = np.tan(np.radians(fov) / 2.0)
        axis = sensor.text("fov_axis", "x")
    else:
        focal = sensor.text("focal_length", "50mm").removesuffix("mm")
        try:
            half = _DIAGONAL / 2.0 / float(focal)
        except (ValueError, ZeroDivisionError):
            raise ValueError(
                f"{sensor.label}: focal_length should be in mm, but is {focal!r}"
            ) from None
        axis = "diagonal"
    sides = {"x": width, "y": height, "diagonal": diagonal}
    sides |= {"smaller": min(width, height), "larger": max(width, height)}
    if axis not in sides:
        raise ValueError(f"{sensor.label}: fov_axis should be one of {', '.join(sides)}")
    return float(2.0 * np.degrees(np.arctan(half * height / sides[axis])))
