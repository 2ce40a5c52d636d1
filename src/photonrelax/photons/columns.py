"""Columns of large tables on disk: read and written by ranges of rows, and mapped no longer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import DTypeLike, NDArray


@dataclass(frozen=True)
class ColumnFolder:
    """A folder of columns of n rows, an ``.npy`` file each.

    Pages of a file that stays mapped count as memory of the process: files are mapped for the time
    of a call.
    """

    folder: Path
    n_rows: int

    def __contains__(self, name: str) -> bool:
        return self._path(name).exists()

    def create(self, name: str, dtype: DTypeLike, width: Sequence[int] = ()) -> None:
        """A column without content; zeros, in which no disk is used."""
        shape = (self.n_rows, *width)
        if self.n_rows:
            np.lib.format.open_memmap(self._path(name), mode="w+", dtype=dtype, shape=shape)
        else:
            np.save(self._path(name), np.zeros(shape, dtype))

    def like(self, name: str, other: str) -> None:
        """A column without content, of the dtype and width of another."""
        mapped = self.mapped(other)
        self.create(name, mapped.dtype, mapped.shape[1:])

    def rename(self, name: str, new: str) -> None:
        """Give a column another name, in place of one that had it."""
        self._path(name).replace(self._path(new))

    def remove(self, *names: str) -> None:
        """Remove columns; those that there are not are left out."""
        for name in names:
            self._path(name).unlink(missing_ok=True)

    def read(self, name: str, start: int = 0, stop: int | None = None) -> NDArray:
        """Rows of a column, copied."""
        return self.mapped(name)[start:stop].copy()

    def take(self, name: str, rows: NDArray[np.intp]) -> NDArray:
        """Some rows (m,) of a column, ascending."""
        return self.mapped(name)[rows]

    def write(self, name: str, start: int, values: NDArray) -> None:
        """Write rows of a column from one on."""
        if len(values):
            self.mapped(name, "r+")[start : start + len(values)] = values

    def put(self, name: str, rows: NDArray[np.intp], values: NDArray) -> None:
        """Write some rows (m,) of a column."""
        if len(rows):
            self.mapped(name, "r+")[rows] = values

    def mapped(self, name: str, mode: Literal["r", "r+"] = "r") -> NDArray:
        """A whole column, mapped for as long as the array is held."""
        path = self._path(name)
        try:
            # Files without rows cannot be mapped.
            mapped: NDArray = np.load(path, mmap_mode=mode if self.n_rows else None)
        except (OSError, ValueError) as error:
            raise ValueError(f"{path} cannot be read as a column: {error}") from None
        if len(mapped) != self.n_rows:
            raise ValueError(f"{path} should have {self.n_rows} rows, but has {len(mapped)}")
        # Slices of a `memmap` are slow.
        return mapped.view(np.ndarray)

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
            rows, first = column[order], 0
            for number in np.flatnonzero(n_rows):
                stop = first + n_rows[number]
                self._columns.write(name, int(self._next[number]), rows[first:stop])
                first = stop
        self._next += n_rows
