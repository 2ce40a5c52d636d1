"""Irradiance of an envelope: means over footprints, by exact overlap."""

from __future__ import annotations

from dataclasses import asdict
from functools import cached_property

import numpy as np

from ..._ext.estimation import envelope as _kernel
from ..._ext.estimation import envelope_grid
from ..._util.parallel import thread_count
from ..._util.validation import Floats
from ..field import Densities, Field, PhotonField, Points
from ..texels import TexelGrid
from .elements import luminances
from .envelope import NOISE, Envelope
from .grids import FootprintGrid, Footprints
from .laying import square_edges

# Distance from the plane of a footprint, over its size, of light that still counts in it, and the
# cosine of the largest angle between their normals.
_LIMITS = {"thickness": 1.0, "least_cosine": 0.5}
# Footprints evaluated together: triangles are gone through once for all those of a grid.
_CHUNK = 1 << 18
# Triangles for each footprint of a grid, at most, that are all gone through.
_PER_TEXEL = 1000


class _Values:
    """Values of triangles (t, c), and densities of photons, if any."""

    def __init__(self, envelope: Envelope, values: Floats, photons: Densities | None) -> None:
        self._envelope, self.photons = envelope, photons
        self.of_triangles = np.ascontiguousarray(values)

    @cached_property
    def sums(self) -> Floats:
        """Sums (rows, c) over the nodes of the triangles' tree."""
        sums: Floats = _kernel.node_sums(self._envelope.tree.kernel, self.of_triangles)
        return sums


class EnvelopeField(Field):
    """A field whose elements are the triangles of an envelope, then its photons.

    Parameters
    ----------
    envelope : Envelope
        Of `trace_envelope`.
    rest : PhotonField, optional
        Of the envelope's photons.
    n_threads : int, optional
        Threads; all by default.

    Notes
    -----
    At points the estimate is the mean over a square as large as the envelope's footprint.
    """

    _chunk = _CHUNK

    def __init__(
        self, envelope: Envelope, rest: PhotonField | None = None, *, n_threads: int | None = None
    ) -> None:
        self.envelope, self.rest = envelope, rest
        self.seconds = dict(envelope.seconds)
        self.used = {"envelope": asdict(envelope.settings)}
        if rest is not None:
            self.seconds |= rest.seconds
            self.used |= rest.used
        self._n_threads = thread_count(n_threads)

    @cached_property
    def flux(self) -> Floats:
        """Flux (n, 3) of the triangles and photons, W."""
        if self.rest is None:
            return self.envelope.flux
        return np.concatenate([self.envelope.flux, self.rest.flux])

    @cached_property
    def _normals(self) -> Floats:
        """Bounds of the triangles' normals in the nodes of their tree."""
        bounds: Floats = _kernel.node_normals(self.envelope.tree.kernel, self.envelope.normal)
        return bounds

    @property
    def layers(self) -> dict[str, Floats]:
        """Shares (n, 1) of the light of each, by the layer's name.

        Of its error, as is estimated: misplaced light is missing in one place and too much in
        another. And of that of photons.
        """
        n_photons = len(self.flux) - len(self.envelope)
        luminance = luminances(self.envelope.flux)
        share = np.divide(
            self.envelope.misplaced, luminance, out=np.zeros(len(luminance)), where=luminance > 0.0
        )
        share = np.minimum(2.0 * share, 1.0)
        return {
            "envelope.error": np.append(share, np.full(n_photons, NOISE))[:, np.newaxis],
            "envelope.photons": np.repeat([0.0, 1.0], [len(share), n_photons])[:, np.newaxis],
        }

    @property
    def has_footprints(self) -> bool:
        return True

    def over_texels(self, grid: TexelGrid, rows: range) -> Floats:
        """Means (n, 3) over texels, without their footprints where triangles are gone through."""
        nx, n = grid.shape[0], grid.shape[0] * len(rows)
        if len(self.envelope) > _PER_TEXEL * n:
            return super().over_texels(grid, rows)
        edges = grid.edges
        origin = grid.origin + rows.start * edges[1]
        sums = self._sums_of_grid(self.envelope.flux, origin, edges, grid.normal, (nx, len(rows)))
        means: Floats = sums.reshape(n, -1) / np.linalg.norm(np.cross(*edges))
        if self.rest is not None:
            # There are no photons where there is no surface.
            means += np.nan_to_num(self.rest.over_texels(grid, rows), copy=False)
        return means

    def _lay_out(self, values: Floats, part: int) -> _Values:
        triangles, photons = np.split(values, [len(self.envelope)])
        rest = None if self.rest is None else self.rest.densities(photons)
        return _Values(self.envelope, triangles, rest)

    def _fill(self, out: Floats, values: Densities, points: Points) -> None:
        laid_out = values.laid_out(0)
        if len(self.envelope):
            self._fill_of_triangles(out, laid_out, points)
        if laid_out.photons is not None:
            rows = points.rows
            footprint = None if points.footprint is None else points.footprint[rows]
            found = laid_out.photons(
                points.queries[rows], points.normals[rows], footprint=footprint
            )
            # There are no photons where there is no surface.
            out[rows] += np.nan_to_num(found, copy=False)

    def _fill_of_triangles(self, out: Floats, values: _Values, points: Points) -> None:
        footprints = self._footprints(points)
        grid = None
        if len(self.envelope) <= _PER_TEXEL * len(points.rows):
            grid = footprints.grid
        if grid is None:
            out[points.rows] = self._means(values.sums, footprints)
        else:
            out[points.rows] = self._means_of_grid(values.of_triangles, grid)

    def _footprints(self, points: Points) -> Footprints:
        edges, rows = points.footprint, points.rows
        if edges is not None and edges.ndim == 3:
            return Footprints.of(points.queries, points.normals, edges, rows)
        normals = points.normals[rows]
        if edges is None:
            sides = np.full(len(rows), self.envelope.settings.footprint)
        else:
            sides = edges[rows]
        squares = square_edges(normals, sides)
        return Footprints.of(points.queries[rows], normals, squares, np.arange(len(rows)))

    def _means(self, sums: Floats, footprints: Footprints) -> Floats:
        """Means (r, c) over any footprints."""
        means = np.empty((len(footprints.rows), sums.shape[1]))
        _kernel.means(
            *(self.envelope.tree.kernel, self.envelope.position, self._normals, sums, *footprints),
            **_LIMITS,
            out=means,
            n_threads=self._n_threads,
        )
        return means

    def _means_of_grid(self, values: Floats, grid: FootprintGrid) -> Floats:
        """Means (r, c) over footprints that are the texels of a grid."""
        sums = self._sums_of_grid(values, grid.origin, grid.edges, grid.normal, grid.shape)
        means: Floats = sums[grid.row, grid.column] / grid.area
        return means

    def _sums_of_grid(
        self, values: Floats, origin: Floats, edges: Floats, normal: Floats, shape: tuple[int, int]
    ) -> Floats:
        """Sums (ny, nx, c) over the texels of a grid; see `FootprintGrid`."""
        sums = np.empty((*shape[::-1], values.shape[1]))
        envelope_grid.sums(
            *(self.envelope.position, self.envelope.normal, values),
            origin=origin,
            edges=edges,
            towards=normal,
            **_LIMITS,
            out=sums,
            n_threads=self._n_threads,
        )
        return sums
