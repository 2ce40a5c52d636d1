"""Photons on a plane, made without a scene, whose exact irradiance is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .._util.validation import MAX_REPEATS, Floats, count
from ..photons.photon_map import PhotonMap

Estimate = Callable[[Floats, Floats], Floats]


@dataclass(frozen=True, eq=False)
class PhotonPattern:
    """Photons on the unit square 0 ≤ x, y ≤ 1 of the plane z = 0, seen straight from above.

    Attributes
    ----------
    name : str
        Name in the gallery.
    photons : PhotonMap
        With emitter coordinates and densities, which some methods need.
    irradiance : callable
        Exact irradiance: maps points (m, 3) on the plane to W/m², (m, 3).
    pixel_means : callable
        Exact image: maps width and height to the mean irradiance over the area of each pixel,
        (height, width, 3); row 0, at the top, is next to y = 1.
    """

    name: str
    photons: PhotonMap
    irradiance: Callable[[Floats], Floats]
    pixel_means: Callable[[int, int], Floats]

    def samples(self, width: int, height: int, supersampling: int = 1) -> tuple[Floats, Floats]:
        """Points of the s·s samples of each pixel, and the normals there, (m, 3) each.

        Pixel by pixel, row by row from the top: a pixel is the mean of s·s consecutive samples.
        """
        width, height = (
            count(side, name, high=MAX_REPEATS)
            for side, name in ((width, "width"), (height, "height"))
        )
        s = count(supersampling, "supersampling", high=MAX_REPEATS)
        row, column, i, j = np.meshgrid(
            range(height), range(width), range(s), range(s), indexing="ij"
        )
        x = (column + (j + 0.5) / s) / width
        y = 1.0 - (row + (i + 0.5) / s) / height
        points = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
        return points, np.tile([0.0, 0.0, 1.0], (len(points), 1))

    def image(self, field: Estimate, width: int, height: int, supersampling: int = 1) -> Floats:
        """Image of a field, W/m²: means over the samples of each pixel.

        Parameters
        ----------
        field : callable
            Result of `photonrelax.irradiance_field`, or any callable of the same signature.
        width, height, supersampling : int
            Size of the image, and s·s samples a pixel.

        Returns
        -------
        (height, width, 3) float array
        """
        estimates = field(*self.samples(width, height, supersampling))
        return estimates.reshape(height, width, supersampling**2, 3).mean(axis=2)
