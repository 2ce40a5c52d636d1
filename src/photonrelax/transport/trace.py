"""Tracing: paths from the emitters through the scene, and their photons on surfaces and sensors.

Paths are traced in batches, a thread each: embree intersects all rays of a batch, then one
compiled pass takes every path through its surface and writes the rays embree gets next. Photons,
their order and the ledger are the same, to the bit, for any number of threads and any batch size.

A dielectric reflects at random with the Fresnel reflectance and refracts otherwise. Mirrors,
absorbing media and, for paths that continue, diffuse surfaces end paths by Russian roulette on the
luminance. So all photons of an emitter carry the same luminance, and the same flux unless the path
was coloured, but for indirect light that is aimed at specular objects (`transport.allotment`).

White light that meets a dispersive surface is taken up there at eight wavelengths, which turn with
the index of the photon: see `photonrelax.scene.dispersion`.

A stored photon takes 148 bytes where all emitters are collimated, else 156, 8 more where light is
dispersed, and 24 more where some carry spectra, each of which takes a fifth of a millisecond, as
its neighbours are traced as well (see `photonrelax.estimation.frequency`). A path of the pending
batches takes a few hundred bytes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from math import fsum

import numpy as np
from numpy.typing import NDArray

from .._ext.transport import trace as _kernel
from .._ext.transport.deposits import Columns
from .._util.memory import ESTIMATE_MARGIN, available_memory, check_memory
from .._util.parallel import ordered_map, thread_count, thread_executor
from .._util.progress import Progress, Reporter
from .._util.validation import Floats, check_choice, count, float_array
from .._util.workers import checked_executor, n_workers, worker_map
from ..photons.energy_ledger import PATH_OUTCOMES, EnergyLedger
from ..photons.photon_map import NothingStoredError, PhotonMap
from ..scene.digest import light_digest
from ..scene.dispersion import N_WAVELENGTHS
from ..scene.scene import Scene
from .allotment import allotted_plan
from .batch import (
    BatchLedger,
    Job,
    TraceContext,
    TracedBatch,
    TraceSettings,
    batch_capacity,
    batch_jobs,
    trace_batch,
    trace_batches,
)
from .emission import PATHS, EmissionPlan, checked_numbers, emit
from .frequency.spectra import SpectrumTracer, batches_by_region
from .media import warn_of_faults
from .raycast import RayCaster

# Far beyond any path that matters; in a mirrored room paths would never end.
MAX_BOUNCES = 10_000
# Where diffuse surfaces end paths by roulette, a cut would only take light away.
_DEFAULT_BOUNCES = {"caustic": 32, "global": MAX_BOUNCES, "all": MAX_BOUNCES}
# Capacity of a growing map over the number of photons expected from its paths so far; pages that
# are not written take no memory.
_CAPACITY_MARGIN = 1.05
# Deposits count the paths of a batch in 32 bits.
_MAX_BATCH = 2**30
# Bytes of a stored photon, at least, and of the ledger of a block of paths.
PHOTON_BYTES = 148
_LEDGER_BYTES = 8 * 3 * len(PATH_OUTCOMES)
# Crossings of a sensor between two events, at most, but for sensors with hollows.
_CROSSINGS = 2
# Paths of a task of an executor at most, some tenths of a second, and tasks of a worker at least,
# so that all end at about the same time.
_PATHS_PER_TASK, _TASKS_PER_WORKER = 2**18, 4
# Paths from which the number of photons stored is estimated.
_PILOT = 16384
# Photons of a region that are looked at to tell why nothing is stored.
_N_PROBES = 4096

_DTYPES: dict[str, type] = {
    "position": np.float64,
    "normal": np.float64,
    "wi": np.float64,
    "flux": np.float64,
    "emitter_coords": np.float64,
    "emitter_density": np.float64,
    "emitter_id": np.int32,
    "path_signature": np.int64,
    "n_bounces": np.int32,
    "path_length": np.float64,
    "object_id": np.int32,
}
_WIDTHS = dict.fromkeys(("position", "normal", "wi", "flux"), 3)


def trace_photons(
    scene: Scene,
    n_emitted: int | Sequence[int],
    *,
    photons: range | None = None,
    seed: int = 0,
    paths: str = "caustic",
    sampler: str = "halton",
    max_bounces: int | None = None,
    frequency_share: float = 0.0,
    n_threads: int | None = None,
    progress: Progress | None = None,
    batch_size: int = 16384,
    caster: RayCaster | None = None,
    sensors: bool = True,
    executor: Executor | None = None,
) -> PhotonMap:
    """Emit photons, trace their paths and store them on diffuse surfaces and sensors.

    Parameters
    ----------
    scene, n_emitted : Scene, int or sequence of int
        Paths to start, apportioned by what emitters bring to what is stored; or those of each.
    photons, seed, sampler : range, int, {"halton", "random"}, optional
        Some by index over all regions in order; each depends on seed and index alone. Evenly
        spaced photons (SJ13) or independent ones.
    paths : {"caustic", "global", "all"}
        Light to store: of specular paths (L S+ D), neither that nor direct light, or all; on
        sensors, light after specular events alone, after a diffuse one, or all.
    max_bounces, frequency_share : int, float, optional
        Events after which a path is cut; by default 32 for caustics, else 10,000, the most there
        may be. Share of the photons not yet scattered by diffuse surfaces that get a spectrum.
    n_threads, progress, executor : int, callable, concurrent.futures.Executor, optional
        Threads, by default all; called as ``progress("trace", done, n_emitted)`` now and then;
        traces batches in its workers, a thread each, but for spectra: see docs/scaling.md.
    batch_size, caster : int, RayCaster, optional
        Paths traced together, rounded up to whole 1024; of the scene: building it takes time.
    sensors : bool
        Store photons on sensors too; only with `paths` "all" others may depend on that.

    Returns
    -------
    PhotonMap
        By emitter, index and event, between two events by sensor; Halton caustics are well spaced.

    Raises
    ------
    TypeError, ValueError, MemoryError
        If an argument is invalid, nothing of all is stored, or photons surely do not fit in memory.
    """
    settings = _checked_settings(paths, max_bounces, frequency_share, sensors=sensors)
    _check_spectra(scene, frequency_share)
    threads, numbers = thread_count(n_threads), checked_numbers(n_emitted, scene)
    caster = caster or RayCaster(scene.surfaces)
    traced = _checked_photons(photons, int(np.sum(numbers)))
    _check_memory(scene, len(traced), settings, caster, threads)
    plan = allotted_plan(scene, numbers, settings, seed=seed, sampler=sampler, caster=caster)
    size = batch_capacity(count(batch_size, "batch_size", high=_MAX_BATCH), plan)
    context = TraceContext(scene, plan, settings, size, caster=caster)
    return _trace_all(context, traced, threads, progress, checked_executor(executor))


def _check_spectra(scene: Scene, frequency_share: float) -> None:
    """Raise ValueError if photons are to get spectra that the light of a scene does not have."""
    if frequency_share and scene.has_dispersion:
        raise ValueError(
            "frequency_share should be 0 in a scene with dispersion: local frequency spectra are "
            "of paths at one index of refraction; take another method than frequency, or give "
            "dielectrics a number as ior"
        )


def _checked_photons(photons: range | None, n_emitted: int) -> range:
    """Photons to trace of an emission, all by default."""
    if photons is None:
        return range(n_emitted)
    if not isinstance(photons, range):
        raise TypeError(f"photons should be a range of indices, but is {type(photons).__name__}")
    if photons.step != 1 or not 0 <= photons.start < photons.stop <= n_emitted:
        raise ValueError(
            f"photons should be some of {range(n_emitted)} in steps of 1, but is {photons}"
        )
    return photons


def check_photons_fit(scene: Scene, n_emitted: int, caster: RayCaster | None = None) -> None:
    """Raise MemoryError if the caustic photons on surfaces surely do not fit in memory."""
    settings = _checked_settings("caustic", None, 0.0, sensors=False)
    _check_memory(scene, n_emitted, settings, caster, n_threads=1)


def stored_per_path(
    scene: Scene,
    paths: str,
    caster: RayCaster | None = None,
    n_threads: int = 1,
    *,
    sensors: bool = False,
) -> float:
    """Photons of a kind of light stored for each path, of the first few thousand.

    They are those on surfaces, and on sensors if these are asked for.
    """
    settings = _checked_settings(paths, None, 0.0, sensors=sensors)
    return _stored_per_path(scene, settings, caster, n_threads)


def _check_memory(
    scene: Scene, n_emitted: int, settings: TraceSettings, caster: RayCaster | None, n_threads: int
) -> None:
    """Raise MemoryError if photons surely do not fit in memory."""
    deposits = 1.0 if settings.paths == "caustic" else _most_scattered(scene, settings)
    if scene.has_dispersion:
        deposits *= N_WAVELENGTHS
    if settings.sensors:
        deposits += _CROSSINGS * len(scene.sensors) * (settings.max_bounces + 1)
    if _bytes(n_emitted, deposits * n_emitted) > available_memory():
        stored = _stored_per_path(scene, settings, caster, n_threads)
        check_memory(
            _bytes(n_emitted, n_emitted * stored / ESTIMATE_MARGIN),
            f"the photons stored of {n_emitted:,} emitted",
            "emit fewer, or render in passes of fresh photons (--passes, render_progressive)",
        )


def _most_scattered(scene: Scene, settings: TraceSettings) -> float:
    """Photons that a path stores on surfaces on average, at most: roulette ends it by albedo."""
    table = scene.material_table()
    albedos = table.reflectance[[kind == "diffuse" for kind in table.kind]]
    absorbed = 1.0 - float(albedos.max(initial=0.0))
    return min(1.0 / absorbed, settings.max_bounces) if absorbed > 0.0 else settings.max_bounces


def _bytes(n_emitted: int, n_stored: float) -> float:
    """Least bytes of photons and of the ledgers of their batches."""
    return PHOTON_BYTES * n_stored + _LEDGER_BYTES * n_emitted / _kernel.LEDGER_BLOCK


def _stored_per_path(
    scene: Scene, settings: TraceSettings, caster: RayCaster | None, n_threads: int
) -> float:
    """Photons stored for each path, of the first paths of each emitter."""
    n = max(_PILOT, len(scene.emitters))
    caster = caster or RayCaster(scene.surfaces)
    plan = allotted_plan(scene, n, settings, caster=caster)
    pilot = TraceContext(scene, plan, replace(settings, frequency_share=0.0), _PILOT, caster=caster)
    try:
        return len(_trace_all(pilot, range(n), n_threads, None)) / n
    except NothingStoredError:
        return 0.0


def _trace_all(
    context: TraceContext,
    traced: range,
    n_threads: int,
    progress: Progress | None,
    executor: Executor | None = None,
) -> PhotonMap:
    """Photons of all batches of those to trace."""
    plan, settings = context.plan, context.settings
    # A region of which hardly any is its own may have fewer photons than were asked of it.
    traced = traced[: max(int(plan.counts.sum()) - traced.start, 0)]
    report = Reporter(progress, "trace", len(traced))
    columns = _Columns(plan, len(traced), context.materials.has_dispersion)
    ledgers, selected = [], []
    for batch in _batches(context, traced, n_threads, executor):
        first = columns.append(batch)
        ledgers.append(batch.ledger)
        if settings.frequency_share:
            rows = first + batch.spectrum_rows
            selected.append((batch.spectrum_regions, batch.spectrum_photons, rows))
        report.advance(batch.ledger.n_paths)
        # The deposits are freed before the next batch is traced.
        del batch
    faults = [*context.faults, *(ledger.faults for ledger in ledgers)]
    n_paths = sum(ledger.n_paths for ledger in ledgers)
    warn_of_faults(context.scene, faults, n_paths, context.materials)
    photons = _photon_map(context, traced, columns, ledgers)
    if not settings.frequency_share:
        return photons
    return photons.replace(spectrum=_spectra(context, selected, len(photons), n_threads, progress))


def _batches(
    context: TraceContext, traced: range, n_threads: int, executor: Executor | None
) -> Iterator[TracedBatch]:
    """All batches in order, traced by threads of this process or by an executor."""
    jobs = batch_jobs(context.plan, traced, context.size)
    if executor is None:
        with thread_executor(n_threads) as threads:
            work = partial(trace_batch, context)
            yield from ordered_map(work, jobs, threads, max_pending=2 * n_threads)
        return
    tasks = _tasks(list(jobs), context.size, n_workers(executor))
    for batches in worker_map(trace_batches, context, tasks, executor):
        # Popped, so that one that was taken in is not held on to.
        while batches:
            yield batches.pop(0)


def _tasks(jobs: list[Job], size: int, n_workers: int) -> Iterator[list[Job]]:
    """Jobs of batches of a size together: some tasks for each worker, none of them long."""
    per_worker = -(-len(jobs) // (_TASKS_PER_WORKER * n_workers))
    per_task = max(1, min(_PATHS_PER_TASK // size, per_worker))
    for first in range(0, len(jobs), per_task):
        yield jobs[first : first + per_task]


def _checked_settings(
    paths: str, max_bounces: int | None, share: float, *, sensors: bool
) -> TraceSettings:
    check_choice(paths, "paths", PATHS)
    if max_bounces is None:
        max_bounces = _DEFAULT_BOUNCES[paths]
    max_bounces = count(max_bounces, "max_bounces", high=MAX_BOUNCES)
    share = float(float_array(share, "frequency_share", (), finite=False))
    if not 0.0 <= share <= 1.0:
        raise ValueError(f"frequency_share should lie in [0, 1], but is {share}")
    if share and paths == "global":
        raise ValueError(
            'frequency_share should be 0 for paths="global": '
            "photons that a diffuse surface scattered have no spectra"
        )
    return TraceSettings(paths, max_bounces, share, bool(sensors))


def _spectra(
    context: TraceContext,
    selected: list[tuple[NDArray[np.intp], NDArray[np.int64], NDArray[np.intp]]],
    n_stored: int,
    n_threads: int,
    progress: Progress | None,
) -> Floats:
    """Return the column of spectra, NaN for photons that were not selected."""
    tracer = SpectrumTracer(context, n_threads)
    out = np.full((n_stored, 3), np.nan)
    region_id, photons, rows = (np.concatenate(column) for column in zip(*selected, strict=True))
    report = Reporter(progress, "spectra", len(rows))
    for some in batches_by_region(region_id, photons, rows):
        out[some.rows] = tracer.spectra(some)
        report.advance(len(some.rows))
    return out


class _Columns:
    """The columns of a photon map that grows batch by batch, in place."""

    def __init__(self, plan: EmissionPlan, n_planned: int, has_wavelengths: bool) -> None:
        emitting = (region for region, n in zip(plan.regions, plan.counts, strict=True) if n)
        coords_width = 2 if all(region.is_plane for region in emitting) else 3
        self._widths = _WIDTHS | {"emitter_coords": coords_width}
        self._dtypes = _DTYPES | ({"wavelength": np.float64} if has_wavelengths else {})
        self._arrays = self._empty(0)
        self._flux = plan.flux_per_photon
        self._emitter_ids = plan.emitter_ids.astype(np.int32)
        self._n_planned = n_planned
        self._n_traced = 0
        self._n_stored = 0

    def append(self, batch: TracedBatch) -> int:
        """Append the photons of a batch, and return the row of the first."""
        first, self._n_stored = self._n_stored, self._n_stored + len(batch.deposits)
        self._n_traced += batch.ledger.n_paths
        if self._n_stored > len(self._arrays["position"]):
            expected = self._n_stored * self._n_planned / self._n_traced
            self._resize(int(_CAPACITY_MARGIN * expected) + 1)
        if len(batch.deposits):
            region_id = batch.ledger.region_id
            Columns(**self._arrays).write(
                *(batch.deposits, batch.rows, batch.emitter_coords, batch.emitter_density),
                first=first,
                flux=self._flux[region_id],
                emitter_id=self._emitter_ids[region_id],
            )
        return first

    def finished(self, scene: Scene) -> dict[str, NDArray]:
        """Return the columns of a scene's photons, ready to be frozen without a copy."""
        self._resize(self._n_stored)
        self._arrays["object_id"] = scene.ids_of(self._arrays["object_id"])
        if not self._arrays.get("wavelength", np.ones(1)).any():
            del self._arrays["wavelength"]
        for array in self._arrays.values():
            array.setflags(write=False)
        return self._arrays

    def _resize(self, n: int) -> None:
        if len(self._arrays["position"]) == 0:
            self._arrays = self._empty(n)
            return
        # In place: concatenated columns would need their memory twice.
        for array in self._arrays.values():
            array.resize((n, *array.shape[1:]), refcheck=False)

    def _empty(self, n: int) -> dict[str, NDArray]:
        widths = self._widths
        shapes = {name: (n, widths[name]) if name in widths else (n,) for name in self._dtypes}
        return {name: np.empty(shapes[name], dtype) for name, dtype in self._dtypes.items()}


