"""Irradiance of an envelope: means over footprints, by exact overlap."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from ..._ext.estimation import envelope as _kernel
from ..._util.parallel import thread_count
from ..._util.validation import Floats
from ..field import Densities, Field, Points
from .elements import luminances
from .envelope import Envelope
from .laying import square_edges

# Distance from the plane of a footprint, over its size, of light that still counts in it.
_THICKNESS = 1.0


class EnvelopeField(Field):
    """A field whose elements are the triangles of an envelope.

    Parameters
    ----------
    envelope : Envelope
        Of `trace_envelope`.
    n_threads : int, optional
        Threads; all by default.

    Notes
    -----
    At points the estimate is the mean over a square as large as the envelope's footprint.
    """

    def __init__(self, envelope: Envelope, *, n_threads: int | None = None) -> None:
        self.envelope = envelope
        self.seconds = dict(envelope.seconds)
        self.used = {"envelope": asdict(envelope.settings)}
        self._n_threads = thread_count(n_threads)

    @property
    def flux(self) -> Floats:
        """Flux (n, 3) of the triangles, W."""
        return self.envelope.flux

    @property
    def layers(self) -> dict[str, Floats]:
        """Estimated share (n, 1) of the light of each that is misplaced, by the layer's name."""
        luminance = luminances(self.flux)
        share = np.divide(
            self.envelope.misplaced, luminance, out=np.zeros(len(luminance)), where=luminance > 0.0
        )
        return {"envelope.error": share[:, np.newaxis]}

    @property
    def has_footprints(self) -> bool:
        return True

    def _lay_out(self, values: Floats, part: int) -> Floats:
        return np.ascontiguousarray(values)

    def _fill(self, out: Floats, values: Densities, points: Points) -> None:
        envelope = self.envelope
        edges = points.footprint
        if edges is None:
            edges = np.full(len(points.queries), envelope.settings.footprint)
        if edges.ndim == 1:
            edges = square_edges(points.normals, edges)
        _kernel.means(
            envelope.tree.kernel,
            envelope.position,
            envelope.normal,
            values.laid_out(0),
            np.ascontiguousarray(points.queries),
            np.ascontiguousarray(points.normals),
            np.ascontiguousarray(edges),
            points.rows,
            thickness=_THICKNESS,
            out=out,
            n_threads=self._n_threads,
        )
