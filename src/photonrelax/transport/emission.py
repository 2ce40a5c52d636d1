"""Emission of photons towards a target (SJ13 §4.1).

Each emitter is sampled over a region of its emitter coordinates, metres on the plane of a
collimated emitter or unit vectors around a point, which the emitter itself provides: one region, or
one for each group of casters where these lie apart. All photons of a region carry the same flux,
of a map of the sky the same luminance, and those of the other regions of an emitter differ from it
by the rounding of their numbers, unless these go by what is stored of them (`transport.allotment`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from .._ext.transport import emission as _kernel
from .._util.parallel import thread_count
from .._util.parcels import state_without_caches
from .._util.validation import Floats, check_choice, check_seed, count
from ..scene.emission_region import EmissionRegion, Sphere
from ..scene.emitters import Emitter
from ..scene.scene import Scene
from .aim import aimed_regions, luminance, nested_regions, nested_spheres, overlapped
from .sampling import seed_shifts

PATHS = ("caustic", "global", "all")
SAMPLERS = ("halton", "random")
# Halton numbers of larger indices are not exact.
MAX_PHOTONS = 10**15

# Candidates from which the share of a region that lies in no earlier one is estimated, and how
# many times as many as that suggests are tried.
_N_PILOT = 1 << 12
_MAX_TRIES = 4
# Photons of a region in the mean, at least, or an emitter aims at all casters together.
_PER_REGION = 16
# Photons between those whose candidates are noted.
_STARTS_EVERY = 1024
# Emitters are fewer than two to this power.
_EMITTER_BITS = 32

_regions: WeakKeyDictionary[Scene, dict[tuple[str, bool], tuple[AimedRegion, ...]]] = (
    WeakKeyDictionary()
)


class AimedRegion(NamedTuple):
    """A region of an emitter.

    Attributes
    ----------
    emitter_id, number : int
        Index of the emitter in the scene, and of the region among those of the emitter.
    region : EmissionRegion
        The region.
    outlines : (m, 4) float64
        What its photons lie outside or inside of, as of `transport.aim.overlapped`.
    """

    emitter_id: int
    number: int
    region: EmissionRegion
    outlines: Floats

    @property
    def is_thinned(self) -> bool:
        """True if not all candidates are photons."""
        return self.region.is_thinned or len(self.outlines) > 0


@dataclass(frozen=True, eq=False)
class EmissionPlan:
    """The emission regions of a scene, and the number of photons of each.

    The photons of a region are those of its candidates, a sequence over the whole region, that lie
    in no earlier region of the same emitter.

    Attributes
    ----------
    aimed : tuple of AimedRegion
        One or more per emitter, in the order of the emitters.
    starts : tuple of sequences of int
        Candidates that are photons 0, 1024, … of regions not all of whose candidates are photons.
    counts, candidates : (n_regions,) int64
        Photons of each region, none where no flux leaves through it, and its candidates.
    colours : (n_regions, 3) float64
        Mean flux of the photons of each region over `flux_per_photon`: ones unless they differ.
    seed, sampler : int, str
        The sequence of the candidates.
    guide : Sphere, optional
        Half of the photons are scattered towards it where they first meet a diffuse surface.
    """

    aimed: tuple[AimedRegion, ...]
    starts: tuple[Sequence[int], ...]
    counts: NDArray[np.int64]
    candidates: NDArray[np.int64]
    colours: Floats
    seed: int
    sampler: str
    guide: Sphere | None = None

    __getstate__ = state_without_caches

    @property
    def regions(self) -> tuple[EmissionRegion, ...]:
        """The regions alone."""
        return tuple(each.region for each in self.aimed)

    @cached_property
    def emitter_ids(self) -> NDArray[np.int64]:
        """The emitter of each region, (n_regions,)."""
        return np.array([each.emitter_id for each in self.aimed], dtype=np.int64)

    @property
    def is_well_spaced(self) -> bool:
        """Photons are even over their emitters: Halton points, none of extended emitters."""
        return self.sampler == "halton" and self.extended_ids is None

    @property
    def extended_ids(self) -> NDArray[np.int64] | None:
        """The extended ones among the emitters, ascending; None without any."""
        extended = [region.is_extended for region in self.regions]
        return np.unique(self.emitter_ids[extended]) if any(extended) else None

    @cached_property
    def flux_per_photon(self) -> Floats:
        """W carried by a photon of each region, (n_regions, 3); by the mean one of a map."""
        flux = np.array([each.region.flux for each in self.aimed])
        return flux / np.maximum(self.candidates, 1)[:, np.newaxis]

    @cached_property
    def flux(self) -> Floats:
        """W that each emitter sends out, (n_emitters, 3)."""
        ids = self.emitter_ids
        flux = np.zeros((int(ids[-1]) + 1, 3))
        np.add.at(flux, ids, self.region_flux)
        return flux

    @property
    def region_flux(self) -> Floats:
        """W that is sent out through each region, (n_regions, 3)."""
        photons = self.counts[:, np.newaxis] * self.colours
        flux: Floats = photons * self.flux_per_photon
        return flux

    def parts(self, photons: range) -> list[tuple[int, range]]:
        """Regions, and their photons, among some photons of all regions in order."""
        first = np.cumsum(self.counts) - self.counts
        starts = np.maximum(photons.start - first, 0)
        stops = np.minimum(photons.stop - first, self.counts)
        rows = np.flatnonzero(starts < stops)
        ranges = map(range, starts[rows].tolist(), stops[rows].tolist())
        return list(zip(rows.tolist(), ranges, strict=True))

    def flux_of(self, photons: range) -> Floats:
        """W that each emitter sends out with some photons of all regions, (n_emitters, 3)."""
        flux, per_photon = np.zeros_like(self.flux), self.flux_per_photon
        for region_id, mine in self.parts(photons):
            colour = self._mean_colour(region_id, mine)
            flux[self.emitter_ids[region_id]] += len(mine) * colour * per_photon[region_id]
        return flux

    def _mean_colour(self, region_id: int, photons: range) -> Floats:
        if len(photons) == self.counts[region_id]:
            return self.colours[region_id]
        first = self.candidates_of(region_id, range(photons.start, photons.start + 1))[0]
        last = self.candidates_of(region_id, range(photons.stop - 1, photons.stop))[0]
        return np.array(self.emission(region_id).mean_colour(last + 1, first))

    def emission(self, region_id: int) -> _kernel.Emission:
        """The kernel that emits the candidates of a region, each from its index."""
        n_candidates = int(self.candidates[region_id])
        return _emission(self.aimed[region_id], n_candidates, self.seed, self.sampler)

    def candidates_of(self, region_id: int, photons: range) -> NDArray[np.int64]:
        """Indices, among the candidates of a region, of some of its photons."""
        starts = self.starts[region_id]
        if not len(starts):
            return np.arange(photons.start, photons.stop, dtype=np.int64)
        block = photons.start // _STARTS_EVERY
        skipped = photons.start - block * _STARTS_EVERY
        found = self.emission(region_id).accepted(starts[block], skipped + len(photons))
        return found[skipped:]


@dataclass(frozen=True, eq=False)
class PrimalRays:
    """Rays that leave one emitter through one of its regions.

    Attributes
    ----------
    emitter_id : int
        Index of the emitter in the scene.
    origin, direction : (n, 3) float64
        Origins, m, and unit vectors.
    emitter_coords : (n, 2) or (n, 3) float64
        m on the emitter plane, of a sun on that across the ray, relative to the projection of the
        centre of all targets; or unit vectors.
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


