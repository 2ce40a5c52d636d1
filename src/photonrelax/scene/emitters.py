"""Light sources."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._ext.scene.emitters import towards
from .._util.frozen import frozen, set_field
from .._util.validation import Floats, float_array, rgb, unit_vectors
from .emission_region import (
    EmissionRegion,
    Sphere,
    SpotLobe,
    cap_directions,
    cap_region,
    cosine_lobe_region,
    disk_region,
    spot_region,
    start_distance,
    sun_region,
)
from .lamps import COSINE, PARALLEL, SPOT, UNIFORM, Lamp

if TYPE_CHECKING:
    from .scene import SceneObject

# Largest half angle of a spot, degrees, as in glTF.
_WIDEST_SPOT = 90.0
# Angular radius that those of suns are below, degrees.
_WIDEST_SUN = 90.0


class DirectLight(NamedTuple):
    """Unoccluded light of one emitter at m points.

    Attributes
    ----------
    direction : (m, 3) float64
        Unit vectors to the emitter; zero where there is no light.
    distance : (m,) float64
        To the emitter, m; inf for light from infinitely far away.
    irradiance : (m, 3) float64
        W/m² on surfaces that face the emitter.
    """

    direction: Floats
    distance: Floats
    irradiance: Floats


class Emitter(ABC):
    """A light source with one ray at each emitter coordinate.

    Subclasses are frozen dataclasses: the digest of a scene is that of their fields.
    """

    @property
    def point(self) -> Floats | None:
        """Position (3,) of a point-like emitter, m; None for others."""
        return None

    @abstractmethod
    def emission_region(
        self, target: Sphere, scene: Sphere, emitter_offset: float
    ) -> EmissionRegion:
        """Return the region to sample for photons that may hit a target, one of several.

        The regions of an emitter share one chart: disks with the same frame, whatever the target,
        or directions from the same point. Where they overlap, light counts once.

        Parameters
        ----------
        target, scene : Sphere
            Around what photons are aimed at, and around all objects.
        emitter_offset : float
            Distance from the emitter within which photons hit nothing, for it may lie on a
            surface, m.
        """

    @property
    def surface(self) -> SceneObject | None:
        """Object that rays meet, of an emitter that is a surface; None for others."""
        return None

    def surface_radiance(self, from_behind: NDArray[np.bool_]) -> Floats:
        """Return the radiance (m, 3) of its surface, seen from behind or not, W/(m² sr)."""
        return np.zeros((len(from_behind), 3))

    @property
    def is_extended(self) -> bool:
        """True if a point gets light from many directions, which are then sampled."""
        return False

    @property
    def lamp(self) -> Lamp | None:
        """Parameters for the kernels that replace `direct` where lamps are many; None: not one."""
        return None

    @abstractmethod
    def direct(self, position: Floats, emitter_offset: float) -> DirectLight:
        """Return the light at points (m, 3); none nearer to the emitter than the offset, m.

        That of an extended emitter is as if all came from its middle.
        """

    @property
    def is_background(self) -> bool:
        """True if it is seen where there is no surface."""
        return False

    def background(self, direction: Floats) -> Floats:
        """Return the radiance (m, 3) that rays of directions (m, 3) escape to, W/(m² sr)."""
        return np.zeros_like(direction)

    def background_means(self, direction: Floats, edges: Floats) -> Floats:
        """Return means (m, 3) of the radiance around directions (m, 3), W/(m² sr).

        They are over parallelograms whose edges are changes (m, 2, 3) of the unit vectors. By
        default the radiance in the middle.
        """
        return self.background(direction)

    def sampled(
        self, position: Floats, normal: Floats, emitter_offset: float, sample: Floats
    ) -> DirectLight:
        """Return light of which the mean over all samples (m, 2), in [0, 1)², is that at points.

        `normal` (m, 3) is on the lit side. As `direct` for emitters that are not extended.
        """
        return self.direct(position, emitter_offset)


@dataclass(frozen=True, eq=False)
class CollimatedEmitter(Emitter):
    """Light from infinitely far away, covering the scene: parallel, or of a sun.

    Parameters
    ----------
    direction : (3,)
        Where the light of the sun's centre travels to; any length.
    irradiance : (3,) or float
        W/m² on a plane facing the light.
    angular_radius : float
        Half the angle under which the sun is seen, degrees, below 90; its radiance is the same all
        over. 0 is parallel light; the sun of the Earth has 0.266.
    """

    direction: ArrayLike
    irradiance: ArrayLike = (1.0, 1.0, 1.0)
    angular_radius: float = 0.0

    def __post_init__(self) -> None:
        set_field(self, "direction", frozen(unit_vectors(self.direction, "direction", (3,))))
        set_field(self, "irradiance", frozen(rgb(self.irradiance, "irradiance")))
        angle = float(float_array(self.angular_radius, "angular_radius", ()))
        if not 0.0 <= angle < _WIDEST_SUN:
            raise ValueError(
                f"angular_radius should be in degrees, from 0 to below {_WIDEST_SUN:.0f}, "
                f"but is {angle}"
            )
        set_field(self, "angular_radius", angle)

    def emission_region(
        self, target: Sphere, scene: Sphere, emitter_offset: float
    ) -> EmissionRegion:
        """Return a disk across the light, upstream of the scene, that covers the target."""
        direction, irradiance = np.asarray(self.direction), np.asarray(self.irradiance)
        if self.angular_radius:
            angle = np.radians(self.angular_radius)
            return sun_region(direction, irradiance, angle, target, scene)
        return disk_region(direction, irradiance, target, scene)

    @property
    def is_extended(self) -> bool:
        return self.angular_radius > 0.0

    @property
    def lamp(self) -> Lamp | None:
        if self.is_extended:
            return None
        return Lamp(PARALLEL, np.asarray(self.irradiance), axis=np.asarray(self.direction))

    def direct(self, position: Floats, emitter_offset: float) -> DirectLight:
        """Return the same light at all points."""
        return self._from(np.tile(-np.asarray(self.direction), (len(position), 1)), 1.0)

    def sampled(
        self, position: Floats, normal: Floats, emitter_offset: float, sample: Floats
    ) -> DirectLight:
        """Return light from directions that are uniform over the sun."""
        one_minus_cos = 2.0 * np.sin(0.5 * np.radians(self.angular_radius)) ** 2
        to_sun = cap_directions(-np.asarray(self.direction), one_minus_cos, sample)
        # A plane that faces the centre sees the rim aslant, by 1 - one_minus_cos / 2 in the mean.
        return self._from(to_sun, 1.0 / (1.0 - 0.5 * one_minus_cos))

    def _from(self, to_sun: Floats, relative: float) -> DirectLight:
        irradiance = relative * np.asarray(self.irradiance)
        return DirectLight(
            to_sun, np.full(len(to_sun), np.inf), np.tile(irradiance, (len(to_sun), 1))
        )


@dataclass(frozen=True, eq=False)
class PointEmitter(Emitter):
    """A point with the same intensity in all directions, power/4π.

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

    @property
    def point(self) -> Floats:
        return np.asarray(self.position)

    def emission_region(
        self, target: Sphere, scene: Sphere, emitter_offset: float
    ) -> EmissionRegion:
        """Return the cone of directions to the target, or all directions from inside of it."""
        position = np.asarray(self.position)
        start = start_distance(position, scene, emitter_offset)
        return cap_region(position, np.asarray(self.power), target, start)

    def direct(self, position: Floats, emitter_offset: float) -> DirectLight:
        """Return the intensity over the squared distance."""
        direction, distance, inverse = _towards(self.position, position, emitter_offset)
        return DirectLight(direction, distance, self._intensity * inverse**2)

    @property
    def lamp(self) -> Lamp:
        return Lamp(UNIFORM, self._intensity, self.point)

    @property
    def _intensity(self) -> Floats:
        return np.asarray(self.power) / (4.0 * np.pi)


