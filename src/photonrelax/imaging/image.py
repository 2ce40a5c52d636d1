"""Images of several layers, and their EXR and PNG files."""

from __future__ import annotations

import io
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._util.files import WriteError, open_file, whole_file
from .._util.frozen import set_field
from .._util.library_output import held_back
from .._util.memory import check_memory
from .._util.text import encodable
from .._util.validation import Floats, float_array

if TYPE_CHECKING:
    import OpenEXR
    import PIL.Image

# Channels of layers with three values per pixel that are not NAME.R, NAME.G and NAME.B.
_CHANNELS = {"radiance": ("R", "G", "B"), "N": ("N.X", "N.Y", "N.Z")}
# Layers that may hold inf: the depth where nothing is seen.
MAY_BE_INFINITE = ("Z",)
_MAX_FLOAT32 = float(np.finfo(np.float32).max)
# Formats of movies by suffix.
_MOVIES = {".webp": "WEBP", ".png": "PNG"}
# Stops, in either direction; larger ones would overflow.
MAX_EXPOSURE = 100.0
# How Radiance files begin.
_RADIANCE = b"#?"
# Printed by OpenEXR in place of an error.
_PIXELS_FAILED = "Warning: Exception raised reading pixel data"
# Attributes of the EXR format, which metadata must not overwrite.
_RESERVED = frozenset(
    [
        *("channels", "chunkCount", "compression", "dataWindow", "displayWindow", "lineOrder"),
        *("name", "pixelAspectRatio", "screenWindowCenter", "screenWindowWidth", "tiles"),
        *("type", "version", "view"),
    ]
)


@dataclass(frozen=True, eq=False)
class Image:
    """Image of named layers.

    Parameters
    ----------
    layers : mapping of str to (height, width) or (height, width, 3)
        Row 0 is at the top. ``radiance`` is in W/(m² sr); ``N`` holds normals; ``Z`` is the
        depth, m, inf where nothing is seen. Written files hold finite values otherwise; files
        that were read may hold any.
    metadata : mapping of str to str
        Written into the header of EXR files.
    stats : dict
        Times and counts of the stages of a render; not written to files.

    Raises
    ------
    TypeError, ValueError
        If a layer is not numeric or has another size than the others; if metadata are not text.
    """

    layers: Mapping[str, NDArray[Any]]
    metadata: Mapping[str, str] = field(default_factory=dict)
    stats: dict[str, Any] = field(default_factory=dict)

    if TYPE_CHECKING:
        # Arguments may be of wider types than the fields.
        def __init__(
            self,
            layers: Mapping[str, ArrayLike],
            metadata: Mapping[str, str] = ...,
            stats: dict[str, Any] = ...,
        ) -> None: ...

    def __post_init__(self) -> None:
        layers = {name: _checked_layer(name, layer) for name, layer in self.layers.items()}
        if not layers:
            raise ValueError("layers should not be empty")
        sizes = {name: layer.shape[:2] for name, layer in layers.items()}
        if len(set(sizes.values())) > 1:
            raise ValueError(f"layers should be of one size, but are {sizes}")
        set_field(self, "layers", layers)
        set_field(self, "metadata", _checked_metadata(self.metadata))

    def write_exr(self, path: str | os.PathLike[str]) -> None:
        """Write all layers as one part of an EXR file, float32 and ZIP, atomically.

        ``radiance`` becomes the channels R, G, B; ``N`` becomes N.X, N.Y, N.Z; another layer
        becomes NAME.R, NAME.G, NAME.B, or the channel NAME if it has one value per pixel.

        Raises
        ------
        ValueError
            If a layer holds NaN or values that float32 cannot, or ``radiance`` or ``N`` have one
            value per pixel.
        OSError
            If the file cannot be written.
        """
        import OpenEXR

        for name, layer in self.layers.items():
            _check_to_write(name, np.asarray(layer))
        header = {
            **{encodable(name): encodable(text) for name, text in self.metadata.items()},
            "compression": OpenEXR.ZIP_COMPRESSION,
            "type": OpenEXR.scanlineimage,
        }
        file = OpenEXR.File(header, self._channels())
        with whole_file(path) as partial:
            try:
                _write(file, partial)
            except RuntimeError as error:
                reason = str(error).replace(str(partial), "the temporary file")
                raise WriteError(partial, reason) from None

    def write_png(self, path: str | os.PathLike[str], exposure: float = 0.0) -> None:
        """Write ``radiance`` times 2^exposure as an 8-bit sRGB image, atomically.

        Raises
        ------
        ValueError
            If there is no ``radiance`` of three finite values per pixel, or `exposure` is not
            between -100 and 100.
        OSError
            If the file cannot be written.
        """
        display = self.display(exposure)
        with whole_file(path) as partial:
            display.save(partial, "PNG")

    def display(self, exposure: float = 0.0) -> PIL.Image.Image:
        """Return ``radiance`` times 2^exposure as an 8-bit sRGB picture.

        Raises
        ------
        ValueError
            As of `write_png`.
        """
        from PIL.Image import fromarray

        if "radiance" not in self.layers:
            raise ValueError(f"layers should include radiance, but are {sorted(self.layers)}")
        radiance = np.asarray(self.layers["radiance"])
        _check_to_write("radiance", radiance)
        display = srgb(radiance * 2.0 ** _checked_exposure(exposure))
        return fromarray(np.rint(255.0 * display).astype(np.uint8))

    def _channels(self) -> dict[str, NDArray[np.float32]]:
        channels = {}
        for name, layer in self.layers.items():
            values = np.asarray(layer, dtype=np.float32)
            if values.ndim == 2:
                channels[encodable(name)] = np.ascontiguousarray(values)
            else:
                for i, channel in enumerate(_channel_names(name)):
                    # OpenEXR silently writes wrong values of other layouts.
                    channels[encodable(channel)] = np.ascontiguousarray(values[..., i])
        return channels


