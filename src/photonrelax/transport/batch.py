"""Batches of traced paths: a function of scene, plan and indices that returns plain arrays.

A batch can be traced in any thread or process: a `TraceContext` is pickled by its arguments.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from .._ext.transport import trace as _kernel
from .._ext.transport.materials import Materials
from .._util.validation import Floats
from ..photons.energy_ledger import PATH_OUTCOMES
from ..scene.dispersion import N_WAVELENGTHS, colour_table
from ..scene.scene import Scene
from ..scene.sky_map import LUMINANCE
from .emission import PATHS, EmissionPlan
from .media import NestingFaults, media_at_emitters
from .raycast import RayCaster
from .sensors import sensor_casters, store_crossings

Job = tuple[int, range]
"""A region of an emission plan and the indices of some of its photons."""
# Faces of a scene from which on rays near to one another in sequence save more time than it takes
# to put them so.
_MANY_FACES = 30_000


@dataclass(frozen=True)
class TraceSettings:
    """The settings of `trace_photons` that its photons depend on."""

    paths: str
    max_bounces: int
    frequency_share: float
    sensors: bool = True


@dataclass(frozen=True, eq=False)
class BatchLedger:
    """Outcomes of some paths of one region.

    `energy` (blocks, outcomes, 3) is relative to the flux of a photon; `ends` (outcomes,) and
    `n_met_specular` count paths, `faults` the rays that the nesting of dielectrics contradicts
    (`warn_of_faults`).
    """

    region_id: int
    n_paths: int
    energy: Floats
    ends: NDArray[np.int64]
    n_met_specular: int
    faults: NestingFaults


@dataclass(frozen=True, eq=False)
class TracedBatch:
    """Photons deposited by some paths of one region.

    Attributes
    ----------
    deposits : (n,) structured
        In the order of events; `photonrelax._ext.transport.deposits.DEPOSIT`.
    emitter_coords, emitter_density : (n_paths, 3), (n_paths,) float64
        Of the paths, by `path` of the deposits.
    ledger : BatchLedger
        Outcomes of the paths.
    spectrum_photons : (m,) int64
        The photons that are to get spectra, by their indices among the candidates.
    spectrum_rows : (m,) intp
        Their rows among the deposits in the order of the paths.
    """

    deposits: NDArray[np.void]
    emitter_coords: Floats
    emitter_density: Floats
    ledger: BatchLedger
    spectrum_photons: NDArray[np.int64]
    spectrum_rows: NDArray[np.intp]


class TraceContext:
    """A scene prepared for tracing batches of up to `size` paths, from several threads at once.

    It is pickled by its arguments: `worker_map` keeps it in its workers.
    """

    def __init__(
        self,
        scene: Scene,
        plan: EmissionPlan,
        settings: TraceSettings,
        size: int,
        *,
        caster: RayCaster | None = None,
    ) -> None:
        self.materials = Materials(scene.material_table())
        self.sensors = sensor_casters(scene) if settings.sensors else []
        if not (self.materials.diffuse[: len(scene.objects)].any() or self.sensors):
            what = "a Diffuse object" + (" or a Sensor" if settings.sensors else "")
            raise ValueError(
                f"scene should have {what} to store photons on, "
                f"but none of its {len(scene.objects)} objects is"
            )
        self.scene, self.plan, self.settings, self.size = scene, plan, settings, size
        self.caster = caster or RayCaster(scene.surfaces)
        self.media, self.faults = media_at_emitters(scene, self.caster, self.materials)
        self.flux = plan.flux_per_photon
        guide = plan.guide
        self._guide = (*guide.centre, guide.radius) if guide else (0.0,) * 4
        self._along_curve = sum(len(item.mesh.faces) for item in scene.surfaces) > _MANY_FACES
        self.emissions = [plan.emission(region) for region in range(len(plan.aimed))]
        self._free_list: list[_kernel.Paths] = []

    def acquire_paths(self) -> _kernel.Paths:
        """Return paths released before, whose memory may still be in the cache, or new ones."""
        try:
            return self._free_list.pop()
        except IndexError:
            return self.new_paths(self.size, self.settings.paths)

    def new_paths(self, size: int, deposits: str) -> _kernel.Paths:
        """Paths of which up to `size` are traced together; `deposits` is one of `PATHS`."""
        return _kernel.Paths(
            self.materials,
            self.caster.frame,
            self.caster.triangles,
            size,
            path_filter=PATHS.index(deposits),
            max_bounces=self.settings.max_bounces,
            n_wavelengths=N_WAVELENGTHS,
            colours=colour_table(),
            guide=self._guide,
        )

    def start(
        self,
        paths: _kernel.Paths,
        region_id: int,
        candidates: NDArray[np.int64],
        *,
        in_order: bool = False,
    ) -> tuple[Floats, NDArray[np.int64]]:
        """Emit candidates (n,) of a region into paths, which fill the arrays returned.

        These are flux (blocks, outcomes, 3) and number (outcomes,) of the ends of paths. Live rays
        stay `in_order` of the candidates, or may follow a curve over the emitter.
        """
        energy = np.zeros((-(-len(candidates) // _kernel.LEDGER_BLOCK), len(PATH_OUTCOMES), 3))
        ends = np.zeros(len(PATH_OUTCOMES), dtype=np.int64)
        paths.start(
            self.emissions[region_id],
            candidates,
            media=self.media[self.plan.aimed[region_id].emitter_id],
            luminance=LUMINANCE * self.flux[region_id],
            ledger=energy,
            ends=ends,
            along_curve=self._along_curve and not in_order,
        )
        return energy, ends

    def release_paths(self, paths: _kernel.Paths) -> None:
        """Take back paths that have ended."""
        self._free_list.append(paths)

    def __reduce__(self) -> tuple:
        parts = (self.scene, self.plan, self.settings, self.size)
        return partial(TraceContext, caster=self.caster), parts


def trace_batch(context: TraceContext, job: Job) -> TracedBatch:
    """Trace some photons of one region to the ends of their paths."""
    region_id, photons = job
    candidates = context.plan.candidates_of(region_id, photons)
    paths = context.acquire_paths()
    energy, ends = context.start(paths, region_id, candidates)
    while paths.n_live or paths.disperse():
        found = context.caster.find_paths(paths)
        if context.sensors:
            store_crossings(context.sensors, paths, found)
        paths.advance(found)
    deposits, coords, density = paths.take_deposits()
    ledger = BatchLedger(
        region_id, len(photons), energy, ends, paths.n_met_specular, paths.faults.take()
    )
    context.release_paths(paths)
    path, rows = _spectrum_rows(context, region_id, candidates, deposits)
    return TracedBatch(deposits, coords, density, ledger, candidates[path], rows)


def trace_batches(context: TraceContext, jobs: Sequence[Job]) -> list[TracedBatch]:
    """Trace several batches, one after the other: a task of a worker."""
    return [trace_batch(context, job) for job in jobs]


def _spectrum_rows(
    context: TraceContext,
    region_id: int,
    candidates: NDArray[np.int64],
    deposits: NDArray[np.void],
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Paths of a batch whose first deposits on surfaces are to get spectra, and their rows.

    Deposits on sensors get none: paths are replayed up to the surface.
    """
    share = context.settings.frequency_share
    if share == 0.0:
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)
    selected = np.empty(len(candidates), dtype=np.uint8)
    context.emissions[region_id].spectrum_photons(candidates, selected, share)
    order = np.argsort(deposits["path"], kind="stable")
    on_surface = ~np.isin(deposits["object_id"][order], context.scene.sensors)
    rows = np.flatnonzero(on_surface)
    path, first = np.unique(deposits["path"][order[rows]], return_index=True)
    chosen = selected[path] > 0
    return path[chosen].astype(np.intp), rows[first[chosen]]
