"""A flat dielectric slab in collimated light, every internal reflection summed."""

from __future__ import annotations

import numpy as np

from .interface import fresnel_reflectance, refraction_angle


def slab_transmittance(
    ior: float, incidence: float = 0.0, *, absorption: float = 0.0, thickness: float = 1.0
) -> float:
    """Return the fraction of the flux that leaves on the far side.

    With interface reflectance R and one-way attenuation A it is the geometric series
    (1-R)² A (1 + R²A² + R⁴A⁴ + …) = (1-R)² A / (1 - R²A²); without absorption (1-R)/(1+R).

    Parameters
    ----------
    ior : float
        Index of the slab over that of its surroundings.
    incidence : float
        Angle outside, in radians.
    absorption : float
        Beer–Lambert coefficient, 1/m.
    thickness : float
        Of the slab, m.
    """
    reflectance, attenuation = _pass(ior, incidence, absorption, thickness)
    passed = (1 - reflectance) ** 2 * attenuation
    return float(passed / (1 - (reflectance * attenuation) ** 2))


def slab_reflectance(
    ior: float, incidence: float = 0.0, *, absorption: float = 0.0, thickness: float = 1.0
) -> float:
    """Return the fraction of the flux that leaves on the near side; see `slab_transmittance`."""
    reflectance, attenuation = _pass(ior, incidence, absorption, thickness)
    returned = (1 - reflectance) ** 2 * reflectance * attenuation**2
    return float(reflectance + returned / (1 - (reflectance * attenuation) ** 2))


def _pass(ior: float, incidence: float, absorption: float, thickness: float) -> tuple[float, float]:
    path = thickness / np.cos(refraction_angle(incidence, ior))
    return float(fresnel_reflectance(incidence, ior)), float(np.exp(-absorption * path))
