"""Meshes of Mitsuba 3 shapes: files and primitives."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._util.validation import Floats
from ..mesh_file import read_ply, read_stl
from ..obj import read_obj
from ..parts import Part
from ..sources import path_beside
from ..substitutions import Substitutions
from .nodes import Plugin

if TYPE_CHECKING:
    import trimesh

_SUBDIVISIONS, _SIDES = 5, 128
# Degrees: files without normals are smooth all over, unless `face_normals` is set.
_ALL_SMOOTH, _CREASE = 180.0, 30.0


def mesh_of(shape: Plugin, scene_path: Path) -> tuple[trimesh.Trimesh, bool | float, Floats | None]:
    """Mesh of a shape in the world, the ``smooth`` of its object and texture coordinates.

    Those (v, 2) are of rectangles and files that have them, v down as Mitsuba has it; else None.

    Raises
    ------
    OSError
        If its file cannot be read.
    ValueError
        If that is damaged or leads out of the folder of the scene, or the shape is not known.
    """
    to_world, uv = shape.transform(), None
    if shape.kind in _PRIMITIVES:
        mesh = _PRIMITIVES[shape.kind](shape)
        smooth: bool | float = _CREASE if shape.kind in ("sphere", "cylinder") else False
        if shape.kind == "rectangle":
            uv = 0.5 * (1.0 + np.asarray(mesh.vertices)[:, :2])
    elif shape.kind in ("obj", "ply", "stl"):
        name = shape.text("filename", "")
        path = path_beside(scene_path, name, f"{shape.label}: filename")
        try:
            mesh, smooth, uv = _joined(_READERS[shape.kind](path, _has_bitmap(shape)))
        except OSError as error:
            raise type(error)(f"{scene_path}, {shape.label}: {error}") from None
    else:
        raise ValueError(f"{shape.label}: a shape of type {shape.kind!r} is not read")
    if uv is not None and shape.flag("flip_tex_coords", shape.kind == "obj"):
        uv = uv * [1.0, -1.0] + [0.0, 1.0]
    mesh.apply_transform(to_world)
    if shape.flag("flip_normals"):
        mesh.invert()
    return mesh, False if shape.flag("face_normals") else smooth, uv


def _has_bitmap(plugin: Plugin) -> bool:
    children = plugin.children.values()
    return any(child.kind == "bitmap" or _has_bitmap(child) for child in children)


def _joined(parts: list[Part]) -> tuple[trimesh.Trimesh, bool | float, Floats | None]:
    """One mesh of parts whose materials do not count, and texture coordinates if all have them."""
    import trimesh

    uvs = [part.uv for part in parts if part.uv is not None]
    uv = np.concatenate(uvs) if len(uvs) == len(parts) else None
    meshes = [part.mesh(np.eye(3)) for part in parts]
    if len(meshes) == 1 and parts[0].normals is not None:
        return meshes[0], True, uv
    joined: Any = trimesh.util.concatenate(meshes) if len(meshes) > 1 else meshes[0]
    return joined, _ALL_SMOOTH, uv


def _sphere(shape: Plugin) -> trimesh.Trimesh:
    import trimesh

    mesh = trimesh.creation.icosphere(_SUBDIVISIONS, shape.number("radius", 1.0))
    mesh.apply_translation(shape.vector("center", (0.0, 0.0, 0.0)))
    return mesh


def _rectangle(shape: Plugin) -> trimesh.Trimesh:
    import trimesh

    corners = [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def _cube(shape: Plugin) -> trimesh.Trimesh:
    import trimesh

    return trimesh.creation.box((2.0, 2.0, 2.0))


def _disk(shape: Plugin) -> trimesh.Trimesh:
    from ...scene.shapes import Disk

    return Disk((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 1.0).mesh()


def _cylinder(shape: Plugin) -> trimesh.Trimesh:
    """Open cylinder, its normals outwards."""
    import trimesh

    start = shape.vector("p0", (0.0, 0.0, 0.0))
    axis = shape.vector("p1", (0.0, 0.0, 1.0)) - start
    radius = shape.number("radius", 1.0)
    angle = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    u, v = _across(axis)
    rim = start + radius * (np.outer(np.cos(angle), u) + np.outer(np.sin(angle), v))
    i = np.arange(_SIDES)
    j = np.roll(i, -1)
    faces = np.concatenate(
        [np.column_stack([i, j, j + _SIDES]), np.column_stack([i, j + _SIDES, i + _SIDES])]
    )
    return trimesh.Trimesh(np.concatenate([rim, rim + axis]), faces, process=False)


def _across(axis: Floats) -> tuple[Floats, Floats]:
    """Unit vectors u, v with u × v along an axis."""
    length = np.linalg.norm(axis)
    if not length > 0.0:
        raise ValueError("p1 of a cylinder should differ from p0")
    w = axis / length
    u = np.cross(np.eye(3)[np.abs(w).argmin()], w)
    u /= np.linalg.norm(u)
    return u, np.cross(w, u)


# Materials of files do not count.
_READERS: dict[str, Callable[[Path, bool], list[Part]]] = {
    "obj": lambda path, uv: read_obj(path, Substitutions(), with_materials=False, with_uv=uv),
    "ply": lambda path, _: read_ply(path, Substitutions()),
    "stl": lambda path, _: read_stl(path, Substitutions()),
}
_PRIMITIVES: dict[str, Callable[[Plugin], trimesh.Trimesh]] = {
    "sphere": _sphere,
    "rectangle": _rectangle,
    "cube": _cube,
    "disk": _disk,
    "cylinder": _cylinder,
}
