"""Light straight through layers of media, without what returns from a second reflection."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from tests.analytic.interface import Floats, fresnel_reflectance

Layer = tuple[float, ArrayLike, float]
"""Index of refraction; absorption (3,) or one, 1/m; length of the way, m."""


def layers_transmittance(*layers: Layer) -> Floats:
    """Return the share of the flux, per channel, that arrives at the end of the last layer."""
    share = np.ones(3)
    for _, absorption, length in layers:
        share = share * np.exp(-np.multiply(absorption, length))
    for (before, _, _), (beyond, _, _) in pairwise(layers):
        share = share * (1.0 - fresnel_reflectance(0.0, beyond / before))
    return share
