"""Regions of emitter coordinates that photons are sampled over."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from .._util.products import product
from .._util.validation import Floats
from .sky_map import SkyMap

DISK, CAP, SPHERE, ELLIPSE, SPOT, SUN, AREA = range(7)
"""Values of `EmissionRegion.kind`; the kernel of emission has the same."""

# Rays start this fraction of the scene's radius before its bounding sphere.
_CLEARANCE = 1e-3
_AXES = np.eye(3)
# Cosine between the normals of faces of one plane, at least.
_FLAT = 1.0 - 1e-9


class Sphere(NamedTuple):
    """A bounding sphere: centre (3,) and radius, m."""

    centre: Floats
    radius: float


class SpotLobe(NamedTuple):
    """Intensity around the axis of a spot, relative to that on it.

    It falls from the inner to the outer cone as (cos θ - cos θ_outer)² / (cos θ_inner -
    cos θ_outer)², the falloff of glTF's KHR_lights_punctual.

    Attributes
    ----------
    inner, outer : float
        1 - cos of the half angles of both cones.
    """

    inner: float
    outer: float

    @classmethod
    def of(cls, inner_angle: float, outer_angle: float) -> SpotLobe:
        """The lobe of half angles in rad."""
        return cls(_drop(inner_angle), _drop(outer_angle))

    def falloff(self, drop: Floats) -> Floats:
        """Relative intensity at directions, by 1 - cos of their angles to the axis."""
        rest = np.clip((self.outer - drop) / (self.outer - self.inner), 0.0, 1.0)
        return np.square(rest)

    def content(self, angle: float) -> float:
        """Integral of the relative intensity up to an angle in rad, over 2π: sr."""
        drop, width = min(_drop(angle), self.outer), self.outer - self.inner
        if drop <= self.inner:
            return drop
        return self.inner + width / 3.0 * (1.0 - ((self.outer - drop) / width) ** 3)


@dataclass(frozen=True, eq=False)
class EmissionRegion:
    """The region one emitter is sampled over, and the flux that leaves through it.

    Attributes
    ----------
    kind : int
        `DISK` on the plane of parallel light; `CAP` or `SPHERE` of directions, sampled uniformly;
        `ELLIPSE`, the outline of a cap in the projected hemisphere of a cosine lobe, in which the
        lobe is uniform; `SPOT`, a sector of the cone of a spot, by its intensity; `SUN`, disks
        across all directions of a cap, both sampled uniformly; `AREA`, rays from triangles to a
        sphere, of which some are taken by the cosine at the triangle and the sphere's solid angle.
    origin : (3,) float64
        Centre of the disk, or the point all rays come from, m.
    frame : (3, 3) float64
        Unit rows u, v, w; w is the direction of the light, the axis of the cap, or the normal.
    shape : (4,) float64, (5,) of a spot
        Disk: radius, m. Cap: 1 - cos of its half angle. Ellipse: cos and sin of the angle between
        normal and axis of the cap, cos and sin of its half angle. Spot: 1 - cos of its inner and
        outer angles; `SpotLobe.content` where the sector begins and ends; half its azimuth, rad.
        Sun: radius of the disks, m; 1 - cos of the half angle of the cap; distance from `origin`
        to the centre of the disks' spheres of light, m; 1 if emitter coordinates are zero. Area:
        radius of the target, m; 1 - cos of the largest half angle under which it is seen; 1 if both
        sides emit; density over that of the candidates, or 0 where it follows the cosine.
    area : float
        Of the region in its chart: m², sr, or sr weighted with the cosine or falloff of a lobe.
    flux : (3,) float64
        Leaving through the region, W.
    start_distance : float
        Distance from the point to the origins of the rays, m: off the surface the point may lie
        on, and up to the scene. Rays from afar would lose their digits in float32 otherwise.
    coords_offset : (2,) float64, (3,) of a sun
        Emitter coordinates of the centre of a disk, or the centre of a sun's target in the frame,
        from that of all targets, m.
    target : (3,) float64, optional
        Centre of what the rays of a sun or an area meet, m.
    triangles, cumulative : (f, 3, 3), (f,) float64, optional
        Corners of an emitting area, m, and its share up to each.
    clip : (3,) float64 and float, optional
        Centre and radius, in emitter coordinates, of the ball that photons lie in: what is sampled
        reaches beyond it.
    sky : SkyMap, optional
        Of the directions of a sun that is all around, in place of uniform ones; photons differ in
        colour with it.
    """

    kind: int
    origin: Floats
    frame: Floats
    shape: Floats
    area: float
    flux: Floats
    start_distance: float = 0.0
    coords_offset: Floats = field(default_factory=lambda: np.zeros(2))
    target: Floats | None = None
    triangles: Floats | None = None
    cumulative: Floats | None = None
    clip: tuple[Floats, float] | None = None
    sky: SkyMap | None = None

    @property
    def is_plane(self) -> bool:
        """True if emitter coordinates are metres across the light, false if unit vectors."""
        return self.kind in (DISK, SUN)

    @property
    def is_extended(self) -> bool:
        """True if many rays have the same emitter coordinates."""
        return self.target is not None

    @property
    def is_thinned(self) -> bool:
        """True if not all candidates are photons, even where no other region overlaps."""
        return self.kind == AREA or self.clip is not None

    @property
    def outline(self) -> tuple[Floats, float]:
        """Centre and radius of the region in emitter coordinates: of a disk, or of a cap.

        Those of the target of a sun or area, m, as its rays are all that meet this sphere. The
        radius of a cap is the chord from its axis to its border.
        """
        if self.clip is not None:
            return self.clip
        if self.kind == DISK:
            return self.coords_offset, float(self.shape[0])
        if self.kind == CAP:
            return self.frame[2], float(np.sqrt(2.0 * self.shape[0]))
        if self.kind == ELLIPSE:
            cos_tilt, sin_tilt, cos, sin = self.shape
            return cos_tilt * self.frame[2] + sin_tilt * self.frame[0], float(
                sin * np.sqrt(2.0 / (1.0 + cos))
            )
        if self.target is not None:
            return self.target, float(self.shape[0])
        if self.kind == SPOT:
            return self.frame[2], float(np.sqrt(2.0 * self.shape[1]))
        return self.frame[2], 2.0

    @property
    def is_cosine_lobe(self) -> bool:
        """True if the density of directions falls with the cosine to w, and ends at 90°."""
        return self.kind == ELLIPSE


def disk_region(
    direction: Floats, irradiance: Floats, target: Sphere, scene: Sphere
) -> EmissionRegion:
    """Return the disk of parallel light that covers the target, upstream of the whole scene."""
    upstream = (scene.centre - target.centre) @ direction - (1.0 + _CLEARANCE) * scene.radius
    area = np.pi * target.radius**2
    return EmissionRegion(
        DISK,
        target.centre + upstream * direction,
        axis_frame(direction),
        np.array([target.radius, 0.0, 0.0, 0.0]),
        area,
        area * irradiance,
    )


def sun_region(
    direction: Floats, irradiance: Floats, angular_radius: float, target: Sphere, scene: Sphere
) -> EmissionRegion:
    """Return disks across all directions of a sun that cover the target, upstream of the scene.

    The sun has the same radiance all over; `irradiance` is that of a plane that faces its centre,
    `angular_radius` in rad.
    """
    between = float(np.linalg.norm(scene.centre - target.centre))
    upstream = between + (1.0 + _CLEARANCE) * scene.radius
    one_minus_cos = _drop(angular_radius)
    area = np.pi * target.radius**2
    return EmissionRegion(
        SUN,
        target.centre - upstream * direction,
        axis_frame(direction),
        np.array([target.radius, one_minus_cos, upstream, 0.0]),
        area,
        # Of solid angle over projected solid angle: the plane sees the rim of the sun aslant.
        area * irradiance * 2.0 / (2.0 - one_minus_cos),
        coords_offset=np.zeros(3),
        target=target.centre,
    )


def environment_region(
    radiance: Floats, target: Sphere, scene: Sphere, sky: SkyMap | None = None
) -> EmissionRegion:
    """Return disks across all directions that cover the target, upstream of the whole scene.

    `radiance` is the mean over all directions.
    """
    # Directions of a map are those of the world.
    axis = np.array([0.0, 0.0, -1.0 if sky is None else 1.0])
    sun = sun_region(axis, radiance, 0.0, target, scene)
    return replace(
        sun,
        shape=np.array([target.radius, 2.0, sun.shape[2], 1.0]),
        flux=4.0 * np.pi * sun.area * radiance,
        sky=sky,
    )


def area_region(
    triangles: Floats,
    normals: Floats,
    cumulative: Floats,
    *,
    flux_per_sr: Floats,
    target: Sphere,
    two_sided: bool,
    start: float,
) -> EmissionRegion:
    """Return all rays from triangles (f, 3, 3) to a target; no flux where all face away from it.

    `flux_per_sr` is radiance times area, `start` the distance of the rays' origins from the
    triangles, m. The target is seen under different angles: candidates are towards it under the
    largest, and as many are taken as the others are smaller.
    """
    distance = _distance_to_triangles(target.centre, triangles) - start
    one_minus_cos = 2.0
    if distance > target.radius:
        sin, cos = _half_angle(target.radius, distance)
        one_minus_cos = sin**2 / (1.0 + cos)
    solid_angle = 2.0 * np.pi * one_minus_cos
    height = np.einsum("fki,fi->fk", target.centre - triangles, normals).max()
    if not two_sided and height + target.radius <= start:
        flux_per_sr = np.zeros(3)
    # Of a closed convex surface a quarter of the area is seen from any side.
    seen = 0.0 if (normals @ normals[0] > _FLAT).all() else 0.25 * (1 + two_sided)
    return EmissionRegion(
        AREA,
        triangles[0].mean(axis=0) + start * normals[0],
        axis_frame(normals[0]),
        np.array(
            np.array([target.radius, one_minus_cos, two_sided, seen]),
        ),
        solid_angle,
        solid_angle * flux_per_sr,
        start,
        target=target.centre,
        triangles=triangles,
        cumulative=cumulative,
    )


def _distance_to_triangles(point: Floats, triangles: Floats) -> float:
    """Least distance of a point from triangles (f, 3, 3)."""
    corners, following = triangles, np.roll(triangles, -1, axis=1)
    edge, offset = following - corners, point - corners
    along = np.clip(np.einsum("fki,fki->fk", offset, edge) / np.square(edge).sum(axis=2), 0.0, 1.0)
    squared = np.square(offset - along[..., np.newaxis] * edge).sum(axis=2)
    least = float(np.sqrt(squared.min()))
    # Above the inside of a triangle, its plane is nearer than its edges.
    normal = np.cross(edge[:, 0], edge[:, 1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    above = (np.einsum("fki,fi->fk", np.cross(edge, offset), normal) >= 0.0).all(axis=1)
    height = np.abs(np.einsum("fi,fi->f", offset[:, 0], normal))[above]
    return min(least, float(height.min(initial=np.inf)))


def cap_region(
    position: Floats, power: Floats, target: Sphere, start_distance: float
) -> EmissionRegion:
    """Return the cone of directions to the target, or all directions from inside of it.

    `power` is that of all directions, which get equal shares.
    """
    shape = np.zeros(4)
    axis, distance = _towards(target.centre, position)
    if distance <= target.radius:
        return EmissionRegion(
            SPHERE, position, np.eye(3), shape, 4.0 * np.pi, power, start_distance
        )
    sin, cos = _half_angle(target.radius, distance)
    # 1 - cos, without its cancellation for thin cones.
    shape[0] = sin**2 / (1.0 + cos)
    return EmissionRegion(
        CAP,
        position,
        axis_frame(axis),
        shape,
        2.0 * np.pi * shape[0],
        0.5 * shape[0] * power,
        start_distance,
    )


def cap_directions(axis: Floats, one_minus_cos: float, sample: Floats) -> Floats:
    """Directions (m, 3) that are uniform over the cap around an axis, for samples (m, 2)."""
    drop, azimuth = one_minus_cos * sample[:, 0], 2.0 * np.pi * sample[:, 1]
    aside = np.sqrt(drop * (2.0 - drop))
    local = np.column_stack([aside * np.cos(azimuth), aside * np.sin(azimuth), 1.0 - drop])
    directions: Floats = product(local, axis_frame(axis))
    return directions


def cosine_directions(normal: Floats, sample: Floats) -> tuple[Floats, Floats]:
    """Directions (m, 3) around normals (m, 3) by the cosine, for samples (m, 2), and cosines."""
    # No sample is on the horizon, as they are below 1.
    cosine, azimuth = np.sqrt(1.0 - sample[:, 0]), 2.0 * np.pi * sample[:, 1]
    aside = np.sqrt(sample[:, 0])
    # A frame around each normal (Duff et al. 2017).
    x, y, z = normal.T
    sign = np.where(z >= 0.0, 1.0, -1.0)
    a = -1.0 / (sign + z)
    u = np.array([1.0 + sign * x * x * a, sign * x * y * a, -sign * x])
    v = np.array([x * y * a, sign + y * y * a, -y])
    directions = aside * (np.cos(azimuth) * u + np.sin(azimuth) * v) + cosine * normal.T
    return np.ascontiguousarray(directions.T), cosine


def cosine_lobe_region(
    position: Floats, normal: Floats, power: Floats, target: Sphere, start_distance: float
) -> EmissionRegion:
    """Return the cone to the target if that is wholly in front, else the whole hemisphere.

    `power` is that of the hemisphere. A target wholly behind gets no flux.
    """
    axis, distance = _towards(target.centre, position)
    cos_tilt, sin_tilt, sin, cos = 1.0, 0.0, 1.0, 0.0
    aside = np.zeros(3)
    if distance > target.radius and abs(axis @ normal) >= target.radius / distance:
        cos_tilt = float(axis @ normal)
        sin, cos = _half_angle(target.radius, distance)
        aside = axis - cos_tilt * normal
        sin_tilt = float(np.linalg.norm(aside))
    projected = max(sin**2 * cos_tilt, 0.0)
    return EmissionRegion(
        ELLIPSE,
        position,
        axis_frame(normal, aside),
        np.array([cos_tilt, sin_tilt, cos, sin]),
        np.pi * projected,
        projected * power,
        start_distance,
    )


def spot_region(
    position: Floats, axis: Floats, power: Floats, lobe: SpotLobe, target: Sphere, *, start: float
) -> EmissionRegion:
    """Return the part of a spot's cone that a target may lie in, or the whole cone from inside.

    `power` is that of the cone, `start` as `EmissionRegion.start_distance`. A target wholly
    outside of the cone gets no flux.
    """
    cone, whole = 2.0 * np.arcsin(np.sqrt(0.5 * lobe.outer)), lobe.content(np.pi)
    low, high, azimuth, aside, clip = 0.0, whole, np.pi, np.zeros(3), None
    to_target, distance = _towards(target.centre, position)
    cap = np.pi if distance <= target.radius else float(np.arcsin(target.radius / distance))
    tilt = _angle(axis, to_target)
    if cap < min(tilt + cone, np.pi):
        first, last = min(max(tilt - cap, 0.0), cone), min(tilt + cap, cone)
        low, high = lobe.content(first), lobe.content(last)
        if 0.0 < first < last:
            azimuth = _half_azimuth(cap, tilt, last)
        aside, clip = to_target - (to_target @ axis) * axis, (to_target, 2.0 * np.sin(0.5 * cap))
    share = azimuth / np.pi * (high - low) / whole
    return EmissionRegion(
        SPOT,
        position,
        axis_frame(axis, aside),
        np.array([lobe.inner, lobe.outer, low, high, azimuth]),
        2.0 * np.pi * whole * share,
        share * power,
        start,
        clip=clip,
    )


def _drop(angle: float) -> float:
    """Return 1 - cos, without its cancellation for small angles."""
    return float(2.0 * np.sin(0.5 * angle) ** 2)


def _angle(a: Floats, b: Floats) -> float:
    """Angle between unit vectors, which keeps its digits where it is small."""
    return float(2.0 * np.arctan2(np.linalg.norm(a - b), np.linalg.norm(a + b)))


def _half_azimuth(cap: float, tilt: float, last: float) -> float:
    """Half the azimuths, around an axis, of a cap that does not hold it, up to a polar angle.

    `tilt` is the angle from the axis to the cap's, `cap` and `last` are the half angle and the
    largest polar angle, all in rad. The cap is widest where great circles through the axis touch
    it.
    """
    touching = np.arccos(np.clip(np.cos(tilt) / max(np.cos(cap), 1e-12), -1.0, 1.0))
    at = min(last, touching)
    # Half-angle form: 1 - cos of the azimuth, without cancellation.
    square = np.sin(0.5 * (cap + tilt - at)) * np.sin(0.5 * (cap - tilt + at))
    return float(2.0 * np.arcsin(np.sqrt(np.clip(square / (np.sin(at) * np.sin(tilt)), 0.0, 1.0))))


def start_distance(position: Floats, scene: Sphere, emitter_offset: float) -> float:
    """Return a length of rays from a point on which they meet nothing: the offset at least."""
    distance = _length(scene.centre - position)
    return max(distance - (1.0 + _CLEARANCE) * scene.radius, 0.0, emitter_offset)


def _towards(centre: Floats, position: Floats) -> tuple[Floats, float]:
    offset = centre - position
    distance = _length(offset)
    return (offset / distance if distance > 0.0 else offset), distance


def _length(vector: Floats) -> float:
    """Length as of np.linalg.norm, which takes far longer; lights may be many."""
    return math.sqrt(vector.dot(vector))


def _half_angle(radius: float, distance: float) -> tuple[float, float]:
    """Return sine and cosine of the half angle under which a sphere is seen from outside."""
    sin = radius / distance
    return sin, np.sqrt((1.0 - sin) * (1.0 + sin))


def axis_frame(w: Floats, aside: Floats | None = None) -> Floats:
    """Right-handed unit rows u, v, w, with u along `aside` where that has a length."""
    if aside is None or not aside.any():
        # The axis least along w.
        aside = _AXES[np.abs(w).argmin()]
    u = aside - (aside @ w) * w
    u /= _length(u)
    # A product as of np.cross, which takes far longer; lights may be many.
    a, b = w.tolist(), u.tolist()
    v = [a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)]
    return np.array([u, v, w])
