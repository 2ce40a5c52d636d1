"""Values for other processes: pickled once, mapped from a file or unpacked, and kept by digest."""

from __future__ import annotations

import mmap
import os
import pickle
import warnings
from collections import OrderedDict
from collections.abc import Callable, Iterator
from functools import cached_property
from hashlib import blake2b
from pathlib import Path
from threading import RLock
from typing import Any, TypeVar

import numpy as np

Value = TypeVar("Value")

# Values that a process keeps: a few scenes with what was prepared of each.
_MOST_KEPT = 8
# Bytes of read-only arrays from which on they are mapped, not copied; alignment in a file.
_MAPPED, _ALIGNMENT = 4096, 64

_kept: OrderedDict[str, Any] = OrderedDict()
# Building a value may ask for other kept values.
_lock = RLock()


def kept(key: str, build: Callable[[], Value]) -> Value:
    """The value of a key that this process has built before, or builds now.

    Of many keys those that were used last are kept.
    """
    with _lock:
        if key not in _kept:
            _kept[key] = build()
        _kept.move_to_end(key)
        while len(_kept) > _MOST_KEPT:
            _kept.popitem(last=False)
        value: Value = _kept[key]
        return value


def is_kept(key: str) -> bool:
    """True if this process has the value of a key."""
    return key in _kept


class Parcel:
    """A value on its way to other processes.

    Large read-only arrays lie outside of its pickle, so that they are mapped from a file and shared
    by all processes of a machine. Others are copied: whoever gets them may write to them.

    Attributes
    ----------
    digest : str
        Of the value's bytes.
    n_bytes : int
    """

    def __init__(self, value: Any) -> None:
        arrays: list[memoryview] = []
        try:
            head = pickle.dumps(value, 5, buffer_callback=lambda given: _copied(given, arrays))
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise TypeError(
                f"what workers are sent should be picklable, but is not: {error}; classes and "
                "functions have to be those of modules that workers can import"
            ) from error
        self._pieces = [memoryview(head), *arrays]
        digest = blake2b(digest_size=16)
        for piece in self._pieces:
            digest.update(piece)
        self.digest = digest.hexdigest()

    @property
    def n_bytes(self) -> int:
        return sum(len(chunk) for chunk in self._chunks())

    def write(self, path: Path) -> None:
        """Write the parcel to a new file."""
        with path.open("xb") as file:
            file.writelines(self._chunks())

    def to_bytes(self) -> bytes:
        """The parcel as the file would be."""
        return b"".join(self._chunks())

    def _chunks(self) -> Iterator[bytes | memoryview]:
        """Number of pieces, their sizes and the pieces, each padded to whole alignments."""
        sizes = [len(self._pieces), *(piece.nbytes for piece in self._pieces)]
        pieces: list[bytes | memoryview] = [np.array(sizes, dtype="<i8").tobytes(), *self._pieces]
        for piece in pieces:
            yield piece
            yield bytes(-len(piece) % _ALIGNMENT)


def _copied(given: pickle.PickleBuffer, arrays: list[memoryview]) -> bool:
    """Append an array to those outside of the pickle, or return True."""
    raw = given.raw()
    if not raw.readonly or raw.nbytes < _MAPPED:
        return True
    arrays.append(raw)
    return False


def unpack(content: bytes | memoryview) -> Any:
    """Value of a parcel's bytes, whose read-only arrays are parts of these."""
    view = memoryview(content)
    n_pieces = int(np.frombuffer(view, "<i8", 1)[0])
    sizes = np.frombuffer(view, "<i8", 1 + n_pieces)[1:].tolist()
    start, pieces = _padded(8 * (1 + n_pieces)), []
    for size in sizes:
        pieces.append(view[start : start + size])
        start += _padded(size)
    with warnings.catch_warnings():
        # Whoever sent the value has been warned of it.
        warnings.simplefilter("ignore")
        return pickle.loads(pieces[0], buffers=pieces[1:])


def unpack_file(path: str | os.PathLike[str]) -> Any:
    """Value of a parcel's file, whose read-only arrays are mapped."""
    with Path(path).open("rb") as file:
        return unpack(memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)))


def _padded(size: int) -> int:
    return size + -size % _ALIGNMENT


def state_without_caches(instance: object) -> dict[str, Any]:
    """State of an instance, for pickles, without its cached properties: they are found again.

    So equal values have equal parcels, whatever of them has been used.
    """
    kind = type(instance)
    return {
        name: value
        for name, value in vars(instance).items()
        if not isinstance(getattr(kind, name, None), cached_property)
    }
