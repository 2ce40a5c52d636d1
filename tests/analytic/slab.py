"""A flat dielectric slab in collimated light, every internal reflection summed."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tests.analytic.interface import Floats, fresnel_reflectance, refraction_angle


def slab_transmittance(
    ior: float, incidence: float = 0.0, *, absorption: ArrayLike = 0.0, thickness: float = 1.0
) -> Floats:
    """Return the fraction of the flux that leaves on the far side.

    With interface reflectance R and one-way attenuation A it is the geometric series
    (1-R)² A (1 + R²A² + R⁴A⁴ + …) = (1-R)² A / (1 - R²A²); without absorption (1-R)/(1+R).

    Parameters
    ----------
    ior : float
        Index of the slab over that of its surroundings.
    incidence : float
        Angle outside, in radians.
    absorption : array_like
        Beer–Lambert coefficients, 1/m; the result has their shape.
    thickness : float
        Of the slab, m.
    """
    reflectance, attenuation = _one_pass(ior, incidence, absorption, thickness)
    return (1 - reflectance) ** 2 * attenuation / (1 - (reflectance * attenuation) ** 2)


def slab_reflectance(
    ior: float, incidence: float = 0.0, *, absorption: ArrayLike = 0.0, thickness: float = 1.0
) -> Floats:
    """Return the fraction of the flux that leaves on the near side; see `slab_transmittance`."""
    reflectance, attenuation = _one_pass(ior, incidence, absorption, thickness)
    returned = (1 - reflectance) ** 2 * reflectance * attenuation**2
    return reflectance + returned / (1 - (reflectance * attenuation) ** 2)


def _one_pass(
    ior: float, incidence: float, absorption: ArrayLike, thickness: float
) -> tuple[Floats, Floats]:
    path = thickness / np.cos(refraction_angle(incidence, ior))
    return fresnel_reflectance(incidence, ior), np.exp(-np.multiply(absorption, path))
