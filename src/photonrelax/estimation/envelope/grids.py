"""Footprints that are the texels of one grid: triangles are laid over all of them at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._ext.estimation import envelope_grid
from ..._util.validation import Floats

# Largest distance of centres from those of a grid, over the size of its texels.
_OFF = 1e-9
# Texels of a grid, at most, for each footprint.
_SPARSE = 4


class FootprintGrid(NamedTuple):
    """A rectangle of texels.

    Attributes
    ----------
    origin, edges, normal : (3,), (2, 3), (3,) float64
        A corner, the edges of a texel, m, and a vector on the side of the light.
    shape : (int, int)
        Texels along both edges.
    column, row : (m,) intp
        Texels that the footprints are, counted from the corner.
    """

    origin: Floats
    edges: Floats
    normal: Floats
    shape: tuple[int, int]
    column: NDArray[np.intp]
    row: NDArray[np.intp]

    @property
    def area(self) -> float:
        """Area of a texel, m²."""
        return float(np.linalg.norm(np.cross(*self.edges)))


class Footprints(NamedTuple):
    """Parallelograms around points, of which those of some rows are looked at.

    Attributes
    ----------
    centres, normals, edges : (m, 3), (m, 3), (m, 2, 3) float64
        m, and normals of any length.
    rows : (r,) intp
    """

    centres: Floats
    normals: Floats
    edges: Floats
    rows: NDArray[np.intp]

    @classmethod
    def of(
        cls, centres: Floats, normals: Floats, edges: Floats, rows: NDArray[np.intp]
    ) -> Footprints:
        """Footprints as kernels read them."""
        centres, normals, edges = map(np.ascontiguousarray, (centres, normals, edges))
        return cls(centres, normals, edges, rows)

    @property
    def grid(self) -> FootprintGrid | None:
        """The grid whose texels the footprints are; None if they are not of one."""
        places = np.empty((2, len(self.rows)))
        if not envelope_grid.places(*self, off=_OFF, out=places):
            return None
        low, high = (np.array([f(each) for each in places]) for f in (np.min, np.max))
        nx, ny = high - low + 1.0
        if nx * ny > _SPARSE * len(self.rows):
            return None
        first = self.rows[0]
        edges = self.edges[first]
        column, row = (places - low[:, np.newaxis]).astype(np.intp)
        return FootprintGrid(
            self.centres[first] + (low - 0.5) @ edges,
            *(edges, self.normals[first], (int(nx), int(ny)), column, row),
        )
