"""Distance that ray casting resolves, which depends on the position: embree works in float32.

Rounding errors of float32 are in proportion to coordinates, so embree's frame has its origin where
the triangles are finest, and triangles that reach much farther from there than they come close are
split before they are rounded. `docs/methods/ray-casting.md` derives the bound.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats
from .meshes import corners_by_axis, longest_squared, squared

# Rounding error of an intersection over the largest coordinate of its triangle: some 16 of float32.
ROUNDING = 1e-6
# Largest coordinate of a triangle over its least distance from the origin, after splitting: a floor
# some twenty times as wide as what stands on it need not be split.
MAX_SPREAD = 32.0


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
    def of(cls, vertices: Floats, faces: NDArray) -> Resolution:
        """Return the resolution of triangles, given vertices (v, 3) and their indices (f, 3).

        Triangles weigh by the inverse square of their longest edge, so a floor outweighs nothing
        that stands on it, however far it reaches.
        """
        low = vertices.min(axis=0)
        a, b, c = corners_by_axis(vertices - low, faces)
        longest = longest_squared(a, b, c)
        weight = longest.min() / longest
        weight /= weight.sum()
        origin = (a + b + c) @ weight / 3.0
        distance = sum(squared(corner - origin[:, np.newaxis]) for corner in (a, b, c)) / 3.0
        return cls(low + origin, float(np.sqrt(weight @ distance)))

    def at(self, position: Floats) -> Floats:
        """Return the distance, m, that is resolved at positions (..., 3)."""
        distance = np.abs(position - self.origin).max(axis=-1)
        return ROUNDING * MAX_SPREAD * np.maximum(distance, self.radius)
