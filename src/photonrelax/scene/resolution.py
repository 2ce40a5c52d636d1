"""Distance that ray casting resolves, which depends on the position: embree works in float32.

Rounding errors of float32 are in proportion to coordinates, so embree's frame has its origin where
the triangles are finest, and triangles that reach much farther from there than they come close are
split before they are rounded. `docs/methods/ray-casting.md` derives the bound.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._util.validation import Floats

# Rounding error of an intersection over the largest coordinate of its triangle: some 16 of float32.
ROUNDING = 1e-6
# Largest coordinate of a triangle over its least distance from the origin, after splitting.
MAX_SPREAD = 8.0


@dataclass(frozen=True, eq=False)
class Resolution:
    """Distance that rays resolve, by position.

    Attributes
    ----------
    origin : (3,)
        Where the triangles are finest, m.
    radius : float
        Root mean square distance of triangles from the origin, the finest weighing most, m.
    """

    origin: Floats
    radius: float

    @classmethod
    def of(cls, corners: Floats) -> Resolution:
        """Return the resolution of triangles with corners (f, 3, 3).

        Triangles weigh by the inverse square of their longest edge, so a floor outweighs nothing
        that stands on it, however far it reaches.
        """
        low = corners.min(axis=(0, 1))
        corners = corners - low
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        weight = (longest.min() / longest) ** 2
        centre = corners.mean(axis=1)
        origin = weight @ centre / weight.sum()
        square = ((corners - origin) ** 2).sum(axis=2).mean(axis=1)
        return cls(low + origin, float(np.sqrt(weight @ square / weight.sum())))

    def at(self, position: Floats) -> Floats:
        """Return the distance, m, that is resolved at positions (..., 3)."""
        distance = np.abs(position - self.origin).max(axis=-1)
        return ROUNDING * MAX_SPREAD * np.maximum(distance, self.radius)
