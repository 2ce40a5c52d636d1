"""The interface of estimators that were prepared once."""

from __future__ import annotations

from abc import ABC, abstractmethod
from copy import copy
from functools import cached_property
from typing import Any, Protocol

from numpy.typing import ArrayLike

from .._util.progress import Progress
from .._util.validation import Floats
from ..photons.photon_map import PhotonMap
from ..relaxation.structure import Structure


class Field(ABC):
    """Photons prepared once by any method, their irradiance evaluated anywhere.

    Attributes
    ----------
    photons : PhotonMap
        As gathered from.
    structure : Structure or None
        What was found for these photons on the way, for those who want to look at it.
    seconds : dict
        How long each stage of the preparation took.
    used : dict
        Settings of each stage, by their names, with what was left open filled in.
    """

    photons: PhotonMap
    structure: Structure | None
    seconds: dict[str, float]
    used: dict[str, dict[str, Any]]

    def __call__(
        self, points: ArrayLike, normals: ArrayLike, *, progress: Progress | None = None
    ) -> Floats:
        """Return the irradiance at points on surfaces.

        Parameters
        ----------
        points, normals : (m, 3) array_like
            m, and directions of any length.
        progress : callable, optional
            Called as ``progress("estimate", done, m)``.

        Returns
        -------
        (m, 3) float array
            W/m².

        Raises
        ------
        TypeError, ValueError
            If a shape is wrong, a value is not finite or a normal is zero.
        """
        return self._irradiance(points, normals, progress=progress)

    @cached_property
    def _irradiance(self) -> Estimate:
        # Of a copy that shares all else: what holds itself outlives its last user.
        return copy(self).densities(self.photons.flux)

    @abstractmethod
    def densities(self, values: ArrayLike) -> Estimate:
        """Return what estimates, per area, anything else that photons carry, (n, c)."""


class Estimate(Protocol):
    """Called with points and normals, (m, 3) each, it returns densities, (m, c)."""

    def __call__(
        self, points: ArrayLike, normals: ArrayLike, *, progress: Progress | None = None
    ) -> Floats:
        """Return the estimates."""
