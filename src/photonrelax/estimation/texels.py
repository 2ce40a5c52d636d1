"""Rectangles that are divided into texels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._util.validation import Floats


class TexelGrid(NamedTuple):
    """Rectangle in space that is divided into texels.

    Attributes
    ----------
    origin, u, v : (3,) float arrays
        A corner, and the sides from there, m; perpendicular to each other.
    shape : (int, int)
        Texels along u and along v.
    normal : (3,) float array
        Unit vector, along u × v or against it.
    """

    origin: Floats
    u: Floats
    v: Floats
    shape: tuple[int, int]
    normal: Floats

    @property
    def edges(self) -> Floats:
        """Edges (2, 3) of a texel, m."""
        return np.array([self.u / self.shape[0], self.v / self.shape[1]])

    def centres(self, rows: range) -> Floats:
        """Centres (n, 3) of the texels of some rows, row by row."""
        (nx, _), (across, along) = self.shape, self.edges
        columns = (np.arange(nx) + 0.5)[:, np.newaxis] * across
        row = (np.array(rows) + 0.5)[:, np.newaxis] * along
        centres: Floats = (self.origin + row[:, np.newaxis] + columns).reshape(-1, 3)
        return centres
