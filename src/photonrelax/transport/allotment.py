"""Photons of each emitter and region, by the light that they bring to what is stored.

An emitter may send much flux towards a target and bring little there: a lamp indoors that is aimed
at a pool outside, say. A few paths of each emitter tell. Of N photons, n_e are of emitter e, which
sends out the luminance Φ_e and brings S_e = Φ_e p_e, p_e being the photons stored a path. The
variance of its light is S_e² / (n_e p_e), so that the sum over emitters is least for n_e in
proportion to S_e / √p_e = √(Φ_e S_e). Where the p_e are equal within their noise, that is Φ_e.

Light that glass and mirrors return to the surfaces around them comes from near by: of a large table
with a small glass hardly any path is stored. So for ``paths="global"`` the first diffuse surface
scatters half of the photons towards the specular objects, and regions take the place of emitters,
shells around these objects, where both make the variance much less. Photons then differ in flux:
with x_r the light of a path of region r that is stored, relative to that emitted, n_r goes by
Φ_r √E[x_r²].
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from .._util.validation import Floats
from ..scene.dispersion import N_WAVELENGTHS
from ..scene.emission_region import Sphere
from ..scene.scene import Scene
from ..scene.sky_map import LUMINANCE
from .batch import (
    TraceContext,
    TracedBatch,
    TraceSettings,
    batch_capacity,
    batch_jobs,
    trace_batch,
)
from .emission import AimedRegion, EmissionPlan, nested_aim, plan_emission, plan_through
from .raycast import RayCaster

# Paths of each emitter that are traced for it, at most and at least, and the share of all photons
# that they are together at most: more emitters are not told apart.
_MOST, _LEAST, _SHARE = 1024, 32, 8
# Paths that are traced together, at most.
_BATCH = 16384
# Standard errors by which shares differ.
_DIFFERENT = 3.0
# Relative variance with shells over that without them, up to which they are worth it.
_MUCH_LESS = 0.5


class _Probe(NamedTuple):
    """Paths of each emitter or region (n,): luminance sent, photons stored, and its variance."""

    sent: Floats
    stored_per_path: Floats
    variance: Floats

    @property
    def share(self) -> Floats:
        """Photons stored of each path, at least of half a path's: none may be by chance."""
        # The variance is at least that of one photon stored.
        least = 0.5 * np.sqrt(self.variance[self.sent > 0.0].min())
        share: Floats = np.maximum(self.stored_per_path, least)
        return share


class _Shells(NamedTuple):
    """Regions of emitters, and the photons of each over those in proportion to its luminance."""

    aimed: tuple[AimedRegion, ...]
    relative: Floats
    guide: Sphere

    def plan(self, n_emitted: int, seed: int, sampler: str) -> EmissionPlan:
        """Plan of as many photons through them."""
        return plan_through(
            *(self.aimed, n_emitted, self.relative), guide=self.guide, seed=seed, sampler=sampler
        )


_Key = tuple[TraceSettings, int]
_brought: WeakKeyDictionary[Scene, dict[_Key, Floats | None]] = WeakKeyDictionary()
_shells: WeakKeyDictionary[Scene, dict[_Key, _Shells | None]] = WeakKeyDictionary()


def allotted_plan(
    scene: Scene,
    n_emitted: int | Sequence[int],
    settings: TraceSettings,
    *,
    seed: int = 0,
    sampler: str = "halton",
    caster: RayCaster,
) -> EmissionPlan:
    """Plan the emission of photons, allotted to emitters and regions by what these bring.

    That does not depend on seed and sampler. Numbers that are given for each emitter are kept. In
    frames of an animation there are no shells: what they bring may differ from frame to frame.
    """
    brought = None
    if isinstance(n_emitted, int):
        # Photons elsewhere do not depend on sensors, unless there is nothing else.
        materials = [item.material for item in scene.objects]
        sensors = all(each.is_sensor or each.is_specular for each in materials)
        probed = replace(settings, frequency_share=0.0, sensors=sensors)
        if settings.paths == "global" and scene.aim is None:
            shells = _shells_of(scene, n_emitted, probed, caster)
            if shells is not None:
                return shells.plan(n_emitted, seed, sampler)
        brought = _brought_by_emitters(scene, n_emitted, probed, caster)
    return plan_emission(
        scene, n_emitted, settings.paths, seed=seed, sampler=sampler, brought=brought
    )


def _brought_by_emitters(
    scene: Scene, n_emitted: int, settings: TraceSettings, caster: RayCaster
) -> Floats | None:
    """As `_brought_by_probe`, found once for a scene; None of few photons or a single emitter."""
    n_paths = _n_paths(n_emitted, len(scene.emitters))
    if len(scene.emitters) == 1 or not n_paths:
        return None
    known = _brought.setdefault(scene, {})
    key = settings, n_paths
    if key not in known:
        known[key] = _brought_by_probe(_probe(scene, settings, n_paths, caster))
    return known[key]


