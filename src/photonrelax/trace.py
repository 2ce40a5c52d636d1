"""Tracing: follows paths through the scene and deposits photons on diffuse surfaces.

Paths are traced in batches, a thread each: embree finds what all rays of a batch hit, then one
compiled pass takes every path through its surface. Photons, their order and the ledger are the
same, to the bit, for any number of threads and any size of batch.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from math import fsum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._arrays import Floats, count, thread_count
from ._ext import trace as _kernel
from ._progress import Progress, Reporter
from .emit import LUMINANCE, PATHS, SAMPLERS, EmissionPlan, check_choice, emit, plan_emission
from .photonmap import FATES, EnergyLedger, PhotonMap
from .raycast import RayCaster
from .sampling import check_seed
from .scene import DIFFUSE, Scene

# Far beyond any path that matters; a mirrored room would keep its light for ever.
MAX_BOUNCES = 10_000
# Photons whose energy is summed up together. Batches hold whole blocks, so the sums, like all
# else, do not depend on the batches.
_BLOCK = 1024


def trace_photons(
    scene: Scene,
    n_emitted: int,
    *,
    seed: int = 0,
    paths: str = "caustic",
    sampler: str = "halton",
    max_bounces: int = 32,
    n_threads: int | None = None,
    progress: Progress | None = None,
    batch_size: int = 65536,
) -> PhotonMap:
    """Emit photons, follow their paths and store them where they land.

    Reflection and refraction at dielectrics are chosen at random with the Fresnel reflectance;
    mirrors and absorbing media, and diffuse surfaces where paths go on, end paths by Russian
    roulette on the luminance. So all photons of an emitter carry the same luminance, and the same
    flux unless the path was coloured. Photon i of an emitter depends on `seed` and i alone.
    Emitters are taken to be outside of dielectrics unless the first thing met is one from behind:
    light is not absorbed between an emitter in glass and another object in the same glass.

    Parameters
    ----------
    scene : Scene
        Objects and emitters.
    n_emitted : int
        Paths to start, shared among the emitters in proportion to the flux they send out.
    seed : int
        Shifts the Halton sequence and chooses the random numbers.
    paths : {"caustic", "global", "all"}
        Which light to store: that met specular surfaces only (L S+ D), neither that nor direct
        light, or all that arrives on diffuse surfaces.
    sampler : {"halton", "random"}
        Evenly spaced photons (SJ13) or independent ones.
    max_bounces : int
        Events (specular or diffuse) after which a path is cut; at most 10,000.
    n_threads : int, optional
        Threads to use; None for all cores.
    progress : callable, optional
        Called as ``progress("trace", done, n_emitted)`` now and then.
    batch_size : int
        Paths traced together, rounded up to a multiple of 1024.

    Returns
    -------
    PhotonMap
        In the order of emitters, indices and events; well spaced for caustics from Halton photons.

    Raises
    ------
    TypeError, ValueError
        If an argument is invalid, or if nothing is stored: the message says why.
    """
    how = _checked(seed, paths, sampler, max_bounces)
    plan = plan_emission(scene, n_emitted, paths)
    jobs = _jobs(plan, -(-count(batch_size, "batch_size") // _BLOCK) * _BLOCK)
    report = Reporter(progress, "trace", int(plan.counts.sum()))
    batches = _run(_Tracer(scene, plan, how), jobs, report, thread_count(n_threads))
    return _photon_map(plan, how, batches)


@dataclass(frozen=True)
class _How:
    """The settings of `trace_photons` that its photons depend on."""

    seed: int
    paths: str
    sampler: str
    max_bounces: int


def _checked(seed: int, paths: str, sampler: str, max_bounces: int) -> _How:
    check_choice(paths, "paths", PATHS)
    check_choice(sampler, "sampler", SAMPLERS)
    max_bounces = count(max_bounces, "max_bounces", high=MAX_BOUNCES)
    return _How(check_seed(seed), paths, sampler, max_bounces)


@dataclass(frozen=True, eq=False)
class _Batch:
    """What became of some paths of one emitter.

    `photons` are columns of a PhotonMap; `energy` (blocks, fates, 3) is relative to the flux of a
    photon; `ends` (fates,) counts paths.
    """

    emitter_id: int
    n_paths: int
    photons: dict[str, NDArray]
    energy: Floats
    ends: NDArray[np.int64]
    n_met_specular: int

    def __len__(self) -> int:
        return len(self.photons["position"])


class _Tracer:
    """A scene made ready to trace batches of paths, from several threads at once."""

    def __init__(self, scene: Scene, plan: EmissionPlan, how: _How) -> None:
        table = scene.material_table()
        if not (table.kind == DIFFUSE).any():
            raise ValueError(
                "scene should have a Diffuse object to store photons on, "
                f"but none of its {len(scene.objects)} objects is"
            )
        self._surfaces = _kernel.Surfaces(
            table.kind, table.reflectance, table.ior, table.exterior_ior, table.absorption
        )
        self._caster = RayCaster(scene.objects)
        self._plan = plan
        self._how = how
        emitting = (aim for aim, n in zip(plan.aims, plan.counts, strict=True) if n)
        self._coords_width = 2 if all(aim.is_plane for aim in emitting) else 3

    def trace(self, job: tuple[int, range]) -> _Batch:
        """Follow some photons of one emitter to their ends."""
        emitter_id, photons = job
        seed, sampler = self._how.seed, self._how.sampler
        primal = emit(self._plan, emitter_id, photons, seed=seed, sampler=sampler, n_threads=1)
        n, flux = len(photons), self._plan.flux_per_photon[emitter_id]
        rays = (primal.origin, primal.direction, np.empty((n, 3)))
        energy = np.zeros((-(-n // _BLOCK), len(FATES), 3))
        ends = np.zeros(len(FATES), dtype=np.int64)
        paths = _kernel.Paths(
            self._surfaces,
            *rays,
            **_path_arrays(n),
            ledger=energy,
            ends=ends,
            luminance=LUMINANCE * flux,
            wanted=PATHS.index(self._how.paths),
            max_bounces=self._how.max_bounces,
            block=_BLOCK,
        )
        paths.start(seed, emitter_id, photons.start, primal.travelled)
        deposits = self._follow(paths, rays)
        path = deposits.pop("path")
        deposits["flux"] = deposits.pop("throughput") * flux
        deposits["emitter_coords"] = _padded(primal.emitter_coords, self._coords_width)[path]
        deposits["emitter_density"] = primal.emitter_density[path]
        deposits["emitter_id"] = np.full(len(path), emitter_id, dtype=np.int32)
        return _Batch(emitter_id, n, deposits, energy, ends, paths.n_met_specular)

    def _follow(self, paths: Any, rays: tuple[Floats, Floats, Floats]) -> dict[str, NDArray]:
        """Advance paths until none is live; return the deposits in the order of the paths."""
        passes = []
        while paths.n_live:
            origin, direction, leaving = (array[: paths.n_live] for array in rays)
            hits = self._caster.intersect(origin, direction, leaving=leaving)
            room = _deposit_arrays(paths.n_live)
            paths.advance(
                _kernel.Hits(
                    hits.object_id,
                    hits.distance,
                    hits.position,
                    hits.geometric_normal,
                    hits.shading_normal,
                ),
                _kernel.Deposits(**room),
            )
            passes.append({name: array[: paths.n_deposits] for name, array in room.items()})
        joined = {name: np.concatenate([p[name] for p in passes]) for name in passes[0]}
        order = np.argsort(joined["path"], kind="stable")
        return {name: array[order] for name, array in joined.items()}


def _path_arrays(n: int) -> dict[str, NDArray]:
    return {
        "path": np.empty(n, np.int32),
        "throughput": np.empty((n, 3)),
        "path_length": np.empty(n),
        "signature": np.empty(n, np.uint64),
        "key": np.empty(n, np.uint64),
        "n_specular": np.empty(n, np.int32),
        "n_diffuse": np.empty(n, np.int32),
        "medium": np.empty(n, np.int32),
    }


def _deposit_arrays(n: int) -> dict[str, NDArray]:
    return {
        "path": np.empty(n, np.int32),
        "position": np.empty((n, 3)),
        "normal": np.empty((n, 3)),
        "wi": np.empty((n, 3)),
        "throughput": np.empty((n, 3)),
        "path_length": np.empty(n),
        "path_signature": np.empty(n, np.int64),
        "n_bounces": np.empty(n, np.int32),
        "object_id": np.empty(n, np.int32),
    }


def _jobs(plan: EmissionPlan, size: int) -> Iterator[tuple[int, range]]:
    for emitter_id, planned in enumerate(plan.counts.tolist()):
        for start in range(0, planned, size):
            yield emitter_id, range(start, min(start + size, planned))


def _run(
    tracer: _Tracer, jobs: Iterable[tuple[int, range]], report: Reporter, n_threads: int
) -> list[_Batch]:
    batches = []
    for batch in _in_order(tracer.trace, jobs, n_threads):
        batches.append(batch)
        report.advance(batch.n_paths)
    return batches


def _in_order(
    work: Callable[[tuple[int, range]], _Batch], jobs: Iterable[tuple[int, range]], n_threads: int
) -> Iterator[_Batch]:
    """Yield what `work` makes of the jobs, in their order; few are under way at a time."""
    if n_threads == 1:
        yield from map(work, jobs)
        return
    pending: deque[Future[_Batch]] = deque()
    with ThreadPoolExecutor(n_threads) as pool:
        try:
            for job in jobs:
                pending.append(pool.submit(work, job))
                if len(pending) > 2 * n_threads:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            for future in pending:
                future.cancel()


def _padded(coords: Floats, width: int) -> Floats:
    return np.pad(coords, ((0, 0), (0, width - coords.shape[1])))


def _photon_map(plan: EmissionPlan, how: _How, batches: list[_Batch]) -> PhotonMap:
    ledger = _ledger(plan, batches)
    if not any(len(batch) for batch in batches):
        raise ValueError(_nothing_stored(ledger, batches, how))
    return PhotonMap(
        **_joined(batches),
        n_emitted=int(plan.counts.sum()),
        well_spaced=how.sampler == "halton" and how.paths == "caustic",
        ledger=ledger,
        seed=how.seed,
        sampler=how.sampler,
        paths=how.paths,
    )


def _joined(batches: list[_Batch]) -> dict[str, NDArray]:
    """Return the columns of all batches end to end, ready to be frozen without a copy."""
    columns = {}
    for name in list(batches[0].photons):
        columns[name] = np.concatenate([batch.photons.pop(name) for batch in batches])
        columns[name].setflags(write=False)
    return columns


def _ledger(plan: EmissionPlan, batches: list[_Batch]) -> EnergyLedger:
    n_emitters, flux = len(plan.aims), plan.flux_per_photon
    totals = np.zeros((len(FATES), n_emitters, 3))
    ends = np.zeros((len(FATES), n_emitters), dtype=np.int64)
    for e in range(n_emitters):
        mine = [batch for batch in batches if batch.emitter_id == e]
        if mine:
            blocks = np.concatenate([batch.energy for batch in mine]).reshape(-1, len(FATES) * 3)
            totals[:, e] = np.reshape([fsum(column) for column in blocks.T], (len(FATES), 3))
            ends[:, e] = np.sum([batch.ends for batch in mine], axis=0)
    return EnergyLedger(
        emitted=plan.counts[:, np.newaxis] * flux,
        **dict(zip(FATES, totals * flux, strict=True)),
        ends=dict(zip(FATES, ends, strict=True)),
    )


def _nothing_stored(ledger: EnergyLedger, batches: list[_Batch], how: _How) -> str:
    ends = {fate: int(ledger.ends[fate].sum()) for fate in FATES}
    met = sum(batch.n_met_specular for batch in batches)
    return (
        f'no photons were stored for paths="{how.paths}": of {sum(ends.values())} paths, '
        f"{met} met a specular object first, {ends['escaped']} escaped from the scene, "
        f"{ends['absorbed']} were absorbed, {ends['discarded']} ended on diffuse objects as light "
        f"of another kind, {ends['cut']} were cut after max_bounces={how.max_bounces}"
    )
