"""Read-only arrays and fields of frozen dataclasses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]


def set_field(instance: object, name: str, value: object) -> None:
    """Set a field of a frozen dataclass, from its ``__post_init__``."""
    object.__setattr__(instance, name, value)


def frozen(array: NDArray) -> NDArray:
    """Read-only array with no writable owner; copied only if it has one."""
    owner = array if array.base is None else array.base
    if not isinstance(owner, np.ndarray) or owner.flags.writeable:
        array = array.copy()
    return read_only(array)


def read_only(array: NDArray) -> NDArray:
    """The array itself, made read-only."""
    array.setflags(write=False)
    return array
