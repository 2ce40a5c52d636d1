"""Emission: where photons leave their emitters, aimed at what matters (SJ13 §4.1).

Each emitter is sampled over a region of its own chart, the emitter coordinates: metres on the
plane of a collimated emitter, unit vectors around a point. Every photon of an emitter carries
the same flux.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._ext.transport import emission as _kernel
from .._util.parallel import thread_count
from .._util.validation import Floats, check_choice, check_seed, count
from ..scene.emitters import CollimatedEmitter, Emitter, LambertianEmitter, PointEmitter
from ..scene.scene import Scene
from .sampling import seed_shift

DISK, CAP, SPHERE, ELLIPSE = range(4)
"""Values of `EmissionRegion.kind`; the kernel knows them too."""

PATHS = ("caustic", "global", "all")
SAMPLERS = ("halton", "random")
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Weights of red, green and blue in the luminance (Rec. 709)."""

# Rays start this fraction of the scene's radius before its bounding sphere.
_CLEARANCE = 1e-3


@dataclass(frozen=True, eq=False)
class EmissionRegion:
    """The region one emitter is sampled over, and what leaves through it.

    Attributes
    ----------
    kind : int
        `DISK` on the plane of a collimated emitter; `CAP` or `SPHERE` of directions, sampled
        uniformly; `ELLIPSE`, the outline of a cap in the projected hemisphere of a Lambertian
        emitter, where its cosine lobe is uniform.
    origin : (3,) float64
        Centre of the disk, or the point, m.
    frame : (3, 3) float64
        Unit rows u, v, w; w is the direction of the light, the axis of the cap, or the normal.
    shape : (4,) float64
        Disk: radius, m. Cap: 1 - cos of its half angle. Ellipse: cos and sin of the angle between
        normal and axis of the cap, cos and sin of its half angle.
    area : float
        Of the region: m², sr, or projected sr.
    flux : (3,) float64
        Leaving through the region, W.
    start_distance : float
        How far from the point rays start, m: off the surface it may lie on, and where the scene
        begins. Rays from afar would lose their digits in float32 otherwise.
    """

    kind: int
    origin: Floats
    frame: Floats
    shape: Floats
    area: float
    flux: Floats
    start_distance: float = 0.0

    @property
    def is_plane(self) -> bool:
        """Whether emitter coordinates are metres on a plane, rather than unit vectors."""
        return self.kind == DISK


@dataclass(frozen=True, eq=False)
class EmissionPlan:
    """What each emitter of a scene sends out.

    Attributes
    ----------
    regions : tuple of EmissionRegion
        One per emitter.
    counts : (n_emitters,) int64
        Photons of each emitter; none where its aimed flux is zero.
    """

    regions: tuple[EmissionRegion, ...]
    counts: NDArray[np.int64]

    @property
    def flux_per_photon(self) -> Floats:
        """W carried by each photon of each emitter, (n_emitters, 3)."""
        flux = np.array([region.flux for region in self.regions])
        return flux / np.maximum(self.counts, 1)[:, np.newaxis]


@dataclass(frozen=True, eq=False)
class PrimalRays:
    """Rays as they leave one emitter.

    Attributes
    ----------
    emitter_id : int
        Index of the emitter in the scene.
    origin, direction : (n, 3) float64
        Where the rays start, m, and unit vectors.
    emitter_coords : (n, 2) or (n, 3) float64
        m on the emitter plane, relative to the point facing the centre of what is aimed at; or
        unit vectors.
    emitter_density : (n,) float64
        Photons emitted per m² or sr around those coordinates.
    travelled : float
        Distance from the emitter's point or plane to `origin`, m.
    """

    emitter_id: int
    origin: Floats
    direction: Floats
    emitter_coords: Floats
    emitter_density: Floats
    travelled: float

    def __len__(self) -> int:
        return len(self.origin)


