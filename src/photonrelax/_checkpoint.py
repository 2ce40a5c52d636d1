"""A long run kept in a file: whole or as it was, and taken up by the same run alone."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._files import NOT_READABLE, remove_leftovers, whole_file
from .raycast import vertex_normals
from .scene import Scene, SceneObject


class Checkpoint:
    """The file of a run.

    Parameters
    ----------
    path : path
        Of the file; what runs that were killed left half written beside it is removed.
    identity : mapping
        What must be the same for a run to be resumed, as JSON knows it.
    """

    def __init__(self, path: str | os.PathLike[str], identity: Mapping[str, Any]) -> None:
        self.path = Path(path)
        self._identity = json.loads(json.dumps(identity))
        remove_leftovers(self.path)

    def save(self, arrays: Mapping[str, Any]) -> None:
        """Write the file anew, whole and onto the disk before it takes the place of the old one."""
        with whole_file(self.path) as partial, partial.open("wb") as file:
            np.savez(file, identity=json.dumps(self._identity), **arrays)
            file.flush()
            os.fsync(file.fileno())

    def load(self) -> dict[str, NDArray] | None:
        """Return what was saved, None if there is no file.

        Raises
        ------
        ValueError
            If the file is none of `save`, or of another run.
        """
        if not self.path.exists():
            return None
        try:
            with self.path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
                arrays = {name: np.asarray(file[name]) for name in file.files}
            identity = json.loads(str(arrays.pop("identity")))
        except (*NOT_READABLE, KeyError) as error:
            raise ValueError(f"{self.path} does not hold a run to be resumed: {error}") from None
        self._check(identity)
        return arrays

    def _check(self, identity: Mapping[str, Any]) -> None:
        for name, value in self._identity.items():
            if identity.get(name) != value:
                raise ValueError(
                    f"{self.path} holds another run: its {name} is {identity.get(name)}, "
                    f"not {value}"
                )


def scene_digests(scene: Scene) -> dict[str, str]:
    """Return what two scenes share only if all that is rendered of them is the same, by part."""
    parts = {"camera": scene.camera, "objects": scene.objects, "emitters": scene.emitters}
    return {f"digest of the {name}": _digest(part) for name, part in parts.items()}


def scene_digest(scene: Scene) -> str:
    """Return what two scenes share only if they, and their names, are the same."""
    return _digest(scene)


def _digest(value: Any) -> str:
    digest = blake2b(digest_size=16)
    for part in _parts(value):
        digest.update(part)
    return digest.hexdigest()


def _parts(value: Any) -> Iterator[bytes]:
    """Yield all that a scene is made of."""
    if isinstance(value, SceneObject):
        yield from _parts([value.material, value.smooth, *_mesh_arrays(value)])
    elif is_dataclass(value):
        yield type(value).__name__.encode()
        for field in fields(value):
            yield from _parts(getattr(value, field.name))
    elif isinstance(value, np.ndarray):
        yield f"{value.dtype.str}{value.shape}".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif isinstance(value, list | tuple):
        yield str(len(value)).encode()
        for member in value:
            yield from _parts(member)
    else:
        yield f"{value!r};".encode()


def _mesh_arrays(item: SceneObject) -> Iterable[NDArray]:
    mesh = item.mesh
    yield np.asarray(mesh.vertices)
    yield np.asarray(mesh.faces)
    if item.smooth:
        yield vertex_normals(mesh)
