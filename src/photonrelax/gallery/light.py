"""Light of scenes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..scene.emitters import Emitter
from ..scene.environment import EnvironmentEmitter


def from_around(radiance: ArrayLike) -> list[Emitter]:
    """Light of the same radiance, W/(m² sr), one or (3,), from all around; none of 0."""
    return [EnvironmentEmitter(radiance)] if np.any(radiance) else []
