"""Pictures by progressive photon mapping: pass after pass of fresh photons, stopped at any time.

Hachisuka, Ogaki & Jensen 2008 with hit points kept, or with a new place in the pixel for each
pass, whose hit points then share what is kept of the pixel (Hachisuka & Jensen 2009). A pass is
known by its number: its photons and its place in the pixel follow from it and the seed, so a run
that is stopped and resumed is the run that was never stopped.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._util import validation
from .._util.files import check_writable, file_lock
from .._util.parallel import thread_count
from .._util.progress import Progress
from .._util.validation import check_seed
from .._version import __version__
from ..estimation.methods import PASSES_METHOD
from ..estimation.progressive import ProgressiveSettings
from ..imaging.image import Image
from ..photons.photon_map import NothingStoredError, PhotonMap
from ..scene.digest import scene_digests
from ..scene.scene import Scene
from ..transport.hit_points import MAX_DEPTH
from ..transport.trace import trace_photons
from .checkpoint import Checkpoint
from .metadata import header
from .pass_statistics import FixedPoints, Kept, MovingPoints, Points, Recipe, View


@dataclass(frozen=True)
class Checkpoints:
    """What a run leaves behind while it goes on.

    Attributes
    ----------
    state : path, optional
        File the run is kept in, and resumed from if it exists. It is replaced by a whole one or
        stays as it was, whatever ends the run.
    interval : float
        Seconds from one time to the next; after the last pass, and on Ctrl-C, it is done as well.
    on_image : callable, optional
        Called as ``on_image(image)`` with the picture so far.
    """

    state: str | os.PathLike[str] | None = None
    interval: float = 60.0
    on_image: Callable[[Image], None] | None = None

    def __post_init__(self) -> None:
        interval = validation.positive(self.interval, "Checkpoints.interval", allow_inf=True)
        object.__setattr__(self, "interval", interval)


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
    checkpoints: Checkpoints | None = None,
    n_threads: int | None = None,
    progress: Progress | None = None,
) -> Image:
    """Render what a scene's camera sees by passes of fresh photons, nearer to the truth with each.

    Parameters
    ----------
    scene : Scene
        With a camera.
    n_passes, seconds : int, float, optional
        When to stop: after so many passes in all, those resumed from included, or after the pass
        in which so many seconds of this call are over. At least one is needed.
    photons_per_pass, seed : int
        Photons emitted in each pass; each has a seed of its own, see `pass_seed`.
    settings : ProgressiveSettings, optional
        How discs start and shrink.
    supersampling, stochastic, max_depth : int, bool, int
        s·s samples a pixel; whether they move to another place in it in every pass: memory then
        goes with the pixels, edges become smooth as passes go on, and one sample a pixel will do;
        smooth surfaces a camera ray may meet.
    checkpoints : Checkpoints, optional
        File to keep the run in and to resume from; what is done with the picture so far.
    n_threads, progress : int, callable, optional
        Threads, by default all; called as ``progress("passes" or "seconds", done, total)``.

    Returns
    -------
    Image
        Layers ``radiance``, ``caustic``, ``direct``, ``albedo``, ``N`` and ``Z``, as of `render`.

    Raises
    ------
    TypeError, ValueError, BlockingIOError
        If an argument is invalid, nothing is ever stored, or the file is of another run or in use.
    KeyboardInterrupt
        On Ctrl-C, after the run was saved, as it is before any other error leaves.
    """
    end = _End.given(n_passes, seconds)
    recipe = Recipe(
        settings=_settings(settings),
        photons_per_pass=validation.count(photons_per_pass, "photons_per_pass"),
        seed=check_seed(seed),
        supersampling=validation.count(supersampling, "supersampling"),
        stochastic=bool(stochastic),
        max_depth=validation.count(max_depth, "max_depth", low=0, high=MAX_DEPTH),
    )
    run = _Run(scene, recipe, thread_count(n_threads))
    return _follow(run, end, checkpoints or Checkpoints(), progress)


def _settings(settings: ProgressiveSettings | None) -> ProgressiveSettings:
    if settings is not None and not isinstance(settings, ProgressiveSettings):
        raise TypeError(f"settings should be ProgressiveSettings, but is {settings!r}")
    return settings or ProgressiveSettings()


def pass_seed(seed: int, number: int) -> int:
    """Return the seed of a pass: the first 64 bits of NumPy's ``SeedSequence((seed, number))``."""
    state = np.random.SeedSequence((check_seed(seed), validation.count(number, "number", low=0)))
    return int(state.generate_state(1, np.uint64)[0])


@dataclass(frozen=True)
class _End:
    """When a run is over."""

    n_passes: float
    seconds: float

    @classmethod
    def given(cls, n_passes: int | None, seconds: float | None) -> _End:
        """Return the end that arguments of `render_progressive` say; it needs one."""
        if n_passes is None and seconds is None:
            raise ValueError("n_passes or seconds should be given: passes have no end of their own")
        return cls(
            np.inf if n_passes is None else validation.count(n_passes, "n_passes"),
            np.inf if seconds is None else validation.positive(seconds, "seconds"),
        )

    def tell(self, progress: Progress | None, n_passes: int, seconds: float) -> None:
        if progress is None:
            return
        if self.n_passes < np.inf:
            progress("passes", n_passes, int(self.n_passes))
        else:
            total = int(np.ceil(self.seconds))
            progress("seconds", min(int(seconds), total), total)


