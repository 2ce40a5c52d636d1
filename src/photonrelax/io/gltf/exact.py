"""Scenes as JSON and arrays of 64 bits, for the extras of files that photonrelax writes.

glTF has numbers of 32 bits and not all that a scene has. Of a file that another program wrote again
the extras may be out of date: they are read where the generator is photonrelax.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..._version import __version__
from ...scene.area_emitter import AreaEmitter
from ...scene.camera import Camera
from ...scene.dispersion import Abbe, Cauchy, Sellmeier
from ...scene.emitters import CollimatedEmitter, LambertianEmitter, PointEmitter, SpotEmitter
from ...scene.environment import EnvironmentEmitter
from ...scene.materials import Dielectric, Diffuse, Mirror, Sensor
from ...scene.scene import Scene, SceneObject
from ...scene.shading import given_normals
from ...scene.shapes import Disk, Rectangle, Sphere
from ...scene.textures import Texture
from ..json_entry import JsonEntry
from .file import GltfFile

if TYPE_CHECKING:
    import trimesh

GENERATOR = f"photonrelax {__version__}"
KEY = "photonrelax"
_VERSION = 1
_CLASSES: dict[str, type] = {
    each.__name__: each
    for each in (
        Texture,
        Scene,
        SceneObject,
        Camera,
        Diffuse,
        Mirror,
        Dielectric,
        Sensor,
        Cauchy,
        Sellmeier,
        Abbe,
        CollimatedEmitter,
        PointEmitter,
        LambertianEmitter,
        SpotEmitter,
        AreaEmitter,
        EnvironmentEmitter,
        Rectangle,
        Disk,
        Sphere,
    )
}
# Larger arrays lie in the buffer.
_MAX_INLINE = 16
_DTYPES = ("<f8", "<f4", "<i8", "|u1")

AddView = Callable[[bytes], int]


def encoded(scene: Scene, add_view: AddView) -> dict[str, Any]:
    """A scene as JSON; `add_view` adds bytes to the buffer and returns the index of their view.

    Raises
    ------
    TypeError
        If a material, emitter or shape is not one of photonrelax.
    """
    return {"version": _VERSION, "scene": _encoded(scene, add_view)}


def decoded(file: GltfFile) -> Scene | None:
    """The scene that `encoded` made of a file; None if it has none, or another program wrote it.

    Raises
    ------
    ValueError
        If it is damaged, or of a later version.
    """
    if not file.root.entry("asset").text("generator").startswith(KEY):
        return None
    extras = file.root.entry("extras").entry(KEY)
    if "scene" not in extras:
        return None
    if extras.count("version") != _VERSION:
        raise extras.error("version", f"{_VERSION}, that of this version of photonrelax")
    try:
        scene = _decoded(extras.value("scene"), file)
    except (TypeError, ValueError, KeyError, RecursionError) as error:
        raise ValueError(f"{extras.where} is damaged: {error}") from None
    if not isinstance(scene, Scene):
        raise extras.error("scene", "a scene")
    return scene


def _encoded(value: Any, add_view: AddView) -> Any:
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        inline = value.size <= _MAX_INLINE and value.dtype == np.float64
        return value.tolist() if inline else _view_of(value, add_view)
    if isinstance(value, list | tuple):
        return [_encoded(each, add_view) for each in value]
    if hasattr(value, "vertices") and hasattr(value, "faces"):
        return _encoded_mesh(value, add_view)
    if is_dataclass(value) and _CLASSES.get(type(value).__name__) is type(value):
        members = {f.name: getattr(value, f.name) for f in fields(value) if f.init}
        encoded = {name: _encoded(member, add_view) for name, member in members.items()}
        return {"class": type(value).__name__, **encoded}
    raise TypeError(
        f"a scene that is saved should be of classes of photonrelax, but has a "
        f"{type(value).__name__}"
    )


def _encoded_mesh(mesh: trimesh.Trimesh, add_view: AddView) -> dict[str, Any]:
    arrays = {
        "vertices": np.asarray(mesh.vertices, dtype="<f8"),
        "faces": np.asarray(mesh.faces, dtype="<i8"),
        "vertex_normals": given_normals(mesh),
        "uv": getattr(mesh.visual, "uv", None),
    }
    views = {
        key: _view_of(np.asarray(each), add_view)
        for key, each in arrays.items()
        if each is not None
    }
    return {"class": "Trimesh", **views}


def _view_of(array: NDArray, add_view: AddView) -> dict[str, Any]:
    array = np.ascontiguousarray(array)
    array = array.astype(array.dtype.newbyteorder("<"), copy=False)
    return {
        "class": "array",
        "dtype": array.dtype.str,
        "shape": list(array.shape),
        "bufferView": add_view(array.tobytes()),
    }


def _decoded(value: Any, file: GltfFile) -> Any:
    if isinstance(value, list):
        return [_decoded(each, file) for each in value]
    if not isinstance(value, dict):
        return value
    name = value["class"]
    if name == "array":
        return _array(value, file)
    members = {key: _decoded(each, file) for key, each in value.items() if key != "class"}
    if name == "Trimesh":
        import trimesh

        uv = members.pop("uv", None)
        visual = None if uv is None else trimesh.visual.TextureVisuals(uv=uv)
        return trimesh.Trimesh(**members, visual=visual, process=False)
    return _CLASSES[name](**members)


def _array(value: dict[str, Any], file: GltfFile) -> NDArray:
    entry = JsonEntry(value, f"{file.path}.extras")
    views = len(file.entries("bufferViews"))
    index = entry.index("bufferView", views)
    shape = value["shape"]
    if value["dtype"] not in _DTYPES or index is None:
        raise entry.error("dtype", f"one of {', '.join(_DTYPES)}")
    array = np.frombuffer(file.bytes_of_view(index), value["dtype"])
    return array.reshape(shape).copy()
