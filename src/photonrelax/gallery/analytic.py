"""Analytic irradiance of built-in scenes, from geometry without photons."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats
from ..spatial.kdtree import KDTree
from ..transport.optics import fresnel

Bools = NDArray[np.bool_]
AnalyticIrradiance = Callable[[Floats, Floats], tuple[Floats, Bools]]
"""Maps points and normals, (m, 3) each, to the irradiance of caustics, (m,) W/m², equal in all
channels, and to a mask (m,) of the points where it is known."""

# Intervals of azimuth that are searched for the light at a point; points evaluated together; steps
# of Newton's method; azimuths of the points on folds and borders.
_N_INTERVALS, _CHUNK, _NEWTON_STEPS, _N_BORDER = 256, 20_000, 4, 4001
# Orders of reflection inside a sphere, angles of incidence, and spacing of distances, m.
_ORDERS, _N_ANGLES, _SPACING = range(-1, 12), 100_001, 5e-4


def _on_floor(points: Floats, normals: Floats) -> Bools:
    return (np.abs(points[:, 2]) < 1e-6) & (normals[:, 2] > 0.5)


@dataclass(frozen=True)
class RingIrradiance:
    """Irradiance of the floor from light that `photonrelax.gallery.ring` reflects once.

    At azimuth a of the wall light is reflected along -(cos 2a, sin 2a). It descends by tan e per
    metre, and after s metres over the floor its irradiance is ρ E₀ sin e / abs(1 - 2s / (R cos a)).
    It passes the point (x, y) if x sin 2a - y cos 2a = R sin a. The irradiance is known inside the
    ring, except near its rim, where light arrives that was reflected twice, and except within
    `margin` m of the fold and of the borders of light.

    Attributes are those of the scene; `elevation` in degrees.
    """

    radius: float = 1.0
    height: float = 0.4
    gap: float = 1e-3
    elevation: float = 28.0
    reflectance: float = 0.95
    irradiance: float = 1.6
    margin: float = 0.01

    def __call__(self, points: Floats, normals: Floats) -> tuple[Floats, Bools]:
        """Irradiance (m,) and the mask (m,) of the points where it is known."""
        known = _on_floor(points, normals)
        known &= np.linalg.norm(points[:, :2], axis=1) < self._reflected_once() - self.margin
        rows = np.flatnonzero(known)
        known[rows] = self._borders.query(points[rows, :2], 1).distance[:, 0] > self.margin
        irradiance = np.zeros(len(points))
        for first in range(0, len(rows), _CHUNK):
            some = rows[first : first + _CHUNK]
            irradiance[some] = self._irradiance(points[some, :2])
        return irradiance, known

    @property
    def _slope(self) -> float:
        return float(np.tan(np.radians(self.elevation)))

    def _reflected_once(self) -> float:
        """Radius of the circle that light reflected twice does not reach, m."""
        half_chord = self.height / (2.0 * self._slope)
        return float(np.sqrt(max(self.radius**2 - half_chord**2, 0.0)))

    @cached_property
    def _borders(self) -> KDTree:
        """Points on the fold and on the borders of light."""
        azimuth = np.linspace(-np.pi / 2, np.pi / 2, _N_BORDER)
        chord, top = 2.0 * self.radius * np.cos(azimuth), (self.gap + self.height) / self._slope
        runs = (chord / 4.0, np.full(_N_BORDER, self.gap / self._slope), np.full(_N_BORDER, top))
        wall = self.radius * np.column_stack([np.cos(azimuth), np.sin(azimuth)])
        heading = -np.column_stack([np.cos(2 * azimuth), np.sin(2 * azimuth)])
        drawn = [wall + run[:, np.newaxis] * heading for run in (*runs, top - chord)]
        return KDTree(np.concatenate(drawn), n_metric=2)

    def _irradiance(self, xy: Floats) -> Floats:
        """Irradiance (m,) at points (m, 2) of the floor, summed over azimuths."""
        azimuth = np.linspace(-np.pi / 2, np.pi / 2, _N_INTERVALS + 1)
        side = xy @ np.stack([np.sin(2 * azimuth), -np.cos(2 * azimuth)])
        side -= self.radius * np.sin(azimuth)
        rows, cells = np.nonzero((side[:, :-1] > 0.0) != (side[:, 1:] > 0.0))
        before, after = side[rows, cells], side[rows, cells + 1]
        found = azimuth[cells] + before / (before - after) * (azimuth[1] - azimuth[0])
        x, y = xy[rows].T
        for _ in range(_NEWTON_STEPS):
            value = x * np.sin(2 * found) - y * np.cos(2 * found) - self.radius * np.sin(found)
            slope = 2 * x * np.cos(2 * found) + 2 * y * np.sin(2 * found)
            found = found - value / (slope - self.radius * np.cos(found))
        irradiance = np.zeros(len(xy))
        np.add.at(irradiance, rows, self._branch(x, y, found))
        return irradiance

    def _branch(self, x: Floats, y: Floats, azimuth: Floats) -> Floats:
        """Irradiance (m,) at points from one azimuth of the wall each, W/m²."""
        cosine = np.cos(azimuth)
        run = -(x - self.radius * cosine) * np.cos(2 * azimuth)
        run -= (y - self.radius * np.sin(azimuth)) * np.sin(2 * azimuth)
        left, top = run * self._slope, self.gap + self.height
        lit = (left >= self.gap) & (left <= top)
        lit &= left + 2 * self.radius * cosine * self._slope > top
        spread = np.abs(1.0 - 2.0 * run / (self.radius * cosine))
        falling = self.reflectance * self.irradiance * np.sin(np.radians(self.elevation))
        return np.divide(falling, spread, out=np.zeros_like(spread), where=lit & (spread > 0.0))


@dataclass(frozen=True)
class SphereIrradiance:
    """Irradiance of the floor from light that `photonrelax.gallery.sphere` refracts and reflects.

    Light that enters at the distance b from the axis, at the angle of incidence i and of refraction
    t, and is reflected inside m times is deflected by 2 (i - t) + m (π - 2t); reflected outside, by
    2i - π. At the distance r where it meets the floor its irradiance is E₀ w b / (r |dr/db|), with
    the share w by Fresnel's equations. The irradiance is known except within `margin` m of a fold
    and three times that of the axis.

    Attributes are those of the scene.
    """

    radius: float = 1.0
    gap: float = 0.2
    ior: float = 1.5
    irradiance: float = 0.8
    margin: float = 0.02

    def __call__(self, points: Floats, normals: Floats) -> tuple[Floats, Bools]:
        """Irradiance (m,) and the mask (m,) of the points where it is known."""
        distance = np.linalg.norm(points[:, :2], axis=1)
        at, values, folds = self._table
        known = _on_floor(points, normals) & (distance > 3.0 * self.margin) & (distance < at[-1])
        next_to = np.searchsorted(folds, distance)
        for fold in (folds[np.maximum(next_to - 1, 0)], folds[np.minimum(next_to, folds.size - 1)]):
            known &= np.abs(distance - fold) > self.margin
        return np.interp(distance, at, values), known

    @cached_property
    def _table(self) -> tuple[Floats, Floats, Floats]:
        """Distances from the axis, the irradiance there, and the distances of folds."""
        at = np.arange(_SPACING, 6.0 * self.radius, _SPACING)
        angle = np.linspace(0.0, np.pi / 2, _N_ANGLES)
        total, folds = np.zeros(at.size + 1), []
        for order in _ORDERS:
            landing, weight = self._landing(angle, order)
            flux = np.diff((self.radius * np.sin(angle)) ** 2) / 2 * (weight[1:] + weight[:-1]) / 2
            width = np.diff(landing)
            lands = np.isfinite(width) & (width != 0.0)
            first = np.searchsorted(at, np.minimum(landing[:-1], landing[1:])[lands])
            end = np.searchsorted(at, np.maximum(landing[:-1], landing[1:])[lands])
            density = flux[lands] / np.abs(width[lands])
            # Each interval of incidence adds its density between two distances.
            total += np.bincount(first, density, minlength=at.size + 1)
            total -= np.bincount(end, density, minlength=at.size + 1)
            turns = np.sign(width[1:]) * np.sign(width[:-1]) < 0.0
            folds.append(landing[1:-1][turns])
        values = self.irradiance * np.maximum(np.cumsum(total)[:-1], 0.0) / at
        return at, values, np.unique(np.concatenate(folds))

    def _landing(self, incidence: Floats, order: int) -> tuple[Floats, Floats]:
        """Distance from the axis where light meets the floor, m, or NaN; its share of the flux."""
        refraction = np.arcsin(np.sin(incidence) / self.ior)
        # Angles from straight up, in the plane of incidence.
        leaves_at = incidence + (order + 1) * (np.pi - 2 * refraction)
        downward = -np.cos(leaves_at + incidence)
        height = self.radius + self.gap + self.radius * np.cos(leaves_at)
        run = np.divide(height, downward, out=np.full_like(height, np.nan), where=downward > 1e-12)
        landing = np.abs(self.radius * np.sin(leaves_at) + run * np.sin(leaves_at + incidence))
        reflected = fresnel(np.cos(incidence), 1.0, self.ior)
        share = reflected if order < 0 else (1 - reflected) ** 2 * reflected**order
        return landing, share


_BY_SCENE: dict[str, Any] = {"ring": RingIrradiance, "sphere": SphereIrradiance}


def analytic_irradiance(name: str) -> AnalyticIrradiance | None:
    """Analytic irradiance of a built-in scene of its default sizes, None if there is none."""
    irradiance: AnalyticIrradiance | None = _BY_SCENE[name]() if name in _BY_SCENE else None
    return irradiance
