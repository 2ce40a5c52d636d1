"""Tracing: follows paths through the scene and deposits photons on diffuse surfaces.

Paths are traced in batches, a thread each: embree finds what all rays of a batch hit, then one
compiled pass takes every path through its surface and writes the rays that embree is given next.
Photons, their order and the ledger are the same, to the bit, for any number of threads and any
size of batch.

Reflection and refraction at dielectrics are chosen at random with the Fresnel reflectance; mirrors
and absorbing media, and diffuse surfaces where paths go on, end paths by Russian roulette on the
luminance. So all photons of an emitter carry the same luminance, and the same flux unless the path
was coloured. Emitters are taken to be outside of dielectrics unless the first thing met is one from
behind: light is not absorbed between an emitter in glass and another object in the same glass.

A stored photon takes 148 bytes where all emitters are collimated, else 156, 24 more where some
carry spectra, each of which takes a fifth of a millisecond, as its neighbours are traced as well
(see `photonrelax.estimation.frequency`); a path of the batches under way takes a few hundred.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from math import fsum

import numpy as np
from numpy.typing import NDArray

from .._ext.transport import trace as _kernel
from .._ext.transport.deposits import Columns, Deposits
from .._ext.transport.materials import Materials
from .._util.parallel import thread_count
from .._util.progress import Progress, Reporter
from .._util.validation import Floats, check_choice, check_seed, count, float_array
from ..photons.energy_ledger import PATH_OUTCOMES, EnergyLedger
from ..photons.photon_map import NothingStoredError, PhotonMap
from ..scene.scene import Scene
from .emission import LUMINANCE, PATHS, SAMPLERS, EmissionPlan, emission, plan_emission
from .frequency.spectra import ReplayBatch, SpectrumTracer, batches_by_emitter
from .raycast import RayCaster

# Far beyond any path that matters; a mirrored room would keep its light for ever.
MAX_BOUNCES = 10_000
# Room a growing map makes, of what its paths so far let expect; memory not used is not taken.
_MARGIN = 1.05

Job = tuple[int, range]
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
    n_emitted: int,
    *,
    seed: int = 0,
    paths: str = "caustic",
    sampler: str = "halton",
    max_bounces: int = 32,
    frequency_share: float = 0.0,
    n_threads: int | None = None,
    progress: Progress | None = None,
    batch_size: int = 16384,
    caster: RayCaster | None = None,
) -> PhotonMap:
    """Emit photons, follow their paths and store them where they land.

    Photon i of an emitter depends on `seed` and i alone. How its path goes on at surfaces, and the
    memory it takes, is said in `photonrelax.transport.trace`.

    Parameters
    ----------
    scene : Scene
        Objects and emitters.
    n_emitted, seed : int
        Paths to start, shared among the emitters in proportion to the flux they send out; what
        shifts the Halton sequence and chooses the random numbers.
    paths : {"caustic", "global", "all"}
        Which light to store: that met specular surfaces only (L S+ D), neither that nor direct
        light, or all that arrives on diffuse surfaces.
    sampler : {"halton", "random"}
        Evenly spaced photons (SJ13) or independent ones.
    max_bounces : int
        Events (specular or diffuse) after which a path is cut; at most 10,000.
    frequency_share : float
        Share of the photons, in [0, 1], that get a spectrum: those, chosen by their indices, that
        no diffuse surface has scattered yet.
    n_threads, progress : int, callable, optional
        Threads, by default all; called as ``progress("trace", done, n_emitted)`` now and then.
    batch_size : int
        Paths traced together, rounded up to a multiple of 1024.
    caster : RayCaster, optional
        Of the scene's objects, if it is made already: making it takes time.

    Returns
    -------
    PhotonMap
        In the order of emitters, indices and events; well spaced for caustics from Halton photons.

    Raises
    ------
    TypeError, ValueError
        If an argument is invalid, or if nothing is stored: the message says why.
    """
    how = _checked(seed, paths, sampler, max_bounces, frequency_share)
    plan = plan_emission(scene, n_emitted, paths)
    most = min(count(batch_size, "batch_size"), int(plan.counts.max()))
    size = -(-most // _kernel.LEDGER_BLOCK) * _kernel.LEDGER_BLOCK
    tracer = _Tracer(scene, caster or RayCaster(scene.objects), plan, how, size=size)
    return _traced(tracer, thread_count(n_threads), progress)


def _traced(tracer: _Tracer, n_threads: int, progress: Progress | None) -> PhotonMap:
    """Trace all batches; return what they stored."""
    plan, how = tracer.plan, tracer.how
    report = Reporter(progress, "trace", int(plan.counts.sum()))
    columns, accounts, chosen = _Columns(plan), [], []
    for batch in _in_order(tracer.trace, _jobs(plan, tracer.size), n_threads):
        first = len(columns)
        columns.append(batch.paths.deposits, batch.account)
        if how.frequency_share:
            chosen.append(tracer.chosen(batch, first))
        tracer.put_away(batch.paths)
        accounts.append(batch.account)
        report.advance(batch.account.n_paths)
    photons = _photon_map(plan, how, columns, accounts)
    if not how.frequency_share:
        return photons
    return photons.replace(spectrum=tracer.spectra(chosen, len(photons), n_threads, progress))


@dataclass(frozen=True)
class _How:
    """The settings of `trace_photons` that its photons depend on."""

    seed: int
    paths: str
    sampler: str
    max_bounces: int
    frequency_share: float


def _checked(seed: int, paths: str, sampler: str, max_bounces: int, share: float) -> _How:
    check_choice(paths, "paths", PATHS)
    check_choice(sampler, "sampler", SAMPLERS)
    max_bounces = count(max_bounces, "max_bounces", high=MAX_BOUNCES)
    share = float(float_array(share, "frequency_share", (), finite=False))
    if not 0.0 <= share <= 1.0:
        raise ValueError(f"frequency_share should lie in [0, 1], but is {share}")
    if share and paths == "global":
        raise ValueError(
            'frequency_share should be 0 for paths="global": '
            "photons that a diffuse surface scattered have no spectra"
        )
    return _How(check_seed(seed), paths, sampler, max_bounces, share)


@dataclass(frozen=True, eq=False)
class _Account:
    """What became of some paths of one emitter.

    `energy` (blocks, fates, 3) is relative to the flux of a photon; `ends` (fates,) counts paths.
    """

    emitter_id: int
    n_paths: int
    energy: Floats
    ends: NDArray[np.int64]
    n_met_specular: int


@dataclass(frozen=True, eq=False)
class _Batch:
    """Paths at their ends: what they deposited is in `paths` until these are put away."""

    paths: _kernel.Paths
    account: _Account
    first: int


class _Tracer:
    """A scene made ready to trace batches of up to `size` paths, from several threads at once."""

    def __init__(
        self, scene: Scene, caster: RayCaster, plan: EmissionPlan, how: _How, *, size: int
    ) -> None:
        materials = Materials(scene.material_table())
        if not materials.diffuse.any():
            raise ValueError(
                "scene should have a Diffuse object to store photons on, "
                f"but none of its {len(scene.objects)} objects is"
            )
        self.size = size
        self._scene, self.plan = scene, plan
        self._materials = materials
        self._caster = caster
        self.how = how
        self._flux = plan.flux_per_photon
        self._emissions = [
            emission(plan, e, seed=how.seed, sampler=how.sampler) for e in range(len(plan.regions))
        ]
        self._put_away: list[_kernel.Paths] = []

    def trace(self, job: Job) -> _Batch:
        """Follow some photons of one emitter to their ends."""
        emitter_id, photons = job
        energy = np.zeros((-(-len(photons) // _kernel.LEDGER_BLOCK), len(PATH_OUTCOMES), 3))
        ends = np.zeros(len(PATH_OUTCOMES), dtype=np.int64)
        paths = self._paths()
        paths.start(
            self._emissions[emitter_id],
            np.arange(photons.start, photons.stop, dtype=np.int64),
            luminance=LUMINANCE * self._flux[emitter_id],
            ledger=energy,
            ends=ends,
        )
        while paths.n_live:
            paths.advance(self._caster.find(*paths.rays))
        account = _Account(emitter_id, len(photons), energy, ends, paths.n_met_specular)
        return _Batch(paths, account, photons.start)

    def chosen(self, batch: _Batch, first_row: int) -> ReplayBatch:
        """Return which photons of a batch, written from a row on, are to get spectra."""
        emitter_id, n = batch.account.emitter_id, batch.account.n_paths
        drawn = np.empty(n, dtype=np.uint8)
        self._emissions[emitter_id].spectrum_photons(batch.first, drawn, self.how.frequency_share)
        ends = batch.paths.deposits.ends()
        starts = np.concatenate([[0], ends[:-1]])
        path = np.flatnonzero((drawn > 0) & (ends > starts))
        return ReplayBatch(emitter_id, batch.first + path, first_row + starts[path])

    def spectra(
        self, chosen: list[ReplayBatch], n_stored: int, n_threads: int, progress: Progress | None
    ) -> Floats:
        """Return the column of spectra, NaN for photons not among the chosen."""
        tracer = SpectrumTracer(
            self._scene,
            self.plan,
            self._caster,
            seed=self.how.seed,
            sampler=self.how.sampler,
            max_bounces=self.how.max_bounces,
            n_threads=n_threads,
        )
        out = np.full((n_stored, 3), np.nan)
        report = Reporter(progress, "spectra", sum(len(some.rows) for some in chosen))
        for some in batches_by_emitter(chosen):
            out[some.rows] = tracer.spectra(some)
            report.advance(len(some.rows))
        return out

    def put_away(self, paths: _kernel.Paths) -> None:
        """Take paths back for another batch: memory just used is in the cache."""
        self._put_away.append(paths)

    def _paths(self) -> _kernel.Paths:
        try:
            return self._put_away.pop()
        except IndexError:
            return _kernel.Paths(
                self._materials,
                self._caster.frame,
                self._caster.triangles,
                self.size,
                path_filter=PATHS.index(self.how.paths),
                max_bounces=self.how.max_bounces,
            )


class _Columns:
    """The columns of a photon map that grows batch by batch, in place."""

    def __init__(self, plan: EmissionPlan) -> None:
        emitting = (region for region, n in zip(plan.regions, plan.counts, strict=True) if n)
        coords_width = 2 if all(region.is_plane for region in emitting) else 3
        self._widths = _WIDTHS | {"emitter_coords": coords_width}
        self._arrays = self._empty(0)
        self._flux = plan.flux_per_photon
        self._n_planned = int(plan.counts.sum())
        self._n_traced = 0
        self._n_stored = 0

    def __len__(self) -> int:
        return self._n_stored

    def append(self, deposits: Deposits, account: _Account) -> None:
        """Write what a batch deposited behind what is there."""
        first, self._n_stored = self._n_stored, self._n_stored + len(deposits)
        self._n_traced += account.n_paths
        if self._n_stored > len(self._arrays["position"]):
            self._resize(int(_MARGIN * self._n_stored * self._n_planned / self._n_traced) + 1)
        flux = self._flux[account.emitter_id]
        deposits.write(Columns(**self._arrays), first, flux, account.emitter_id)

    def finished(self) -> dict[str, NDArray]:
        """Return the columns, ready to be frozen without a copy."""
        self._resize(self._n_stored)
        for array in self._arrays.values():
            array.setflags(write=False)
        return self._arrays

    def _resize(self, n: int) -> None:
        if len(self._arrays["position"]) == 0:
            self._arrays = self._empty(n)
            return
        # In place, where columns joined from parts would need their memory twice.
        for array in self._arrays.values():
            array.resize((n, *array.shape[1:]), refcheck=False)

    def _empty(self, n: int) -> dict[str, NDArray]:
        widths = self._widths
        shapes = {name: (n, widths[name]) if name in widths else (n,) for name in _DTYPES}
        return {name: np.empty(shapes[name], dtype) for name, dtype in _DTYPES.items()}


def _jobs(plan: EmissionPlan, size: int) -> Iterator[Job]:
    for emitter_id, planned in enumerate(plan.counts.tolist()):
        for start in range(0, planned, size):
            yield emitter_id, range(start, min(start + size, planned))


def _in_order(
    work: Callable[[Job], _Batch], jobs: Iterable[Job], n_threads: int
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


def _photon_map(
    plan: EmissionPlan, how: _How, columns: _Columns, accounts: list[_Account]
) -> PhotonMap:
    ledger = _ledger(plan, accounts)
    photons = PhotonMap(
        **columns.finished(),
        n_emitted=int(plan.counts.sum()),
        well_spaced=how.sampler == "halton" and how.paths == "caustic",
        ledger=ledger,
        seed=how.seed,
        sampler=how.sampler,
        paths=how.paths,
    )
    if not len(photons):
        raise NothingStoredError(_nothing_stored(ledger, accounts, how), photons)
    return photons


def _ledger(plan: EmissionPlan, accounts: list[_Account]) -> EnergyLedger:
    n_emitters, flux = len(plan.regions), plan.flux_per_photon
    totals = np.zeros((len(PATH_OUTCOMES), n_emitters, 3))
    ends = np.zeros((len(PATH_OUTCOMES), n_emitters), dtype=np.int64)
    for e in range(n_emitters):
        mine = [account for account in accounts if account.emitter_id == e]
        if mine:
            blocks = np.concatenate([account.energy for account in mine])
            blocks = blocks.reshape(-1, len(PATH_OUTCOMES) * 3)
            totals[:, e] = np.reshape(
                [fsum(column) for column in blocks.T], (len(PATH_OUTCOMES), 3)
            )
            ends[:, e] = np.sum([account.ends for account in mine], axis=0)
    return EnergyLedger(
        emitted=plan.counts[:, np.newaxis] * flux,
        **dict(zip(PATH_OUTCOMES, totals * flux, strict=True)),
        ends=dict(zip(PATH_OUTCOMES, ends, strict=True)),
    )


def _nothing_stored(ledger: EnergyLedger, accounts: list[_Account], how: _How) -> str:
    ends = {fate: int(ledger.ends[fate].sum()) for fate in PATH_OUTCOMES}
    met = sum(account.n_met_specular for account in accounts)
    return (
        f'no photons were stored for paths="{how.paths}": of {sum(ends.values())} paths, '
        f"{met} met a specular object first, {ends['escaped']} escaped from the scene, "
        f"{ends['absorbed']} were absorbed, {ends['discarded']} ended on diffuse objects as light "
        f"of another kind, {ends['cut']} were cut after max_bounces={how.max_bounces}"
    )
