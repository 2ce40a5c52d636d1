"""Irradiance from photons in blocks on disk: those near some points at a time are in memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace
from functools import cached_property
from typing import Any

import numpy as np

from .._ext.spatial import kth_distance as _kth_distance
from .._util.parallel import thread_count
from .._util.progress import Reporter
from .._util.validation import Floats
from ..photons.axes import MAX_NORMAL_CHORD
from ..photons.block_search import BlockSearch, Found, GroupTiles, Neighbourhood
from ..photons.blocks import PHOTONS_PER_BLOCK, BlockedPhotons
from ..photons.photon_map import PhotonMap
from ..spatial.kdtree import KDTree
from .field import Densities, Field, Points, Rows
from .footprint import half_diagonals
from .kernels import SAMPLE, gather_radius_of
from .nearest import GatherSettings, IrradianceField

# Distance of photons that count from the middle of a footprint, in half diagonals and in gather
# radii: kernels fill boxes, as thick as a cap whose normals turn by 60°.
_OF_HALF_DIAGONAL, _OF_RADIUS = 1.6, 2.5


class BlockedField(Field):
    """Irradiance from the k nearest of the photons in blocks, as `IrradianceField` has it.

    Parameters
    ----------
    photons : BlockedPhotons
        As they are to be gathered.
    settings : GatherSettings, optional
        The automatic gather radius is that of a sample of the photons, and so differs a little
        from that of one piece, which takes another.
    photons_per_block : int
        Photons in memory at a time, about; more where a kernel reaches more.
    n_threads : int, optional

    Attributes
    ----------
    settings : GatherSettings
        With the radius in use.

    Raises
    ------
    ValueError
        If photons are of dispersed light, whose numbers are those of a whole map.
    """

    def __init__(
        self,
        photons: BlockedPhotons,
        settings: GatherSettings | None = None,
        *,
        photons_per_block: int = PHOTONS_PER_BLOCK,
        n_threads: int | None = None,
    ) -> None:
        if "wavelength" in photons.columns:
            raise ValueError(
                "photons in blocks should be of light that is not dispersed to be gathered, but "
                "have wavelengths: gather from their photon_map(), in memory"
            )
        self.photons = photons
        self._per_block, self._n_threads = photons_per_block, thread_count(n_threads)
        whole = photons.segments._replace(group=np.zeros_like(photons.segments.group))
        self._tiles = GroupTiles(replace(photons, segments=whole), 0)
        for segment in range(self._tiles.n_segments):
            rows = self._tiles.rows(segment)
            for name in ("position", "normal"):
                self._tiles.bound(segment, name, photons.columns.read(name, *rows))
        settings = settings or GatherSettings()
        if settings.gather_radius is None:
            settings = replace(settings, gather_radius=self._automatic_radius(settings.k_reached))
        self.settings = settings
        self.seconds = {}
        self.used = {"gather": asdict(settings)}

    @property
    def flux(self) -> Floats:
        """Flux (n, 3) of the photons in the order of blocks, W; mapped, not in memory."""
        return self.photons.columns.mapped("flux")

    @property
    def has_footprints(self) -> bool:
        """Whether there are means over footprints: there are."""
        return True

    @property
    def reach(self) -> float:
        """Gather radius, m."""
        radius = self.settings.gather_radius
        return np.inf if radius is None else radius

    def _lay_out(self, values: Floats, part: int) -> Any:
        """Nothing: values are read with the photons."""
        return None

    def _fill(self, out: Floats, values: Densities, points: Points) -> None:
        far = self.reach
        if self.settings.refinement != "none":
            far *= np.sqrt(self.settings.k / self.settings.k_min)
        half = half_diagonals(points.footprint, len(points.queries))
        margin = _OF_HALF_DIAGONAL * half + _OF_RADIUS * far
        # In steps, so that what is near a point does not depend on the others.
        step = np.full(len(margin), np.inf)
        known = np.isfinite(margin) & (margin > 0.0)
        step[known] = np.exp2(np.ceil(np.log2(margin[known])))
        for widest in np.unique(step[points.rows]).tolist():
            rows = points.rows[step[points.rows] == widest]
            for some, near in self._divided(points.queries, rows, widest):
                if len(near):
                    self._fill_from(near, out, values, points._replace(rows=some))

    def _divided(self, queries: Floats, rows: Rows, margin: float) -> Iterator[tuple[Rows, Rows]]:
        """Divide points by boxes in space; yield those of each, and the photons near it.

        Boxes are halved as long as more photons are near than are to be in memory, but not much
        below the margin, from where on most are near both halves.
        """
        pending = [(*self._bounds, rows)]
        while pending:
            low, high, some = pending.pop()
            if not len(some):
                continue
            tiles = self._tiles_near(low - margin, high + margin)
            n_photons = (self._tiles.stop - self._tiles.first)[tiles].sum()
            axis = int(np.argmax(high - low))
            if n_photons <= self._per_block or high[axis] - low[axis] <= 0.5 * margin:
                yield some, self._photons_near(tiles, low - margin, high + margin)
                continue
            middle = 0.5 * (low[axis] + high[axis])
            below, behind, before = queries[some, axis] < middle, high.copy(), low.copy()
            behind[axis] = before[axis] = middle
            pending += [(before, high, some[~below]), (low, behind, some[below])]

    @cached_property
    def _bounds(self) -> tuple[Floats, Floats]:
        """Box of all photons."""
        boxes = self._tiles.boxes((("position", 1.0),))
        return boxes.low.min(axis=0), boxes.high.max(axis=0)

    def _tiles_near(self, low: Floats, high: Floats) -> Rows:
        """Tiles that overlap a box."""
        boxes = self._tiles.boxes((("position", 1.0),))
        return np.flatnonzero(((boxes.low <= high) & (boxes.high >= low)).all(axis=1))

    def _photons_near(self, tiles: Rows, low: Floats, high: Floats) -> Rows:
        """Photons of tiles, ascending, that are in a box."""
        position, near = self.photons.columns.mapped("position"), [np.empty(0, np.intp)]
        for first, stop in zip(self._tiles.first[tiles], self._tiles.stop[tiles], strict=True):
            there = position[first:stop]
            near.append(first + np.flatnonzero(((there >= low) & (there <= high)).all(axis=1)))
        return np.concatenate(near)

    def _fill_from(self, near: Rows, out: Floats, values: Densities, points: Points) -> None:
        """Write the densities at rows of points from some photons."""
        position, normal = (self.photons.columns.take(n, near) for n in ("position", "normal"))
        photons = PhotonMap(
            position,
            normal,
            self.flux[near],
            well_spaced=self.photons.shared["well_spaced"],
        )
        field = IrradianceField(photons, self.settings, n_threads=self._n_threads)
        field.surface = self.surface
        rows, footprint = points.rows, points.footprint
        some = points.queries[rows, :3], points.normals[rows]
        found, report = np.zeros((len(rows), values.n_channels)), Reporter(None, "estimate", 1)
        densities = Densities(field, values.of(near))
        for chunk in field._chunks(*some, report):
            chunk = chunk._replace(footprint=None if footprint is None else footprint[rows])
            field._fill(found, densities, chunk)
        out[rows] = found

    def _automatic_radius(self, k: int) -> float:
        """Radius that holds k photons nearly everywhere there is light; see `kernels`."""
        step = -(-len(self.photons) // SAMPLE)
        limits = np.full(len(self._tiles.first), MAX_NORMAL_CHORD)
        axes = (("position", 1.0), ("normal", 1.0))
        search = BlockSearch(self.photons.columns, self._tiles, axes, None, limits, k)

        def distances(some: Neighbourhood) -> Found:
            own = some.rows[: some.n_own]
            sample = np.flatnonzero(own % step == 0)
            points = np.hstack([some.read("position"), some.read("normal")])
            reached = np.zeros(len(own))
            reached[sample] = _kth_distance.of_queries(
                *(KDTree(points, n_threads=self._n_threads).kernel, points, sample),
                k=k,
                range_radius=MAX_NORMAL_CHORD,
                n_threads=self._n_threads,
            )
            return Found({"distance": reached}, reached)

        found = []
        for segment in range(self._tiles.n_segments):
            first, stop = self._tiles.rows(segment)
            distance = search.run(segment, distances)["distance"]
            found.append(distance[np.arange(first, stop) % step == 0])
        sampled = np.concatenate(found)
        extent = float(np.linalg.norm(self._tiles.extent("position")))
        return gather_radius_of(sampled[np.isfinite(sampled)], extent)
