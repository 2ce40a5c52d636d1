"""What a camera sees, traced once for all methods."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from .._arrays import Floats, thread_count
from .._progress import Progress, Reporter
from ..estimate import Field
from ..gallery.known import KnownLight
from ..picture import Band, PhotonLayers, bands, joined
from ..scene import Scene


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


@dataclass(frozen=True, eq=False)
class View:
    """The points a camera sees, kept.

    Attributes
    ----------
    bands : list of Band
        From the top down.
    fixed : dict
        Layers that need no photons.
    seconds : float
        What finding them took.
    """

    bands: list[Band]
    fixed: dict[str, Floats]
    seconds: float

    def caustic(self, field: Field, progress: Progress | None) -> Floats:
        """Return the radiance (height, width, 3) of a field's irradiance."""
        report = Reporter(progress, "render", sum(len(band.rows) for band in self.bands))
        parts = []
        for band in self.bands:
            parts.append(band.radiance(field(band.hits.position, band.hits.normal)))
            report.advance(len(band.rows))
        return np.concatenate(parts)

    def known(self, light: KnownLight) -> Known:
        """Return the picture of known light; a pixel is known if all points it sees are."""
        parts, where = [], []
        for band in self.bands:
            irradiance, known = light(band.hits.position, band.hits.normal)
            parts.append(band.radiance(np.where(known, irradiance, 0.0)[:, np.newaxis]))
            counts = band.sums(np.column_stack([known, np.ones(len(known))]))
            where.append((counts[..., 0] == counts[..., 1]) & (counts[..., 1] > 0.0))
        return Known(np.concatenate(parts), np.concatenate(where))

    def photon_layers(self, field: Field) -> dict[str, Floats]:
        """Return what the photons of a field carry, as layers, and their caustic."""
        layers = PhotonLayers(field)
        return joined([layers(band) for band in self.bands])


def look(
    scene: Scene,
    *,
    supersampling: int,
    max_depth: int,
    n_threads: int | None,
    progress: Progress | None,
) -> View:
    """Find what a scene's camera sees."""
    if scene.camera is None:
        raise ValueError("scene should have a camera to be seen")
    started = perf_counter()
    report = Reporter(progress, "camera", scene.camera.height)
    seen = []
    for band in bands(
        scene,
        scene.camera,
        supersampling=supersampling,
        max_depth=max_depth,
        n_threads=thread_count(n_threads),
    ):
        seen.append(band)
        report.advance(len(band.rows))
    fixed = joined([band.fixed_layers() for band in seen])
    return View(seen, fixed, perf_counter() - started)