def plan_emission(
    scene: Scene,
    n_emitted: int | Sequence[int],
    paths: str = "caustic",
    *,
    seed: int = 0,
    sampler: str = "halton",
    brought: Floats | None = None,
) -> EmissionPlan:
    """Aim the emitters of a scene, and apportion photons to their regions.

    Targets are the groups of the specular objects' parts for caustics, else the objects together:
    the visible ones for light that they scatter, and sensors too where direct light is stored.
    Regions get photons in proportion to the luminance of the flux that they alone send out; by what
    is brought of it, emitters get more or less.

    Parameters
    ----------
    scene : Scene
        Its emitters and objects.
    n_emitted : int or sequence of int
        Photons in all, at least one per region; or of each emitter.
    paths : {"caustic", "global", "all"}
        The light to be traced.
    seed, sampler : int, str
        As of `emit`: where regions overlap, photons depend on them.
    brought : (n_emitters,), optional
        Luminance that each emitter brings to what is looked for, see `transport.allotment`; by
        default it is in proportion to what they send.

    Raises
    ------
    TypeError, ValueError
        If `paths`, seed or sampler is invalid, there is no specular object to aim at, no emitter
        shines on the target, there are fewer photons than regions, or photons are asked of an
        emitter that does not shine on the target.
    """
    n_emitted = checked_numbers(n_emitted, scene)
    n_in_all = n_emitted if isinstance(n_emitted, int) else sum(n_emitted)
    aimed = _aimed(scene, paths, n_in_all)

    def numbers(weights: Floats) -> NDArray[np.int64]:
        if not weights.any():
            what = "the specular objects" if paths == "caustic" else "the scene"
            raise ValueError(
                f"emitters should shine on {what}, "
                f"but all {len(scene.emitters)} have no power or face away"
            )
        return _numbers(n_emitted, weights, aimed, brought)

    return _planned(aimed, numbers, seed, sampler)


