"""Sheets of light, of one path on one surface: those that have images, and those left to photons.

Few sheets have nearly all light, and hundreds the rest. Rays are followed where they lead to one of
the few; photons of all others are relaxed and gathered. So each sheet is accounted for once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._ext.transport.splitting import sheets
from ..._util.validation import Floats
from ...spatial.kdtree import KDTree
from ...transport.aim import LUMINANCE
from ...transport.splitting import Signatures, SplittingTracer
from .charts import Chart

# Rays of all charts by which the light of their sheets is found, at most and at least, and the
# share of all that may be traced.
_MOST_EXPLORED, _LEAST_EXPLORED, _SHARE = 4096, 64, 0.125
_R2 = (0.7548776662466927, 0.5698402909980532)
# Share of all light that is in sheets left to photons, unless these are rough, and share of the
# light of each that makes a sheet worth its elements: over the light that may be misplaced, and the
# largest such share.
_LEFT, _LEAST, _MOST_MISPLACED = 0.05, 0.2, 0.01
# Points of light that the square around each is as large as.
_NEIGHBOURS = 8
# Standard errors, and share besides, by which the light of images may fall short of that explored.
_SHORT, _SHORT_SHARE = 1.0, 0.05


class Points(NamedTuple):
    """Positions (n, 3), m, normals (n, 3) and fluxes (n, 3), W, of light that has no image.

    `place` (n, 2) is in the unit square of the chart, `sheet` (n,) the path and surface, and
    `side` (n,) that of the square which the light is laid over, m, if larger than a footprint.
    """

    position: Floats
    normal: Floats
    flux: Floats
    place: Floats
    sheet: Signatures
    side: Floats

    @classmethod
    def none(cls) -> Points:
        """No points."""
        vectors = np.empty((0, 3))
        none = np.empty((0, 2)), np.empty(0, np.uint64), np.empty(0)
        return cls(vectors, vectors, vectors, *none)

    def of(self, rows: NDArray) -> Points:
        """Those of some rows."""
        return Points(*(column[rows] for column in self))


def spacings(position: Floats) -> Floats:
    """Sides (n,) of squares as large as the disks to the eighth of the points around each."""
    if len(position) <= _NEIGHBOURS:
        extent = np.subtract(
            position.max(axis=0, initial=-np.inf), position.min(axis=0, initial=np.inf)
        )
        return np.full(len(position), extent.max())
    sides: Floats = KDTree(position).query_self(_NEIGHBOURS).distance[:, -1] * np.sqrt(np.pi)
    return sides


class Explored(NamedTuple):
    """Sheets of an emitter.

    Attributes
    ----------
    sheet, path : (n,) uint64
        Ascending, and the signature of its path.
    surface : (n,) int32
        Row of the surface that it is on.
    luminance : (n,) float64
        W.
    n_rays : (n,) int64
        Rays that it is the light of.
    before : (k, 2) uint64
        Signatures of paths, and of those one event before.
    points : dict of Chart to Points
        All light that was found, of each chart.
    n_scattered : int
        Rays of each chart.
    """

    sheet: Signatures
    path: Signatures
    surface: NDArray[np.int32]
    luminance: Floats
    n_rays: NDArray[np.int64]
    before: NDArray[np.uint64]
    points: dict[Chart, Points]
    n_scattered: int


class FollowedSheets:
    """Sheets of an emitter that have images.

    Attributes
    ----------
    sheets : (n,) uint64
        Ascending.
    paths : (k,) uint64
        The sheets, and the signatures of paths that lead to them, ascending.
    """

    def __init__(self, explored: Explored, is_followed: NDArray[np.bool_]) -> None:
        self._explored = explored
        self._path = dict(zip(explored.sheet.tolist(), explored.path.tolist(), strict=True))
        self._before = dict(explored.before.tolist())
        self._follow(explored.sheet[is_followed])

    @property
    def surfaces(self) -> dict[int, int]:
        """Rows of the surfaces that sheets are on."""
        return dict(
            zip(self._explored.sheet.tolist(), self._explored.surface.tolist(), strict=True)
        )

    @property
    def left(self) -> float:
        """Luminance of the sheets that are not followed, W."""
        others = ~np.isin(self._explored.sheet, self.sheets)
        return float(self._explored.luminance[others].sum())

    @property
    def luminance(self) -> float:
        """Luminance of all sheets, W."""
        return float(self._explored.luminance.sum())

    def falls_short(self, luminance: Floats) -> NDArray[np.bool_]:
        """(n,) true for the sheets of whose light (n,) much is missing from images."""
        rows = np.searchsorted(self._explored.sheet, self.sheets)
        noise = _SHORT / np.sqrt(self._explored.n_rays[rows])
        short: NDArray[np.bool_] = luminance < (
            (1.0 - _SHORT_SHARE - noise) * self._explored.luminance[rows]
        )
        return short

    @property
    def n_scattered(self) -> int:
        """Rays of each chart that sheets were found by."""
        return self._explored.n_scattered

    def points(self, chart: Chart, *, followed: bool) -> Points:
        """Light of a chart that was found of sheets that are followed, or of all others."""
        points = self._explored.points[chart]
        return points.of(np.isin(points.sheet, self.sheets, invert=not followed))

    def drop(self, given_up: Signatures) -> None:
        """Leave some sheets to photons."""
        self._follow(self.sheets[~np.isin(self.sheets, given_up)])

    def _follow(self, followed: Signatures) -> None:
        paths = set(followed.tolist())
        for sheet in followed.tolist():
            path = self._path[sheet]
            while path:
                paths.add(path)
                path = self._before[path]
        self.sheets = followed
        self.paths = np.array(sorted(paths), dtype=np.uint64)


def followed_sheets(
    charts: list[Chart], tracer: SplittingTracer, n_rays: int, misplaced: float
) -> dict[int, FollowedSheets]:
    """Of each emitter the sheets of most light, all but a small share of the light of all.

    `n_rays` are all that may be traced, `misplaced` is the share of the light that may lie
    elsewhere.
    """
    n = int(np.clip(_SHARE * n_rays, _LEAST_EXPLORED, _MOST_EXPLORED)) // max(len(charts), 1)
    found: dict[int, Explored] = {}
    for emitter_id in sorted({each.emitter_id for each in charts}):
        mine = [each for each in charts if each.emitter_id == emitter_id]
        found[emitter_id] = _explored(mine, tracer, max(n, _LEAST_EXPLORED))
    luminance = np.concatenate([each.luminance for each in found.values()] or [np.empty(0)])
    share = min(misplaced, _MOST_MISPLACED) * luminance.sum()
    order = np.argsort(-luminance, kind="stable")
    rest = luminance.sum() - np.cumsum(luminance[order])
    is_followed = np.zeros(len(order), dtype=bool)
    is_followed[order[: int(np.count_nonzero(rest > _LEFT * share)) + 1]] = True
    is_followed &= luminance >= _LEAST * share
    ends = np.cumsum([len(each.sheet) for each in found.values()])
    parts = np.split(is_followed, ends[:-1]) if found else []
    return {
        emitter_id: FollowedSheets(each, part)
        for (emitter_id, each), part in zip(found.items(), parts, strict=True)
    }


def _explored(charts: list[Chart], tracer: SplittingTracer, n_rays: int) -> Explored:
    """Sheets of the charts of one emitter, by so many rays scattered over each."""
    points, surface = {}, []
    before = [np.empty((0, 2), np.uint64)]
    places = scattered(n_rays)
    for chart in charts:
        rays = chart.rays(places)
        key = np.arange(n_rays, dtype=np.uint64)
        found, signatures = tracer.explore(rays.origin, rays.direction, key, chart.emitter_id)
        light = found.throughput * rays.power[found.node] / n_rays
        place = places[found.node]
        # Among the light of all sheets, so that a faint one is not brighter than others around it.
        side = spacings(found.position)
        points[chart] = Points(found.position, found.normal, light, place, found.sheet, side)
        surface.append(found.object_id)
        before.append(signatures)
    sheet = np.concatenate([each.sheet for each in points.values()])
    luminance = np.concatenate([each.flux for each in points.values()]) @ LUMINANCE
    each, first, number = np.unique(sheet, return_index=True, return_inverse=True)
    surface_of_each = np.concatenate(surface)[first]
    return Explored(
        each,
        # A sheet is its path's signature and its surface, by exclusive or.
        sheets(each, surface_of_each),
        surface_of_each,
        np.bincount(number, luminance, len(each)).astype(np.float64),
        np.bincount(number, minlength=len(each)),
        np.unique(np.concatenate(before), axis=0),
        points,
        n_rays,
    )


def scattered(n: int) -> Floats:
    """Evenly scattered points (n, 2) of the unit square (the R2 sequence of Roberts 2018).

    Sheets may be narrow along the edges of a chart, where grids have no points.
    """
    return np.mod(0.5 + np.outer(np.arange(n), _R2), 1.0)