def write_movie(
    pictures: Sequence[PIL.Image.Image], path: str | os.PathLike[str], fps: float
) -> None:
    """Write pictures as an animated WebP or PNG file, by its suffix, that repeats for ever.

    Raises
    ------
    ValueError
        If the suffix is another.
    OSError
        If the file cannot be written.
    """
    kind = check_movie(path)
    # Of WebP in whole milliseconds.
    duration = round(1000.0 / fps) if kind == "WEBP" else 1000.0 / fps
    with whole_file(path) as partial:
        pictures[0].save(
            partial, kind, save_all=True, append_images=pictures[1:], duration=duration, loop=0
        )


def check_movie(path: str | os.PathLike[str]) -> str:
    """Return the format of a movie by the suffix of its file; raises as `write_movie` does."""
    suffix = Path(path).suffix.lower()
    if suffix not in _MOVIES:
        raise ValueError(f"a movie should be a .webp or .png file, but is {path}")
    return _MOVIES[suffix]


def read_exr(path: str | os.PathLike[str]) -> Image:
    """Read an EXR file of one part and of any program.

    Three channels as named by `Image.write_exr` are a layer, every other channel is one by itself.
    Values need not be finite.

    Raises
    ------
    OSError
        If there is no such file, or it cannot be read.
    ValueError
        If it is damaged or not an EXR file, such as a Radiance file (``.hdr``), has several parts,
        or channels of different sizes.
    MemoryError
        If its pixels do not fit in memory.
    """
    path = Path(path)
    with open_file(path) as file:
        if file.read(len(_RADIANCE)) == _RADIANCE:
            raise ValueError(
                f"{path} should be an EXR file, but is a Radiance file (.hdr): convert it, such as "
                f"by: oiiotool {path.name} -o {path.stem}.exr"
            )
    n_parts, header, pixels = _parts(path)
    if n_parts > 1:
        raise ValueError(f"{path} should be an EXR file of one part, but has {n_parts}")
    metadata = {k: v for k, v in header.items() if isinstance(v, str) and k not in _RESERVED}
    try:
        return Image(_group(pixels), metadata)
    except (TypeError, ValueError) as error:
        raise _not_whole(path, error) from None


def _parts(path: Path) -> tuple[int, dict[str, Any], dict[str, NDArray]]:
    """Number of parts of an EXR file, and header and channels of the first."""
    with held_back(f"{path}: ", _PIXELS_FAILED) as held:
        try:
            return _read_parts(path)
        except (RuntimeError, ValueError, TypeError, LookupError) as error:
            caught = error
    failed = any(line.startswith(_PIXELS_FAILED) for line in held.lines)
    raise _not_whole(path, "its pixels are damaged or cut off" if failed else caught)


