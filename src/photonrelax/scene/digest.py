"""Digests of scenes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields, is_dataclass
from hashlib import blake2b
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from .scene import Scene, SceneObject
from .textures import face_texture

_of_light: WeakKeyDictionary[Scene, str] = WeakKeyDictionary()


def light_digest(scene: Scene) -> str:
    """Return the digest of what photons depend on: objects and emitters, without their names.

    It is found once for a scene.
    """
    if scene not in _of_light:
        _of_light[scene] = _digest([scene.objects, scene.emitters])
    return _of_light[scene]


def scene_digests(scene: Scene) -> dict[str, str]:
    """Return a digest of camera, objects and emitters each; the name does not count."""
    parts = {"camera": scene.camera, "objects": scene.objects, "emitters": scene.emitters}
    return {f"digest of the {name}": _digest(part) for name, part in parts.items()}


def scene_digest(scene: Scene) -> str:
    """Return the digest of a whole scene, its name included."""
    return _digest(scene)


def objects_digest(objects: Sequence[SceneObject]) -> str:
    """Return the digest of some objects."""
    return _digest(list(objects))


def _digest(value: Any) -> str:
    digest = blake2b(digest_size=16)
    for part in _parts(value):
        digest.update(part)
    return digest.hexdigest()


def _parts(value: Any) -> Iterator[bytes]:
    """Yield the bytes of all fields and arrays of a scene, in order."""
    if isinstance(value, SceneObject):
        yield from _parts([value.material, value.smooth, *_mesh_arrays(value)])
    elif is_dataclass(value):
        yield type(value).__name__.encode()
        for field in fields(value):
            part = getattr(value, field.name)
            # Scenes without an aim of their own keep the digests of earlier versions.
            if not (isinstance(value, Scene) and field.name == "aim" and part is None):
                yield from _parts(part)
    elif hasattr(value, "vertices") and hasattr(value, "faces"):
        yield from _parts([np.asarray(value.vertices), np.asarray(value.faces)])
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
    yield np.asarray(item.mesh.vertices)
    yield np.asarray(item.mesh.faces)
    # With these arrays and `smooth`, they determine the corner that each belongs to.
    if item.smooth:
        yield item.shading_normals.normal
    texture = face_texture(item)
    if texture is not None:
        yield texture.uv
