"""Points in an order in which those that follow each other are near."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ids = NDArray[np.intp]

_BITS = 21
# Steps that move apart the bits of a 21-bit number until two zeros follow each.
_SPREAD = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def morton_order(points: Floats) -> Ids:
    """Return rows of points (n, 2|3) in the order of a Z-curve through cells of equal sides."""
    low = points.min(axis=0)
    cells = (points - low) * ((2**_BITS - 1) / max(np.ptp(points, axis=0).max(), 1e-300))
    code = np.zeros(len(points), dtype=np.uint64)
    for axis, column in enumerate(cells.astype(np.uint64).T):
        code |= _spread(column) << np.uint64(axis)
    return np.argsort(code, kind="stable")


def _spread(bits: NDArray[np.uint64]) -> NDArray[np.uint64]:
    for shift, mask in _SPREAD:
        bits = (bits | (bits << np.uint64(shift))) & np.uint64(mask)
    return bits
