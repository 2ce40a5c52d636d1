"""Scenes to files."""

from __future__ import annotations

import os
from pathlib import Path

from ..scene.scene import Scene
from .gltf.save import save_gltf


def save_scene(scene: Scene, path: str | os.PathLike[str]) -> None:
    """Write a scene to a GLB file, which `load_scene` reads as the same scene.

    Other programs read meshes, materials, lights and the camera in glTF's own terms, and numbers of
    32 bits; the extras hold all of the scene exactly. They are not read of a file that another
    program wrote again.

    Parameters
    ----------
    scene : Scene
        Of materials, emitters and shapes of photonrelax.
    path : path
        Ends in ``.glb``.

    Raises
    ------
    OSError
        If it cannot be written.
    TypeError, ValueError
        If the scene has others, or the path another ending.
    """
    save_gltf(scene, Path(path))