def plan_emission(scene: Scene, n_emitted: int, paths: str = "caustic") -> EmissionPlan:
    """Aim the emitters of a scene, and share photons out among them.

    Emitters are aimed at the bounding sphere of the specular objects for caustics, else of all
    objects, and get photons in proportion to the luminance of their aimed flux.

    Parameters
    ----------
    scene : Scene
        Its emitters and objects.
    n_emitted : int
        Photons in all; at least one per emitter that shines on the target.
    paths : {"caustic", "global", "all"}
        What the photons are for.

    Returns
    -------
    EmissionPlan
        Aims and photon counts.

    Raises
    ------
    ValueError
        If `paths` is unknown, there is no specular object to aim at, no emitter shines on the
        target, or there are fewer photons than emitters.
    """
    n_emitted = count(n_emitted, "n_emitted")
    target = _target(scene, paths)
    whole = scene.bounding_sphere()
    gap = scene.emitter_offset
    regions = tuple(_region(emitter, *target, whole=whole, gap=gap) for emitter in scene.emitters)
    luminances = [float(region.flux @ LUMINANCE) for region in regions]
    if not any(luminances):
        what = "the specular objects" if paths == "caustic" else "the scene"
        raise ValueError(
            f"emitters should shine on {what}, but all {len(regions)} have no power or face away"
        )
    return EmissionPlan(regions, _apportion(n_emitted, luminances))


def emit(
    plan: EmissionPlan,
    emitter_id: int,
    photons: range,
    *,
    seed: int = 0,
    sampler: str = "halton",
    n_threads: int | None = None,
) -> PrimalRays:
    """Return the primal rays of some photons of one emitter.

    Photon i depends on seed, emitter and i alone (and, for its density, on the count planned).

    Parameters
    ----------
    plan : EmissionPlan
        From `plan_emission`.
    emitter_id : int
        Which emitter.
    photons : range
        Indices of the photons among those of the emitter, step 1.
    seed : int
        Shifts the Halton sequence, or chooses the random one.
    sampler : {"halton", "random"}
        Evenly spaced points (SJ13), or independent ones.
    n_threads : int, optional
        Threads to use; None for all cores.

    Returns
    -------
    PrimalRays
        One row per photon.

    Raises
    ------
    TypeError, ValueError
        If the seed or sampler is invalid or the photons are not among those planned.
    """
    check_choice(sampler, "sampler", SAMPLERS)
    planned = int(plan.counts[emitter_id])
    if photons.step != 1 or photons.start < 0 or photons.stop > planned:
        raise ValueError(f"photons should lie in {range(planned)} in steps of 1, but is {photons}")
    rays = _empty_rays(emitter_id, len(photons), plan.regions[emitter_id])
    _kernel.emit(
        emission(plan, emitter_id, seed=seed, sampler=sampler),
        photons.start,
        rays.origin,
        rays.direction,
        rays.emitter_coords,
        rays.emitter_density,
        thread_count(n_threads),
    )
    return rays


def emission(plan: EmissionPlan, emitter_id: int, *, seed: int, sampler: str) -> _kernel.Emission:
    """Return what kernels need to emit the photons of one emitter, each from its index."""
    region, planned = plan.regions[emitter_id], int(plan.counts[emitter_id])
    per_area = planned / region.area if planned else 0.0
    return _kernel.Emission(
        _kernel.EmissionRegion(
            region.kind, region.origin, region.frame, region.shape, region.start_distance, per_area
        ),
        check_seed(seed),
        emitter_id,
        np.array(seed_shift(seed, emitter_id) if sampler == "halton" else ()),
    )


def _empty_rays(emitter_id: int, n: int, region: EmissionRegion) -> PrimalRays:
    return PrimalRays(
        emitter_id,
        origin=np.empty((n, 3)),
        direction=np.empty((n, 3)),
        emitter_coords=np.empty((n, 2 if region.is_plane else 3)),
        emitter_density=np.empty(n),
        travelled=region.start_distance,
    )


def _target(scene: Scene, paths: str) -> tuple[Floats, float]:
    check_choice(paths, "paths", PATHS)
    if paths != "caustic":
        return scene.bounding_sphere()
    if not scene.specular_objects:
        raise ValueError(
            'paths="caustic" should have a specular object to aim at, '
            f"but none of the {len(scene.objects)} objects is a Mirror or Dielectric"
        )
    return scene.bounding_sphere(scene.specular_objects)


def _region(
    emitter: Emitter, centre: Floats, radius: float, *, whole: tuple[Floats, float], gap: float
) -> EmissionRegion:
    if isinstance(emitter, CollimatedEmitter):
        return _aim_plane(emitter, centre, radius, whole)
    start_distance = max(_clearance(np.asarray(emitter.position), whole), gap)
    if isinstance(emitter, PointEmitter):
        return _aim_point(emitter, centre, radius, start_distance)
    return _aim_lambertian(emitter, centre, radius, start_distance)


