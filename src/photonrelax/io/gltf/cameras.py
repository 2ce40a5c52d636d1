"""Cameras of glTF files."""

from __future__ import annotations

import math
from pathlib import Path

from ..._util.validation import MAX_REPEATS
from ...scene.camera import Camera
from ..json_entry import JsonEntry
from .file import GltfFile
from .nodes import PlacedNode

# Pixels of the height of images; files have no more than the proportions.
_HEIGHT = 600
# Metres from a camera to its target, which nothing but the direction of follows from.
_AHEAD = 1.0


def cameras_of(file: GltfFile, nodes: list[PlacedNode]) -> dict[str, Camera]:
    """The cameras by the names of their nodes."""
    cameras = file.entries("cameras")
    found: dict[str, Camera] = {}
    for node in nodes:
        index = node.entry.index("camera", len(cameras))
        if index is not None:
            found.setdefault(node.name, _camera(cameras[index], node))
    return found


def chosen_camera(path: Path, cameras: dict[str, Camera], name: str | None) -> Camera | None:
    """The camera of a name, by default the first; None where there is none to choose from.

    Raises
    ------
    ValueError
        If none has the name.
    """
    if name is None:
        return next(iter(cameras.values()), None)
    if name not in cameras:
        raise ValueError(
            f"camera should be one of those of {path}, {', '.join(cameras) or 'which has none'}, "
            f"but is {name!r}"
        )
    return cameras[name]


def _camera(entry: JsonEntry, node: PlacedNode) -> Camera:
    position, forward = node.position, -node.axis(2)
    kind = entry.text("type")
    if kind not in ("perspective", "orthographic"):
        raise entry.error("type", "perspective or orthographic")
    lens = entry.entry(kind)
    tiny = math.ulp(0.0)
    height: float | None = None
    fov = 45.0
    if kind == "perspective":
        aspect = lens.number("aspectRatio", 1.0, low=tiny)
        fov = math.degrees(lens.number("yfov", 0.0, tiny, math.pi - 1e-9))
    else:
        half_width, half_height = (abs(lens.number(each, 0.0)) for each in ("xmag", "ymag"))
        if not (half_width > 0.0 and half_height > 0.0):
            raise lens.error("ymag", "half the height of the image, with xmag half its width")
        aspect, height = half_width / half_height, 2.0 * half_height
    width = max(_HEIGHT * min(aspect, MAX_REPEATS / _HEIGHT / 2.0), 1.0)
    return Camera(
        position,
        position + _AHEAD * forward,
        node.axis(1),
        fov,
        round(width),
        _HEIGHT,
        orthographic_height=height,
    )