def _photon_map(
    context: TraceContext, traced: range, columns: _Columns, ledgers: list[BatchLedger]
) -> PhotonMap:
    plan, settings = context.plan, context.settings
    n_emitted = int(plan.counts.sum())
    is_whole = len(traced) == n_emitted
    ledger = _ledger(plan, plan.flux if is_whole else plan.flux_of(traced), ledgers)
    photons = PhotonMap(
        **columns.finished(context.scene),
        n_emitted=n_emitted,
        well_spaced=plan.is_well_spaced and settings.paths == "caustic",
        ledger=ledger,
        seed=plan.seed,
        sampler=plan.sampler,
        paths=settings.paths,
        sensor_ids=context.scene.sensors if context.sensors else None,
        extended_ids=plan.extended_ids,
        n_wavelengths=N_WAVELENGTHS if context.materials.has_dispersion else None,
        emitted_ranges=None if is_whole else [(traced.start, traced.stop)],
        scene_digest=light_digest(context.scene),
    )
    if is_whole and not len(photons):
        raise NothingStoredError(_nothing_stored(context, ledger, ledgers), photons)
    return photons


def _ledger(plan: EmissionPlan, emitted: Floats, ledgers: list[BatchLedger]) -> EnergyLedger:
    """The outcomes of all batches, which are in the order of their regions, by emitter."""
    shape = len(emitted), len(PATH_OUTCOMES)
    totals, ends = np.zeros((*shape, 3)), np.zeros(shape, dtype=np.int64)
    block_region = np.concatenate([batch.region_id for batch in ledgers])
    region_id, first = np.unique(block_region, return_index=True)
    energy = _region_sums(np.concatenate([batch.energy for batch in ledgers]), first)
    flux = plan.flux_per_photon[region_id][:, np.newaxis]
    np.add.at(totals, plan.emitter_ids[region_id], energy * flux)
    of_blocks = np.concatenate([batch.ends for batch in ledgers])
    np.add.at(ends, plan.emitter_ids[block_region], of_blocks)
    return EnergyLedger(
        emitted=emitted,
        **dict(zip(PATH_OUTCOMES, totals.swapaxes(0, 1), strict=True)),
        ends=dict(zip(PATH_OUTCOMES, ends.T, strict=True)),
    )


