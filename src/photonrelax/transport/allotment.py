"""Photons of each emitter, by the light that it brings to what is stored.

An emitter may send much flux towards a target and bring little there: a lamp indoors that is aimed
at a pool outside, say. A few paths of each emitter tell. Of N photons, n_e are of emitter e, which
sends out the luminance Φ_e and brings S_e = Φ_e p_e, p_e being the photons stored a path. The
variance of its light is S_e² / (n_e p_e), so that the sum over emitters is least for n_e in
proportion to S_e / √p_e = √(Φ_e S_e). Where the p_e are equal within their noise, that is Φ_e.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from .._util.validation import Floats
from ..scene.dispersion import N_WAVELENGTHS
from ..scene.scene import Scene
from ..scene.sky_map import LUMINANCE
from .batch import TraceContext, TraceSettings, trace_batch
from .emission import EmissionPlan, plan_emission
from .raycast import RayCaster

# Paths of each emitter that are traced for it, at most and at least, and the share of all photons
# that they are together at most: more emitters are not told apart.
_MOST, _LEAST, _SHARE = 1024, 32, 8
# Standard errors by which shares differ.
_DIFFERENT = 3.0


class _Probe(NamedTuple):
    """Paths of each emitter (n_emitters,): luminance sent, photons stored, and its variance."""

    sent: Floats
    stored_per_path: Floats
    variance: Floats


_brought: WeakKeyDictionary[Scene, dict[tuple[TraceSettings, int], Floats | None]] = (
    WeakKeyDictionary()
)


def allotted_plan(
    scene: Scene,
    n_emitted: int | Sequence[int],
    settings: TraceSettings,
    *,
    seed: int = 0,
    sampler: str = "halton",
    caster: RayCaster,
) -> EmissionPlan:
    """Plan the emission of photons, allotted to the emitters by what these bring.

    That does not depend on seed and sampler. Numbers that are given for each emitter are kept.
    """
    brought = None
    if isinstance(n_emitted, int) and len(scene.emitters) > 1:
        # Photons elsewhere do not depend on sensors, unless there is nothing else.
        materials = [item.material for item in scene.objects]
        sensors = all(each.is_sensor or each.is_specular for each in materials)
        settings = replace(settings, frequency_share=0.0, sensors=sensors)
        n_paths = min(_MOST, n_emitted // (_SHARE * len(scene.emitters)))
        if n_paths >= _LEAST:
            brought = _known(scene, settings, n_paths, caster)
    return plan_emission(
        scene, n_emitted, settings.paths, seed=seed, sampler=sampler, brought=brought
    )


def _known(scene: Scene, settings: TraceSettings, n_paths: int, caster: RayCaster) -> Floats | None:
    """As `_brought_by_probe`, found once for a scene."""
    known = _brought.setdefault(scene, {})
    key = settings, n_paths
    if key not in known:
        known[key] = _brought_by_probe(_probe(scene, settings, n_paths, caster))
    return known[key]


def _brought_by_probe(probe: _Probe) -> Floats | None:
    """Luminance (n_emitters,) that emitters bring; None if it is in proportion to what they send.

    Of an emitter whose paths are never stored, it is that of half a path.
    """
    lit = probe.sent > 0.0
    stored, variance = probe.stored_per_path[lit], probe.variance[lit]
    mean, of_mean = stored.mean(), variance.mean() / len(stored)
    if (np.abs(stored - mean) <= _DIFFERENT * np.sqrt(variance + of_mean)).all():
        return None
    # The variance is at least that of one photon stored.
    return probe.sent * np.maximum(probe.stored_per_path, 0.5 * np.sqrt(variance.min()))


def _probe(scene: Scene, settings: TraceSettings, n_paths: int, caster: RayCaster) -> _Probe:
    """Trace the first paths of each emitter."""
    n_emitters = len(scene.emitters)
    first = plan_emission(scene, n_paths * n_emitters, settings.paths)
    shines = np.bincount(first.emitter_ids, first.counts, minlength=n_emitters) > 0
    plan = plan_emission(scene, np.where(shines, n_paths, 0).tolist(), settings.paths)
    context = TraceContext(scene, plan, settings, n_paths, caster=caster)
    paths, stored, squares = np.zeros((3, n_emitters))
    for region_id, n in enumerate(plan.counts.tolist()):
        emitter = plan.emitter_ids[region_id]
        deposits = trace_batch(context, (region_id, range(n))).deposits
        # The wavelengths of a path bring its light together.
        share = np.where(deposits["wavelength"] > 0.0, 1.0 / N_WAVELENGTHS, 1.0)
        of_path = np.bincount(deposits["path"], share, minlength=n)
        paths[emitter] += n
        stored[emitter] += of_path.sum()
        squares[emitter] += np.square(of_path).sum()
    paths = np.maximum(paths, 1.0)
    return _Probe(plan.flux @ LUMINANCE, stored / paths, (squares + 1.0) / paths**2)
