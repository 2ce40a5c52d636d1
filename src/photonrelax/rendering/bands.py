"""Layers of bands of an image, in this process or in workers."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

from .._util.parcels import state_without_caches
from .._util.validation import Floats
from ..estimation.field import Field
from ..estimation.indirect import IndirectField
from .final_gather import FinalGather
from .layers import FieldEstimates, band_layers, with_radiance
from .view import View


class RenderedBand(NamedTuple):
    """Layers of some rows of an image, and the number of their hit points."""

    layers: dict[str, Floats]
    n_hit_points: int


class BandRenderer:
    """Renderer of the bands of an image, from the fields that all of them share.

    Parameters
    ----------
    view : View
    direct, emission : bool
        Whether direct light, and emitters seen, are modelled.
    caustic : Field, optional
        Of caustics.
    indirect : FinalGather or IndirectField, optional
        Of indirect light.
    """

    def __init__(
        self,
        view: View,
        direct: bool,
        emission: bool,
        caustic: Field | None,
        indirect: FinalGather | IndirectField | None,
    ) -> None:
        self._view, self._direct, self._emission = view, direct, emission
        self._field, self._indirect = caustic, indirect

    __getstate__ = state_without_caches

    @cached_property
    def _caustic(self) -> FieldEstimates | None:
        return None if self._field is None else FieldEstimates(self._field)

    def layers(self, rows: range) -> RenderedBand:
        """Layers of some rows."""
        band = self._view.band(rows, direct=self._direct)
        estimates = {} if self._caustic is None else self._caustic(band)
        if isinstance(self._indirect, FinalGather):
            estimates["indirect"] = band.radiance(*self._indirect(band))
        elif self._indirect is not None:
            estimates["indirect"] = band.radiance(*band.estimates(self._indirect))
        layers = band_layers(band, estimates)
        if not self._emission:
            layers.pop("emission", None)
        return RenderedBand(with_radiance(layers), len(band.hits))