def _not_whole(path: Path, reason: Exception | str) -> ValueError:
    return ValueError(f"{path} is not a whole EXR file: {reason}; render or copy it again")


def _read_parts(path: Path) -> tuple[int, dict[str, Any], dict[str, NDArray]]:
    import OpenEXR

    # As bytes: names of files need not be text.
    name = os.fsencode(path)
    with OpenEXR.File(name, header_only=True) as file:
        n_parts, header = len(file.parts), dict(file.header())
    _check_size(path, header)
    with OpenEXR.File(name, separate_channels=True) as file:
        channels = {name: channel.pixels for name, channel in file.channels().items()}
        return n_parts, header, channels


def _check_size(path: Path, header: dict[str, Any]) -> None:
    first, last = header["dataWindow"]
    width, height = (int(end) - int(start) + 1 for start, end in zip(first, last, strict=True))
    n_channels = len(header["channels"])
    check_memory(
        8.0 * n_channels * width * height,
        f"the {n_channels} channels of {width} x {height} pixels of {path}",
        "it may be damaged",
    )


def _write(file: OpenEXR.File, path: Path) -> None:
    """Write an EXR file to a path of any name; OpenEXR takes names in UTF-8 alone."""
    try:
        in_utf8 = str(path).encode() == os.fsencode(path)
    except UnicodeEncodeError:
        in_utf8 = False
    if in_utf8:
        file.write(str(path))
    else:
        content = io.BytesIO()
        file.write(content)
        path.write_bytes(content.getvalue())


def srgb(linear: ArrayLike) -> Floats:
    """Display values of linear values clipped to [0, 1] (IEC 61966-2-1)."""
    linear = np.clip(float_array(linear, "linear"), 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def _channel_names(layer: str) -> tuple[str, ...]:
    return _CHANNELS.get(layer, tuple(f"{layer}.{c}" for c in "RGB"))


def _group(channels: dict[str, NDArray]) -> dict[str, NDArray]:
    """Layers of channels; a channel that belongs to no other is a layer by itself."""
    layers = {}
    left = dict(channels)
    for name in _triple_names(channels):
        layers[name] = np.stack([left.pop(c) for c in _channel_names(name)], axis=-1)
    return layers | left


def _triple_names(channels: Iterable[str]) -> list[str]:
    present = set(channels)
    candidates = [*_CHANNELS, *(c[:-2] for c in present if c.endswith(".R"))]
    return [
        name
        for name in candidates
        # If a channel has this name already, the three are layers by themselves.
        if present.issuperset(_channel_names(name)) and name not in present
    ]


def _checked_layer(name: str, layer: ArrayLike) -> Floats:
    if not isinstance(name, str) or not name:
        raise TypeError(f"names of layers should be text, but one is {name!r}")
    values = float_array(layer, f"layer {name}", finite=False)
    if values.ndim not in (2, 3) or values.shape[2:] not in ((), (3,)) or values.size == 0:
        raise ValueError(
            f"layer {name} should have shape (height, width) or (height, width, 3), "
            f"but has {values.shape}"
        )
    return values


def _check_to_write(name: str, values: Floats) -> None:
    if name in _CHANNELS and values.ndim == 2:
        raise ValueError(f"layer {name} should have three values per pixel, but has one")
    bad = ~(np.abs(values) <= _MAX_FLOAT32)
    if name in MAY_BE_INFINITE:
        bad &= values != np.inf
    if bad.any():
        row, column = np.argwhere(bad)[0][:2]
        raise ValueError(
            f"layer {name} should hold finite float32 values, but {bad.sum()} are not: "
            f"the first, at row {row} and column {column}, is {values[bad][0]}"
        )


def _checked_exposure(exposure: float) -> float:
    stops = float(float_array(exposure, "exposure", ()))
    if abs(stops) > MAX_EXPOSURE:
        raise ValueError(
            f"exposure should be between -{MAX_EXPOSURE:g} and {MAX_EXPOSURE:g} stops, "
            f"but is {stops:g}"
        )
    return stops


def _checked_metadata(metadata: Mapping[str, str]) -> dict[str, str]:
    for key, value in metadata.items():
        if not isinstance(key, str) or not isinstance(value, str):
            raise TypeError(f"metadata should be text, but {key!r} is {value!r}")
        if not key or key in _RESERVED:
            raise ValueError(
                f"metadata should not use {key!r}, a name EXR files keep for themselves"
            )
    return dict(metadata)
