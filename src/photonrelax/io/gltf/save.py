"""Scenes as GLB files: in glTF's own terms for other programs, and exactly in the extras."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._util.files import output_path, whole_file
from ..._util.products import product
from ..._util.validation import Floats
from ...scene.area_emitter import AreaEmitter
from ...scene.camera import Camera
from ...scene.dispersion import Dispersion
from ...scene.emitters import CollimatedEmitter, Emitter, PointEmitter, SpotEmitter
from ...scene.materials import Dielectric, Diffuse, Material, Mirror
from ...scene.scene import Scene, SceneObject
from ...scene.textures import Texture
from .exact import GENERATOR, KEY, encoded
from .file import MAGIC
from .lights import EXTENSION as LIGHTS
from .lights import LUMENS_PER_WATT, spot_solid_angle
from .materials import DISPERSION_TIMES_ABBE

_FLOAT, _UNSIGNED = 5126, 5125
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3"}
_NEAREST = 9728
_WRAPS = {"repeat": 10497, "mirror": 33648, "clamp": 33071}
# To glTF's axes, y up: (x, y, z) becomes (x, z, -y).
_Y_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
# Metres after which light in a medium has its colour.
_ATTENUATION_DISTANCE = 1.0


def save_gltf(scene: Scene, path: Path) -> None:
    """Write a scene to a GLB file, whole or not at all.

    Raises
    ------
    OSError
        If it cannot be written.
    TypeError
        If a material, emitter or shape is not one of photonrelax.
    """
    output_path(path, ".glb")
    writer = _Writer()
    for i, item in enumerate(scene.objects):
        writer.add_object(item, item.name or f"object {i}")
    for i, emitter in enumerate(scene.emitters):
        writer.add_emitter(emitter, f"emitter {i}")
    if scene.camera is not None:
        writer.add_camera(scene.camera)
    content = writer.finished(scene)
    with whole_file(path) as partial:
        partial.write_bytes(content)


class _Writer:
    """The JSON and the buffer of a file."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._lists: dict[str, list[Any]] = {
            name: []
            for name in (
                *("nodes", "meshes", "materials", "cameras", "accessors", "bufferViews"),
                *("textures", "samplers", "images"),
            )
        }
        self._lights: list[dict[str, Any]] = []
        self._extensions: set[str] = set()

    def add_object(self, item: SceneObject, name: str, radiance: Floats | None = None) -> None:
        """Add a node with the mesh of an object, one that emits if it has a radiance."""
        material = self._material(item.material, name)
        if radiance is not None:
            self._set_radiance(material, radiance)
        vertices, faces = np.asarray(item.mesh.vertices), np.asarray(item.mesh.faces)
        attributes = {}
        uv = _texture_coordinates(item)
        if item.smooth:
            shading = item.shading_normals
            vertices, faces = vertices[shading.vertex], shading.faces
            uv = None if uv is None else uv[shading.vertex]
            length = np.linalg.norm(shading.normal, axis=1, keepdims=True)
            if (length > 0.0).all():
                normals = shading.normal / length
                attributes["NORMAL"] = self._accessor(product(normals, _Y_UP.T), _FLOAT)
        attributes["POSITION"] = self._accessor(product(vertices, _Y_UP.T), _FLOAT)
        if uv is not None:
            attributes["TEXCOORD_0"] = self._accessor(uv * [1.0, -1.0] + [0.0, 1.0], _FLOAT)
        primitive = {
            "attributes": attributes,
            "indices": self._accessor(faces.ravel(), _UNSIGNED),
            "material": self._append("materials", material),
        }
        mesh = self._append("meshes", {"name": name, "primitives": [primitive]})
        self._append("nodes", {"name": name, "mesh": mesh})

    def add_emitter(self, emitter: Emitter, name: str) -> None:
        """Add a node with a light, or a surface that emits; others are in the extras alone."""
        if isinstance(emitter, AreaEmitter):
            self.add_object(emitter.surface, name, emitter.emitted_radiance)
            self._lists["materials"][-1]["doubleSided"] = emitter.two_sided
            return
        light = _light(emitter)
        if light is None:
            return
        self._extensions.add(LIGHTS)
        direction = getattr(emitter, "direction", (0.0, 0.0, -1.0))
        point = np.zeros(3) if emitter.point is None else emitter.point
        index = len(self._lights)
        self._lights.append(light | {"name": name})
        node = {"name": name, "matrix": _matrix(direction, point)}
        self._append("nodes", node | {"extensions": {LIGHTS: {"light": index}}})

    def add_camera(self, camera: Camera) -> None:
        """Add a node with a camera."""
        aspect = camera.width / camera.height
        lens: dict[str, Any] = {"type": "perspective"}
        if camera.orthographic_height is None:
            yfov = np.radians(camera.vertical_fov)
            lens["perspective"] = {"yfov": yfov, "aspectRatio": aspect, "znear": 1e-3}
        else:
            half = camera.orthographic_height / 2.0
            lens["type"] = "orthographic"
            lens["orthographic"] = {"xmag": aspect * half, "ymag": half, "znear": 0.0, "zfar": 1e9}
        index = self._append("cameras", lens)
        right, up, forward = camera.axes()
        matrix = _affine(np.array([right, up, -forward]).T, np.asarray(camera.origin))
        self._append("nodes", {"name": "Camera", "camera": index, "matrix": matrix})

    def finished(self, scene: Scene) -> bytes:
        """The file, with the exact scene in its extras."""
        root: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": GENERATOR},
            "extras": {KEY: encoded(scene, self._add_view)},
            "scene": 0,
            "scenes": [{"name": scene.name, "nodes": list(range(len(self._lists["nodes"])))}],
            "buffers": [{"byteLength": len(self._buffer)}],
        }
        root |= {name: values for name, values in self._lists.items() if values}
        if self._lights:
            root["extensions"] = {LIGHTS: {"lights": self._lights}}
        if self._extensions:
            root["extensionsUsed"] = sorted(self._extensions)
        text = _padded(json.dumps(root, allow_nan=False).encode(), b" ")
        binary = _padded(bytes(self._buffer), b"\x00")
        chunks = b"".join(
            struct.pack("<I4s", len(content), kind) + content
            for kind, content in ((b"JSON", text), (b"BIN\x00", binary))
        )
        return struct.pack("<4sII", MAGIC, 2, 12 + len(chunks)) + chunks

    def _material(self, material: Material, name: str) -> dict[str, Any]:
        row = material.row()
        colour = row.tint if isinstance(material, Dielectric) else row.reflectance
        opacity = 0.0 if material.is_sensor else 1.0
        factors = {
            "baseColorFactor": [*np.asarray(colour, dtype=float).tolist(), opacity],
            "metallicFactor": float(isinstance(material, Mirror)),
            "roughnessFactor": float(isinstance(material, Diffuse)),
        }
        made: dict[str, Any] = {"name": name, "pbrMetallicRoughness": factors}
        if material.is_sensor:
            made["alphaMode"] = "BLEND"
        if material.texture is not None:
            factors["baseColorFactor"] = [*np.asarray(material.texture.factor).tolist(), 1.0]
            factors["baseColorTexture"] = {"index": self._add_texture(material.texture)}
        if isinstance(material, Dielectric):
            made["extensions"] = self._glass(material)
        return made

    def _glass(self, material: Dielectric) -> dict[str, Any]:
        extensions: dict[str, Any] = {
            "KHR_materials_transmission": {"transmissionFactor": 1.0},
            "KHR_materials_ior": {"ior": material.row().ior},
        }
        if isinstance(material.ior, Dispersion):
            dispersion = DISPERSION_TIMES_ABBE / material.ior.abbe_number
            extensions["KHR_materials_dispersion"] = {"dispersion": max(dispersion, 0.0)}
        absorption = np.asarray(material.absorption)
        colour = np.exp(-_ATTENUATION_DISTANCE * absorption).tolist()
        extensions["KHR_materials_volume"] = {
            "thicknessFactor": 1.0,
            "attenuationColor": colour,
            "attenuationDistance": _ATTENUATION_DISTANCE,
        }
        self._extensions |= extensions.keys()
        return extensions

    def _add_texture(self, texture: Texture) -> int:
        u, v = texture.wrap
        sampler = {"magFilter": _NEAREST, "wrapS": _WRAPS[u], "wrapT": _WRAPS[v]}
        image = {"mimeType": "image/png", "bufferView": self._add_view(_png(texture))}
        source = self._append("images", image)
        sampler_index = self._append("samplers", sampler)
        return self._append("textures", {"source": source, "sampler": sampler_index})

    def _set_radiance(self, material: dict[str, Any], radiance: Floats) -> None:
        """Emission in cd/m², as a factor of 1 at most and a strength."""
        nits = LUMENS_PER_WATT * radiance
        strength = float(nits.max()) or 1.0
        material["emissiveFactor"] = (nits / strength).tolist()
        name = "KHR_materials_emissive_strength"
        material.setdefault("extensions", {})[name] = {"emissiveStrength": strength}
        self._extensions.add(name)

    def _accessor(self, array: NDArray, component: int) -> int:
        kind = np.float32 if component == _FLOAT else np.uint32
        array = np.ascontiguousarray(array, dtype=kind)
        width = array.shape[1] if array.ndim == 2 else 1
        accessor: dict[str, Any] = {
            "bufferView": self._add_view(array.tobytes()),
            "componentType": component,
            "count": len(array),
            "type": _TYPES[width],
        }
        if width > 1:
            accessor |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
        return self._append("accessors", accessor)

    def _add_view(self, content: bytes) -> int:
        # Accessors are aligned to their numbers.
        self._buffer += bytes(-len(self._buffer) % 8)
        view = {"buffer": 0, "byteOffset": len(self._buffer), "byteLength": len(content)}
        self._buffer += content
        return self._append("bufferViews", view)

    def _append(self, name: str, value: dict[str, Any]) -> int:
        self._lists[name].append(value)
        return len(self._lists[name]) - 1


