"""Errors of methods over the time they take: a sweep of settings, and the best of them.

Settings are compared on few photons first; the half of them that is nearest to the front goes on to
three times as many, and so on. Of each method the best always goes on, so that each has a curve;
so do the settings of presets, which are measured anew so. A point is on the front if no other is
both quicker and more exact. What is measured already is read from the folder: a sweep that was
interrupted goes on.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, field, replace
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np

from .._util import validation
from .._util.files import write_json
from .._util.frozen import set_field
from .._util.memory import peak_memory, reset_peak_memory
from .._util.progress import Progress, prefixed
from .._util.validation import Floats
from .._util.workers import checked_executor
from .._version import __version__
from ..estimation.methods import METHODS, MethodInput, Settings, prepare
from ..imaging import metrics
from ..imaging.image import Image
from ..imaging.metrics import Errors
from ..photons.photon_map import PhotonMap
from ..rendering.layers import fixed_layers
from ..rendering.presets import Choice, preset_names
from ..rendering.view import StoredView, View
from ..scene.digest import scene_digest
from ..scene.scene import Scene
from ..transport.trace import trace_photons
from .reference import (
    Reference,
    ReferenceSettings,
    cached_reference,
    check_reference,
    uncertainty_of,
)
from .request import ComparisonRequest
from .subject import SceneSubject

STATE, REFERENCE = "tradeoff.json", "reference.exr"
# Photons of the first rung over those of the last, and factor between rungs.
_FEWEST, _FACTOR = 1e-2, 10.0**0.5
# Envelopes that take longer are not worth waiting for in a sweep.
_ENVELOPE_SECONDS = 20.0


def _relaxing(
    method: str, iterations: Iterable[tuple[int, int]], ks: Iterable[int], **relax: Any
) -> list[Choice]:
    return [
        Choice(method, 0, stages={"relax": {"n_iterations": list(n), **relax}, "gather": {"k": k}})
        for n in iterations
        for k in ks
    ]


CHOICES = (
    *(Choice("standard", 0, stages={"gather": {"k": k}}) for k in (8, 15, 30)),
    Choice("standard", 0, 1, {"gather": {"k": 15}}),
    *_relaxing("parameterised", [(2, 2), (3, 3), (3, 7), (7, 7)], [8, 15]),
    *_relaxing("parameterised", [(4, 3)], [8], step=2.0),
    *_relaxing("mapped", [(3, 3), (5, 5)], [8, 15]),
    *_relaxing("mapped", [(14, 14)], [8]),
    *_relaxing("mapped", [(4, 3)], [8], step=2.0),
    replace(_relaxing("mapped", [(5, 5)], [8])[0], supersampling=1),
    *(Choice("diffusion", 0, stages={"diffusion": {"k": k}}) for k in (100, 500)),
    Choice("progressive", 0),
)
"""Choices of the first rung; photons are the rung's."""
ENVELOPES = tuple(
    Choice("envelope", 0, stages={"envelope": {"error": error, "seconds": _ENVELOPE_SECONDS}})
    for error in (0.1, 0.05, 0.02, 0.01)
)
"""Choices without photons, which are in no rung."""
SWEPT_METHODS = tuple(dict.fromkeys(choice.method for choice in (*CHOICES, *ENVELOPES)))
"""Methods that have choices."""


@dataclass(frozen=True)
class TradeoffRequest:
    """Extent of a sweep.

    Attributes
    ----------
    n_emitted : int
        Photons of the last rung.
    methods : tuple of str
        Methods to sweep, by default all that have choices.
    seed : int
        Of the photons.
    reference : ReferenceSettings
        Passes and photons of the reference.
    """

    n_emitted: int = 1_000_000
    methods: tuple[str, ...] = ()
    seed: int = 0
    reference: ReferenceSettings = field(default_factory=ReferenceSettings)

    def __post_init__(self) -> None:
        validation.count(self.n_emitted, "n_emitted", low=1000)
        validation.check_seed(self.seed)
        for name in self.methods:
            validation.check_choice(name, "methods", SWEPT_METHODS)
        set_field(self, "methods", tuple(self.methods) or SWEPT_METHODS)

    @property
    def rungs(self) -> list[int]:
        """Photons of each rung, few to many."""
        n = round(np.log(1.0 / _FEWEST) / np.log(_FACTOR))
        return [round(self.n_emitted / _FACTOR**i) for i in range(n, -1, -1)]

    def choices(self, all_of: Sequence[Choice]) -> list[Choice]:
        """Those of the methods to sweep."""
        return [choice for choice in all_of if choice.method in self.methods]


