"""Pixels whose irradiance is known analytically."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats
from ..gallery.analytic import AnalyticIrradiance
from ..rendering.view import StoredView
from ..transport.hit_points import HitPoints


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


# Points a side of a footprint at which irradiance is evaluated, its middle among them.
_POINTS = 3


def analytic_pixels(view: StoredView, irradiance: AnalyticIrradiance) -> AnalyticPixels | None:
    """Caustic of a view, None if no light is known of it.

    A pixel is known if the irradiance is known all over its footprints.
    """
    caustic, where = [], []
    for band in view.bands:
        values, known = _means(band.hits, irradiance)
        caustic.append(band.radiance(np.where(known, values, 0.0)[:, np.newaxis]))
        counts = band.sums(np.column_stack([known, np.ones(len(known))]))
        where.append((counts[..., 0] == counts[..., 1]) & (counts[..., 1] > 0.0))
    found = AnalyticPixels(np.concatenate(caustic), np.concatenate(where))
    return found if found.caustic[found.where].any() else None


def _means(hits: HitPoints, irradiance: AnalyticIrradiance) -> tuple[Floats, NDArray[np.bool_]]:
    """Mean irradiance (m,) over the footprints of hit points, and whether all of it is known."""
    if hits.footprint is None:
        return irradiance(hits.position, hits.normal)
    total, all_known = np.zeros(len(hits)), np.ones(len(hits), dtype=bool)
    places = (np.arange(_POINTS) + 0.5) / _POINTS - 0.5
    for right in places:
        for down in places:
            offset = right * hits.footprint[:, 0] + down * hits.footprint[:, 1]
            values, known = irradiance(hits.position + offset, hits.normal)
            total += np.where(known, values, 0.0) / _POINTS**2
            all_known &= known
    return total, all_known