def nested_aim(scene: Scene) -> tuple[AimedRegion, ...]:
    """Regions of all emitters towards the specular objects, and in shells around these.

    The last of each emitter is around all objects; empty without specular ones.
    """
    aim = scene.targets
    if aim.around_casters is None:
        return ()
    spheres = nested_spheres(aim.around_casters, aim.around)
    return _of_emitters(scene, lambda *of: nested_regions(of[0], spheres, aim.around, of[1]))


def plan_through(
    aimed: tuple[AimedRegion, ...],
    n_emitted: int,
    relative: Floats | None = None,
    *,
    guide: Sphere | None = None,
    seed: int = 0,
    sampler: str = "halton",
) -> EmissionPlan:
    """Apportion photons to regions through which there is flux.

    Parameters
    ----------
    aimed : tuple of AimedRegion
        Such as those of `nested_aim`.
    n_emitted : int
        Photons in all.
    relative : (n_regions,), optional
        Photons of each region over those in proportion to the luminance that it alone sends out;
        by default there are as many of each.
    guide : Sphere, optional
        As of `EmissionPlan`.
    seed, sampler : int, str
        As of `emit`.
    """

    def numbers(weights: Floats) -> NDArray[np.int64]:
        return _apportion(n_emitted, np.sign(weights) if relative is None else weights * relative)

    return replace(_planned(aimed, numbers, seed, sampler), guide=guide)


def _planned(
    aimed: tuple[AimedRegion, ...],
    numbers: Callable[[Floats], NDArray[np.int64]],
    seed: int,
    sampler: str,
) -> EmissionPlan:
    """Plan of as many photons of each region as follow from the luminance that it alone sends."""
    check_choice(sampler, "sampler", SAMPLERS)
    draw = partial(_emission, n_candidates=0, seed=check_seed(seed), sampler=sampler)
    # Whole regions are not sampled for it: there may be many emitters.
    thinned = [i for i, each in enumerate(aimed) if each.is_thinned]
    shares = np.ones(len(aimed))
    shares[thinned] = [draw(aimed[i]).share(_N_PILOT) for i in thinned]
    counts = numbers(shares * [luminance(each.region) for each in aimed])
    candidates, colours = counts.copy(), np.ones((len(aimed), 3))
    starts: list[Sequence[int]] = [()] * len(aimed)
    for i in thinned:
        limit = min(int(_MAX_TRIES * int(counts[i]) / shares[i]), 2**62)
        found = draw(aimed[i]).photons(counts[i], _STARTS_EVERY, limit)
        starts[i], counts[i], candidates[i] = found
    for i, each in enumerate(aimed):
        if each.region.sky:
            colours[i] = draw(each).mean_colour(candidates[i])
    return EmissionPlan(aimed, tuple(starts), counts, candidates, colours, seed, sampler)


def emit(
    plan: EmissionPlan, region_id: int, photons: range, *, n_threads: int | None = None
) -> PrimalRays:
    """Return the primal rays of some photons of one region.

    Photon i depends on seed, emitter, region and i alone (and, for its density, on the count
    planned).

    Parameters
    ----------
    plan : EmissionPlan
        From `plan_emission`.
    region_id : int
        Which region.
    photons : range
        Indices of the photons among those of the region, step 1.
    n_threads : int, optional
        Threads to use; None for all cores.

    Returns
    -------
    PrimalRays
        One row per photon.

    Raises
    ------
    ValueError
        If the photons are not among those planned.
    """
    planned = int(plan.counts[region_id])
    if photons.step != 1 or photons.start < 0 or photons.stop > planned:
        raise ValueError(f"photons should lie in {range(planned)} in steps of 1, but is {photons}")
    rays = _empty_rays(plan.aimed[region_id], len(photons))
    _kernel.emit(
        plan.emission(region_id),
        plan.candidates_of(region_id, photons),
        origin=rays.origin,
        direction=rays.direction,
        coords=rays.emitter_coords,
        density=rays.emitter_density,
        n_threads=thread_count(n_threads),
    )
    return rays


def _emission(aimed: AimedRegion, n_candidates: int, seed: int, sampler: str) -> _kernel.Emission:
    region, emitter_id = aimed.region, aimed.emitter_id
    # Regions of an emitter draw from sequences of their own.
    stream = emitter_id + (aimed.number << _EMITTER_BITS)
    return _kernel.Emission(
        _kernel.EmissionRegion(
            *(region.kind, region.origin, region.frame, region.shape),
            start_distance=region.start_distance,
            coords_offset=region.coords_offset,
            density=n_candidates / region.area if n_candidates else 0.0,
            target=region.target,
            triangles=region.triangles,
            cumulative=region.cumulative,
            sky=region.sky.kernel() if region.sky else None,
            colours=region.sky.colours if region.sky else None,
        ),
        seed,
        stream,
        np.array(seed_shifts(seed, stream, 4) if sampler == "halton" else ()),
        aimed.outlines,
    )


