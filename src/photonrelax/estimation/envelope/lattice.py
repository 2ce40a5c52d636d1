"""Nodes of a chart, traced once each, and the light that arrives from them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..._util.validation import Floats
from ...transport.splitting import Arrivals, SplittingTracer
from .charts import Chart

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
    arrivals : Arrivals
        Of all nodes, by node; without single photons.
    singles : Arrivals
        Single photons.
    sheet : (m,) uint64
        Signature and receiver of the arrivals.
    light : (m, 3) float64
        W per area of the chart that arrives around them.
    first, count : (n_nodes,) intp
        Rows of the arrivals of each node.
    power : (n_nodes, 3)
        W per area of the chart.
    """

    def __init__(self, chart: Chart, tracer: SplittingTracer, n_cells: int) -> None:
        self._chart, self._tracer = chart, tracer
        aspect = chart.sides / np.sqrt(np.prod(chart.sides))
        cells = np.maximum(np.rint(np.sqrt(n_cells) * aspect), 1.0)
        self.cells: NDArray[np.int64] = cells.astype(np.int64)
        self._keys = np.empty(0, np.int64)
        self._rows = np.empty(0, np.intp)
        self.first = self.count = np.empty(0, np.intp)
        self.power = np.empty((0, 3))
        self.arrivals = self.singles = Arrivals.none()
        self.sheet = np.empty(0, np.uint64)
        self.light = np.empty((0, 3))

    def __len__(self) -> int:
        return len(self._keys)

    def in_unit(self, places: Floats | Places) -> Floats:
        """Places (n, 2) as points of the chart's unit square."""
        unit: Floats = places / (UNIT * self.cells)
        return unit

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

    def trace(self, places: Floats, key: NDArray[np.uint64]) -> tuple[Arrivals, Floats]:
        """Arrivals of rays at places (n, 2) that may lie between nodes, and their power."""
        rays = self._chart.rays(self.in_unit(places))
        return (
            self._tracer.trace(rays.origin, rays.direction, key, self._chart.emitter_id),
            rays.power,
        )

    def _add(self, new: NDArray[np.int64], at: Ids) -> None:
        n_before = len(self)
        places = np.column_stack([new >> 32, new & 0xFFFFFFFF])
        found, power = self.trace(places, new.astype(np.uint64))
        self._keys = np.insert(self._keys, at, new)
        self._rows = np.insert(self._rows, at, n_before + np.arange(len(new)))
        self.power = np.concatenate([self.power, power])
        singles, kept = found[found.is_single], found[~found.is_single]
        count = np.bincount(kept.node, minlength=len(new))
        first = len(self.arrivals) + np.cumsum(count) - count
        self.first, self.count = np.append(self.first, first), np.append(self.count, count)
        self.sheet = np.append(self.sheet, sheets_of(kept))
        self.light = np.concatenate([self.light, kept.throughput * power[kept.node]])
        self.arrivals = Arrivals.concatenate([self.arrivals, kept.moved(n_before)])
        self.singles = Arrivals.concatenate([self.singles, singles.moved(n_before)])


def sheets_of(arrivals: Arrivals) -> NDArray[np.uint64]:
    """Numbers (m,) that tell paths and the surfaces that light arrived on apart."""
    receiver = arrivals.object_id.astype(np.uint64) + np.uint64(1)
    sheets: NDArray[np.uint64] = arrivals.signature ^ (receiver * np.uint64(0x9E3779B97F4A7C15))
    return sheets
