"""Light from all around the scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .._util.frozen import frozen, set_field
from .._util.validation import Floats, rgb
from .emission_region import EmissionRegion, Sphere, cosine_directions, environment_region
from .emitters import DirectLight, Emitter


@dataclass(frozen=True, eq=False)
class EnvironmentEmitter(Emitter):
    """The same radiance from all directions, infinitely far away; cameras see it behind everything.

    Parameters
    ----------
    radiance : (3,) or float
        W/(m² sr).
    """

    radiance: ArrayLike = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        set_field(self, "radiance", frozen(rgb(self.radiance, "radiance")))

    @property
    def is_extended(self) -> bool:
        return True

    @property
    def background(self) -> Floats:
        return np.asarray(self.radiance)

    def emission_region(
        self, target: Sphere, scene: Sphere, emitter_offset: float
    ) -> EmissionRegion:
        """Return disks across all directions that cover the target, upstream of the scene."""
        return environment_region(np.asarray(self.radiance), target, scene)

    def direct(self, position: Floats, emitter_offset: float) -> DirectLight:
        """Return light from above, with the irradiance that a plate facing up gets of all."""
        up = np.tile([0.0, 0.0, 1.0], (len(position), 1))
        return self._from(up, np.ones(len(position)))

    def sampled(
        self, position: Floats, normal: Floats, emitter_offset: float, sample: Floats
    ) -> DirectLight:
        """Return light from the hemisphere above each point, by the cosine."""
        return self._from(*cosine_directions(normal, sample))

    def _from(self, direction: Floats, cosine: Floats) -> DirectLight:
        distance = np.full(len(direction), np.inf)
        return DirectLight(direction, distance, np.outer(np.pi / cosine, self.background))
