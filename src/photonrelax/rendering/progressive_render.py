"""Progressive photon mapping: pass after pass of new photons, interrupted and resumed at any time.

Passes are of caustics. Indirect light is estimated from one map of its own for the whole run, so
that its blur is that of `render`; in passes it would be that of their few photons.

PPM (Hachisuka, Ogaki & Jensen 2008) with fixed hit points, or SPPM (Hachisuka & Jensen 2009), which
jitters them in their pixel in every pass. The photons and the jitter of a pass follow from the seed
and the number of the pass, so that a resumed run has the bits of an uninterrupted one.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import count, takewhile
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._util import validation
from .._util.files import check_writable, file_lock
from .._util.frozen import set_field
from .._util.npz import check_names, scalar
from .._util.progress import Progress
from .._util.validation import check_seed
from .._util.workers import Workers, checked_executor
from .._version import __version__
from ..estimation.indirect import IndirectField
from ..estimation.methods import PASSES_METHOD
from ..estimation.nearest import GatherSettings
from ..estimation.progressive import ProgressiveSettings
from ..imaging.image import Image
from ..photons.photon_map import NothingStoredError
from ..scene.digest import scene_digests
from ..scene.scene import Scene
from ..transport.emission import MAX_PHOTONS
from ..transport.trace import check_photons_fit, trace_photons
from .checkpoint import Checkpoint, unreadable
from .layers import with_radiance
from .metadata import metadata
from .pass_statistics import (
    FixedHitPoints,
    PassHitPoints,
    PassSettings,
    PassState,
    StochasticHitPoints,
)
from .passes import PassFindings, PassGatherer, PassPhotons, PassTracer
from .plan import plan
from .view import View

# Passes whose photons are as many as those of indirect light by default, at most.
_PASSES_OF_GLOBAL = 10


@dataclass(frozen=True)
class Checkpoints:
    """Files and images of a run, written at intervals.

    Attributes
    ----------
    state : path, optional
        File that the run is saved to, and resumed from if it exists. It is replaced as a whole,
        whatever ends the run.
    interval : float
        Seconds from one checkpoint to the next; the last pass and Ctrl-C make one as well.
    on_image : callable, optional
        Called as ``on_image(image)`` with the image so far.
    """

    state: str | os.PathLike[str] | None = None
    interval: float = 60.0
    on_image: Callable[[Image], None] | None = None

    def __post_init__(self) -> None:
        interval = validation.positive(self.interval, "Checkpoints.interval", allow_inf=True)
        set_field(self, "interval", interval)


def render_progressive(
    scene: Scene,
    *,
    n_passes: int | None = None,
    seconds: float | None = None,
    photons_per_pass: int = 100_000,
    seed: int = 0,
    settings: ProgressiveSettings | None = None,
    supersampling: int = 2,
    stochastic: bool = False,
    max_depth: int = 8,
    light_samples: int | None = None,
    n_global: int | None = None,
    indirect: GatherSettings | None = None,
    checkpoints: Checkpoints | None = None,
    n_threads: int | None = None,
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Image:
    """Render the view of a scene's camera by passes of photons; errors of caustics tend to zero.

    Parameters
    ----------
    scene : Scene
        With a camera.
    n_passes, seconds : int, float, optional
        One at least: passes, those resumed from included; time, after which no pass is begun.
    photons_per_pass, seed, settings : int, int, ProgressiveSettings
        Photons of a pass, whose seed is `pass_seed`; initial radius and radius reduction.
    supersampling, stochastic : int, bool
        s·s samples a pixel, with means over their footprints. Or samples jitter in their pixel
        from pass to pass: memory is that of pixels, edges become smooth, one sample suffices.
    max_depth, light_samples, n_global, indirect : int, int, int, GatherSettings, optional
        As of `render`. Photons of indirect light are by default no more than ten passes emit.
    checkpoints : Checkpoints, optional
        File to save the run to and to resume it from; use of the image so far.
    n_threads, progress, executor : int, callable, concurrent.futures.Executor, optional
        Threads, by default all; called as ``progress("passes" or "seconds", done, total)``; makes
        passes, with global radii, or else their photons in its workers: see docs/scaling.md.

    Returns
    -------
    Image
        Layers as of `render`, but for the means over photons.

    Raises
    ------
    TypeError, ValueError, BlockingIOError, MemoryError
        If an argument is invalid, no pass stores a photon, the file is damaged, of another run or
        in use, or memory surely does not suffice. The run is saved first, as on Ctrl-C.
    """
    stop, saved = _StopCondition.from_arguments(n_passes, seconds), checkpoints or Checkpoints()
    limits: dict[str, Any] = {"supersampling": supersampling, "max_depth": max_depth}
    workers = Workers(checked_executor(executor), n_threads or 1)
    view = View(scene, **limits, light_samples=light_samples, seed=seed, n_threads=n_threads)
    of_passes = _pass_settings(view, settings, photons_per_pass, seed, stochastic)
    check_photons_fit(scene, of_passes.photons_per_pass, view.caster)
    with _locked(saved.state):
        run = _Run(view, _with_indirect(view, of_passes, n_global, indirect), workers)
        return _run_to_end(run, stop, saved, progress)


def _pass_settings(
    view: View,
    settings: ProgressiveSettings | None,
    photons_per_pass: int,
    seed: int,
    stochastic: bool,
) -> PassSettings:
    settings_of_view: dict[str, Any] = view.settings
    return PassSettings(
        settings=_checked_settings(settings),
        photons_per_pass=validation.count(photons_per_pass, "photons_per_pass", high=MAX_PHOTONS),
        seed=check_seed(seed),
        stochastic=bool(stochastic),
        **settings_of_view,
    )


def _with_indirect(
    view: View, settings: PassSettings, n_global: int | None, indirect: GatherSettings | None
) -> PassSettings:
    """Settings with the photons of indirect light, as planned."""
    planned = plan(
        view.scene,
        n_emitted=min(_PASSES_OF_GLOBAL * settings.photons_per_pass, MAX_PHOTONS),
        n_global=n_global,
        components=("indirect",),
        caster=view.caster,
        n_threads=view.n_threads,
    )
    return replace(settings, n_global=planned.n_global, indirect=indirect)


def _checked_settings(settings: ProgressiveSettings | None) -> ProgressiveSettings:
    if settings is not None and not isinstance(settings, ProgressiveSettings):
        raise TypeError(f"settings should be ProgressiveSettings, but is {settings!r}")
    return settings or ProgressiveSettings()


@dataclass(frozen=True)
class _StopCondition:
    """Number of passes and seconds after which a run ends."""

    n_passes: float
    seconds: float

    @classmethod
    def from_arguments(cls, n_passes: int | None, seconds: float | None) -> _StopCondition:
        """The condition of arguments of `render_progressive`, one of which is needed."""
        if n_passes is None and seconds is None:
            raise ValueError("n_passes or seconds should be given: passes have no end of their own")
        return cls(
            np.inf
            if n_passes is None
            else validation.count(n_passes, "n_passes", high=validation.MAX_REPEATS),
            np.inf if seconds is None else validation.positive(seconds, "seconds"),
        )

    def report(self, progress: Progress | None, n_passes: int, seconds: float) -> None:
        if progress is None:
            return
        if self.n_passes < np.inf:
            progress("passes", n_passes, int(self.n_passes))
        else:
            total = int(np.ceil(self.seconds))
            progress("seconds", min(int(seconds), total), total)


def _run_to_end(
    run: _Run, stop: _StopCondition, checkpoints: Checkpoints, progress: Progress | None
) -> Image:
    """Image of a run that is resumed, and run to its end with checkpoints."""
    checkpointer = _Checkpointer(run, checkpoints)
    checkpointer.resume(stop)
    run.n_wanted = stop.n_passes
    _loop(run, stop, checkpointer, progress)
    run.check()
    return run.image()


@contextmanager
def _locked(state: str | os.PathLike[str] | None) -> Iterator[None]:
    """Keep other processes from the file of a run, before rays are traced: that is long."""
    if state is None:
        yield
        return
    check_writable(state)
    with file_lock(state):
        yield


def _loop(
    run: _Run, stop: _StopCondition, checkpointer: _Checkpointer, progress: Progress | None
) -> None:
    """Do passes until the run ends; save it at intervals, at the end, and on any error."""
    started = perf_counter()
    try:
        # At least one pass is done, however short the time.
        while run.n_passes < stop.n_passes and run.seconds < stop.seconds:
            run.advance()
            run.seconds = perf_counter() - started
            stop.report(progress, run.n_passes, run.seconds)
            checkpointer.save_at_intervals()
        checkpointer.save()
    except KeyboardInterrupt:
        checkpointer.save()
        raise
    except BaseException:
        checkpointer.save_state()
        raise
    finally:
        run.close()


class _Checkpointer:
    """Saves a run, and resumes it."""

    def __init__(self, run: _Run, checkpoints: Checkpoints) -> None:
        self._run = run
        self._on_image = checkpoints.on_image
        self._interval = checkpoints.interval
        self._saved_at = perf_counter()
        self._file: Checkpoint | None = None
        self._n_saved = 0
        if checkpoints.state is not None:
            self._file = Checkpoint(checkpoints.state, run.identity())

    def resume(self, stop: _StopCondition) -> None:
        """Restore the run from its file, if there is one."""
        arrays = None if self._file is None else self._file.load()
        if arrays is None or self._file is None:
            return
        try:
            self._run.restore(arrays)
        except (TypeError, ValueError) as error:
            raise unreadable(self._file.path, error) from None
        n_passes = self._run.n_passes
        if n_passes > stop.n_passes:
            raise ValueError(
                f"n_passes should be at least the {n_passes} that {self._file.path} holds "
                f"already, but is {stop.n_passes}"
            )
        self._n_saved = n_passes

    def save_at_intervals(self) -> None:
        """Save the run and hand on the image if the interval is over."""
        if perf_counter() - self._saved_at >= self._interval:
            self.save()
            self._saved_at = perf_counter()

    def save(self) -> None:
        """Save the run and hand on the image."""
        self.save_state()
        if self._on_image is not None and self._run.n_passes > 0:
            self._on_image(self._run.image())

    def save_state(self) -> None:
        """Save the run if it has new passes."""
        run = self._run
        if self._file is not None and run.n_passes > self._n_saved:
            self._file.save(run.arrays())
            self._n_saved = run.n_passes


def _indirect_field(view: View, settings: PassSettings) -> IndirectField:
    """Estimates of indirect light for the whole run."""
    try:
        photons = trace_photons(
            view.scene,
            settings.n_global,
            seed=settings.seed,
            paths="global",
            n_threads=view.n_threads,
            caster=view.caster,
            sensors=False,
        )
    except NothingStoredError as nothing:
        photons = nothing.photons
    return IndirectField(photons, settings.indirect, scene=view.scene, n_threads=view.n_threads)


@dataclass(frozen=True)
class _Completed:
    """Completed passes and their state; replaced by one assignment, so that it is consistent."""

    n_passes: int = 0
    n_stored: int = 0
    state: PassState = field(default_factory=PassState)


class _Run:
    """A progressive render, pass by pass."""

    def __init__(self, view: View, settings: PassSettings, workers: Workers) -> None:
        self.seconds = 0.0
        self.n_wanted = np.inf
        self._workers = workers
        self._ahead: Generator[PassPhotons | PassFindings] | None = None
        self._completed = _Completed()
        self._view = view
        self._settings = settings
        kind = StochasticHitPoints if settings.stochastic else FixedHitPoints
        started = perf_counter()
        self._indirect = _indirect_field(view, settings) if settings.n_global else None
        self._seconds_of_indirect = perf_counter() - started
        self._hit_points: PassHitPoints = kind(view, settings, self._indirect)
        self._nothing: str | None = None

    @property
    def n_passes(self) -> int:
        return self._completed.n_passes

    def identity(self) -> dict[str, Any]:
        """Parameters that a run must share to be resumed."""
        scene = self._view.scene
        identity = {
            "version": __version__,
            "scene": scene.name,
            **scene_digests(scene),
            # Runs without indirect light are resumed without.
            "n_global": None,
            "indirect": None,
            **self._settings.to_dict(),
        }
        if not self._settings.stochastic:
            # Runs saved before had statistics of points.
            identity["estimates"] = "over footprints"
        return identity

    def advance(self) -> None:
        """Do the next pass."""
        done = self._completed
        found = self._found()
        self._nothing = found.nothing or self._nothing
        if isinstance(found, PassFindings):
            n_stored, statistics = found.n_stored, done.state.statistics
            state = self._hit_points.with_sums(done.state, statistics, found.sums)
        else:
            n_stored = len(found.photons)
            state = self._hit_points.after(done.state, found.photons, done.n_passes)
        self._completed = _Completed(done.n_passes + 1, done.n_stored + n_stored, state)

    def _found(self) -> PassPhotons | PassFindings:
        """Photons of the next pass, or what they add, from workers if there are any."""
        done, tracer = self._completed, self._tracer
        statistics = done.state.statistics
        if self._workers.executor is None:
            return tracer.trace(done.n_passes)
        if self._ahead is None:
            numbers = takewhile(lambda number: number < self.n_wanted, count(done.n_passes))
            if not self._settings.settings.is_global:
                self._ahead = self._workers.map(PassTracer.trace_lean, tracer, numbers)
            elif statistics is None:
                # Initial radii follow from the photons of the first pass that stores any.
                return tracer.trace(done.n_passes)
            else:
                gatherer = PassGatherer(tracer, self._hit_points, statistics)
                self._ahead = self._workers.map(PassGatherer.gather, gatherer, numbers)
        return next(self._ahead)

    @property
    def _tracer(self) -> PassTracer:
        return PassTracer(self._view, self._settings.photons_per_pass, self._settings.seed)

    def close(self) -> None:
        """Cancel passes that workers are making."""
        if self._ahead is not None:
            self._ahead.close()

    def check(self) -> None:
        """Raise ValueError if no pass has stored anything."""
        if self._completed.n_stored == 0:
            last = "" if self._nothing is None else f"; of the last: {self._nothing}"
            raise ValueError(f"no photon was stored in {self.n_passes} passes{last}")

    def arrays(self) -> dict[str, Any]:
        """The completed passes as arrays for a checkpoint."""
        done = self._completed
        return {"n_passes": done.n_passes, "n_stored": done.n_stored, **done.state.arrays()}

    def restore(self, arrays: dict[str, NDArray]) -> None:
        """Continue after the passes saved as `arrays`; raises ValueError if they are none."""
        check_names(arrays, ["n_passes", "n_stored"])
        n_passes = scalar(arrays, "n_passes", "iu")
        validation.count(n_passes, "n_passes", high=validation.MAX_REPEATS)
        n_stored = validation.count(scalar(arrays, "n_stored", "iu"), "n_stored", low=0)
        state = self._hit_points.restored(arrays, n_passes)
        if (n_stored == 0) != (state.statistics is None):
            raise ValueError(f"it has statistics of photons, or none, but n_stored is {n_stored}")
        self._completed = _Completed(n_passes, n_stored, state)

    def image(self) -> Image:
        """Image so far, the same however often the run was resumed."""
        done, settings = self._completed, self._settings
        layers = self._hit_points.layers(done.state, done.n_passes)
        about = metadata(
            photons_emitted=done.n_passes * settings.photons_per_pass,
            photons_stored=done.n_stored,
            seed=settings.seed,
            scene=self._view.scene.name,
            method=PASSES_METHOD,
            settings={**settings.to_dict(), "n_passes": done.n_passes},
        )
        stages: dict[str, dict[str, Any]] = {}
        if self._indirect is not None:
            stages["indirect"] = {
                "seconds": self._seconds_of_indirect,
                "emitted": settings.n_global,
            }
        stages["passes"] = {
            "seconds": self.seconds,
            "passes": done.n_passes,
            "stored": done.n_stored,
        }
        stats = {"stages": stages, "seconds": sum(stage["seconds"] for stage in stages.values())}
        return Image(with_radiance(layers), about, stats)
