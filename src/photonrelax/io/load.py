"""Scenes from files, by the ending of their names."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from .._util.validation import check_choice
from ..scene.scene import Scene
from .caster import ReadParts, load_caster
from .gltf.load import load_gltf
from .mesh_file import is_mesh_format, read_other, read_ply, read_stl
from .mitsuba.load import load_mitsuba, load_mitsuba_dict
from .obj import read_obj
from .options import LIGHT_UNITS, LoadOptions
from .script import load_script

# Loaders by the endings of names.
_LOADERS: dict[str, Callable[[Path, LoadOptions], Scene]] = {
    ".py": load_script,
    ".glb": load_gltf,
    ".gltf": load_gltf,
    ".xml": load_mitsuba,
}
# Readers of files of a mesh alone.
_MESHES: dict[str, ReadParts] = {".obj": read_obj, ".stl": read_stl, ".ply": read_ply}


def load_scene(
    path: str | os.PathLike[str] | Mapping[str, Any],
    *,
    camera: str | None = None,
    light_units: str = "standard",
    strict: bool = False,
    arguments: Mapping[str, Any] | None = None,
) -> Scene:
    """Scene of a file.

    Parameters
    ----------
    path : path, or dict
        A Python script (``.py``) that defines ``scene()``; glTF 2.0 (``.glb``, ``.gltf``); or a
        mesh (``.obj`` with its materials, ``.stl``, ``.ply``, or any that trimesh reads), which
        gets parallel light and a screen behind it; or a Mitsuba 3 scene (``.xml``), also as a
        dictionary.
    camera : str, optional
        Name of the camera, of several in the file; by default the first.
    light_units : str
        ``"standard"``, ``"compat"`` or ``"raw"``, the units of light in a glTF file.
    strict : bool
        Raise an error for what the file holds and the scene cannot, in place of a warning.
    arguments : mapping, optional
        Keyword arguments of a script's function; for a mesh ``material`` (``"glass"``,
        ``"mirror"``, ``"diffuse"``), ``ior``, ``units`` of the file, ``direction`` of the light,
        ``distance`` of the screen from the last point along the light, ``rotate`` about x, y and z
        in degrees, ``sun_angular_radius``, ``irradiance``, and ``screen``, ``"diffuse"`` or
        ``"sensor"``.

    Raises
    ------
    OSError
        If there is no such file or it cannot be read.
    ValueError
        If the file is damaged or not of a known format, or an argument has no meaning for it.
    """
    check_choice(light_units, "light_units", LIGHT_UNITS)
    options = LoadOptions(camera, light_units, strict, dict(arguments or {}))
    if isinstance(path, Mapping):
        return load_mitsuba_dict(path, options)
    return load_with(path, options)


def load_with(path: str | os.PathLike[str], options: LoadOptions) -> Scene:
    """Scene of a file, with all options."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in _LOADERS:
        return _LOADERS[suffix](path, options)
    if is_mesh_file(path):
        return load_caster(path, options, _MESHES.get(suffix, read_other))
    known = ", ".join(f"*{each}" for each in endings())
    raise ValueError(
        f"a scene should be a file named {known}, or a mesh that trimesh reads, but is {path}"
    )


def is_mesh_file(path: str | os.PathLike[str]) -> bool:
    """True for the name of a file of a mesh alone, by its ending."""
    suffix = Path(path).suffix.lower()
    return suffix in _MESHES or (suffix not in _LOADERS and is_mesh_format(suffix))


def endings() -> tuple[str, ...]:
    """Endings of the names of files that hold scenes; trimesh may read more."""
    return (*_LOADERS, *_MESHES)
