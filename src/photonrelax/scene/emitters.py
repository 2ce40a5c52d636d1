"""Light sources."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from .._util.frozen import frozen, set_field
from .._util.validation import float_array, rgb, unit_vectors

if TYPE_CHECKING:
    pass


@dataclass(frozen=True, eq=False)
class CollimatedEmitter:
    """Parallel light from infinitely far away, covering the scene.

    Parameters
    ----------
    direction : (3,)
        Where the light travels to; any length.
    irradiance : (3,) or float
        W/m² on a plane facing the light.
    """

    direction: ArrayLike
    irradiance: ArrayLike = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        set_field(self, "direction", frozen(unit_vectors(self.direction, "direction", (3,))))
        set_field(self, "irradiance", frozen(rgb(self.irradiance, "irradiance")))


@dataclass(frozen=True, eq=False)
class PointEmitter:
    """A point that shines alike in all directions, with intensity power/4π.

    Parameters
    ----------
    position : (3,)
        m.
    power : (3,) or float
        Total emitted flux, W.
    """

    position: ArrayLike
    power: ArrayLike = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        set_field(self, "position", frozen(float_array(self.position, "position", (3,))))
        set_field(self, "power", frozen(rgb(self.power, "power")))


@dataclass(frozen=True, eq=False)
class LambertianEmitter:
    """A point that shines into a hemisphere with intensity power/π · cos θ.

    Parameters
    ----------
    position : (3,)
        m.
    direction : (3,)
        Axis of the hemisphere; any length.
    power : (3,) or float
        Total emitted flux, W.
    """

    position: ArrayLike
    direction: ArrayLike
    power: ArrayLike = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        set_field(self, "position", frozen(float_array(self.position, "position", (3,))))
        set_field(self, "direction", frozen(unit_vectors(self.direction, "direction", (3,))))
        set_field(self, "power", frozen(rgb(self.power, "power")))


Emitter = CollimatedEmitter | PointEmitter | LambertianEmitter
