"""Textures: colours of a surface by its texture coordinates."""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._ext.scene.textures import WRAPS, means
from .._util.files import open_file
from .._util.frozen import frozen, read_only, set_field
from .._util.memory import check_memory
from .._util.validation import Floats, check_choice, float_array, rgb

if TYPE_CHECKING:
    from .scene import SceneObject

ENCODINGS = ("linear", "srgb")
_FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TIFF")
# Texels along a footprint that are counted one by one, at most: from there on blocks of texels are,
# 32 along it or more.
_MAX_EXTENT = 256.0
# Texels along the side of the smallest blocks: all blocks take a twelfth of the image of bytes.
_BLOCK = 8


@dataclass(frozen=True, eq=False)
class Texture:
    """An image over a surface, by the texture coordinates of its mesh.

    Texels are squares of one colour. Row 0 of the image is on top, at v = 1.

    Parameters
    ----------
    image : (h, w, 3) array, or path
        Linear colours in [0, 1], or bytes; or an image file, PNG, JPEG, WebP, BMP or TIFF.
    factor : (3,) or float
        Factor on all colours.
    wrap : str, or two
        Beyond [0, 1]: ``"repeat"``, ``"mirror"`` or ``"clamp"``; along u and v.
    uv : (v, 2), optional
        Texture coordinates of the vertices of the mesh; by default ``mesh.visual.uv``.
    encoding : str, optional
        ``"linear"`` or ``"srgb"``, of bytes: by default that of files is sRGB, that of arrays
        linear.
    """

    image: ArrayLike
    _: KW_ONLY
    factor: ArrayLike = (1.0, 1.0, 1.0)
    wrap: str | Sequence[str] = "repeat"
    uv: ArrayLike | None = None
    encoding: str | None = None

    def __post_init__(self) -> None:
        image, encoding = self.image, self.encoding
        if isinstance(image, str | os.PathLike):
            image, encoding = decoded_image(Path(image)), encoding or "srgb"
        set_field(self, "encoding", encoding or "linear")
        check_choice(str(self.encoding), "encoding", ENCODINGS)
        set_field(self, "image", _texels(image))
        set_field(self, "factor", frozen(rgb(self.factor, "factor", high=1.0)))
        wrap = (self.wrap, self.wrap) if isinstance(self.wrap, str) else tuple(self.wrap)
        if len(wrap) != 2:
            raise ValueError(f"wrap should be one mode or two, but is {self.wrap!r}")
        for mode in wrap:
            check_choice(mode, "wrap", WRAPS)
        set_field(self, "wrap", wrap)
        if self.uv is not None:
            set_field(self, "uv", frozen(float_array(self.uv, "uv", (None, 2))))

    @property
    def wraps(self) -> tuple[int, int]:
        """Wrap modes along u and v, as kernels have them."""
        u, v = self.wrap
        return WRAPS[u], WRAPS[v]

    @cached_property
    def meaning(self) -> Floats:
        """Colours (256,) that bytes stand for."""
        values = np.arange(256) / 255.0
        if self.encoding == "srgb":
            low = values / 12.92
            values = np.where(values <= 0.04045, low, ((values + 0.055) / 1.055) ** 2.4)
        return values

    @cached_property
    def mean(self) -> Floats:
        """Mean colour (3,) of the whole image, times the factor."""
        coarsest = self._levels[-1]
        mean: Floats = coarsest.reshape(-1, 3).mean(axis=0, dtype=np.float64)
        return mean * np.asarray(self.factor)

    def means(self, uv: Floats, edges: Floats) -> Floats:
        """Mean colours (m, 3) over parallelograms around texture coordinates.

        Parameters
        ----------
        uv : (m, 2)
            Of their centres.
        edges : (m, 2, 2)
            Changes of the texture coordinates along their edges.
        """
        colours = np.empty((len(uv), 3))
        level = self._level_of(edges)
        for number in np.unique(level):
            rows = np.flatnonzero(level == number)
            texels = np.asarray(self.image) if number == 0 else self._levels[number - 1]
            colours[rows] = self._means(texels, uv[rows], edges[rows])
        return colours * np.asarray(self.factor)

    def _means(self, texels: NDArray, uv: Floats, edges: Floats) -> Floats:
        # To the right and down.
        size = np.array([texels.shape[1], texels.shape[0]], dtype=np.float64)
        centre = np.array([uv[:, 0], 1.0 - uv[:, 1]]).T * size
        is_bytes = texels.dtype == np.uint8
        found: Floats = means(
            texels if is_bytes else None,
            None if is_bytes else texels,
            self.meaning,
            np.ascontiguousarray(centre),
            np.ascontiguousarray(edges * [1.0, -1.0] * size),
            *self.wraps,
        )
        return found

    def _level_of(self, edges: Floats) -> NDArray[np.intp]:
        """Number of the level (m,) at which each parallelogram has few texels along it.

        0 is the image. Footprints of more texels than the coarsest level has are of that.
        """
        height, width = np.shape(self.image)[:2]
        extent = (np.abs(edges).sum(axis=1) * [width, height]).max(axis=1)
        coarse = np.maximum(extent / _MAX_EXTENT, 1.0)
        level = np.ceil(np.log2(coarse / _BLOCK)).clip(0.0) + 1.0
        return np.where(coarse > 1.0, np.minimum(level, len(self._levels)), 0.0).astype(np.intp)

    @cached_property
    def _levels(self) -> list[NDArray[np.float32]]:
        """Means over blocks of the image, 8 texels wide and then twice as wide each."""
        levels = [_reduced(np.asarray(self.image), _BLOCK, self.meaning)]
        while max(levels[-1].shape[:2]) > 1:
            levels.append(_reduced(levels[-1], 2, self.meaning))
        return levels