@dataclass(frozen=True)
class Point:
    """A choice, what it takes and its errors.

    Attributes
    ----------
    choice : Choice
    n_stored : int
        Photons stored, 0 without photons.
    seconds : dict
        By stage.
    cpu_seconds, peak_bytes : float
        Time of all threads, and resident memory at most; NaN where it is not known.
    errors : Errors
        Of the caustic; SSIM and FLIP of the image.
    """

    choice: Choice
    n_stored: int
    seconds: dict[str, float]
    cpu_seconds: float
    peak_bytes: float
    errors: Errors

    @property
    def total(self) -> float:
        """Seconds of all stages."""
        return sum(self.seconds.values())

    @property
    def error(self) -> float:
        """Relative L1."""
        return self.errors.relative_l1

    def to_dict(self) -> dict[str, Any]:
        """The point as JSON has it."""
        peak = None if np.isnan(self.peak_bytes) else self.peak_bytes
        return {
            **vars(self),
            "choice": self.choice.to_dict(),
            "peak_bytes": peak,
            "errors": self.errors.to_dict(),
        }

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Point:
        """The point of `to_dict`."""
        peak = float("nan") if values["peak_bytes"] is None else values["peak_bytes"]
        choice, errors = Choice(**values["choice"]), Errors(**values["errors"])
        return cls(**values | {"choice": choice, "peak_bytes": peak, "errors": errors})


def front(points: Iterable[Point]) -> list[Point]:
    """Points that no other is both quicker and more exact than, from the quickest on."""
    found: list[Point] = []
    for point in sorted(points, key=lambda each: (each.total, each.error)):
        if not found or point.error < found[-1].error:
            found.append(point)
    return found


def seconds_for(points: Iterable[Point], error: float) -> float:
    """Seconds in which an error is reached; infinite if none of the points does.

    Between the points of the front, times are those of a power of the error.
    """
    best = front(points)
    for before, after in zip([None, *best], best, strict=False):
        if after.error <= error:
            if before is None:
                return after.total
            share = np.log(before.error / error) / np.log(before.error / after.error)
            return float(before.total * (after.total / before.total) ** share)
    return float("inf")


@dataclass(frozen=True)
class Tradeoff:
    """The points of a scene and its reference.

    Attributes
    ----------
    about : dict
        Scene, size, settings, version and machine.
    points : tuple of Point
    reference : str
        How the reference was made.
    doubt : float
        Relative L1 of the noise and bias of the reference, NaN if unknown.
    """

    about: dict[str, Any]
    points: tuple[Point, ...]
    reference: str
    doubt: float

    @property
    def front(self) -> list[Point]:
        """Points that no other is both quicker and more exact than."""
        return front(self.points)

    def of(self, method: str) -> list[Point]:
        """Points of a method."""
        return [point for point in self.points if point.choice.method == method]


