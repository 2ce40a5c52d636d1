"""Photons that no scene was traced for, and whose irradiance is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .._util.validation import Floats, count
from ..photons.photon_map import PhotonMap

Estimate = Callable[[Floats, Floats], Floats]


@dataclass(frozen=True, eq=False)
class Distribution:
    """Photons on the unit square 0 ≤ x, y ≤ 1 of the plane z = 0, seen straight from above.

    Attributes
    ----------
    name : str
        By which the gallery knows it.
    photons : PhotonMap
        With emitter coordinates and densities, so that every method has what it needs.
    irradiance : callable
        The truth: maps points (m, 3) on the plane to W/m², (m, 3).
    pixel_means : callable
        The truth as a picture: maps width and height to the mean irradiance over the area of each
        pixel, exactly, (height, width, 3); row 0, at the top, is next to y = 1.
    """

    name: str
    photons: PhotonMap
    irradiance: Callable[[Floats], Floats]
    pixel_means: Callable[[int, int], Floats]

    def samples(self, width: int, height: int, supersampling: int = 1) -> tuple[Floats, Floats]:
        """Return s·s points in each pixel of a picture, and the normals there, (m, 3) each.

        Pixel by pixel, row by row from the top: means over each s·s are pixels.
        """
        width, height = count(width, "width"), count(height, "height")
        s = count(supersampling, "supersampling")
        row, column, i, j = np.meshgrid(
            range(height), range(width), range(s), range(s), indexing="ij"
        )
        x = (column + (j + 0.5) / s) / width
        y = 1.0 - (row + (i + 0.5) / s) / height
        points = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
        return points, np.tile([0.0, 0.0, 1.0], (len(points), 1))

    def picture(self, field: Estimate, width: int, height: int, supersampling: int = 1) -> Floats:
        """Return what a field shows, W/m²: means over the samples of each pixel.

        Parameters
        ----------
        field : callable
            What `photonrelax.irradiance_field` returns, or anything called like it.
        width, height, supersampling : int
            Of the picture; s·s samples a pixel.

        Returns
        -------
        (height, width, 3) float array
        """
        estimates = field(*self.samples(width, height, supersampling))
        return estimates.reshape(height, width, supersampling**2, 3).mean(axis=2)
