"""Bitmaps of Mitsuba 3 scenes: textures of albedos, and maps of the surroundings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..._util.validation import Floats
from ...imaging.image import read_exr
from ...scene.environment import EnvironmentEmitter
from ...scene.sky_map import SkyMap
from ...scene.textures import Texture, decoded_image
from ..sources import path_beside
from ..substitutions import Substitutions
from .nodes import Plugin

_WRAPS = ("repeat", "mirror", "clamp")
# Rows: where x, y and z of the direction of a texel in photonrelax's map are in Mitsuba's.
_AXES = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
# Samples along either side of a texel of a map that is turned.
_SAMPLES = 4
_ROUNDING = 1e-6


class BitmapReader:
    """Reads bitmaps in the folder of a scene's file, each file once."""

    def __init__(self, path: Path, substitutions: Substitutions) -> None:
        self._path, self.substitutions = path, substitutions
        self._images: dict[Path, NDArray] = {}

    def texture(self, node: Plugin, uv: Floats | None, owner: str) -> Texture | Floats:
        """A texture on a mesh with texture coordinates (v, 2), of Mitsuba; or its mean colour.

        Raises
        ------
        OSError, ValueError
            If its file cannot be read, or a value of it is none.
        """
        image = self._image(node)
        is_bytes = image.dtype == np.uint8
        if not is_bytes:
            image = np.clip(image, 0.0, 1.0)
        encoding = "srgb" if is_bytes and not node.flag("raw") else "linear"
        wrap = node.text("wrap_mode", "repeat")
        if wrap not in _WRAPS:
            raise ValueError(
                f"{node.label}: wrap_mode should be one of {', '.join(_WRAPS)}, but is {wrap!r}"
            )
        texture = Texture(image, wrap=wrap, encoding=encoding)
        if uv is None:
            self.substitutions.add(owner, "texture without coordinates of files", "its mean")
            return texture.mean
        if node.text("filter_type", "bilinear") != "nearest":
            self.substitutions.add_reading(owner, "linear filter of texels", "means over pixels")
        return Texture(image, wrap=texture.wrap, encoding=encoding, uv=_mapped(uv, node))

    def environment(self, node: Plugin) -> EnvironmentEmitter:
        """Surroundings by a map, whose row 0 is towards +y of Mitsuba's ``to_world``.

        Raises
        ------
        OSError, ValueError
            If its file cannot be read, its transform does more than turn, or a value is none.
        """
        image = self._image(node)
        if image.dtype == np.uint8:
            image = Texture(image, encoding="srgb").meaning[image]
        radiance = node.number("scale", 1.0) * np.asarray(image, dtype=np.float64)
        turn = node.transform()[:3, :3]
        turn = turn / np.linalg.norm(turn, axis=0)
        if not np.allclose(turn.T @ turn, np.eye(3), atol=_ROUNDING):
            raise ValueError(f"{node.label}: to_world should turn alone")
        return EnvironmentEmitter(_turned(radiance, _AXES @ turn.T))

    def _image(self, node: Plugin) -> NDArray:
        """Texels (h, w, 3): bytes, or numbers of an EXR file."""
        name = node.text("filename", "")
        if not name:
            raise ValueError(f"{node.label} should have a filename")
        path = path_beside(self._path, name, f"{node.label}: filename")
        if path not in self._images:
            try:
                self._images[path] = _read(path)
            except OSError as error:
                raise type(error)(f"{self._path}, {node.label}: {error}") from None
        return self._images[path]


def _read(path: Path) -> NDArray:
    # Of a Radiance file the reader of EXR says what to do.
    if path.suffix.lower() not in (".exr", ".hdr"):
        return decoded_image(path)
    layers = read_exr(path).layers
    if "radiance" not in layers:
        raise ValueError(f"{path} should have channels R, G and B, but has {sorted(layers)}")
    return np.asarray(layers["radiance"])


def _mapped(uv: Floats, node: Plugin) -> Floats:
    """Texture coordinates as photonrelax has them, v up, of Mitsuba's, v down."""
    to_uv = np.asarray(node.values.get("to_uv", np.eye(4)), dtype=np.float64)
    mapped = uv @ to_uv[:2, :2].T + to_uv[:2, 3]
    return np.column_stack([mapped[:, 0], 1.0 - mapped[:, 1]])


def _turned(radiance: Floats, turn: Floats) -> Floats:
    """A map as seen after a rotation (3, 3), which takes directions of the scene to its own."""
    if np.allclose(turn, np.eye(3), atol=_ROUNDING):
        return radiance
    sky, (height, width) = SkyMap(radiance), radiance.shape[:2]
    turned = np.zeros((height * width, 3))
    for i, j in np.ndindex(_SAMPLES, _SAMPLES):
        polar = np.pi * (np.arange(height) + (i + 0.5) / _SAMPLES) / height
        azimuth = np.pi * (1.0 - 2.0 * (np.arange(width) + (j + 0.5) / _SAMPLES) / width)
        z, x = np.meshgrid(np.cos(polar), np.cos(azimuth), indexing="ij")
        across = np.sqrt(1.0 - z * z)
        direction = np.stack([across * x, across * np.sin(azimuth), z], axis=-1).reshape(-1, 3)
        turned += sky.seen(np.ascontiguousarray(direction @ turn.T))
    return turned.reshape(radiance.shape) / _SAMPLES**2
