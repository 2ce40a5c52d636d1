"""Batches of traced paths: a function of scene, plan and indices that returns plain arrays.

A batch can be traced in any thread or process: a `TraceContext` is pickled by its arguments.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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

Job = tuple[tuple[int, range], ...]
"""Regions of an emission plan, and the indices of some of the photons of each."""
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
    """Outcomes of some paths, by blocks of those of one region.

    `region_id` is that of each block. `energy` (blocks, outcomes, 3) is relative to the flux of a
    photon; `ends` (blocks, outcomes) and `n_met_specular` count paths, `faults` the rays that the
    nesting of dielectrics contradicts (`warn_of_faults`).
    """

    region_id: NDArray[np.intp]
    n_paths: int
    energy: Floats
    ends: NDArray[np.int64]
    n_met_specular: int
    faults: NestingFaults


@dataclass(frozen=True, eq=False)
class TracedBatch:
    """Photons deposited by some paths.

    Attributes
    ----------
    region_id, counts : (n_regions,) intp, int64
        The regions that the paths are of, and the number of paths of each in sequence.
    deposits : (n,) structured
        In the order of events; `photonrelax._ext.transport.deposits.DEPOSIT`.
    rows : (n,) int32
        Of the deposits, in the order of the paths.
    emitter_coords, emitter_density : (n, 3), (n,) float64
        Of the paths of the deposits.
    ledger : BatchLedger
        Outcomes of the paths.
    spectrum_regions, spectrum_photons : (m,) intp, (m,) int64
        The photons that are to get spectra: their regions, and indices among the candidates.
    spectrum_rows : (m,) intp
        Their rows among the deposits in the order of the paths.
    """

    region_id: NDArray[np.intp]
    counts: NDArray[np.int64]
    deposits: NDArray[np.void]
    rows: NDArray[np.int32]
    emitter_coords: Floats
    emitter_density: Floats
    ledger: BatchLedger
    spectrum_regions: NDArray[np.intp]
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
        self._media_of_region = self.media[plan.emitter_ids]
        self._luminance = LUMINANCE * self.flux
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
        region_id: NDArray[np.intp],
        counts: NDArray[np.int64],
        candidates: NDArray[np.int64],
        *,
        in_order: bool = False,
    ) -> tuple[NDArray[np.intp], Floats, NDArray[np.int64]]:
        """Emit candidates, so many of each of some regions, into paths.

        Live rays stay `in_order` of the candidates, or may follow a curve over the emitters.

        Returns
        -------
        (blocks,) intp, (blocks, outcomes, 3), (blocks, outcomes) int64
            Regions of the blocks of the ledger; flux and number of the ends of paths, which
            `paths` fill.
        """
        block_region = np.repeat(region_id, -(-counts // _kernel.LEDGER_BLOCK))
        shape = len(block_region), len(PATH_OUTCOMES)
        energy, ends = np.zeros((*shape, 3)), np.zeros(shape, dtype=np.int64)
        paths.start(
            [self.emissions[region] for region in region_id.tolist()],
            counts,
            candidates,
            media=self._media_of_region[region_id],
            luminance=self._luminance[region_id],
            ledger=energy,
            ends=ends,
            along_curve=self._along_curve and not in_order,
        )
        return block_region, energy, ends

    def release_paths(self, paths: _kernel.Paths) -> None:
        """Take back paths that have ended."""
        self._free_list.append(paths)

    def __reduce__(self) -> tuple:
        parts = (self.scene, self.plan, self.settings, self.size)
        return partial(TraceContext, caster=self.caster), parts


def batch_capacity(most: int, plan: EmissionPlan) -> int:
    """Paths of a batch, so many at most rounded up to whole blocks of the ledger."""
    most = min(most, int(plan.counts.sum()))
    return -(-most // _kernel.LEDGER_BLOCK) * _kernel.LEDGER_BLOCK


def batch_jobs(plan: EmissionPlan, photons: range, size: int) -> Iterator[Job]:
    """Some photons of all regions in order, in jobs of up to `size` of them.

    Jobs end after whole blocks of the ledger of a region, or after its last photon.
    """
    job: list[tuple[int, range]] = []
    room = size
    for region_id, mine in plan.parts(photons):
        while len(mine):
            # The rest of the region, or the whole blocks there is room for.
            n = len(mine) if len(mine) <= room else room - room % _kernel.LEDGER_BLOCK
            if n:
                job.append((region_id, mine[:n]))
                mine, room = mine[n:], room - n
            if len(mine) or room == 0:
                yield tuple(job)
                job, room = [], size
    if job:
        yield tuple(job)


def trace_batch(context: TraceContext, job: Job) -> TracedBatch:
    """Trace some photons of some regions to the ends of their paths."""
    region_id = np.array([region for region, _ in job], dtype=np.intp)
    counts = np.array([len(photons) for _, photons in job])
    parts = [context.plan.candidates_of(*part) for part in job]
    candidates = parts[0] if len(parts) == 1 else np.concatenate(parts)
    paths = context.acquire_paths()
    block_region, energy, ends = context.start(paths, region_id, counts, candidates)
    while paths.n_live or paths.disperse():
        found = context.caster.find_paths(paths)
        if context.sensors:
            store_crossings(context.sensors, paths, found)
        paths.advance(found)
    deposits, rows, coords, density = paths.take_deposits()
    outcomes = energy, ends, paths.n_met_specular, paths.faults.take()
    ledger = BatchLedger(block_region, len(candidates), *outcomes)
    context.release_paths(paths)
    spectra = _spectra(context, region_id, counts, candidates, deposits)
    return TracedBatch(region_id, counts, deposits, rows, coords, density, ledger, *spectra)


def trace_batches(context: TraceContext, jobs: Sequence[Job]) -> list[TracedBatch]:
    """Trace several batches, one after the other: a task of a worker."""
    return [trace_batch(context, job) for job in jobs]


def _spectra(
    context: TraceContext,
    region_id: NDArray[np.intp],
    counts: NDArray[np.int64],
    candidates: NDArray[np.int64],
    deposits: NDArray[np.void],
) -> tuple[NDArray[np.intp], NDArray[np.int64], NDArray[np.intp]]:
    """Regions, candidates and rows of first deposits on surfaces that are to get spectra.

    Deposits on sensors get none: paths are replayed up to the surface.
    """
    share = context.settings.frequency_share
    if share == 0.0:
        none = np.empty(0, dtype=np.intp)
        return none, none, none
    stops = np.cumsum(counts)
    chosen = [
        context.emissions[region].spectrum_photons(mine, share)
        for region, mine in zip(region_id.tolist(), np.split(candidates, stops[:-1]), strict=True)
    ]
    order = np.argsort(deposits["path"], kind="stable")
    on_surface = ~np.isin(deposits["object_id"][order], context.scene.sensors)
    rows = np.flatnonzero(on_surface)
    path, first = np.unique(deposits["path"][order[rows]], return_index=True)
    is_chosen = np.concatenate(chosen)[path] > 0
    path, rows = path[is_chosen], rows[first[is_chosen]]
    return region_id[np.searchsorted(stops, path, side="right")], candidates[path], rows