def _region_sums(energy: Floats, first: NDArray[np.intp]) -> Floats:
    """Sums (regions, outcomes, 3) of blocks, exactly rounded, given the first of each region."""
    sums = energy[first]
    counts = np.diff(first, append=len(energy))
    # Most regions of many emitters have one block.
    for i in np.flatnonzero(counts > 1).tolist():
        columns = energy[first[i] : first[i] + counts[i]].reshape(counts[i], -1).T
        sums[i] = np.reshape([fsum(column) for column in columns], sums[i].shape)
    return sums


def _nothing_stored(context: TraceContext, ledger: EnergyLedger, ledgers: list[BatchLedger]) -> str:
    ends = {outcome: int(ledger.ends[outcome].sum()) for outcome in PATH_OUTCOMES}
    met, settings = sum(batch.n_met_specular for batch in ledgers), context.settings
    return (
        f'no photons were stored for paths="{settings.paths}": of {sum(ends.values())} paths, '
        f"{met} met a specular object first, {ends['escaped']} escaped from the scene, "
        f"{ends['absorbed']} were absorbed, {ends['discarded']} ended on diffuse objects as light "
        f"of another kind, {ends['cut']} were cut after max_bounces={settings.max_bounces}. "
        f"{_remedy(context, ends, met)}"
    )


