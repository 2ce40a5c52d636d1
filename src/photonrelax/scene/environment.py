"""Light from all around the scene."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from .._util.frozen import frozen, set_field
from .._util.validation import Floats, check_magnitude, not_negative, rgb
from .emission_region import EmissionRegion, Sphere, cosine_directions, environment_region
from .emitters import DirectLight, Emitter
from .sky_map import SkyMap


@dataclass(frozen=True, eq=False)
class EnvironmentEmitter(Emitter):
    """Light from all directions, infinitely far away; cameras see it behind everything.

    Parameters
    ----------
    radiance : (3,), float or (h, w, 3)
        W/(m² sr): the same from all directions, or a latitude–longitude map. Row 0 of that is
        towards +z, column j at azimuth π (1 - 2 (j + ½) / w) from +x to +y; radiance is the same
        all over a texel.
    """

    radiance: ArrayLike = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        if np.ndim(self.radiance) == 3:
            given = not_negative(self.radiance, "radiance", (None, None, 3))
            if given.size == 0:
                raise ValueError(f"radiance should have texels, but has shape {given.shape}")
            radiance = check_magnitude(given, "radiance")
        else:
            radiance = rgb(self.radiance, "radiance")
        set_field(self, "radiance", frozen(radiance))

    @classmethod
    def from_exr(cls, path: str | os.PathLike[str]) -> EnvironmentEmitter:
        """Return the environment of a latitude–longitude map, the channels R, G, B of an EXR file.

        Raises
        ------
        OSError, ValueError, MemoryError
            If the file cannot be read, has no such channels, or values that are no radiance.
        """
        from ..imaging.image import read_exr

        layers = read_exr(path).layers
        if "radiance" not in layers:
            raise ValueError(f"{path} should have channels R, G and B, but has {sorted(layers)}")
        return cls(layers["radiance"])

    @cached_property
    def _sky(self) -> SkyMap | None:
        """The map; None of constant radiance."""
        radiance = np.asarray(self.radiance)
        return SkyMap(radiance) if radiance.ndim == 3 else None

    @property
    def is_extended(self) -> bool:
        return True

    @property
    def is_background(self) -> bool:
        return True

    def background(self, direction: Floats) -> Floats:
        """Return the radiance that rays of directions (m, 3) escape to."""
        if self._sky is not None:
            return self._sky.seen(direction)
        return np.tile(np.asarray(self.radiance), (len(direction), 1))

    def background_means(self, direction: Floats, edges: Floats) -> Floats:
        """Return means of the radiance around directions; see `Emitter.background_means`."""
        if self._sky is None:
            return self.background(direction)
        return self._sky.means(direction, edges)

    def emission_region(
        self, target: Sphere, scene: Sphere, emitter_offset: float
    ) -> EmissionRegion:
        """Return disks across all directions that cover the target, upstream of the scene."""
        sky = self._sky
        mean = np.asarray(self.radiance) if sky is None else sky.flux_per_area / (4.0 * np.pi)
        return environment_region(mean, target, scene, sky)

    def direct(self, position: Floats, emitter_offset: float) -> DirectLight:
        """Return light from above, with the irradiance that a plate facing up gets of all."""
        up = np.tile([0.0, 0.0, 1.0], (len(position), 1))
        sky = self._sky
        total = np.pi * np.asarray(self.radiance) if sky is None else sky.irradiance_up
        return _from(up, np.tile(total, (len(up), 1)))

    def sampled(
        self, position: Floats, normal: Floats, emitter_offset: float, sample: Floats
    ) -> DirectLight:
        """Return light from the hemisphere above each point, by the cosine; of a map by its light.

        The luminance of a map is the same in all samples.
        """
        sky = self._sky
        if sky is not None:
            return _from(*sky.sampled(sample))
        direction, cosine = cosine_directions(normal, sample)
        return _from(direction, np.outer(np.pi / cosine, np.asarray(self.radiance)))


def _from(direction: Floats, irradiance: Floats) -> DirectLight:
    """Light from infinitely far away."""
    return DirectLight(direction, np.full(len(direction), np.inf), irradiance)
