"""Progressive photon mapping of one photon map, whose photons are dealt to passes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._util import validation
from .._util.parallel import thread_count
from .._util.progress import Progress, Reporter
from .._util.validation import Floats
from ..photons.photon_map import PhotonMap
from ..photons.photon_trees import PhotonTrees, morton_order
from ..relaxation.structure import Structure
from .field import Field
from .progressive import HitPointStatistics, InitialRadius, PhotonPass, ProgressiveSettings


def dealt(photons: PhotonMap, n_passes: int) -> NDArray[np.intp]:
    """Return the pass (n,) that each photon of a map is dealt to.

    Photons go to one pass after the other in the order of their distance from the middle of all,
    which, but for ties, depends neither on the order of the map nor on place, rotation and scale.
    Dealing every so many-th photon of the map itself would be the worst of choices: of a Halton
    sequence these lie in one strip of the emitter.
    """
    middle = photons.position.mean(axis=0) if len(photons) else 0.0
    distance = np.linalg.norm(photons.position - middle, axis=1)
    number = np.empty(len(photons), dtype=np.intp)
    number[np.argsort(distance, kind="stable")] = np.arange(len(photons)) % n_passes
    return number


class ProgressiveField(Field):
    """Progressive photon mapping of one photon map at any points: a `Field`.

    The photons are dealt to passes (see `dealt`), no more of them than have k photons each. The
    points asked for are the hit points, so that passes are gone through at every call.

    Parameters
    ----------
    photons : PhotonMap
        As gathered from.
    settings : ProgressiveSettings, optional
    n_threads : int, optional
        Threads; all available by default. Results do not depend on it.

    Attributes
    ----------
    photons, settings, structure, seconds, used
        See `Field`; `settings.n_passes` is the number in use.

    Raises
    ------
    ValueError
        If radii are left open and all photons are at one point.
    """

    def __init__(
        self,
        photons: PhotonMap,
        settings: ProgressiveSettings | None = None,
        *,
        n_threads: int | None = None,
    ) -> None:
        settings = settings or ProgressiveSettings()
        most = max(len(photons) // settings.k, 1)
        settings = replace(settings, n_passes=min(settings.n_passes, most))
        self.photons = photons
        self.settings = settings
        self.structure: Structure | None = None
        self.seconds: dict[str, float] = {}
        self.used: dict[str, dict[str, Any]] = {"progressive": asdict(settings)}
        self._n_threads = thread_count(n_threads)
        self._passes = list(self._dealt())
        rows, trees = self._passes[0]
        first = photons.subset(rows)
        self._initial_radius = InitialRadius(first, settings, self._n_threads, trees)

    def _dealt(self) -> Iterator[tuple[NDArray[np.intp], PhotonTrees]]:
        number = dealt(self.photons, self.settings.n_passes)
        for one in range(self.settings.n_passes):
            rows = np.flatnonzero(number == one)
            trees = PhotonTrees(self.photons.subset(rows), self._n_threads)
            trees.build()
            yield rows, trees

    def least_radius(self, points: Floats, normals: Floats, radius: Floats) -> Floats | None:
        """Return the radii (m,) discs need not go below; None for discs that shrink for ever."""
        return None

    def densities(self, values: ArrayLike) -> ProgressiveDensities:
        """Return what estimates, per area, anything else that photons carry, (n, c).

        Raises
        ------
        TypeError, ValueError
            If `values` does not have a row for each photon.
        """
        array = validation.float_array(values, "values", (len(self.photons), None))
        return ProgressiveDensities(self, array)


class ProgressiveDensities:
    """Estimates per area of values that the photons of a field carry; see `densities` there."""

    def __init__(self, field: ProgressiveField, values: Floats) -> None:
        self._field = field
        self._n_channels = values.shape[1]
        self._passes = [
            PhotonPass(trees, values[rows], field._n_threads) for rows, trees in field._passes
        ]

    def __call__(
        self, points: ArrayLike, normals: ArrayLike, *, progress: Progress | None = None
    ) -> Floats:
        """Return the estimates (m, c) at points (m, 3) on surfaces with the given normals."""
        points = validation.float_array(points, "points", (None, 3))
        normals = validation.float_array(normals, "normals", (len(points), 3), finite=False)
        out = np.empty((len(points), self._n_channels))
        for first, end in Reporter(progress, "estimate", len(points)).chunks(len(points)):
            out[first:end] = self._some(points[first:end], normals[first:end])
        return out

    def _some(self, points: Floats, normals: Floats) -> Floats:
        """Estimate at no more than so many points that what is kept of them is small."""
        field = self._field
        normals = validation.unit_vectors(normals, "normals", points.shape, field._n_threads)
        discs = HitPointStatistics(
            field._initial_radius(points, normals),
            self._n_channels,
            alpha=field.settings.alpha,
            n_threads=field._n_threads,
        )
        order = morton_order(points, field._n_threads)
        for one in self._passes:
            found = one.within((points, normals), discs.radius, order)
            # What photons carry is divided by the number emitted in all passes already.
            discs.update(*found, 1.0, field.least_radius(points, normals, discs.radius))
        return discs.n_passes * discs.densities()
