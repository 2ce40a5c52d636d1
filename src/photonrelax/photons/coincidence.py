"""Photons at the same point, as of programs that round positions or store a beam at its axis.

They count as one photon with the sum of their flux: a distance to the k-th photon is one to the
k-th place. Only positions that are equal to the bit coincide. Trees say whether any may
(``Tree.may_coincide``), so that maps without such photons are not searched for them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats

_MIXERS = tuple(np.uint64(odd) for odd in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9))
_SHIFT = np.uint64(31)


class Distinct(NamedTuple):
    """Photons that stand for others at the same point.

    Attributes
    ----------
    rows : (m,) intp array
        The first photon of each point.
    merged, first : (r,) intp arrays
        The other photons, and which of `rows` stands for each.
    """

    rows: NDArray[np.intp]
    merged: NDArray[np.intp]
    first: NDArray[np.intp]

    def repeat(self, *columns: NDArray) -> None:
        """Copy the rows of photons that stand for others, of some columns, to those."""
        for column in columns:
            column[self.merged] = column[self.first]


def distinct_photons(
    rows: NDArray[np.intp],
    columns: Sequence[NDArray],
    normal: Floats | None = None,
    *,
    max_chord: float,
) -> Distinct | None:
    """The photons of `rows` (n,) that differ in a column, or face different ways.

    Parameters
    ----------
    rows : (n,) intp array
        Rows of the photons.
    columns : sequence of (n,) or (n, c) arrays
        Positions, and whatever else has to be equal.
    normal : (n, 3) float array, optional
        Unit normals, of which the chord is no more than `max_chord`.

    Returns
    -------
    Distinct or None
        None if all are.
    """
    first = first_equal_rows(columns)
    if first is not None and normal is not None:
        first = _first_facing_rows(first, normal, max_chord)
    if first is None:
        return None
    alone = first == np.arange(len(rows))
    return Distinct(rows[alone], rows[~alone], rows[first[~alone]])


def first_equal_rows(columns: Sequence[NDArray]) -> NDArray[np.intp] | None:
    """First row (n,) that has the values of each row in all columns (n, c).

    None if no two rows are equal.
    """
    # Minus zero is zero.
    table = np.column_stack([np.asarray(column, dtype=np.float64) + 0.0 for column in columns])
    key = row_hashes(table)
    order = np.argsort(key, kind="stable")
    equal = key[order][1:] == key[order][:-1]
    # Most rows differ in their hashes.
    pairs = np.flatnonzero(equal)
    equal[pairs] = (table[order[pairs]] == table[order[pairs + 1]]).all(axis=1)
    if not equal.any():
        return None
    start = np.flatnonzero(np.concatenate([[True], ~equal]))
    first = np.empty(len(table), dtype=np.intp)
    first[order] = np.repeat(order[start], np.diff(start, append=len(table)))
    return first


def row_hashes(table: Floats) -> NDArray[np.uint64]:
    """Hashes (n,) of the rows of a table (n, c), 64 bits."""
    key = np.zeros(len(table), dtype=np.uint64)
    for column in table.T:
        for mixer in _MIXERS:
            key += np.ascontiguousarray(column).view(np.uint64)
            key *= mixer
            key ^= key >> _SHIFT
    return key


def _first_facing_rows(
    first: NDArray[np.intp], normal: Floats, max_chord: float
) -> NDArray[np.intp]:
    """`first` (n,), but where unit normals differ by more than `max_chord`.

    Photons turned away from the first at their point are one with the first of themselves.
    """
    first = first.copy()
    merged = np.flatnonzero(first != np.arange(len(first)))
    while len(merged):
        chord = normal[merged] - normal[first[merged]]
        merged = merged[np.square(chord).sum(axis=1) > max_chord**2]
        _, index, inverse = np.unique(first[merged], return_index=True, return_inverse=True)
        first[merged] = merged[index][inverse]
    return first