def _texture_coordinates(item: SceneObject) -> Floats | None:
    """Texture coordinates (v, 2) of an object with a texture, v up; None of others."""
    texture = item.material.texture
    if texture is None:
        return None
    visual: Any = item.mesh.visual
    return np.asarray(visual.uv if texture.uv is None else texture.uv, dtype=float)


def _png(texture: Texture) -> bytes:
    """PNG file of an image, in sRGB."""
    from PIL import Image

    texels = np.asarray(texture.image)
    if texels.dtype != np.uint8 or texture.encoding != "srgb":
        linear = texture.meaning[texels] if texels.dtype == np.uint8 else texels
        curved = 1.055 * np.power(linear, 1.0 / 2.4) - 0.055
        stored = np.where(linear <= 0.0031308, 12.92 * linear, curved)
        texels = np.rint(255.0 * stored).astype(np.uint8)
    file = io.BytesIO()
    Image.fromarray(texels).save(file, "PNG")
    return file.getvalue()


def _light(emitter: Emitter) -> dict[str, Any] | None:
    """A light of the standard, None for what it has not."""
    if isinstance(emitter, CollimatedEmitter):
        return {"type": "directional"} | _brightness(np.asarray(emitter.irradiance))
    if isinstance(emitter, PointEmitter):
        return {"type": "point"} | _brightness(np.asarray(emitter.power) / (4.0 * np.pi))
    if not isinstance(emitter, SpotEmitter):
        return None
    inner, outer = np.radians([emitter.inner_angle, emitter.outer_angle]).tolist()
    on_axis = np.asarray(emitter.power) / spot_solid_angle(inner, outer)
    cone = {"innerConeAngle": inner, "outerConeAngle": outer}
    return {"type": "spot", "spot": cone} | _brightness(on_axis)


def _brightness(watts: Floats) -> dict[str, Any]:
    largest = float(watts.max()) or 1.0
    return {"intensity": LUMENS_PER_WATT * largest, "color": (watts / largest).tolist()}


def _matrix(direction: ArrayLike, point: ArrayLike) -> list[float]:
    """Transform of a node whose -z axis is a direction."""
    backward = -np.asarray(direction, dtype=float)
    aside = np.eye(3)[np.abs(backward).argmin()]
    right = np.cross(aside, backward)
    right /= np.linalg.norm(right)
    return _affine(np.array([right, np.cross(backward, right), backward]).T, np.asarray(point))


def _affine(axes: Floats, origin: Floats) -> list[float]:
    """Matrix of a node by columns, from axes (3, 3) as columns and an origin, both z up."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = _Y_UP @ axes, _Y_UP @ origin
    numbers: list[float] = matrix.T.ravel().tolist()
    return numbers


def _padded(content: bytes, filler: bytes) -> bytes:
    return content + filler * (-len(content) % 4)