def tradeoff(
    scene: Scene,
    folder: str | os.PathLike[str],
    settings: TradeoffRequest | None = None,
    *,
    reference: Image | None = None,
    n_threads: int | None = None,
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Tradeoff:
    """Sweep methods and settings over a scene, and measure errors over time.

    Parameters
    ----------
    scene : Scene
        With a camera.
    folder : path
        That there is; the reference and the points are kept there, and read if they are of the
        same scene and settings.
    settings : TradeoffRequest, optional
        Extent of the sweep.
    reference : Image, optional
        ``radiance`` of the view, and ``caustic``, in place of a reference that is computed.
    n_threads : int, optional
        Threads; all available by default.
    progress : callable, optional
        Called as ``progress(stage, done, total)``.
    executor : concurrent.futures.Executor, optional
        Renders the passes of a computed reference. All that is timed runs here, one after the
        other: beside one another runs would share processors and caches.

    Returns
    -------
    Tradeoff

    Raises
    ------
    TypeError, ValueError
        If the scene has no camera, or no photon of a caustic is stored.
    ImportError
        If a package that errors are measured with is not installed.
    """
    metrics.check_installed()
    checked_executor(executor)
    sweep = Sweep(scene, Path(folder), settings or TradeoffRequest(), reference, n_threads)
    return sweep.run(progress, executor)


class Sweep:
    """A sweep of a scene; arguments as of `tradeoff`."""

    def __init__(
        self,
        scene: Scene,
        folder: Path,
        settings: TradeoffRequest,
        reference: Image | None = None,
        n_threads: int | None = None,
    ) -> None:
        self._scene, self._folder, self._settings = scene, folder, settings
        self._n_threads, self._given = n_threads, reference
        self._request = ComparisonRequest(
            subject=SceneSubject(scene), n_emitted=settings.n_emitted, n_threads=n_threads
        )
        if reference is not None:
            check_reference(reference, self._request)
        self._about = {
            "version": __version__,
            "scene": scene.name,
            "digest": scene_digest(scene),
            "reference": None if reference is None else _digest(reference),
            "size": list(self._request.subject.size),
            "settings": json.loads(json.dumps(asdict(settings))),
        }
        self._points = self._read()
        self._views: dict[int, StoredView] = {}
        # Seconds and processor time of the photons traced last.
        self._cast = (0.0, 0.0)
        self._any_view = View(scene, n_threads=n_threads)
        self._pixel_side = self._any_view.pixel_side()

    def estimated_seconds(self) -> float:
        """About how long the sweep will take, from runs on few photons."""
        settings = self._settings
        rungs = settings.rungs
        # The first time loads libraries and starts threads.
        _, few, many = (self._timed(n) for n in (rungs[0], rungs[0], rungs[2]))
        each = max(many[1] - few[1], 0.0) / (rungs[2] - rungs[0])
        left = (len(settings.choices(CHOICES)) * 0.5**i for i in range(len(rungs)))
        runs = [max(some, 5.0) for some in left]
        sweep = sum(some * (few[1] + each * n) for n, some in zip(rungs, runs, strict=True))
        if self._given is not None or (self._folder / REFERENCE).exists():
            return sweep
        photons = 4 * settings.reference.passes_per_run * settings.reference.photons
        return sweep + 2.0 * many[0] * photons / rungs[2]

    def _timed(self, n: int) -> tuple[float, float]:
        """Seconds of tracing some photons, and of a choice that relaxes them."""
        started = time.perf_counter()
        photons = self._trace(n)
        traced = time.perf_counter() - started
        started = time.perf_counter()
        self._run(replace(_relaxing("mapped", [(3, 3)], [8])[0], n_emitted=n), photons)
        return traced, time.perf_counter() - started

    def run(self, progress: Progress | None, executor: Executor | None = None) -> Tradeoff:
        """Measure all points that are not there yet; an executor computes the reference."""
        settings = self._settings
        path = self._folder / REFERENCE
        image = self._given or cached_reference(
            path, self._request, settings.reference, progress, executor
        )
        doubt = uncertainty_of(image)
        fixed = fixed_layers(self._view(2).bands)
        reference = Reference(image, fixed, 0.0)
        for choice in settings.choices(ENVELOPES):
            self._measure(choice, None, reference)
        self._rungs(reference, prefixed(progress, "sweep"))
        return Tradeoff(
            self._about,
            tuple(self._points),
            reference.description,
            float("nan") if doubt is None else float(np.hypot(doubt.noise_l1, doubt.bias_l1)),
        )

    def _rungs(self, reference: Reference, progress: Progress | None) -> None:
        choices = self._settings.choices(CHOICES)
        for n in self._settings.rungs:
            photons = None
            rung = [replace(choice, n_emitted=n) for choice in choices]
            for done, choice in enumerate(rung):
                if photons is None and self._found(choice) is None:
                    photons = self._trace(n)
                self._measure(choice, photons, reference)
                if progress is not None:
                    progress(f"{n:,} photons", done + 1, len(rung))
            points = [found for each in rung if (found := self._found(each)) is not None]
            kept = {point.choice.name for point in survivors(points)} | preset_names()
            choices = [choice for choice in choices if choice.name in kept]

    def _measure(self, choice: Choice, photons: PhotonMap | None, reference: Reference) -> None:
        """Measure a choice, unless it is there."""
        if self._found(choice) is not None:
            return
        try:
            caustic, seconds, cpu, peak = self._run(choice, photons)
        except ValueError:
            # Envelopes are of some emitters only.
            if METHODS[choice.method].needs_photons:
                raise
            return
        _, errors = reference.measure(caustic)
        n_stored = 0 if photons is None else len(photons)
        self._points.append(Point(choice, n_stored, seconds, cpu, peak, errors))
        self._write()

    def _run(
        self, choice: Choice, photons: PhotonMap | None
    ) -> tuple[Floats, dict[str, float], float, float]:
        """Caustic, seconds by stage, processor time and peak of memory."""
        view = self._view(choice.supersampling)
        settings = choice.settings
        if "envelope" in settings.given:
            envelope = replace(settings.given["envelope"], footprint=self._pixel_side)
            settings = Settings(envelope=envelope)
        known = reset_peak_memory()
        started, cpu = time.perf_counter(), time.process_time()
        inputs = MethodInput(
            photons, settings, self._scene, self._n_threads, None, caster=self._any_view.caster
        )
        prepared = prepare(choice.method, inputs)
        caustic = view.caustic(prepared, None)
        spent, used = time.perf_counter() - started, time.process_time() - cpu
        shared = {"camera": view.seconds}
        if photons is not None:
            shared["cast"] = self._cast[0]
            used += self._cast[1]
        rest = max(spent - sum(prepared.seconds.values()), 0.0)
        seconds = {**shared, **prepared.seconds, "gather": rest}
        return caustic, seconds, used, peak_memory() if known else float("nan")

    def _trace(self, n: int) -> PhotonMap:
        started, cpu = time.perf_counter(), time.process_time()
        photons = trace_photons(
            self._scene,
            n,
            seed=self._settings.seed,
            n_threads=self._n_threads,
            caster=self._any_view.caster,
            sensors=False,
        )
        self._cast = time.perf_counter() - started, time.process_time() - cpu
        return photons

    def _view(self, supersampling: int) -> StoredView:
        if supersampling not in self._views:
            view = self._any_view.variant(supersampling=supersampling)
            self._views[supersampling] = view.stored(None)
        return self._views[supersampling]

    def _found(self, choice: Choice) -> Point | None:
        wanted = choice.to_dict()
        return next((p for p in self._points if p.choice.to_dict() == wanted), None)

    def _read(self) -> list[Point]:
        """Points of an earlier sweep of the same scene and settings."""
        path = self._folder / STATE
        if not path.exists():
            return []
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            if data["about"] != self._about:
                return []
            return [Point.from_dict(values) for values in data["points"]]
        except (ValueError, TypeError, LookupError):
            raise ValueError(
                f"{path} should be a sweep that was measured here, but is not: move it away"
            ) from None

    def _write(self) -> None:
        points = [point.to_dict() for point in self._points]
        write_json(self._folder / STATE, {"about": self._about, "points": points})


def _digest(reference: Image) -> str:
    """Hash of the radiance of a reference that is given."""
    radiance = np.ascontiguousarray(reference.layers["radiance"], dtype=np.float64)
    return blake2b(radiance.tobytes(), digest_size=8).hexdigest()


def survivors(points: Sequence[Point]) -> list[Point]:
    """The half of the points that is nearest to their front, and the best of each method."""
    score = {id(point): _lag(point, points) for point in points}
    ordered = sorted(points, key=lambda point: score[id(point)])
    kept = ordered[: -(-len(points) // 2)]
    for method in dict.fromkeys(point.choice.method for point in points):
        if not any(point.choice.method == method for point in kept):
            kept.append(next(p for p in ordered if p.choice.method == method))
    return kept


def _lag(point: Point, points: Sequence[Point]) -> float:
    """Smallest factor, of time and error alike, by which a point would have to be better."""
    return max(min(point.total / other.total, point.error / other.error) for other in points)
