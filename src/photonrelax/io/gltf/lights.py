"""Lights of glTF files, KHR_lights_punctual, as emitters.

The standard has candela and lux. Blender's exporter writes one of three, which nothing in a file
tells apart: that (its default, of radiant watts at 683 lm/W), ``compat``, W/sr and W/m²; or
``raw``, the watts of its own lamps, all around, and W/m².
"""

from __future__ import annotations

import math

import numpy as np

from ..._util.validation import Floats
from ...scene.emitters import CollimatedEmitter, Emitter, PointEmitter, SpotEmitter
from ..json_entry import JsonEntry
from ..substitutions import Substitutions
from .file import GltfFile
from .nodes import PlacedNode

EXTENSION = "KHR_lights_punctual"
# lm/W, at 555 nm: that of Blender, and of glTF where W are asked for.
LUMENS_PER_WATT = 683.0
_FULL_SPHERE = 4.0 * math.pi


def emitters_of(
    file: GltfFile, nodes: list[PlacedNode], light_units: str, substitutions: Substitutions
) -> list[Emitter]:
    """The emitters of nodes that have lights.

    Raises
    ------
    ValueError
        If a light is not one of the standard.
    """
    lights = file.root.entry("extensions").entry(EXTENSION).entries("lights")
    found = []
    for node in nodes:
        index = node.entry.entry("extensions").entry(EXTENSION).index("light", len(lights))
        if index is not None:
            found.append(_emitter(lights[index], node, light_units))
            if "range" in lights[index]:
                substitutions.add(f"light {node.name}", "range", "light that goes on for ever")
    return found


def _emitter(light: JsonEntry, node: PlacedNode, light_units: str) -> Emitter:
    colour = light.numbers("color", (1.0, 1.0, 1.0), low=0.0)
    brightness = colour * light.number("intensity", 1.0, low=0.0)
    kind = light.text("type")
    if kind == "directional":
        watts = LUMENS_PER_WATT if light_units == "standard" else 1.0
        return CollimatedEmitter(-node.axis(2), brightness / watts)
    intensity = _radiant_intensity(brightness, light_units)
    if kind == "point":
        return PointEmitter(node.position, _FULL_SPHERE * intensity)
    if kind != "spot":
        raise light.error("type", "directional, point or spot")
    return _spot(light.entry("spot"), node, intensity)


def _radiant_intensity(brightness: Floats, light_units: str) -> Floats:
    """Radiant intensity, W/sr, of a point, or of a spot on its axis."""
    unit = {"standard": LUMENS_PER_WATT, "compat": 1.0, "raw": _FULL_SPHERE}[light_units]
    return brightness / unit


def _spot(cone: JsonEntry, node: PlacedNode, intensity: Floats) -> SpotEmitter:
    """The spot of an intensity on the axis: its power is that into the cone."""
    inner = cone.number("innerConeAngle", 0.0, 0.0, math.pi / 2.0)
    outer = cone.number("outerConeAngle", math.pi / 4.0, 0.0, math.pi / 2.0)
    if not inner < outer:
        raise cone.error("innerConeAngle", f"below outerConeAngle, {outer:g}")
    power = intensity * spot_solid_angle(inner, outer)
    return SpotEmitter(
        node.position, -node.axis(2), power, math.degrees(inner), math.degrees(outer)
    )


def spot_solid_angle(inner: float, outer: float) -> float:
    """Power into a spot's cone over its intensity on the axis, sr; half angles in rad."""
    cos_inner, cos_outer = np.cos(inner), np.cos(outer)
    return float(2.0 * np.pi * (1.0 - cos_inner + (cos_inner - cos_outer) / 3.0))
