"""glTF 2.0 files: the JSON, the buffers, and arrays in them.

No memory is taken but for bytes that are there, and nothing is read outside of the file's folder.
"""

from __future__ import annotations

import base64
import binascii
import struct
from pathlib import Path
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from ..._util.validation import Floats
from ..json_entry import JsonEntry, parse
from ..sources import read_beside, read_whole

MAGIC = b"glTF"
_JSON, _BIN = b"JSON", b"BIN\x00"
_HEADER = struct.Struct("<4sII")
_CHUNK = struct.Struct("<I4s")
# NumPy's types by componentType, and numbers in an element by type.
_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


class GltfFile:
    """A glTF file, ``.glb`` or ``.gltf``.

    Attributes
    ----------
    path : Path
    root : JsonEntry
        The JSON.

    Raises
    ------
    OSError
        If it cannot be read.
    ValueError
        If it is not glTF 2, or cut off.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        content = read_whole(path)
        self._binary: bytes | None = None
        text = content
        if content[:4] == MAGIC:
            text, self._binary = _chunks(content, str(path))
        self.root = parse(text, str(path))
        version = self.root.entry("asset").text("version")
        if not version.startswith("2."):
            raise ValueError(f"{path} should be glTF of version 2, but its version is {version!r}")
        self._buffers: dict[int, bytes] = {}
        self._entries: dict[str, list[JsonEntry]] = {}

    def array(self, index: int) -> NDArray:
        """Numbers of an accessor, (n,) or (n, width), normalised ones as floats.

        Raises
        ------
        ValueError
            If it is not all in the file.
        """
        accessor = self.at("accessors", index)
        dtype = _COMPONENTS.get(accessor.count("componentType"))
        width = _WIDTHS.get(accessor.text("type"))
        if dtype is None or width is None:
            raise ValueError(
                f"{accessor.where} should hold numbers or vectors, but has componentType "
                f"{accessor.value('componentType')} and type {accessor.value('type')!r}"
            )
        found = self._view(accessor, np.dtype(dtype), accessor.count("count"), width)
        if "sparse" in accessor:
            found = self._with_sparse(found, accessor.entry("sparse"), width)
        if accessor.flag("normalized") and found.dtype.kind in "iu":
            found = np.maximum(found / float(np.iinfo(found.dtype).max), -1.0)
        return found[:, 0] if width == 1 else found

    def floats(self, index: int, width: int) -> Floats:
        """Finite numbers (n, width) of an accessor.

        Raises
        ------
        ValueError
            If there are others in it.
        """
        found = self.array(index)
        if found.shape[1:] != (width,):
            raise ValueError(
                f"{self.path}.accessors[{index}] should hold vectors of {width}, "
                f"but has shape {found.shape}"
            )
        with np.errstate(invalid="ignore"):
            numbers = found.astype(np.float64)
        wrong = np.flatnonzero(~np.isfinite(numbers).all(axis=1))
        if len(wrong):
            raise ValueError(
                f"{self.path}.accessors[{index}] should be finite, but {len(wrong)} of its "
                f"{len(numbers)} vectors are not, the first of them {wrong[0]}"
            )
        return numbers

    def bytes_of_view(self, index: int) -> bytes:
        """Bytes of a bufferView."""
        view = self.at("bufferViews", index)
        buffer, start, length = self._extent(view)
        return buffer[start : start + length]

    def read_uri(self, entry: JsonEntry) -> bytes:
        """Bytes of the ``uri`` of a buffer or image: data in the JSON, or a file beside it.

        Raises
        ------
        ValueError
            If it leads out of the file's folder.
        OSError
            If there is no such file.
        """
        uri = entry.text("uri")
        if uri.startswith("data:"):
            head, comma, data = uri.partition(",")
            try:
                if comma and head.endswith(";base64"):
                    return base64.b64decode(data, validate=True)
            except binascii.Error:
                pass
            raise entry.error("uri", "a file's name or base64 data")
        return read_beside(self.path, unquote(uri), f"{entry.where}.uri")

    def _with_sparse(self, dense: NDArray, sparse: JsonEntry, width: int) -> NDArray:
        n = sparse.count("count", high=len(dense))
        places, values = sparse.entry("indices"), sparse.entry("values")
        index_type = _COMPONENTS.get(places.count("componentType"), "")
        if index_type not in ("<u1", "<u2", "<u4"):
            raise places.error("componentType", "one of unsigned integers")
        at = self._view(places, np.dtype(index_type), n, 1)[:, 0]
        if n and at.max() >= len(dense):
            raise ValueError(f"{places.where} should be below {len(dense)}, but one is {at.max()}")
        changed = dense.copy()
        changed[at] = self._view(values, dense.dtype, n, width)
        return changed

    def _view(self, entry: JsonEntry, dtype: np.dtype, n: int, width: int) -> NDArray:
        """Numbers (n, width) of a bufferView from ``byteOffset`` of an accessor on."""
        index = entry.index("bufferView", len(self.entries("bufferViews")))
        if index is None:
            raise ValueError(f"{entry.where} should have a bufferView with its numbers")
        view = self.at("bufferViews", index)
        buffer, start, length = self._extent(view)
        size = width * dtype.itemsize
        stride = view.count("byteStride", size) or size
        offset = entry.count("byteOffset", 0)
        if stride < size or (n and offset + (n - 1) * stride + size > length):
            raise ValueError(
                f"{entry.where} should have {n} elements of {size} bytes, {stride} apart from "
                f"byte {offset} of {view.where}, but that has {length} bytes"
            )
        if n == 0:
            return np.empty((0, width), dtype)
        strides = (stride, dtype.itemsize)
        return np.ndarray((n, width), dtype, buffer, start + offset, strides)

    def _extent(self, view: JsonEntry) -> tuple[bytes, int, int]:
        """Buffer of a bufferView, and where its bytes start and how many they are."""
        index = view.index("buffer", len(self.entries("buffers")))
        if index is None:
            raise view.error("buffer", "the index of a buffer")
        buffer = self._buffer(index)
        start, length = view.count("byteOffset", 0), view.count("byteLength")
        if start + length > len(buffer):
            raise ValueError(
                f"{view.where} should lie in its buffer of {len(buffer)} bytes, but is of bytes "
                f"{start} to {start + length}"
            )
        return buffer, start, length

    def _buffer(self, index: int) -> bytes:
        if index not in self._buffers:
            entry = self.at("buffers", index)
            content = self.read_uri(entry) if "uri" in entry else self._binary
            n = entry.count("byteLength")
            if content is None or len(content) < n or (index and "uri" not in entry):
                found = "none" if content is None else f"{len(content)}"
                raise ValueError(f"{entry.where} should have {n} bytes, but {found} are there")
            self._buffers[index] = content[:n]
        return self._buffers[index]

    def at(self, key: str, index: int) -> JsonEntry:
        """One of the objects of a list of the root."""
        entries = self.entries(key)
        if index >= len(entries):
            raise ValueError(
                f"{self.path}.{key} should have number {index}, but has {len(entries)}"
            )
        return entries[index]

    def entries(self, key: str) -> list[JsonEntry]:
        """The objects of a list of the root."""
        if key not in self._entries:
            self._entries[key] = self.root.entries(key)
        return self._entries[key]


def _chunks(content: bytes, name: str) -> tuple[bytes, bytes | None]:
    """JSON and binary chunk of a GLB file."""
    if len(content) < _HEADER.size + _CHUNK.size:
        raise ValueError(f"{name} should be a GLB file, but is cut off in its header")
    _, version, total = _HEADER.unpack_from(content)
    if version != 2 or total > len(content):
        raise ValueError(
            f"{name} should be a GLB file of version 2 and {len(content)} bytes, but says that it "
            f"is of version {version} and {total} bytes"
        )
    found: dict[bytes, bytes] = {}
    at = _HEADER.size
    while at + _CHUNK.size <= total:
        n, kind = _CHUNK.unpack_from(content, at)
        at += _CHUNK.size
        if at + n > total:
            raise ValueError(f"{name} is cut off in a chunk of {n} bytes")
        found.setdefault(kind, content[at : at + n])
        at += n
    if _JSON not in found:
        raise ValueError(f"{name} should have a JSON chunk, but has none")
    return found[_JSON], found.get(_BIN)
