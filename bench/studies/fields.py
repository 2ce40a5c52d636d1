"""Fields whose last stage has settings of its own."""

from __future__ import annotations

import photonrelax as pr
from photonrelax.estimation.field import PhotonField
from photonrelax.estimation.methods import METHODS


def field_with(photons: pr.PhotonMap, method: str, settings: object) -> PhotonField:
    """Field of a method, given the settings of the stage that evaluates the estimates."""
    return pr.irradiance_field(photons, method=method, **{METHODS[method].stages[-1]: settings})
