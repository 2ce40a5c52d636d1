"""Pixels whose irradiance is known analytically."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats
from ..gallery.analytic import AnalyticIrradiance
from ..rendering.view import StoredView


@dataclass(frozen=True, eq=False)
class AnalyticPixels:
    """Caustic of the pixels whose irradiance is known analytically.

    Attributes
    ----------
    caustic : (height, width, 3)
        Radiance.
    where : (height, width) bool
        The pixels it is known in.
    """

    caustic: Floats
    where: NDArray[np.bool_]


def analytic_pixels(view: StoredView, irradiance: AnalyticIrradiance) -> AnalyticPixels:
    """Caustic of a view; a pixel is known if the irradiance at all its hit points is."""
    caustic, where = [], []
    for band in view.bands:
        values, known = irradiance(band.hits.position, band.hits.normal)
        caustic.append(band.radiance(np.where(known, values, 0.0)[:, np.newaxis]))
        counts = band.sums(np.column_stack([known, np.ones(len(known))]))
        where.append((counts[..., 0] == counts[..., 1]) & (counts[..., 1] > 0.0))
    return AnalyticPixels(np.concatenate(caustic), np.concatenate(where))