def _n_paths(n_emitted: int, n: int) -> int:
    """Paths to trace of each of n emitters or regions; 0 where that would be too few."""
    n_paths = min(_MOST, n_emitted // (_SHARE * n))
    return n_paths if n_paths >= _LEAST else 0


def _brought_by_probe(probe: _Probe) -> Floats | None:
    """Luminance (n_emitters,) that emitters bring; None if it is in proportion to what they send.

    Of an emitter whose paths are never stored, it is that of half a path.
    """
    lit = probe.sent > 0.0
    stored, variance = probe.stored_per_path[lit], probe.variance[lit]
    mean, of_mean = stored.mean(), variance.mean() / len(stored)
    if (np.abs(stored - mean) <= _DIFFERENT * np.sqrt(variance + of_mean)).all():
        return None
    return probe.sent * probe.share


def _probe(scene: Scene, settings: TraceSettings, n_paths: int, caster: RayCaster) -> _Probe:
    """Trace the first paths of each emitter."""
    n_emitters = len(scene.emitters)
    first = plan_emission(scene, n_paths * n_emitters, settings.paths)
    shines = np.bincount(first.emitter_ids, first.counts, minlength=n_emitters) > 0
    plan = plan_emission(scene, np.where(shines, n_paths, 0).tolist(), settings.paths)
    paths, stored, squares = np.zeros((3, n_emitters))
    for batch in _traced(_context(scene, plan, settings, caster)):
        deposits = batch.deposits
        emitter = np.repeat(plan.emitter_ids[batch.region_id], batch.counts)
        # The wavelengths of a path bring its light together.
        share = np.where(deposits["wavelength"] > 0.0, 1.0 / N_WAVELENGTHS, 1.0)
        of_path = np.bincount(deposits["path"], share, minlength=len(emitter))
        paths += np.bincount(emitter, minlength=n_emitters)
        stored += np.bincount(emitter, of_path, minlength=n_emitters)
        squares += np.bincount(emitter, np.square(of_path), minlength=n_emitters)
    paths = np.maximum(paths, 1.0)
    return _Probe(plan.flux @ LUMINANCE, stored / paths, (squares + 1.0) / paths**2)


def _shells_of(
    scene: Scene, n_emitted: int, settings: TraceSettings, caster: RayCaster
) -> _Shells | None:
    """Shells around the specular objects if they make the variance much less; found once."""
    guide = scene.targets.around_casters
    # Emitters have a region each at least, and many have very many.
    if guide is None or not _n_paths(n_emitted, len(scene.emitters)):
        return None
    aimed = nested_aim(scene)
    n_paths = _n_paths(n_emitted, len(aimed))
    if not n_paths:
        return None
    known = _shells.setdefault(scene, {})
    key = settings, n_paths
    if key not in known:
        plan = plan_through(aimed, n_paths * len(aimed), guide=guide)
        context = _context(scene, plan, settings, caster)
        sent, (mean, square) = plan.region_flux @ LUMINANCE, _stored_light(context)
        relative = _relative(aimed, square, 0.5 / n_paths)
        without = _relative_variance(_probe(scene, settings, n_paths, caster))
        brought = sent @ mean
        much_less = (sent @ relative) ** 2 <= _MUCH_LESS * without * brought**2
        known[key] = _Shells(aimed, relative, guide) if brought and much_less else None
    return known[key]


def _relative(aimed: tuple[AimedRegion, ...], square: Floats, least: float) -> Floats:
    """Roots of mean squares (n_regions,), with values where nothing was stored.

    It falls outwards, and is taken from the region within; of the first it is the least.
    """
    found = square.copy()
    for i in np.flatnonzero(square == 0.0).tolist():
        found[i] = found[i - 1] if aimed[i].number else least
    root: Floats = np.sqrt(found)
    return root


def _stored_light(context: TraceContext) -> tuple[Floats, Floats]:
    """Mean over the paths of each region of light stored over that emitted, and of its square."""
    plan, n_regions = context.plan, len(context.plan.aimed)
    total, square = np.zeros((2, n_regions))
    luminance = LUMINANCE * context.flux
    for batch in _traced(context):
        deposits, region_id = batch.deposits, np.repeat(batch.region_id, batch.counts)
        own = luminance[region_id[deposits["path"]]]
        light = (deposits["throughput"] * own).sum(axis=1) / own.sum(axis=1)
        of_path = np.bincount(deposits["path"], light, minlength=len(region_id))
        total += np.bincount(region_id, of_path, minlength=n_regions)
        square += np.bincount(region_id, np.square(of_path), minlength=n_regions)
    counts = np.maximum(plan.counts, 1)
    return total / counts, square / counts


def _context(
    scene: Scene, plan: EmissionPlan, settings: TraceSettings, caster: RayCaster
) -> TraceContext:
    return TraceContext(scene, plan, settings, batch_capacity(_BATCH, plan), caster=caster)


def _traced(context: TraceContext) -> Iterator[TracedBatch]:
    """Batches of all photons that are planned."""
    photons = range(int(context.plan.counts.sum()))
    return (trace_batch(context, job) for job in batch_jobs(context.plan, photons, context.size))


def _relative_variance(probe: _Probe) -> float:
    """Variance of what emitters bring over its square, of one photon emitted in all."""
    shares = probe.sent * np.sqrt(probe.share)
    return float((shares.sum() / (probe.sent @ probe.share)) ** 2)
