"""Columns of large tables on disk: read and written by ranges of rows, and mapped no longer."""

from __future__ import annotations

import mmap
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from .._util.parcels import state_without_caches


class _Layout(NamedTuple):
    """Rows of a column in its file: dtype, shape of a row, and the bytes before the first."""

    dtype: np.dtype
    width: tuple[int, ...]
    offset: int

    @property
    def row_bytes(self) -> int:
        return self.dtype.itemsize * int(np.prod(self.width))


@dataclass(frozen=True)
class ColumnFolder:
    """A folder of columns of n rows, an ``.npy`` file each.

    Pages of a file that stays mapped count as memory of the process: files are mapped for the time
    of a call.
    """

    folder: Path
    n_rows: int

    __getstate__ = state_without_caches

    def __contains__(self, name: str) -> bool:
        return self._path(name).exists()

    def create(self, name: str, dtype: DTypeLike, width: Sequence[int] = ()) -> None:
        """A column without content; zeros, in which no disk is used."""
        shape = (self.n_rows, *width)
        self._layouts.pop(name, None)
        if self.n_rows:
            np.lib.format.open_memmap(self._path(name), mode="w+", dtype=dtype, shape=shape)
        else:
            np.save(self._path(name), np.zeros(shape, dtype))

    def like(self, name: str, other: str) -> None:
        """A column without content, of the dtype and width of another."""
        layout = self._layout(other)
        self.create(name, layout.dtype, layout.width)

    def rename(self, name: str, new: str) -> None:
        """Give a column another name, in place of one that had it."""
        self._path(name).replace(self._path(new))
        self._layouts.pop(new, None)

    def remove(self, *names: str) -> None:
        """Remove columns; those that there are not are left out."""
        for name in names:
            self._path(name).unlink(missing_ok=True)
            self._layouts.pop(name, None)

    def read(self, name: str, start: int = 0, stop: int | None = None) -> NDArray:
        """Rows of a column."""
        start, stop, _ = slice(start, stop).indices(self.n_rows)
        layout, n = self._layout(name), max(stop - start, 0)
        with self._path(name).open("rb") as file:
            file.seek(layout.offset + start * layout.row_bytes)
            values = np.fromfile(file, layout.dtype, n * int(np.prod(layout.width)))
        return values.reshape(n, *layout.width)

    def take(self, name: str, rows: NDArray[np.intp]) -> NDArray:
        """Some rows (m,) of a column."""
        # Several times as fast as indexing, where rows are of several numbers.
        return np.take(self.mapped(name), rows, axis=0)

    def write(self, name: str, start: int, values: NDArray) -> None:
        """Write rows of a column from one on."""
        layout = self._layout(name)
        if values.shape[1:] != layout.width or start + len(values) > self.n_rows:
            raise ValueError(f"{values.shape} do not fit {self._path(name)} from row {start} on")
        if len(values):
            # Pages of a file that is mapped are fetched one by one.
            with self._path(name).open("r+b") as file:
                file.seek(layout.offset + start * layout.row_bytes)
                content = np.ascontiguousarray(values, layout.dtype).reshape(-1)
                file.write(content.view(np.uint8).data)

    def put(self, name: str, rows: NDArray[np.intp], values: NDArray) -> None:
        """Write some rows (m,) of a column."""
        if len(rows):
            np.load(self._path(name), mmap_mode="r+")[rows] = values

    def mapped(self, name: str) -> NDArray:
        """A whole column, mapped for as long as the array is held."""
        layout = self._layout(name)
        shape = self.n_rows, *layout.width
        if not self.n_rows:
            return np.empty(shape, layout.dtype)
        with self._path(name).open("rb") as file:
            content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        count = int(np.prod(shape))
        return np.frombuffer(content, layout.dtype, count, layout.offset).reshape(shape)

    @cached_property
    def _layouts(self) -> dict[str, _Layout]:
        return {}

    def _layout(self, name: str) -> _Layout:
        """Layout of a column, whose file is looked at once."""
        if name not in self._layouts:
            path = self._path(name)
            try:
                # Files without rows cannot be mapped.
                content: NDArray = np.load(path, mmap_mode="r" if self.n_rows else None)
            except (OSError, ValueError) as error:
                raise ValueError(f"{path} cannot be read as a column: {error}") from None
            if len(content) != self.n_rows:
                raise ValueError(f"{path} should have {self.n_rows} rows, but has {len(content)}")
            offset = content.offset if isinstance(content, np.memmap) else 0
            self._layouts[name] = _Layout(content.dtype, content.shape[1:], offset)
        return self._layouts[name]

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}.npy"


class Scatter:
    """Rows that arrive in any order, and are written to the block that each belongs to.

    The rows of a block are together, in the order of their arrival.
    """

    def __init__(self, columns: ColumnFolder, n_rows: NDArray[np.int64]) -> None:
        self._columns = columns
        self._next = np.cumsum(n_rows) - n_rows

    def write(self, block: NDArray[np.intp], **values: NDArray) -> None:
        """Write rows (m,) of some columns to their blocks (m,)."""
        order = np.argsort(block, kind="stable")
        n_rows = np.bincount(block, minlength=len(self._next))
        for name, column in values.items():
            rows, first = np.take(column, order, axis=0), 0
            for number in np.flatnonzero(n_rows):
                stop = first + n_rows[number]
                self._columns.write(name, int(self._next[number]), rows[first:stop])
                first = stop
        self._next += n_rows
