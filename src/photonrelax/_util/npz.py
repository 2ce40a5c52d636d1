"""NumPy archives: atomic writing, and checks of their arrays."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .files import whole_file

_KIND_NAMES = {"iu": "integer", "b": "truth value", "U": "text"}


def write_npz(path: Path, arrays: Mapping[str, Any], *, sync: bool = False) -> None:
    """Write an archive atomically; with `sync` it is on disk before it replaces another."""
    with whole_file(path) as partial, partial.open("wb") as file:
        np.savez(file, **arrays)
        if sync:
            file.flush()
            os.fsync(file.fileno())


def read_npz(path: Path) -> dict[str, NDArray]:
    """Return all arrays of an archive; raises one of `files.NOT_READABLE` if it is none."""
    with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
        # Members that are not arrays are read as bytes.
        return {name: np.asarray(file[name]) for name in file.files}


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
