"""Pixels whose irradiance is known analytically."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats
from ..gallery.analytic import KnownLight
from ..rendering.view import View


@dataclass(frozen=True, eq=False)
class Known:
    """A picture of light that is known without photons.

    Attributes
    ----------
    caustic : (height, width, 3)
        Radiance.
    where : (height, width) bool
        The pixels it is known in.
    """

    caustic: Floats
    where: NDArray[np.bool_]


def analytic_pixels(view: View, light: KnownLight) -> Known:
    """Return the picture of known light; a pixel is known if all points it sees are."""
    parts, where = [], []
    for band in view.bands:
        irradiance, known = light(band.hits.position, band.hits.normal)
        parts.append(band.radiance(np.where(known, irradiance, 0.0)[:, np.newaxis]))
        counts = band.sums(np.column_stack([known, np.ones(len(known))]))
        where.append((counts[..., 0] == counts[..., 1]) & (counts[..., 1] > 0.0))
    return Known(np.concatenate(parts), np.concatenate(where))
