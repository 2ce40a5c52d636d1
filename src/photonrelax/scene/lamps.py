"""Lamps: emitters that kernels evaluate, points and parallel light."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats

if TYPE_CHECKING:
    from .emitters import Emitter

PARALLEL, UNIFORM, COSINE, SPOT = range(4)
"""Kinds of lamps: parallel light; points that shine alike in all directions, by the cosine to an
axis, or as a spot. Kernels have the same numbers."""


class Lamp(NamedTuple):
    """Light of an emitter that kernels evaluate.

    Attributes
    ----------
    kind : int
        `PARALLEL`, `UNIFORM`, `COSINE` or `SPOT`.
    intensity : (3,) float64
        On the axis, W/sr; of parallel light on a plane across it, W/m².
    position : (3,) float64
        Of a point, m.
    axis : (3,) float64
        Unit vector that light leaves along; zero where all directions are alike.
    inner, outer : float
        1 - cos of the angles to the axis between which the intensity of a spot falls to zero;
        `outer` of others that shine in some directions only.
    """

    kind: int
    intensity: Floats
    position: Floats = np.zeros(3)
    axis: Floats = np.zeros(3)
    inner: float = 0.0
    outer: float = 2.0


@dataclass(frozen=True, eq=False)
class LampTable:
    """Lamps as arrays, a row each.

    Attributes
    ----------
    emitter_id : (n,) intp array
    kind : (n,) uint8 array
    intensity, position, axis : (n, 3) float64 arrays
    inner, outer : (n,) float64 arrays
        As of `Lamp`.
    """

    emitter_id: NDArray[np.intp]
    kind: NDArray[np.uint8]
    intensity: Floats
    position: Floats
    axis: Floats
    inner: Floats
    outer: Floats

    @classmethod
    def of(cls, emitters: Iterable[Emitter]) -> LampTable:
        """The lamps among some emitters; those that are black are left out."""
        lamps = [(i, emitter.lamp) for i, emitter in enumerate(emitters)]
        rows = [(i, lamp) for i, lamp in lamps if lamp is not None]
        columns = {
            name: np.array([getattr(lamp, name) for _, lamp in rows], dtype=np.float64)
            for name in ("intensity", "position", "axis")
        }
        table = cls(
            np.array([i for i, _ in rows], dtype=np.intp),
            np.array([lamp.kind for _, lamp in rows], dtype=np.uint8),
            **{name: column.reshape(-1, 3) for name, column in columns.items()},
            inner=np.array([lamp.inner for _, lamp in rows], dtype=np.float64),
            outer=np.array([lamp.outer for _, lamp in rows], dtype=np.float64),
        )
        return table[np.flatnonzero(table.intensity.any(axis=1))]

    @property
    def brightness(self) -> Floats:
        """Sum of the channels of each, (n,), over that of the brightest."""
        total = self.intensity.sum(axis=1)
        return total / total.max()

    def __len__(self) -> int:
        return len(self.kind)

    def __getitem__(self, rows: NDArray) -> LampTable:
        """Some of the lamps, by their indices or a mask."""
        return LampTable(*(np.ascontiguousarray(column[rows]) for column in vars(self).values()))
