"""A plano-convex lens in parallel light, by exact rays in a plane through its axis."""

from dataclasses import dataclass

import numpy as np
import trimesh

from tests.analytic.interface import fresnel_reflectance, refraction_angle


@dataclass(frozen=True)
class PlanoConvex:
    """The flat face lies in z = 0, the convex one above; lengths in mm."""

    radius: float = 25.0
    curvature_radius: float = 100.0
    edge: float = 2.0
    ior: float = 1.5

    @property
    def thickness(self):
        return self.edge + self.curvature_radius - self.height_of_centre(self.radius)

    def height_of_centre(self, r):
        return np.sqrt(self.curvature_radius**2 - r**2)

    @property
    def focus(self):
        """Depth below the flat face where rays near the axis of light from above meet."""
        return self.curvature_radius / (self.ior - 1) - self.thickness / self.ior

    def mesh(self, rings=40, segments=96):
        r = np.linspace(0.0, self.radius, rings + 1)
        z = self.edge + self.height_of_centre(r) - self.height_of_centre(self.radius)
        profile = np.vstack([[[0.0, 0.0]], [[self.radius, 0.0]], np.column_stack([r, z])[::-1]])
        return trimesh.creation.revolve(profile, sections=segments)

    def flux_within(self, radius, depth, n_rays=200_000):
        """W within a radius of the axis, `depth` below the flat face, of 1 W/mm² from above."""
        y = self.radius * (np.arange(n_rays) + 0.5) / n_rays
        entering = np.arcsin(y / self.curvature_radius)
        inside = refraction_angle(entering, self.ior)
        # Angles from the axis: the normal of the convex face leans by `entering`.
        slope = entering - inside
        z = self.thickness - self.curvature_radius + self.height_of_centre(y)
        below = refraction_angle(slope, 1.0 / self.ior)
        landed = y - z * np.tan(slope) - depth * np.tan(below)
        power = 2 * np.pi * y * self.radius / n_rays
        power *= 1.0 - fresnel_reflectance(entering, self.ior)
        power *= 1.0 - fresnel_reflectance(slope, 1.0 / self.ior)
        return power[np.abs(landed) < radius].sum()

    def flux_within_from_below(self, radius, height, n_rays=200_000):
        """W within a radius of the axis, `height` above the apex, of 1 W/mm² from below."""
        y = self.radius * (np.arange(n_rays) + 0.5) / n_rays
        inside = np.arcsin(y / self.curvature_radius)
        outside = refraction_angle(inside, 1.0 / self.ior)
        rise = height + self.curvature_radius - self.height_of_centre(y)
        landed = y - rise * np.tan(outside - inside)
        power = 2 * np.pi * y * self.radius / n_rays
        power *= 1.0 - fresnel_reflectance(0.0 * y, self.ior)
        power *= 1.0 - fresnel_reflectance(inside, 1.0 / self.ior)
        return power[np.abs(landed) < radius].sum()
