"""Textures of base colours in glTF files."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._util.products import product
from ..._util.validation import Floats
from ...scene.textures import Texture, decoded_image
from ..json_entry import JsonEntry
from ..substitutions import Substitutions
from .file import GltfFile

TRANSFORM = "KHR_texture_transform"
WEBP = "EXT_texture_webp"
_WRAPS = {10497: "repeat", 33648: "mirror", 33071: "clamp"}
_NEAREST = (9728, 9984, 9986)
_KINDS = {b"\x89PNG": "PNG", b"\xff\xd8\xff": "JPEG", b"RIFF": "WebP", b"\xabKTX": "KTX2"}


class TextureUse(NamedTuple):
    """A texture of a material, before it has the coordinates of a mesh.

    `uv_set` is the number of the set of coordinates, and `transform` (2, 3) maps them.
    """

    texture: Texture
    uv_set: int
    transform: Floats

    def on(self, uv: Floats) -> Texture:
        """The texture with coordinates (v, 2) of the file, v down."""
        mapped = product(uv, self.transform[:, :2].T) + self.transform[:, 2]
        return Texture(
            self.texture.image,
            factor=self.texture.factor,
            wrap=self.texture.wrap,
            uv=np.array([mapped[:, 0], 1.0 - mapped[:, 1]]).T,
            encoding=self.texture.encoding,
        )


class TextureReader:
    """Reads textures; an image of several is decoded once."""

    def __init__(self, file: GltfFile, substitutions: Substitutions) -> None:
        self._file, self._substitutions = file, substitutions
        self._images: dict[int, NDArray[np.uint8]] = {}

    def read(self, info: JsonEntry, factor: Floats, name: str) -> TextureUse:
        """The texture of a material, by its ``textureInfo``.

        Raises
        ------
        ValueError
            If its image is damaged, or of a kind without a decoder.
        """
        index = info.index("index", len(self._file.entries("textures")))
        if index is None:
            raise info.error("index", "that of a texture")
        texture = self._file.at("textures", index)
        samplers = self._file.entries("samplers")
        sampler_index = texture.index("sampler", len(samplers))
        sampler = JsonEntry({}, texture.where) if sampler_index is None else samplers[sampler_index]
        if sampler.count("magFilter", _NEAREST[0]) not in _NEAREST:
            self._substitutions.add_reading(name, "linear filter of texels", "means over pixels")
        wrap = [self._wrap(sampler, key) for key in ("wrapS", "wrapT")]
        image = self._image(texture)
        transform = info.entry("extensions").entry(TRANSFORM)
        uv_set = transform.count("texCoord", info.count("texCoord", 0))
        return TextureUse(
            Texture(image, factor=factor, wrap=wrap, encoding="srgb"), uv_set, _matrix(transform)
        )

    def _wrap(self, sampler: JsonEntry, key: str) -> str:
        mode = sampler.count(key, 10497)
        if mode not in _WRAPS:
            raise sampler.error(key, f"one of {', '.join(map(str, _WRAPS))}")
        return _WRAPS[mode]

    def _image(self, texture: JsonEntry) -> NDArray[np.uint8]:
        images = self._file.entries("images")
        webp = texture.entry("extensions").entry(WEBP)
        index = webp.index("source", len(images))
        if index is None:
            index = texture.index("source", len(images))
        if index is None:
            raise ValueError(
                f"{texture.where} should have an image of PNG, JPEG or WebP, but has "
                f"{', '.join(texture.entry('extensions').names()) or 'none'}"
            )
        if index not in self._images:
            self._images[index] = self._decoded(images[index])
        return self._images[index]

    def _decoded(self, image: JsonEntry) -> NDArray[np.uint8]:
        index = image.index("bufferView", len(self._file.entries("bufferViews")))
        content = self._file.read_uri(image) if index is None else self._file.bytes_of_view(index)
        kind = next((kind for mark, kind in _KINDS.items() if content.startswith(mark)), "unknown")
        if not _has_decoder(kind):
            raise ValueError(f"{image.where} is an image of {kind}, for which there is no decoder")
        return decoded_image(content, image.where)


def _has_decoder(kind: str) -> bool:
    from PIL import features

    return kind in ("PNG", "JPEG") or (kind == "WebP" and bool(features.check("webp")))


def _matrix(transform: JsonEntry) -> Floats:
    """Map (2, 3) of texture coordinates, v down: scaled, then turned, then moved."""
    angle = transform.number("rotation", 0.0)
    scale = transform.numbers("scale", (1.0, 1.0))
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, sin], [-sin, cos]])
    return np.column_stack([turn * scale, transform.numbers("offset", (0.0, 0.0))])