@dataclass(frozen=True, eq=False)
class LambertianEmitter(Emitter):
    """A point with intensity power/π · cos θ in the directions of a hemisphere.

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

    @property
    def point(self) -> Floats:
        return np.asarray(self.position)

    def emission_region(
        self, target: Sphere, scene: Sphere, emitter_offset: float
    ) -> EmissionRegion:
        """Return the cone to the target if that is wholly in front, else the hemisphere."""
        position, normal = np.asarray(self.position), np.asarray(self.direction)
        start = start_distance(position, scene, emitter_offset)
        return cosine_lobe_region(position, normal, np.asarray(self.power), target, start)

    def direct(self, position: Floats, emitter_offset: float) -> DirectLight:
        """Return the intensity towards each point over the squared distance."""
        direction, distance, inverse = _towards(self.position, position, emitter_offset)
        cosine = np.maximum(-direction @ np.asarray(self.direction), 0.0)[:, None]
        intensity = np.asarray(self.power) / np.pi * cosine
        return DirectLight(direction, distance, intensity * inverse**2)

    @property
    def lamp(self) -> Lamp:
        on_axis, axis = np.asarray(self.power) / np.pi, np.asarray(self.direction)
        return Lamp(COSINE, on_axis, self.point, axis, outer=1.0)


@dataclass(frozen=True, eq=False)
class SpotEmitter(Emitter):
    """A point with light in a cone, whose intensity falls off from an inner cone outwards.

    The intensity is I within the inner cone, and I ((cos θ - cos θ_outer) / (cos θ_inner -
    cos θ_outer))² from there to the outer one, as in glTF (KHR_lights_punctual); I = power /
    (2π (1 - cos θ_inner + (cos θ_inner - cos θ_outer) / 3)).

    Parameters
    ----------
    position : (3,)
        m.
    direction : (3,)
        Axis of the cone; any length.
    power : (3,) or float
        Flux emitted into the cone, W.
    inner_angle, outer_angle : float
        Half angles of the cones, degrees: 0 <= inner < outer <= 90.
    """

    position: ArrayLike
    direction: ArrayLike
    power: ArrayLike = (1.0, 1.0, 1.0)
    inner_angle: float = 0.0
    outer_angle: float = 45.0

    def __post_init__(self) -> None:
        set_field(self, "position", frozen(float_array(self.position, "position", (3,))))
        set_field(self, "direction", frozen(unit_vectors(self.direction, "direction", (3,))))
        set_field(self, "power", frozen(rgb(self.power, "power")))
        for name in ("inner_angle", "outer_angle"):
            set_field(self, name, float(float_array(getattr(self, name), name, ())))
        if not 0.0 <= self.inner_angle < self.outer_angle <= _WIDEST_SPOT:
            raise ValueError(
                "inner_angle and outer_angle should be half angles in degrees with 0 <= inner < "
                f"outer <= {_WIDEST_SPOT:.0f}, but are {self.inner_angle} and {self.outer_angle}"
            )

    @property
    def point(self) -> Floats:
        return np.asarray(self.position)

    @property
    def _lobe(self) -> SpotLobe:
        return SpotLobe.of(np.radians(self.inner_angle), np.radians(self.outer_angle))

    def emission_region(
        self, target: Sphere, scene: Sphere, emitter_offset: float
    ) -> EmissionRegion:
        """Return the sector of the cone that holds the target, or the cone from inside of it."""
        position, axis = np.asarray(self.position), np.asarray(self.direction)
        start = start_distance(position, scene, emitter_offset)
        return spot_region(position, axis, np.asarray(self.power), self._lobe, target, start=start)

    def direct(self, position: Floats, emitter_offset: float) -> DirectLight:
        """Return the intensity towards each point over the squared distance."""
        direction, distance, inverse = _towards(self.position, position, emitter_offset)
        # 1 - cos from the chord keeps its digits in narrow cones.
        drop = 0.5 * np.square(direction + np.asarray(self.direction)).sum(axis=1)
        intensity = self._on_axis * self._lobe.falloff(drop)[:, np.newaxis]
        return DirectLight(direction, distance, intensity * inverse**2)

    @property
    def lamp(self) -> Lamp:
        return Lamp(SPOT, self._on_axis, self.point, np.asarray(self.direction), *self._lobe)

    @property
    def _on_axis(self) -> Floats:
        return np.asarray(self.power) / (2.0 * np.pi * self._lobe.content(np.pi))


def _towards(
    emitter: ArrayLike, position: Floats, emitter_offset: float
) -> tuple[Floats, Floats, Floats]:
    """Return unit vectors to a point-like emitter, distances, and their inverses (m, 1).

    Vectors and inverses are zero nearer than the offset.
    """
    points = np.ascontiguousarray(position, dtype=np.float64)
    direction, distance, inverse = towards(np.asarray(emitter), points, emitter_offset)
    return direction, distance, inverse[:, np.newaxis]
