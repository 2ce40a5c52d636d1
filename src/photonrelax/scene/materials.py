"""Surface materials."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._util.frozen import frozen, set_field
from .._util.validation import Floats, count, positive, rgb
from .dispersion import Dispersion, table_wavelengths
from .textures import FaceTexture, Texture

MAX_PRIORITY = 2**31 - 1
"""Ceiling of priorities, and of their negatives."""


@dataclass(frozen=True, eq=False)
class MaterialRow:
    """One material as a row of a `MaterialTable`.

    Attributes
    ----------
    kind : str
        Name of the kernel's kind.
    reflectance : (3,)
        Albedo or reflectance.
    ior : float
        Index of refraction inside, at the d line.
    dispersion : Dispersion, optional
        Index over wavelength; None for one index.
    exterior_ior : float, optional
        Index of refraction outside; None for that of the medium around.
    absorption : (3,)
        1/m.
    priority : int
        Of the medium inside, where others overlap it.
    tint : (3,)
        Factor on light that is refracted.
    schlick : bool
        The reflectance rises to 1 at grazing angles.
    """

    kind: str
    reflectance: ArrayLike = (1.0, 1.0, 1.0)
    ior: float = 1.0
    dispersion: Dispersion | None = None
    exterior_ior: float | None = 1.0
    absorption: ArrayLike = (0.0, 0.0, 0.0)
    priority: int = 0
    tint: ArrayLike = (1.0, 1.0, 1.0)
    schlick: bool = False


class Material(ABC):
    """Surface of an object.

    Attributes
    ----------
    is_specular : bool
        Light leaves it in single directions; photons of caustics are aimed at it.
    has_inside : bool
        Its two sides differ: closed meshes wind outwards.
    is_sensor : bool
        It stores the photons that cross it, and nothing else meets it.
    """

    is_specular: ClassVar[bool] = True
    has_inside: ClassVar[bool] = False
    is_sensor: ClassVar[bool] = False

    @property
    def texture(self) -> Texture | None:
        """Texture of the albedo; None for one albedo all over."""
        return None

    @abstractmethod
    def row(self) -> MaterialRow:
        """The material as kernels read it."""


@dataclass(frozen=True, eq=False)
class Diffuse(Material):
    """Lambertian surface, the same from both sides.

    Parameters
    ----------
    albedo : (3,), float or Texture
        Reflected fraction of the light per channel, in [0, 1].
    """

    is_specular: ClassVar[bool] = False

    albedo: ArrayLike | Texture = (0.8, 0.8, 0.8)

    def __post_init__(self) -> None:
        if not isinstance(self.albedo, Texture):
            set_field(self, "albedo", frozen(rgb(self.albedo, "albedo", high=1.0)))

    @property
    def texture(self) -> Texture | None:
        return self.albedo if isinstance(self.albedo, Texture) else None

    def row(self) -> MaterialRow:
        albedo = self.albedo.mean if isinstance(self.albedo, Texture) else self.albedo
        return MaterialRow("diffuse", reflectance=albedo)


@dataclass(frozen=True, eq=False)
class Mirror(Material):
    """Perfectly smooth metal, reflecting from both sides.

    Parameters
    ----------
    reflectance : (3,) or float
        Reflected fraction R of the light per channel, in [0, 1].
    schlick : bool
        True: R is that of light along the normal, and rises to 1 at grazing angles as Schlick's
        approximation of metals has it, R + (1 - R) (1 - cos θ)⁵. False: the same at all angles.
    """

    reflectance: ArrayLike = (1.0, 1.0, 1.0)
    schlick: bool = False

    def __post_init__(self) -> None:
        set_field(self, "reflectance", frozen(rgb(self.reflectance, "reflectance", high=1.0)))
        set_field(self, "schlick", bool(self.schlick))

    def row(self) -> MaterialRow:
        return MaterialRow("mirror", reflectance=self.reflectance, schlick=self.schlick)


@dataclass(frozen=True, eq=False)
class Dielectric(Material):
    """Perfectly smooth transparent body; the faces of its mesh wind outwards.

    Bodies may lie in one another: a bubble in water is a body of index 1 in a body of index 1.33.
    Where several overlap, that of the largest priority rules; of equal ones, that which a ray
    entered last. The surface of a body is not there inside of a body of larger priority: light goes
    straight on, which is no bounce.

    Parameters
    ----------
    ior : float or Dispersion
        Index of refraction inside the mesh: a number, or one over wavelength, by
        which white light is dispersed; cameras see by that at the d line.
    exterior_ior : float, optional
        Index of refraction outside of it. None, the default, is that of the dielectric around, or
        1 in none. A number holds for this surface alone, whatever is around it: the surface is
        there inside of bodies of larger priority too, with both of its indices.
    absorption : (3,) or float
        Absorption inside the mesh per channel, 1/m (Beer–Lambert), where the body rules. It does
        not add to that of dielectrics around.
    priority : int
        Larger ones rule, at most 2^31 - 1 in size: a liquid that overlaps its glass has a smaller
        one than the glass.
    tint : (3,) or float
        Factor per channel, in [0, 1], on the light that is refracted at the surface, whichever way
        it goes; the rest is absorbed. Reflected light has none, nor has light at a surface that is
        not there.
    """

    has_inside: ClassVar[bool] = True

    ior: float | Dispersion = 1.5
    exterior_ior: float | None = None
    absorption: ArrayLike = (0.0, 0.0, 0.0)
    priority: int = 0
    tint: ArrayLike = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        if not isinstance(self.ior, Dispersion):
            set_field(self, "ior", positive(self.ior, "ior"))
        if self.exterior_ior is not None:
            set_field(self, "exterior_ior", positive(self.exterior_ior, "exterior_ior"))
        set_field(self, "absorption", frozen(rgb(self.absorption, "absorption")))
        priority = count(self.priority, "priority", low=-MAX_PRIORITY, high=MAX_PRIORITY)
        set_field(self, "priority", priority)
        set_field(self, "tint", frozen(rgb(self.tint, "tint", high=1.0)))

    def row(self) -> MaterialRow:
        glass = self.ior
        return MaterialRow(
            "dielectric",
            ior=glass.index_d if isinstance(glass, Dispersion) else glass,
            dispersion=glass if isinstance(glass, Dispersion) else None,
            exterior_ior=self.exterior_ior,
            absorption=self.absorption,
            priority=self.priority,
            tint=self.tint,
        )


@dataclass(frozen=True, eq=False)
class Sensor(Material):
    """Surface in free space, or inside of anything, that stores the photons that cross it.

    Photons of the kind that is traced are stored on it, from either side, and go on as if it were
    not there, so that they may be stored on other sensors and objects as well. Cameras, direct
    light and the energy ledger know nothing of it: the flux that a ledger says to be stored is that
    of the photons on other objects.
    """

    is_specular: ClassVar[bool] = False
    is_sensor: ClassVar[bool] = True

    def row(self) -> MaterialRow:
        return MaterialRow("sensor")


@dataclass(frozen=True, eq=False)
class MaterialTable:
    """The materials of n objects as arrays, for kernels.

    Attributes
    ----------
    kind : (n,) str
        "diffuse", "mirror", "dielectric" or "sensor".
    reflectance : (n, 3)
        Albedo or reflectance; 1 for dielectrics and sensors.
    ior : (n,)
        Index of refraction inside dielectrics, at the d line; 1 for other materials.
    dispersed_ior : (n,) array or None
        Indices (nodes,) at the wavelengths of tables; None for one index.
    exterior_ior : (n,)
        Index of refraction outside; NaN where it is that of the medium around, 1 for other
        materials.
    absorption : (n, 3)
        1/m; 0 for other materials.
    priority : (n,) int64
        Of dielectrics, where they overlap; 0 for other materials.
    tint : (n, 3)
        Factor on light that dielectrics refract; 1 for other materials.
    schlick : (n,) bool
        The reflectance rises to 1 at grazing angles.
    textures : (n,) FaceTexture or None
        Of diffuse objects, whose `reflectance` is the mean; None for those of one albedo, and for
        all where no meshes are known.
    """

    kind: tuple[str, ...]
    reflectance: Floats
    ior: Floats
    dispersed_ior: tuple[Floats | None, ...]
    exterior_ior: Floats
    absorption: Floats
    priority: NDArray[np.int64]
    tint: Floats
    schlick: NDArray[np.bool_]
    textures: tuple[FaceTexture | None, ...]

    @classmethod
    def of(cls, materials: Iterable[Material]) -> MaterialTable:
        """Table of materials, a row each."""
        rows = [material.row() for material in materials]
        return cls(
            kind=tuple(row.kind for row in rows),
            reflectance=np.array([row.reflectance for row in rows], dtype=np.float64),
            ior=np.array([row.ior for row in rows], dtype=np.float64),
            dispersed_ior=tuple(
                None if row.dispersion is None else row.dispersion.index(table_wavelengths())
                for row in rows
            ),
            # None becomes NaN.
            exterior_ior=np.array([row.exterior_ior for row in rows], dtype=np.float64),
            absorption=np.array([row.absorption for row in rows], dtype=np.float64),
            priority=np.array([row.priority for row in rows], dtype=np.int64),
            tint=np.array([row.tint for row in rows], dtype=np.float64),
            schlick=np.array([row.schlick for row in rows], dtype=bool),
            textures=(None,) * len(rows),
        )