def _remedy(context: TraceContext, ends: dict[str, int], met: int) -> str:
    """The likely cause, and what would do."""
    if context.settings.paths == "caustic":
        if met == 0 and ends["absorbed"] < max(ends.values()):
            return _BLOCKED if _is_aimed_at_specular(context) else _MISSED
        # Direct light says nothing of what became of light from the specular objects.
        ends = {**ends, "discarded": 0}
    return _REMEDIES[max(_REMEDIES, key=lambda outcome: ends[outcome])]


def _is_aimed_at_specular(context: TraceContext) -> bool:
    """True if photons would meet a specular object if there were no diffuse ones."""
    is_diffuse, caster = context.materials.diffuse, context.caster
    for region_id, planned in enumerate(context.plan.counts.tolist()):
        rays = emit(context.plan, region_id, range(min(planned, _N_PROBES)), n_threads=1)
        direction, found = rays.direction, caster.intersect(rays.origin, rays.direction)
        while found.hit.any():
            direction, found = direction[found.hit], found[found.hit]
            if not is_diffuse[found.object_id].all():
                return True
            found = caster.intersect(found.position, direction, origin_offset=found.offset)
    return False


_BLOCKED = (
    "Diffuse objects stand between the emitters and the specular ones: move them out of "
    "the light, or raise n_emitted if it passes through small gaps"
)
_MISSED = (
    "The light misses the specular objects, which are small within their bounding spheres: "
    "raise n_emitted"
)
# By what became of most paths; the first of equal ones.
_REMEDIES = {
    "cut": "Most were cut: raise max_bounces",
    "escaped": "Most light leaves the scene: place a Diffuse object or a Sensor where it falls",
    "absorbed": (
        "Most were absorbed: raise the reflectance of the materials or lower their absorption, "
        "or raise n_emitted"
    ),
    "discarded": (
        'Light of that kind is missing: trace paths="all" for direct light too, or raise n_emitted'
    ),
}
