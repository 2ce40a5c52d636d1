"""Surface materials."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._util.frozen import frozen, set_field
from .._util.validation import Floats, positive, rgb

if TYPE_CHECKING:
    pass

DIFFUSE, MIRROR, DIELECTRIC = 0, 1, 2
"""Values of `MaterialTable.kind`."""


@dataclass(frozen=True, eq=False)
class Diffuse:
    """Lambertian surface, the same from both sides.

    Parameters
    ----------
    albedo : (3,) or float
        Reflected fraction of the light per channel, in [0, 1].
    """

    albedo: ArrayLike = (0.8, 0.8, 0.8)

    def __post_init__(self) -> None:
        set_field(self, "albedo", frozen(rgb(self.albedo, "albedo", high=1.0)))


@dataclass(frozen=True, eq=False)
class Mirror:
    """Perfectly smooth metal, reflecting from both sides.

    Parameters
    ----------
    reflectance : (3,) or float
        Reflected fraction of the light per channel, in [0, 1].
    """

    reflectance: ArrayLike = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        set_field(self, "reflectance", frozen(rgb(self.reflectance, "reflectance", high=1.0)))


@dataclass(frozen=True, eq=False)
class Dielectric:
    """Perfectly smooth transparent body; the faces of its mesh wind outwards.

    Parameters
    ----------
    ior, exterior_ior : float
        Index of refraction inside the mesh and outside it.
    absorption : (3,) or float
        Absorption inside the mesh per channel, 1/m (Beer–Lambert).
    """

    ior: float = 1.5
    exterior_ior: float = 1.0
    absorption: ArrayLike = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        set_field(self, "ior", positive(self.ior, "ior"))
        set_field(self, "exterior_ior", positive(self.exterior_ior, "exterior_ior"))
        set_field(self, "absorption", frozen(rgb(self.absorption, "absorption")))


Material = Diffuse | Mirror | Dielectric


@dataclass(frozen=True, eq=False)
class MaterialTable:
    """The materials of n objects as arrays, for kernels.

    Attributes
    ----------
    kind : (n,) int32
        `DIFFUSE`, `MIRROR` or `DIELECTRIC`.
    reflectance : (n, 3)
        Albedo or reflectance; 1 for dielectrics.
    ior, exterior_ior : (n,)
        Indices of refraction; 1 for other materials.
    absorption : (n, 3)
        1/m; 0 for other materials.
    """

    kind: NDArray[np.int32]
    reflectance: Floats
    ior: Floats
    exterior_ior: Floats
    absorption: Floats


def _tabulate(table: MaterialTable, row: int, material: Material) -> None:
    if isinstance(material, Diffuse):
        table.kind[row] = DIFFUSE
        table.reflectance[row] = material.albedo
    elif isinstance(material, Mirror):
        table.kind[row] = MIRROR
        table.reflectance[row] = material.reflectance
    else:
        table.kind[row] = DIELECTRIC
        table.ior[row] = material.ior
        table.exterior_ior[row] = material.exterior_ior
        table.absorption[row] = material.absorption