def _follow(run: _Run, end: _End, checkpoints: Checkpoints, progress: Progress | None) -> Image:
    """Do passes until the end, and leave behind what is asked for; return the picture."""
    with _kept_alone(checkpoints.state):
        keeper = _Keeper(run, checkpoints)
        keeper.resume(end)
        _go_on(run, end, keeper, checkpoints.interval, progress)
    run.check()
    return run.image()


@contextmanager
def _kept_alone(state: str | os.PathLike[str] | None) -> Iterator[None]:
    """Let no other process work on the file of a run."""
    if state is None:
        yield
        return
    check_writable(state)
    with file_lock(state):
        yield


def _go_on(
    run: _Run, end: _End, keeper: _Keeper, interval: float, progress: Progress | None
) -> None:
    started = saved = perf_counter()
    try:
        # However short the time, one pass is done in it.
        while run.n_passes < end.n_passes and run.seconds < end.seconds:
            run.advance()
            run.seconds = perf_counter() - started
            end.tell(progress, run.n_passes, run.seconds)
            if perf_counter() - saved >= interval:
                keeper.save()
                saved = perf_counter()
        keeper.save()
    except KeyboardInterrupt:
        keeper.save()
        raise
    except BaseException:
        keeper.save_state()
        raise


class _Keeper:
    """Saves a run and resumes it."""

    def __init__(self, run: _Run, checkpoints: Checkpoints) -> None:
        self._run = run
        self._on_image = checkpoints.on_image
        self._file: Checkpoint | None = None
        self._n_saved = 0
        if checkpoints.state is not None:
            self._file = Checkpoint(checkpoints.state, run.identity())

    def resume(self, end: _End) -> None:
        """Take up the run from its file, if there is one."""
        kept = None if self._file is None else self._file.load()
        if kept is None or self._file is None:
            return
        n_passes = int(kept["n_passes"])
        if n_passes > end.n_passes:
            raise ValueError(
                f"n_passes should be at least the {n_passes} that {self._file.path} holds "
                f"already, but is {end.n_passes}"
            )
        self._run.restore(kept)
        self._n_saved = n_passes

    def save(self) -> None:
        """Save the run and show the picture."""
        self.save_state()
        if self._on_image is not None and self._run.n_passes > 0:
            self._on_image(self._run.image())

    def save_state(self) -> None:
        """Save the run, unless no pass is new."""
        run = self._run
        if self._file is not None and run.n_passes > self._n_saved:
            self._file.save(run.arrays())
            self._n_saved = run.n_passes


@dataclass(frozen=True)
class _Done:
    """Passes done and what is kept of them; replaced as one, so that no run is ever torn."""

    n_passes: int = 0
    n_stored: int = 0
    kept: Kept = field(default_factory=Kept)


class _Run:
    """A picture in the making, pass by pass."""

    def __init__(self, scene: Scene, recipe: Recipe, n_threads: int) -> None:
        self.seconds = 0.0
        self._done = _Done()
        self._scene = scene
        self._recipe = recipe
        self._n_threads = n_threads
        kind = MovingPoints if recipe.stochastic else FixedPoints
        self._view = View(scene, recipe, n_threads)
        self._points: Points = kind(self._view)
        self._nothing: NothingStoredError | None = None

    @property
    def n_passes(self) -> int:
        return self._done.n_passes

    def identity(self) -> dict[str, Any]:
        """Return what must be the same for a run to be resumed."""
        return {
            "version": __version__,
            "scene": self._scene.name,
            **scene_digests(self._scene),
            **self._recipe.named(),
        }

    def advance(self) -> None:
        """Do the next pass."""
        done = self._done
        photons = self._photons(done.n_passes)
        kept = self._points.after(done.kept, photons, done.n_passes)
        self._done = _Done(done.n_passes + 1, done.n_stored + len(photons), kept)

    def _photons(self, number: int) -> PhotonMap:
        """Return the photons of a pass, of which there may be none."""
        try:
            return trace_photons(
                self._scene,
                self._recipe.photons_per_pass,
                seed=pass_seed(self._recipe.seed, number),
                n_threads=self._n_threads,
                caster=self._view.caster,
            )
        except NothingStoredError as nothing:
            self._nothing = nothing
            return nothing.photons

    def check(self) -> None:
        """Raise ValueError if no pass has stored anything."""
        if self._done.n_stored == 0:
            last = "" if self._nothing is None else f"; of the last: {self._nothing}"
            raise ValueError(f"no photon was stored in {self.n_passes} passes{last}")

    def arrays(self) -> dict[str, Any]:
        """Return all that later passes build upon."""
        counts = {"n_passes": self._done.n_passes, "n_stored": self._done.n_stored}
        return {**counts, **self._done.kept.arrays()}

    def restore(self, arrays: dict[str, NDArray]) -> None:
        """Take up what `arrays` returned."""
        kept = Kept.of(arrays, self._view)
        self._done = _Done(int(arrays["n_passes"]), int(arrays["n_stored"]), kept)

    def image(self) -> Image:
        """Return the picture so far; it tells nothing of how often the run was resumed."""
        layers = self._points.layers(self._done.kept, self.n_passes)
        metadata = header(
            photons_emitted=self.n_passes * self._recipe.photons_per_pass,
            photons_stored=self._done.n_stored,
            seed=self._recipe.seed,
            scene=self._scene.name,
            method=PASSES_METHOD,
            settings={**self._recipe.named(), "n_passes": self.n_passes},
        )
        radiance = {"radiance": layers["caustic"] + layers["direct"]}
        stage = {"seconds": self.seconds, "passes": self.n_passes, "stored": self._done.n_stored}
        return Image(
            radiance | layers,
            metadata,
            {"stages": {"passes": stage}, "seconds": self.seconds},
        )
