"""Fresnel at a plane interface, in NumPy, as the oracles use it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def refraction_angle(incidence: ArrayLike, ior: float) -> Floats:
    """Return the angle inside a medium of relative index `ior` (Snell), both in radians."""
    return np.arcsin(np.sin(incidence) / ior)


def fresnel_reflectance(incidence: ArrayLike, ior: float) -> Floats:
    """Return the unpolarised mean reflectance for light entering relative index `ior`.

    It is the same for light that leaves by the same path, so one function serves both sides.
    """
    cos_outside = np.cos(incidence)
    cos_inside = np.cos(refraction_angle(incidence, ior))
    perpendicular = (cos_outside - ior * cos_inside) / (cos_outside + ior * cos_inside)
    parallel = (ior * cos_outside - cos_inside) / (ior * cos_outside + cos_inside)
    return (perpendicular**2 + parallel**2) / 2
