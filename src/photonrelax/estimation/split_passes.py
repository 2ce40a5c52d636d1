"""Progressive photon mapping of one photon map, which is split into passes.

Hachisuka, Ogaki & Jensen 2008 gather fresh photons in every pass; see
`photonrelax.estimation.progressive` for the equations. Here the photons of a map are split into
passes, and the points that irradiance is asked for at are the hit points.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace

import numpy as np

from .._util import validation
from .._util.parallel import thread_count
from .._util.validation import Floats
from ..photons.coincidence import first_equal_rows
from ..photons.neighbourhoods import spectrum_parts
from ..photons.photon_map import PhotonMap
from ..photons.photon_trees import PhotonTrees
from .field import Densities, PhotonField, Points, Rows
from .progressive import HitPointStatistics, InitialRadius, PhotonPass, ProgressiveSettings


def assign_passes(photons: PhotonMap, n_passes: int, k: int = 1) -> Rows:
    """Pass (n,) that each photon of a map belongs to, from 0.

    Photons are assigned to the passes in turn, in the order of their distance from their centroid.
    But for ties, that depends neither on the order of the map nor on position, rotation and scale.
    Every so many-th photon of the map itself would be the worst of choices: those of a Halton
    sequence lie in one strip of the emitter. Photons at the same point are in the same pass, and so
    are those of all wavelengths of a path, or else each part of the spectrum is assigned by itself:
    passes have all colours. There are at most as many passes as leave k points to each.
    """
    position = photons.position
    path = _first_of_paths(photons)
    if path is not None:
        rows = np.unique(path)
        order = rows[_by_distance(position[rows])[0]]
        n_passes = min(n_passes, max(len(photons) // k, 1))
        return _in_turn(order, len(photons), n_passes)[path]
    order, any_tied = _by_distance(position)
    first = first_equal_rows([position]) if any_tied else None
    if first is not None:
        rows = np.unique(first)
        order = rows[_by_distance(position[rows])[0]]
    parts = spectrum_parts(photons)
    if parts is not None:
        order = order[np.argsort(parts[order], kind="stable")]
    n_passes = min(n_passes, max(len(order) // k, 1))
    number = _in_turn(order, len(photons), n_passes)
    return number if first is None else number[first]


def _in_turn(order: Rows, n: int, n_passes: int) -> Rows:
    """Passes of n photons, which those in an order are assigned to in turn."""
    number: Rows = np.empty(n, dtype=np.intp)
    number[order] = np.arange(len(order)) % n_passes
    return number


def _first_of_paths(photons: PhotonMap) -> Rows | None:
    """First photon (n,) of the path of each, which is dispersed; None if that is not known.

    Discs of different passes have different radii, in which the wavelengths of a path, which are
    white together, count alike. Rays of extended emitters do not differ in emitter coordinates.
    """
    if photons.wavelength is None or photons.emitter_coords is None or photons.is_of_extended.any():
        return None
    columns = [photons.emitter_coords]
    if photons.emitter_id is not None:
        columns.append(photons.emitter_id.astype(np.float64))
    return first_equal_rows(columns)


def _by_distance(position: Floats) -> tuple[Rows, bool]:
    """Rows (n,) in the order of their distance from their centroid; true if some are equal."""
    centroid = position.mean(axis=0) if len(position) else 0.0
    distance = np.linalg.norm(position - centroid, axis=1)
    order = np.argsort(distance, kind="stable")
    return order, not np.diff(distance[order]).all()


class ProgressiveField(PhotonField):
    """Progressive photon mapping of one photon map at any points.

    The photons are split into passes (see `assign_passes`), at most as many as leave k points to
    each. All passes are gathered whenever the field is called, as the points are its hit points.

    Parameters
    ----------
    photons : PhotonMap
    settings : ProgressiveSettings, optional
    n_threads : int, optional
        Threads; all available by default. Results do not depend on it.

    Attributes
    ----------
    photons, settings, structure, seconds, used
        See `PhotonField`; `settings.n_passes` is the number in use.

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
        number = assign_passes(photons, settings.n_passes, photons.counted(settings.k))
        settings = replace(settings, n_passes=int(number.max(initial=0)) + 1)
        self.photons = photons
        self.settings = settings
        self.seconds = {}
        self.used = {"progressive": asdict(settings)}
        self._n_threads = thread_count(n_threads)
        self._passes = list(self._split(number))
        rows, trees = self._passes[0]
        self._initial_radius = InitialRadius(photons.subset(rows), settings, self._n_threads, trees)

    def _split(self, number: Rows) -> Iterator[tuple[Rows, PhotonTrees]]:
        """Rows and trees of the photons of each pass."""
        for one in range(self.settings.n_passes):
            rows = np.flatnonzero(number == one)
            trees = PhotonTrees(self.photons.subset(rows), self._n_threads)
            trees.build()
            yield rows, trees

    @property
    def has_footprints(self) -> bool:
        """Whether there are means over footprints: there are."""
        return True

    @property
    def reach(self) -> float:
        """Largest initial radius, m."""
        return self._initial_radius.largest if len(self.photons) else np.inf

    def least_radius(
        self, points: Floats, normals: Floats, radius: Floats, footprint: Floats | None = None
    ) -> Floats | None:
        """Radii (m,), m, that those of the hit points do not shrink below; None for no limit."""
        return None

    def _lay_out(self, values: Floats, part: int) -> PhotonPass:
        """Photons of a pass with their values."""
        rows, trees = self._passes[part]
        return PhotonPass(trees, values[rows], self._n_threads, self.surface)

    def _fill(self, out: Floats, values: Densities, points: Points) -> None:
        position, normal = points.queries[points.rows], points.normals[points.rows]
        normal = validation.unit_vectors(normal, "normals", normal.shape, self._n_threads)
        footprint = None if points.footprint is None else points.footprint[points.rows]
        hits = HitPointStatistics(
            self._initial_radius(position, normal, footprint, self.edges),
            values.n_channels,
            alpha=self.settings.alpha,
            n_threads=self._n_threads,
            is_global=self.settings.is_global,
        )
        order = np.arange(len(position))
        for number in range(len(self._passes)):
            photons: PhotonPass = values.laid_out(number)
            radius = hits.pass_radius()
            counts, sums = photons.within((position, normal), radius, order, footprint)
            least = self.least_radius(position, normal, radius, footprint)
            # Fluxes are divided by the number of photons emitted in all passes already.
            hits.update(counts, sums, 1.0, least)
        out[points.rows] = hits.n_passes * hits.densities()
