"""Photons of light that has no images: of rough or faint sheets, and of emitters with a size."""

from __future__ import annotations

from concurrent.futures import Executor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._ext.transport.splitting import sheets
from ..._util.validation import Floats
from ...photons.photon_map import NothingStoredError, PhotonMap
from ...scene.scene import Scene
from ...transport.allotment import allotted_plan
from ...transport.batch import TraceSettings
from ...transport.raycast import RayCaster
from ...transport.splitting import MAX_BOUNCES, Signatures
from ...transport.trace import trace_photons

# Relaxed photons of a map whose relative L1 error would be one: it falls with their root.
_PHOTONS_OF_NOISE = 300.0
# Photons stored at least: estimates of fewer do not keep their flux.
_LEAST_STORED = 2000.0
# Share of the misplaced light that that of photons may be, and that of light that is left out.
_OF_ERROR, _LEFT_OUT = 1.0 / 3.0, 0.2


class Rest(NamedTuple):
    """Photons of the light that has no images; None if there are none.

    `emitted` (3,) is the flux of the emitters all of whose light is theirs, W.
    """

    photons: PhotonMap | None
    emitted: Floats


def photons_wanted(share: float, stored: float, error: float) -> float:
    """Photons to emit for a share of the light, so that its noise is a third of an error.

    `stored` is the share of the photons that finds such light. None for light that is far less than
    the error.
    """
    if share <= _LEFT_OUT * error:
        return 0.0
    noise = _OF_ERROR * error / share
    return max(_PHOTONS_OF_NOISE / noise**2, _LEAST_STORED) / stored if noise > 0.0 else np.inf


def rest_photons(
    scene: Scene,
    wanted: dict[int, float],
    followed: dict[int, Signatures],
    *,
    n_photons: int,
    n_threads: int,
    caster: RayCaster,
    executor: Executor | None,
) -> Rest:
    """Photons of sheets that are not followed, and of all those of some emitters.

    Parameters
    ----------
    wanted : dict of int to float
        Photons to emit for each emitter that has followed sheets.
    followed : dict of int to (k,) uint64
        These, ascending.
    n_photons : int
        Photons to emit, at most.
    """
    n_emitted = _numbers(scene, wanted, n_photons, caster)
    nothing = Rest(None, np.zeros(3))
    if not n_emitted.any():
        return nothing
    try:
        photons = trace_photons(
            scene,
            n_emitted.tolist(),
            n_threads=n_threads,
            caster=caster,
            sensors=False,
            executor=executor,
        )
    except NothingStoredError:
        if any(len(each) for each in followed.values()):
            return nothing
        raise
    without = np.setdiff1d(np.arange(len(scene.emitters)), list(followed))
    assert photons.ledger is not None
    emitted = photons.ledger.emitted[without].sum(axis=0)
    rest = photons.subset(_is_rest(photons, scene, followed)).replace(ledger=None)
    return Rest(rest if len(rest) else None, emitted)


def _numbers(
    scene: Scene, wanted: dict[int, float], n_photons: int, caster: RayCaster
) -> NDArray[np.int64]:
    """Photons (n_emitters,) to emit."""
    numbers = np.full(len(scene.emitters), n_photons)
    if len(wanted) < len(scene.emitters):
        settings = TraceSettings("caustic", MAX_BOUNCES, 0.0, sensors=False)
        plan = allotted_plan(scene, n_photons, settings, caster=caster)
        numbers = np.bincount(plan.emitter_ids, plan.counts, minlength=len(scene.emitters))
    for emitter_id, n in wanted.items():
        numbers[emitter_id] = min(numbers[emitter_id], np.ceil(n))
    return numbers.astype(np.int64)


def _is_rest(
    photons: PhotonMap, scene: Scene, followed: dict[int, Signatures]
) -> NDArray[np.bool_]:
    """Mask (n,) of the photons of sheets that are not followed."""
    assert photons.object_id is not None
    assert photons.path_signature is not None
    surface = np.searchsorted(scene.surface_ids, photons.object_id).astype(np.int32)
    sheet = sheets(photons.path_signature.view(np.uint64), surface)
    is_rest = np.ones(len(photons), dtype=bool)
    for emitter_id, mine in followed.items():
        is_rest &= ~((photons.emitter_id == emitter_id) & np.isin(sheet, mine))
    return is_rest
