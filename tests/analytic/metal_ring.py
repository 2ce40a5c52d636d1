"""A ring that reflects on its inner wall, standing on a floor, in tilted collimated light.

The wall is the cylinder x² + y² = radius², from `gap` to `gap + height` over the floor z = 0; the
light travels along (cos e, 0, -sin e) with elevation e. The lit part of the wall is sampled
densely, each sample's flux follows the law of reflection down to the floor and is binned there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.analytic.interface import Floats


@dataclass(frozen=True)
class MetalRing:
    """Inner wall of a metal ring; lengths in m, `elevation` of the light in radians."""

    radius: float = 1.0
    height: float = 0.5
    gap: float = 1e-3
    elevation: float = np.pi / 4
    irradiance: float = 1.0
    reflectance: float = 1.0

    def deposits(self, n_samples: int = 1_000_000) -> tuple[Floats, Floats]:
        """Points of the floor (m, 2) that light lands at, and its flux (m,) in W.

        A vertical mirror turns the horizontal heading and leaves the rate of descent alone, so
        light falls tan e per metre travelled along the floor, whatever it bounced off.
        """
        position, height, flux = self._lit_wall(n_samples)
        slope = np.tan(self.elevation)
        # Of the floor as the complex plane.
        heading = np.ones(len(flux), dtype=complex)
        landed = np.zeros_like(position)
        going = np.arange(len(flux))
        while len(going):
            normal = position / self.radius
            across = normal.real * heading.real + normal.imag * heading.imag
            heading -= 2 * across * normal
            flux[going] *= self.reflectance
            # The reflected ray leaves the wall at the angle it came, over the chord 2R cos i.
            chord = 2 * self.radius * np.abs(across)
            meets_wall = height - slope * chord > self.gap
            run = np.where(meets_wall, chord, height / slope)
            position = position + run * heading
            landed[going[~meets_wall]] = position[~meets_wall]
            going, position, heading = (each[meets_wall] for each in (going, position, heading))
            height = (height - slope * run)[meets_wall]
        return landed.view(float).reshape(-1, 2), flux

    def pixel_irradiance(self, edges: Floats, n_samples: int = 4_000_000) -> Floats:
        """Return the mean irradiance of square pixels, W/m², indexed [x, y].

        Parameters
        ----------
        edges : (n + 1,) array
            Pixel borders along both axes, m, evenly spaced.
        n_samples : int
            Samples over the whole wall.
        """
        landed, flux = self.deposits(n_samples)
        n, side = len(edges) - 1, edges[1] - edges[0]
        column, row = np.floor((landed.T - edges[0]) / side).astype(np.intp)
        inside = (column >= 0) & (column < n) & (row >= 0) & (row < n)
        pixel = column[inside] * n + row[inside]
        return np.bincount(pixel, flux[inside], n * n).reshape(n, n) / side**2

    def irradiance_at(self, points: Floats, n_azimuths: int = 40_001) -> Floats:
        """Return the irradiance at points (m, 2) of the floor, W/m².

        Light from azimuth a leaves the wall along -(cos 2a, sin 2a) and has E₀ sin e / |1 - 2s /
        (R cos a)| after s metres over the floor; the azimuths whose light meets a point are where
        the side changes on which it passes. Points should be so far inside that they see no light
        that met the wall twice: that stays beyond R √(1 - (height / 2R tan e)²) of the middle.
        """
        azimuth = np.linspace(-np.pi / 2, np.pi / 2, n_azimuths)[1:-1]
        heading = -np.array([np.cos(2 * azimuth), np.sin(2 * azimuth)])
        # So many points at a time that what they need fits in a cache.
        parts = np.array_split(points, len(points) * n_azimuths // 2**18 + 1)
        return np.concatenate([self._arriving(some, heading, azimuth) for some in parts])

    def _arriving(self, points: Floats, heading: Floats, azimuth: Floats) -> Floats:
        """Return the irradiance at points (m, 2), given the headings (2, n) of all azimuths."""
        # The wall is at (cos a, sin a): across and along its headings, sin a and -cos a.
        x, y = points.T[:, :, np.newaxis]
        passed = x * heading[1] - y * heading[0] + self.radius * np.sin(azimuth)
        point, before = np.nonzero((passed[:, :-1] > 0) != (passed[:, 1:] > 0))
        first, last = passed[point, before], passed[point, before + 1]
        share = first / (first - last)
        ends = np.array([before, before + 1])
        run = (points[point].T[:, np.newaxis] * heading[:, ends]).sum(axis=0)
        run += self.radius * np.cos(azimuth[ends])
        run = run[0] + share * (run[1] - run[0])
        cosine = np.cos(azimuth[before] + share * (azimuth[1] - azimuth[0]))
        left = run * np.tan(self.elevation)
        top = self.gap + self.height
        lit = (left >= self.gap) & (left <= top)
        lit &= left + 2 * self.radius * cosine * np.tan(self.elevation) > top
        spread = np.abs(1 - 2 * run[lit] / (self.radius * cosine[lit]))
        falling = self.irradiance * np.sin(self.elevation)
        with np.errstate(divide="ignore"):
            return np.bincount(point[lit], self.reflectance * falling / spread, len(points))

    def lit_flux(self) -> float:
        """Return the flux that the inner wall intercepts directly, W, by quadrature.

        At azimuth a the front wall leaves light to the uppermost 2R cos a · tan e of the wall,
        where the irradiance is E₀ cos e cos a.
        """
        azimuth = (np.arange(100_000) + 0.5) / 100_000 * np.pi - np.pi / 2
        lit = np.minimum(self.height, 2 * self.radius * np.cos(azimuth) * np.tan(self.elevation))
        per_azimuth = self.irradiance * np.cos(self.elevation) * np.cos(azimuth) * lit
        return float(per_azimuth.mean() * np.pi * self.radius)

    def _lit_wall(self, n_samples: int) -> tuple[Floats, Floats, Floats]:
        """Return complex positions (m,), heights and incident fluxes over the lit wall."""
        first, second = _even_points(n_samples)
        azimuth = (first - 0.5) * np.pi
        height = self.gap + second * self.height
        per_area = self.irradiance * np.cos(self.elevation) * np.cos(azimuth)
        flux = per_area * np.pi * self.radius * self.height / n_samples
        clearance = 2 * self.radius * np.cos(azimuth) * np.tan(self.elevation)
        lit = height + clearance > self.gap + self.height
        position = self.radius * np.exp(1j * azimuth[lit])
        return position, height[lit], flux[lit]


def _even_points(n: int) -> tuple[Floats, Floats]:
    """Return n points that fill the unit square evenly (Kronecker lattice of the plastic ratio)."""
    plastic = 1.324717957244746
    index = np.arange(n)
    return (0.5 + index / plastic) % 1.0, (0.5 + index / plastic**2) % 1.0
