"""Scenes from files, by the ending of their names."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from .._util.validation import check_choice
from ..scene.scene import Scene
from .gltf.load import load_gltf
from .options import LIGHT_UNITS, LoadOptions
from .script import load_script

# Loaders by the endings of names.
_LOADERS: dict[str, Callable[[Path, LoadOptions], Scene]] = {
    ".py": load_script,
    ".glb": load_gltf,
    ".gltf": load_gltf,
}


def load_scene(
    path: str | os.PathLike[str],
    *,
    camera: str | None = None,
    light_units: str = "standard",
    strict: bool = False,
    arguments: Mapping[str, Any] | None = None,
) -> Scene:
    """Scene of a file.

    Parameters
    ----------
    path : path
        A Python script (``.py``) that defines ``scene()``, or glTF 2.0 (``.glb``, ``.gltf``).
    camera : str, optional
        Name of the camera, of several in the file; by default the first.
    light_units : str
        ``"standard"``, ``"compat"`` or ``"raw"``, the units of light in a glTF file.
    strict : bool
        Raise an error for what the file holds and the scene cannot, in place of a warning.
    arguments : mapping, optional
        Keyword arguments of a script's function.

    Raises
    ------
    OSError
        If there is no such file or it cannot be read.
    ValueError
        If the file is damaged or not of a known format, or an argument has no meaning for it.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _LOADERS:
        raise ValueError(
            f"a scene should be a file named {', '.join('*' + each for each in endings())}, "
            f"but is {path}"
        )
    check_choice(light_units, "light_units", LIGHT_UNITS)
    options = LoadOptions(camera, light_units, strict, dict(arguments or {}))
    return _LOADERS[suffix](path, options)


def endings() -> tuple[str, ...]:
    """Endings of the names of files that hold scenes."""
    return tuple(_LOADERS)
