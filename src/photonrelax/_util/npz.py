"""NumPy archives: atomic writing, and reading of files that may be damaged or of anyone."""

from __future__ import annotations

import math
import os
import struct
import warnings
import zipfile
import zlib
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from .files import open_file, whole_file
from .memory import check_memory

# Raised by zipfile, zlib and NumPy where an archive is damaged.
_DAMAGED = (
    *(ValueError, TypeError, EOFError, RuntimeError, OSError, LookupError, OverflowError),
    *(zipfile.BadZipFile, zlib.error, struct.error, SyntaxError, TokenError),
)
_COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_SUFFIX = ".npy"
# Headers of plain arrays are shorter; NumPy's parser takes long over longer ones.
_MAX_HEADER = 1000
_KIND_NAMES = {"iu": "integer", "b": "truth value", "U": "text", "f": "number"}


def write_npz(path: Path, arrays: Mapping[str, Any], *, sync: bool = False) -> None:
    """Write an archive atomically; with `sync` it is on disk before it replaces another."""
    with whole_file(path) as partial, partial.open("wb") as file:
        np.savez(file, **arrays)
        if sync:
            file.flush()
            os.fsync(file.fileno())


def read_npz(path: Path, names: Collection[str] | None = None) -> dict[str, NDArray]:
    """Return the arrays of an archive, all or those of some names that it has.

    Nothing is unpickled, and no memory is allocated but for bytes that are in the file.

    Raises
    ------
    OSError
        If it cannot be opened, or is no regular file.
    ValueError
        If it is damaged or no archive of plain arrays.
    MemoryError
        If the arrays do not fit in memory.
    """
    with open_file(path) as stream:
        try:
            with zipfile.ZipFile(stream) as archive, warnings.catch_warnings():
                # Of NumPy, about headers that are strange.
                warnings.simplefilter("ignore")
                members = _members(archive, names)
                n_bytes = sum(member.file_size for member in members.values())
                check_memory(n_bytes, f"the arrays of {path}", "it may be another file")
                return {name: _array(archive, member) for name, member in members.items()}
        except _DAMAGED as error:
            raise ValueError(_reason(path, error)) from None


def _members(archive: zipfile.ZipFile, names: Collection[str] | None) -> dict[str, zipfile.ZipInfo]:
    """Members of an archive by the names of their arrays."""
    members = {info.filename.removesuffix(_SUFFIX): info for info in archive.infolist()}
    return {name: info for name, info in members.items() if names is None or name in names}


def _array(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> NDArray:
    if info.compress_type not in _COMPRESSIONS:
        raise ValueError(f"{info.filename} is compressed in a way that NumPy does not write")
    with archive.open(info) as member:
        _check_header(member, info)
    with archive.open(info) as member:
        array: NDArray = np.lib.format.read_array(
            member, allow_pickle=False, max_header_size=_MAX_HEADER
        )
    return array


def _check_header(member: IO[bytes], info: zipfile.ZipInfo) -> None:
    """Raise ValueError unless an array is plain, and its bytes are as many as it should have."""
    version = np.lib.format.read_magic(member)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"{info.filename} is no plain array")
    read = getattr(np.lib.format, f"read_array_header_{version[0]}_0")
    shape, _, dtype = read(member, max_header_size=_MAX_HEADER)
    if dtype.kind not in "biufcSU" or dtype.itemsize == 0:
        raise ValueError(f"{info.filename} should be a plain array, but its dtype is {dtype}")
    stated, there = math.prod(shape) * dtype.itemsize, info.file_size - member.tell()
    if min(shape, default=0) < 0 or stated != there:
        raise ValueError(
            f"{info.filename} should have {stated:,} bytes for its shape {shape}, but has {there:,}"
        )


def _reason(path: Path, error: BaseException) -> str:
    if path.stat().st_size == 0:
        return "it is empty"
    return " ".join(str(error).split()) or type(error).__name__


def check_names(arrays: Mapping[str, NDArray], names: Sequence[str]) -> None:
    """Raise ValueError if one of the names is missing."""
    missing = [name for name in names if name not in arrays]
    if missing:
        raise ValueError(f"it has no {', '.join(missing)}")


def scalar(arrays: Mapping[str, NDArray], name: str, kinds: str) -> Any:
    """Return the value of a 0-d array, None if there is no such array.

    Raises
    ------
    ValueError
        If it has a shape, or a dtype of none of the `kinds`.
    """
    if name not in arrays:
        return None
    array = arrays[name]
    if array.shape != () or array.dtype.kind not in kinds:
        raise ValueError(
            f"{name} should be one {_KIND_NAMES[kinds]}, "
            f"but has shape {array.shape} and dtype {array.dtype}"
        )
    return array.item()
