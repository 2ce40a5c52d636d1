"""Nodes of a chart, traced once each, and the light that arrives from them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..._util.validation import Floats
from ...transport.aim import LUMINANCE
from ...transport.splitting import Arrivals, SplittingTracer
from .charts import Chart
from .sheets import FollowedSheets

Ids = NDArray[np.intp]
Places = NDArray[np.int64]

# Bits of the places of nodes within a cell of the first grid, and levels of elements.
DEPTH = 14
MAX_LEVEL = DEPTH - 1
UNIT = 1 << DEPTH


class Lattice:
    """Nodes at whole places (i, j) of a chart, kept in the order in which they were traced.

    Attributes
    ----------
    cells : (2,) int
        Cells of the first grid along u and v; each is 2**14 places wide.
    followed : FollowedSheets
        Those that nodes have arrivals of.
    arrivals : Arrivals
        Of all nodes, by node.
    light, luminance : (m, 3), (m,) float64
        W per area of the chart that arrives around them.
    first, count : (n_nodes,) intp
        Rows of the arrivals of each node.
    power : (n_nodes, 3)
        W per area of the chart.
    """

    def __init__(
        self, chart: Chart, tracer: SplittingTracer, followed: FollowedSheets, n_cells: int
    ) -> None:
        self.chart, self.followed, self._tracer = chart, followed, tracer
        aspect = chart.sides / np.sqrt(np.prod(chart.sides))
        cells = np.maximum(np.rint(np.sqrt(n_cells) * aspect), 1.0)
        self.cells: NDArray[np.int64] = cells.astype(np.int64)
        self._keys = np.empty(0, np.int64)
        self._rows = np.empty(0, np.intp)
        self.first = self.count = np.empty(0, np.intp)
        self.power = np.empty((0, 3))
        self.arrivals = Arrivals.none()
        self.light, self.luminance = np.empty((0, 3)), np.empty(0)

    @property
    def n_traced(self) -> int:
        """Rays traced so far, those of other lattices of the scene among them."""
        return self._tracer.n_rays

    def __len__(self) -> int:
        return len(self._keys)

    def in_unit(self, places: Floats | Places) -> Floats:
        """Places (n, 2) as points of the chart's unit square."""
        unit: Floats = places / (UNIT * self.cells)
        return unit

    def in_lattice(self, unit: Floats) -> Floats:
        """Points (n, 2) of the chart's unit square as places, which need not be whole."""
        places: Floats = unit * (UNIT * self.cells)
        return places

    def nodes(self, places: Places) -> Ids:
        """Nodes at places (n, 2); those not yet there are traced."""
        keys: NDArray[np.int64] = (places[:, 0] << 32) | places[:, 1]
        wanted: NDArray[np.int64]
        wanted, inverse = np.unique(keys, return_inverse=True)
        at = np.searchsorted(self._keys, wanted)
        known = np.zeros(len(wanted), dtype=bool)
        inside = at < len(self._keys)
        known[inside] = self._keys[at[inside]] == wanted[inside]
        new = wanted[~known]
        rows = np.empty(len(wanted), dtype=np.intp)
        rows[known] = self._rows[at[known]]
        rows[~known] = len(self) + np.arange(len(new))
        if len(new):
            self._add(new, at[~known])
        found: Ids = rows[inverse]
        return found

    def known_nodes(self, places: Places) -> Ids:
        """Nodes (n,) at places (n, 2), -1 where none is."""
        keys: NDArray[np.int64] = (places[:, 0] << 32) | places[:, 1]
        at = np.minimum(np.searchsorted(self._keys, keys), len(self) - 1)
        found: Ids = np.where(self._keys[at] == keys, self._rows[at], -1)
        return found

    def trace(self, places: Floats | Places) -> tuple[Arrivals, Floats]:
        """Arrivals of rays at places (n, 2) that may lie between nodes, and their power."""
        rays = self.chart.rays(self.in_unit(places))
        found = self._tracer.trace(
            rays.origin, rays.direction, self.followed.paths, self.chart.emitter_id
        )
        return found, rays.power

    def drop_unfollowed(self) -> Ids:
        """Leave out the arrivals of sheets that are not followed; new rows (m,) of the others."""
        kept = np.isin(self.arrivals.sheet, self.followed.sheets)
        self.arrivals = self.arrivals[kept]
        self.light, self.luminance = self.light[kept], self.luminance[kept]
        self.count = np.bincount(self.arrivals.node, minlength=len(self))
        self.first = np.cumsum(self.count) - self.count
        rows: Ids = np.where(kept, np.cumsum(kept) - 1, -1)
        return rows

    def _add(self, new: NDArray[np.int64], at: Ids) -> None:
        n_before = len(self)
        places = np.column_stack([new >> 32, new & 0xFFFFFFFF])
        found, power = self.trace(places)
        self._keys = np.insert(self._keys, at, new)
        self._rows = np.insert(self._rows, at, n_before + np.arange(len(new)))
        self.power = np.concatenate([self.power, power])
        count = np.bincount(found.node, minlength=len(new))
        first = len(self.arrivals) + np.cumsum(count) - count
        self.first, self.count = np.append(self.first, first), np.append(self.count, count)
        light = found.throughput * power[found.node]
        self.light = np.concatenate([self.light, light])
        self.luminance = np.concatenate([self.luminance, light @ LUMINANCE])
        self.arrivals = Arrivals.concatenate([self.arrivals, found.moved(n_before)])
