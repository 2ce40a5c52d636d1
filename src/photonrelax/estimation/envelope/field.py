"""Irradiance of an envelope: means over footprints, by exact overlap."""

from __future__ import annotations

from dataclasses import asdict
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..._ext.estimation import envelope as _kernel
from ..._util.parallel import thread_count
from ..._util.validation import Floats
from ..field import Densities, Field, PhotonField, Points
from .elements import luminances
from .envelope import NOISE, Envelope
from .laying import square_edges

# Distance from the plane of a footprint, over its size, of light that still counts in it.
_THICKNESS = 1.0


class _Values(NamedTuple):
    """Sums (rows, c) over nodes of the triangles' tree, and densities of photons, if any."""

    sums: Floats
    photons: Densities | None


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

    def _lay_out(self, values: Floats, part: int) -> _Values:
        triangles, photons = np.split(values, [len(self.envelope)])
        return _Values(
            _kernel.node_sums(self.envelope.tree.kernel, triangles),
            None if self.rest is None else self.rest.densities(photons),
        )

    def _fill(self, out: Floats, values: Densities, points: Points) -> None:
        laid_out = values.laid_out(0)
        if len(self.envelope):
            self._fill_of_triangles(out, laid_out.sums, points)
        if laid_out.photons is not None:
            rows = points.rows
            footprint = None if points.footprint is None else points.footprint[rows]
            found = laid_out.photons(
                points.queries[rows], points.normals[rows], footprint=footprint
            )
            # There are no photons where there is no surface.
            out[rows] += np.nan_to_num(found, copy=False)

    def _fill_of_triangles(self, out: Floats, sums: Floats, points: Points) -> None:
        envelope = self.envelope
        edges = points.footprint
        if edges is None:
            edges = np.full(len(points.queries), envelope.settings.footprint)
        if edges.ndim == 1:
            edges = square_edges(points.normals, edges)
        _kernel.means(
            envelope.tree.kernel,
            envelope.position,
            self._normals,
            sums,
            np.ascontiguousarray(points.queries),
            np.ascontiguousarray(points.normals),
            np.ascontiguousarray(edges),
            points.rows,
            thickness=_THICKNESS,
            out=out,
            n_threads=self._n_threads,
        )
