"""Two overlapping sets of photons, after SJ13 Fig. 2 and 3.

Where they overlap, the border of each is a weak step of density, hard to tell from noise in the
plane alone; emitter coordinates keep the sets apart. The kind of density is that of the figures,
shapes and sizes are not.
"""

from __future__ import annotations

import numpy as np

from .._util.validation import positive
from .photon_pattern import PhotonPattern
from .stencil import Disc, Parallelogram, Stencil

SETS = (Disc((0.40, 0.58), 0.30), Parallelogram((0.34, 0.12), (0.54, 0.12), (-0.06, 0.44)))
# Of each set, over that of both together.
_SHARES = np.array([0.64, 0.36])
# Emitter coordinates of the second set less its positions, m: the windows are apart.
_APART = (2.0, 0.0)


def two_sets(
    *, n: int = 60_000, sampler: str = "random", seed: int = 0, irradiance: float = 1.0
) -> PhotonPattern:
    """Photons of collimated light through two windows, brought onto one another.

    Parameters
    ----------
    n : int
        Number of photons; all that are emitted pass the windows and are stored.
    sampler : {"random", "halton"}
        Independent photons, or evenly spaced ones within each set.
    seed : int
        Of the random numbers, or of the shift of the sequence.
    irradiance : float
        Where both sets are, W/m².

    Raises
    ------
    TypeError, ValueError
        If an argument is of a wrong type.
    """
    lit = positive(irradiance, "irradiance") * _SHARES
    stencil = Stencil(SETS, lit, np.array([(0.0, 0.0), _APART]))
    return stencil.pattern("two-sets", n, sampler, seed)