def _empty_rays(aimed: AimedRegion, n: int) -> PrimalRays:
    region = aimed.region
    return PrimalRays(
        aimed.emitter_id,
        origin=np.empty((n, 3)),
        direction=np.empty((n, 3)),
        emitter_coords=np.empty((n, 2 if region.is_plane else 3)),
        emitter_density=np.empty(n),
        travelled=region.start_distance,
    )


def _aimed(scene: Scene, paths: str, n_emitted: int) -> tuple[AimedRegion, ...]:
    """The regions of all emitters; one of each where photons are too few for more.

    They are found once for a scene: emitters may be many, and so may the passes of a render.
    """
    targets, around, whole = _targets(scene, paths)
    are_few = n_emitted < _PER_REGION * len(targets) * len(scene.emitters)
    if are_few:
        targets = (around,)
    known = _regions.setdefault(scene, {})
    key = paths, are_few
    if key not in known:
        known[key] = _of_emitters(
            scene, lambda *of: aimed_regions(of[0], targets, around, whole, of[1])
        )
    return known[key]


def _of_emitters(
    scene: Scene, regions_of: Callable[[Emitter, float], list[EmissionRegion]]
) -> tuple[AimedRegion, ...]:
    """The regions of all emitters, by a function of each and of its offset."""
    aimed: list[AimedRegion] = []
    for emitter_id, emitter in enumerate(scene.emitters):
        regions = regions_of(emitter, float(scene.emitter_offsets[emitter_id]))
        pairs = zip(regions, overlapped(regions), strict=True)
        aimed += [AimedRegion(emitter_id, number, *pair) for number, pair in enumerate(pairs)]
    return tuple(aimed)


def _targets(scene: Scene, paths: str) -> tuple[tuple[Sphere, ...], Sphere, Sphere]:
    """Targets of the photons, and spheres around them and around all that photons may meet.

    Light is stored on sensors after it has met another object, unless paths are "all".
    """
    check_choice(paths, "paths", PATHS)
    aim = scene.targets
    whole = scene.bounding_sphere(range(len(scene.surfaces))) if paths == "all" else aim.around
    if paths != "caustic":
        return (whole,), whole, whole
    if aim.around_casters is None:
        raise ValueError(
            'paths="caustic" should have a specular object to aim at, '
            f"but none of the {len(scene.objects)} objects is a Mirror or Dielectric"
        )
    return aim.casters, aim.around_casters, whole


def checked_numbers(n_emitted: int | Sequence[int], scene: Scene) -> int | list[int]:
    """Photons in all, or of each emitter of a scene; raises TypeError or ValueError if invalid."""
    if not isinstance(n_emitted, Sequence | np.ndarray):
        return count(n_emitted, "n_emitted", high=MAX_PHOTONS)
    numbers = [count(n, "n_emitted", low=0, high=MAX_PHOTONS) for n in n_emitted]
    if len(numbers) != len(scene.emitters):
        raise ValueError(
            f"n_emitted should have a number for each of the {len(scene.emitters)} emitters, "
            f"but has {len(numbers)}"
        )
    count(sum(numbers), "the sum of n_emitted", high=MAX_PHOTONS)
    return numbers


def _numbers(
    n_emitted: int | list[int],
    weights: Floats,
    aimed: tuple[AimedRegion, ...],
    brought: Floats | None,
) -> NDArray[np.int64]:
    """Photons of each region, by weights and by what its emitter brings, or as asked of that."""
    emitter_ids = np.array([each.emitter_id for each in aimed])
    if isinstance(n_emitted, int):
        if brought is not None:
            sent = np.bincount(emitter_ids, weights)
            relative = np.divide(brought, sent, out=np.zeros_like(sent), where=sent > 0.0)
            weights = weights * np.sqrt(relative)[emitter_ids]
        return _apportion(n_emitted, weights)
    numbers = np.zeros(len(aimed), dtype=np.int64)
    for emitter_id, n in enumerate(n_emitted):
        mine = emitter_ids == emitter_id
        if n and not weights[mine].any():
            raise ValueError(
                f"n_emitted should be 0 for emitter {emitter_id}, which has no power or faces away "
                f"from the target, but is {n}"
            )
        if n:
            numbers[mine] = _apportion(n, weights[mine])
    return numbers


def _apportion(n: int, weights: Floats) -> NDArray[np.int64]:
    """Apportion n by weights, at least one to each positive weight (largest remainders)."""
    share = weights / np.sum(weights)
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