def _aim_plane(
    emitter: CollimatedEmitter, centre: Floats, radius: float, whole: tuple[Floats, float]
) -> EmissionRegion:
    """Cover the target's shadow with a disk, upstream of the whole scene."""
    direction = np.asarray(emitter.direction)
    upstream = (whole[0] - centre) @ direction - (1.0 + _CLEARANCE) * whole[1]
    area = np.pi * radius**2
    return EmissionRegion(
        DISK,
        centre + upstream * direction,
        _frame(direction),
        np.array([radius, 0.0, 0.0, 0.0]),
        area,
        area * np.asarray(emitter.irradiance),
    )


def _aim_point(
    emitter: PointEmitter, centre: Floats, radius: float, start_distance: float
) -> EmissionRegion:
    """Cover the target with a cone, or shine all around from inside it."""
    position, power = np.asarray(emitter.position), np.asarray(emitter.power)
    axis, distance = _towards(centre, position)
    shape = np.zeros(4)
    if distance <= radius:
        return EmissionRegion(
            SPHERE, position, np.eye(3), shape, 4.0 * np.pi, power, start_distance
        )
    sin, cos = _half_angle(radius, distance)
    # 1 - cos, without its cancellation for thin cones.
    shape[0] = sin**2 / (1.0 + cos)
    return EmissionRegion(
        CAP,
        position,
        _frame(axis),
        shape,
        2.0 * np.pi * shape[0],
        0.5 * shape[0] * power,
        start_distance,
    )


def _aim_lambertian(
    emitter: LambertianEmitter, centre: Floats, radius: float, start_distance: float
) -> EmissionRegion:
    """Cover the target with a cone if that is wholly in front, else shine into the hemisphere."""
    position, normal = np.asarray(emitter.position), np.asarray(emitter.direction)
    axis, distance = _towards(centre, position)
    cos_tilt, sin_tilt, sin, cos = 1.0, 0.0, 1.0, 0.0
    aside = np.zeros(3)
    if distance > radius and abs(axis @ normal) >= radius / distance:
        cos_tilt = float(axis @ normal)
        sin, cos = _half_angle(radius, distance)
        aside = axis - cos_tilt * normal
        sin_tilt = float(np.linalg.norm(aside))
    # A target wholly behind the emitter gets nothing.
    projected = max(sin**2 * cos_tilt, 0.0)
    return EmissionRegion(
        ELLIPSE,
        position,
        _frame(normal, aside),
        np.array([cos_tilt, sin_tilt, cos, sin]),
        np.pi * projected,
        projected * np.asarray(emitter.power),
        start_distance,
    )


def _towards(centre: Floats, position: Floats) -> tuple[Floats, float]:
    offset = centre - position
    distance = float(np.linalg.norm(offset))
    return (offset / distance if distance > 0.0 else offset), distance


def _half_angle(radius: float, distance: float) -> tuple[float, float]:
    """Return sine and cosine of the half angle under which a sphere is seen from outside."""
    sin = radius / distance
    return sin, np.sqrt((1.0 - sin) * (1.0 + sin))


def _clearance(position: Floats, whole: tuple[Floats, float]) -> float:
    """Return a length of rays from a point on which they cannot meet the scene yet, or 0."""
    distance = float(np.linalg.norm(whole[0] - position))
    return max(distance - (1.0 + _CLEARANCE) * whole[1], 0.0)


def _frame(w: Floats, aside: Floats | None = None) -> Floats:
    """Return right-handed unit rows u, v, w, with u along `aside` where that has a length."""
    if aside is None or not aside.any():
        # The axis least along w.
        aside = np.eye(3)[np.abs(w).argmin()]
    u = aside - (aside @ w) * w
    u /= np.linalg.norm(u)
    return np.array([u, np.cross(w, u), w])


def _apportion(n: int, weights: list[float]) -> NDArray[np.int64]:
    """Share n out in proportion, at least one to each positive weight (largest remainders)."""
    share = np.array(weights) / np.sum(weights)
    counts = np.maximum(np.floor(n * share), share > 0.0).astype(np.int64)
    if counts.sum() > n and n < np.count_nonzero(share):
        raise ValueError(
            f"n_emitted should be at least {np.count_nonzero(share)}, one for each emitter "
            f"that shines on the target, but is {n}"
        )
    while counts.sum() > n:
        counts[counts.argmax()] -= 1
    rest = n * share - counts
    rest[share == 0.0] = -np.inf
    counts[np.argsort(-rest, kind="stable")[: n - counts.sum()]] += 1
    return counts