class FaceTexture(NamedTuple):
    """A texture and the texture coordinates (f, 3, 2) of the corners of an object's faces."""

    texture: Texture
    uv: Floats

    def at(
        self, item: SceneObject, face: NDArray, position: Floats, footprint: Floats | None
    ) -> Floats:
        """Mean colours (m, 3) over footprints (m, 2, 3) around positions (m, 3) on faces (m,)."""
        corners = np.asarray(item.mesh.vertices)[np.asarray(item.mesh.faces)[face]]
        ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        uv = self.uv[face]
        along = np.stack([uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]], axis=1)
        centre = uv[:, 0] + _mapped(position - corners[:, 0], ab, ac, along)
        if footprint is None:
            footprint = np.zeros((len(face), 2, 3))
        edges = np.stack([_mapped(footprint[:, k], ab, ac, along) for k in range(2)], axis=1)
        return self.texture.means(centre, edges)


def face_texture(item: SceneObject) -> FaceTexture | None:
    """The texture of an object with the coordinates of its faces; None if it has none.

    Raises
    ------
    ValueError
        If the mesh has no texture coordinates, or not as many as vertices.
    """
    texture = item.material.texture
    if texture is None:
        return None
    uv: Any = texture.uv
    if uv is None:
        uv = getattr(getattr(item.mesh, "visual", None), "uv", None)
    n = len(item.mesh.vertices)
    found = None if uv is None else np.shape(uv)
    if found != (n, 2):
        raise ValueError(
            f"texture coordinates should have shape ({n}, 2), a row a vertex, but "
            + ("there are none: give the Texture uv" if found is None else f"have {found}")
        )
    return FaceTexture(texture, float_array(uv, "uv")[np.asarray(item.mesh.faces)])


def _mapped(vector: Floats, ab: Floats, ac: Floats, along: Floats) -> Floats:
    """Changes (m, 2) of texture coordinates, those `along` two edges, along vectors (m, 3)."""
    bb, bc, cc = (np.einsum("ij,ij->i", *pair) for pair in ((ab, ab), (ab, ac), (ac, ac)))
    vb, vc = np.einsum("ij,ij->i", vector, ab), np.einsum("ij,ij->i", vector, ac)
    # Faces without an area are never hit.
    inverse = 1.0 / (bb * cc - bc * bc)
    b, c = (cc * vb - bc * vc) * inverse, (bb * vc - bc * vb) * inverse
    mapped: Floats = b[:, np.newaxis] * along[:, 0] + c[:, np.newaxis] * along[:, 1]
    return mapped


def decoded_image(source: Path | bytes, name: str | None = None) -> NDArray[np.uint8]:
    """Bytes (h, w, 3) of an image file, or of its content.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is damaged, or no image of a known kind.
    MemoryError
        If it surely does not fit.
    """
    from PIL import Image

    label = str(source) if isinstance(source, Path) else str(name)
    if isinstance(source, Path):
        with open_file(source) as file:
            source = file.read()
    try:
        with Image.open(io.BytesIO(source), formats=_FORMATS) as image:
            n_bytes = 3.0 * image.width * image.height
            check_memory(n_bytes, f"the texels of {label}", "make it smaller")
            return read_only(np.array(image.convert("RGB")))
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise ValueError(f"{label} cannot be read as an image: {error}") from None


def _texels(image: ArrayLike) -> NDArray:
    """Bytes, or float32 in [0, 1], (h, w, 3), contiguous and read-only."""
    array = np.asarray(image)
    if array.dtype != np.uint8:
        if array.dtype != np.float32:
            array = float_array(array, "image").astype(np.float32)
        low, high = float(array.min(initial=0.0)), float(array.max(initial=0.0))
        if not (low >= 0.0 and high <= 1.0):
            raise ValueError(f"image should lie in [0, 1], but is from {low:g} to {high:g}")
    if array.ndim != 3 or array.shape[2] != 3 or not array.size:
        raise ValueError(f"image should have shape (h, w, 3), but has {array.shape}")
    return frozen(np.ascontiguousarray(array))


def _reduced(texels: NDArray, factor: int, meaning: Floats) -> NDArray[np.float32]:
    """Means over blocks of about factor × factor texels, which fill the image evenly."""
    height, width = (max(-(-n // factor), 1) for n in texels.shape[:2])
    reduced = np.empty((height, width, 3), dtype=np.float32)
    limits = np.arange(height + 1) * (texels.shape[0] / height)
    columns = np.arange(width + 1) * (texels.shape[1] / width)
    for i in range(height):
        first, last = int(np.floor(limits[i])), int(np.ceil(limits[i + 1]))
        last = min(max(last, first + 1), texels.shape[0])
        rows = texels[first:last]
        colours = meaning[rows] if texels.dtype == np.uint8 else rows.astype(np.float64)
        edges = np.arange(first, last + 1).clip(limits[i], limits[i + 1])
        mean = np.einsum("i,ijk->jk", np.diff(edges), colours) / (limits[i + 1] - limits[i])
        summed = np.concatenate([np.zeros((1, 3)), np.cumsum(mean, axis=0)])
        at = [np.interp(columns, np.arange(len(summed)), summed[:, c]) for c in range(3)]
        reduced[i] = (np.diff(at, axis=1) / np.diff(columns)).T
    return reduced
