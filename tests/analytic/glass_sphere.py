"""A glass sphere over a plane, in collimated light along the plane's normal.

Everything turns about the axis, so a path is a function of the impact parameter alone: a ray that
enters at angle of incidence i, refracts to t and is reflected inside m times leaves turned by
2(i - t) + m(π - 2t) in all. m = -1 stands for the reflection off the outside, turned by 2i - π.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.analytic.interface import Floats, fresnel_reflectance, refraction_angle

OUTSIDE_REFLECTION = -1


@dataclass(frozen=True)
class GlassSphere:
    """Sphere whose lowest point is `gap` above the plane, light of irradiance `irradiance`."""

    radius: float = 1.0
    gap: float = 1.0
    ior: float = 1.5
    irradiance: float = 1.0

    def landing(self, impact: Floats, reflections: int = 0) -> tuple[Floats, Floats]:
        """Landing points of rays, as signed distances from the axis, and weights of their paths.

        Positive is the side the ray came in on; NaN where the ray leaves upwards. The weight is
        the fraction of the ray's flux that takes the path.
        """
        incidence = np.arcsin(impact / self.radius)
        refraction = refraction_angle(incidence, self.ior)
        # Clock angles in the plane of incidence, from straight up towards the side of the ray.
        leaves_at = incidence + (reflections + 1) * (np.pi - 2 * refraction)
        heading = leaves_at + incidence
        height = self.radius + self.gap + self.radius * np.cos(leaves_at)
        downward = -np.cos(heading)
        with np.errstate(divide="ignore", invalid="ignore"):
            run = np.where(downward > 0, height / downward, np.nan)
        position = self.radius * np.sin(leaves_at) + run * np.sin(heading)
        return position, self._weight(incidence, reflections)

    def total_flux(self, *, within: float = np.inf, orders: range = range(1)) -> float:
        """Return the flux on the plane within a distance of the axis, W.

        Parameters
        ----------
        within : float
            Distance, m.
        orders : range
            Numbers of internal reflections to sum over; -1 is the reflection off the outside.
        """
        return float(self.annulus_flux(np.array([0.0, within]), orders=orders)[0])

    def annulus_flux(
        self, edges: Floats, *, orders: range = range(1), n_samples: int = 400_000
    ) -> Floats:
        """Return the flux between consecutive distances from the axis, W.

        Midpoint quadrature over the squared impact parameter, in which flux is uniform.
        """
        impact = self.radius * np.sqrt((np.arange(n_samples) + 0.5) / n_samples)
        per_sample = self.irradiance * np.pi * self.radius**2 / n_samples
        flux = np.zeros(len(edges) - 1)
        for order in orders:
            position, weight = self.landing(impact, order)
            lands = np.isfinite(position)
            flux += np.histogram(np.abs(position[lands]), edges, weights=weight[lands])[0]
        return flux * per_sample

    def annulus_irradiance(self, edges: Floats, *, orders: range = range(1)) -> Floats:
        """Return the mean irradiance between consecutive distances from the axis, W/m².

        Finite at folds, where the irradiance itself is not.
        """
        return self.annulus_flux(edges, orders=orders) / (np.pi * np.diff(np.square(edges)))

    def irradiance_at(self, distance: Floats, *, orders: range = range(1)) -> Floats:
        """Return the irradiance at distances from the axis, W/m²: the sum over all branches.

        Each impact parameter b that lands at distance r adds E₀ w b / (r |dr/db|).
        """
        # Even steps in the angle of incidence resolve grazing rays, which fan out the most.
        angle = np.linspace(0.0, np.pi / 2, 100_001)
        impact = self.radius * np.sin(angle)
        total = np.zeros(len(distance))
        for order in orders:
            position, weight = self.landing(impact, order)
            reach = np.abs(position)
            cell_flux = np.diff(impact**2) / 2 * (weight[1:] + weight[:-1]) / 2
            for index, r in enumerate(distance):
                lands = (reach[:-1] - r) * (reach[1:] - r) <= 0
                width = np.abs(np.diff(reach))[lands]
                total[index] += self.irradiance * (cell_flux[lands] / (r * width)).sum()
        return total

    def _weight(self, incidence: Floats, reflections: int) -> Floats:
        reflectance = fresnel_reflectance(incidence, self.ior)
        if reflections == OUTSIDE_REFLECTION:
            return reflectance
        return (1 - reflectance) ** 2 * reflectance**reflections
