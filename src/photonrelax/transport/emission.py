"""Emission of photons towards a target (SJ13 §4.1).

Each emitter is sampled over a region of its emitter coordinates, metres on the plane of a
collimated emitter or unit vectors around a point, which the emitter itself provides. All photons
of an emitter carry the same flux.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._ext.transport import emission as _kernel
from .._util.parallel import thread_count
from .._util.validation import Floats, check_choice, check_seed, count
from ..scene.emission_region import EmissionRegion, Sphere
from ..scene.scene import Scene
from .sampling import seed_shift

PATHS = ("caustic", "global", "all")
SAMPLERS = ("halton", "random")
# Halton numbers of larger indices are not exact.
MAX_PHOTONS = 10**15
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Weights of red, green and blue in the luminance (Rec. 709)."""


@dataclass(frozen=True, eq=False)
class EmissionPlan:
    """The emission region and the number of photons of each emitter of a scene.

    Attributes
    ----------
    regions : tuple of EmissionRegion
        One per emitter.
    counts : (n_emitters,) int64
        Photons of each emitter; none where no flux leaves through its region.
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
    """Rays that leave one emitter.

    Attributes
    ----------
    emitter_id : int
        Index of the emitter in the scene.
    origin, direction : (n, 3) float64
        Origins, m, and unit vectors.
    emitter_coords : (n, 2) or (n, 3) float64
        m on the emitter plane, relative to the projection of the target's centre; or unit vectors.
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
    """Aim the emitters of a scene, and apportion photons to them.

    The target is the bounding sphere of the specular objects for caustics, else of all objects.
    Emitters get photons in proportion to the luminance of the flux through their regions.

    Parameters
    ----------
    scene : Scene
        Its emitters and objects.
    n_emitted : int
        Photons in all; at least one per emitter that shines on the target.
    paths : {"caustic", "global", "all"}
        The light to be traced.

    Raises
    ------
    ValueError
        If `paths` is unknown, there is no specular object to aim at, no emitter shines on the
        target, or there are fewer photons than emitters.
    """
    n_emitted = count(n_emitted, "n_emitted", high=MAX_PHOTONS)
    target = _target(scene, paths)
    whole = scene.bounding_sphere()
    regions = tuple(
        emitter.emission_region(target, whole, scene.emitter_offset(emitter))
        for emitter in scene.emitters
    )
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
        origin=rays.origin,
        direction=rays.direction,
        coords=rays.emitter_coords,
        density=rays.emitter_density,
        n_threads=thread_count(n_threads),
    )
    return rays


def emission(plan: EmissionPlan, emitter_id: int, *, seed: int, sampler: str) -> _kernel.Emission:
    """Return the kernel that emits the photons of one emitter, each from its index."""
    region, planned = plan.regions[emitter_id], int(plan.counts[emitter_id])
    per_area = planned / region.area if planned else 0.0
    return _kernel.Emission(
        _kernel.EmissionRegion(
            *(region.kind, region.origin, region.frame, region.shape),
            start_distance=region.start_distance,
            density=per_area,
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


def _target(scene: Scene, paths: str) -> Sphere:
    check_choice(paths, "paths", PATHS)
    if paths != "caustic":
        return scene.bounding_sphere()
    if not scene.specular_objects:
        raise ValueError(
            'paths="caustic" should have a specular object to aim at, '
            f"but none of the {len(scene.objects)} objects is a Mirror or Dielectric"
        )
    return scene.bounding_sphere(scene.specular_objects)


def _apportion(n: int, weights: list[float]) -> NDArray[np.int64]:
    """Apportion n by weights, at least one to each positive weight (largest remainders)."""
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
