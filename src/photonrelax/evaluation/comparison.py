"""Methods on one photon map, seen at the same points, measured against the same reference."""

from __future__ import annotations

import json
import os
import platform
from dataclasses import dataclass, replace
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np

from .._util.parallel import thread_count
from .._util.progress import Progress, prefixed
from .._util.validation import Floats
from .._version import __version__
from ..estimation.field import Field
from ..estimation.methods import (
    DEFAULT_METHOD,
    METHODS,
    PLAIN_METHOD,
    MethodInput,
    Settings,
    prepare,
)
from ..imaging import metrics
from ..imaging.image import Image
from ..imaging.metrics import Errors
from ..photons.photon_map import PhotonMap
from ..rendering.layers import photon_layers
from ..rendering.metadata import photon_header
from ..rendering.view import View
from .analytic_pixels import Known
from .request import Plan
from .truth import ABOUT, Truth, check_reference


@dataclass(frozen=True, eq=False)
class Run:
    """One method that ran: its picture, and how long it took.

    Attributes
    ----------
    name : str
        Of the column: the method's, or the variant's.
    method : str
        Its name.
    image : Image
        The ``caustic``; of an `Entry`, more.
    n_emitted, n_stored : int
        Photons it used.
    seconds : dict
        Of its stages in order; those before its own, ``cast`` and ``camera``, were done for all
        methods, which share photons. ``spectra`` is what these cost, for methods that need them.
    settings : dict
        It used, by stage.
    """

    name: str
    method: str
    image: Image
    n_emitted: int
    n_stored: int
    seconds: dict[str, float]
    settings: dict[str, Any]


@dataclass(frozen=True, eq=False)
class Entry(Run):
    """A run, and how far it is from the reference.

    Attributes
    ----------
    name, method, n_emitted, n_stored, seconds, settings
        See `Run`.
    image : Image
        The layers of a picture, ``difference`` from the reference and ``flip``.
    errors : Errors
        Of the caustic, and of the picture on a display.
    known_errors : dict
        Of the caustic where light is known without photons; empty if it is nowhere.
    """

    errors: Errors
    known_errors: dict[str, float]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Entries on one scene, the reference, and what the photons carry.

    Attributes
    ----------
    plan : Plan
        What was asked for.
    entries : tuple of Entry
        One a method.
    reference : Image
        What they are measured against; ``radiance``, and ``caustic`` where it is known.
    about_reference : str
        How it was made.
    truth : Truth
        What else is known of it.
    photon_layers : dict
        ``caustic`` and what photons carry (`photonrelax.rendering.layers.PhotonLayers`).
    """

    plan: Plan
    entries: tuple[Entry, ...]
    reference: Image
    about_reference: str
    truth: Truth
    photon_layers: dict[str, Floats]

    def to_dict(self) -> dict[str, Any]:
        """Return all but the pictures."""
        plan = self.plan
        width, height = plan.subject.size
        return {
            "version": __version__,
            "scene": plan.subject.name,
            "width": width,
            "height": height,
            **{name: getattr(plan, name) for name in _TOLD},
            "reference": self.about_reference,
            "reference_cost": reference_cost(self.reference),
            "clipped": self.truth.clipped,
            "known_share": self.truth.known_share,
            "reference_known_errors": self.truth.known_errors,
            "n_threads": thread_count(plan.n_threads),
            "machine": machine(),
            "methods": {entry.name: _told(entry) for entry in self.entries},
        }


_TOLD = ("n_emitted", "seed", "sampler", "supersampling", "max_depth", "exposure", "rounds")


def _told(entry: Entry) -> dict[str, Any]:
    told = {
        "method": entry.method,
        "n_emitted": entry.n_emitted,
        "n_stored": entry.n_stored,
        "seconds": entry.seconds,
        "total_seconds": sum(entry.seconds.values()),
        "errors": entry.errors.to_dict(),
        "known_errors": entry.known_errors,
        "settings": entry.settings,
    }
    # JSON has no word for infinity but null.
    finite: dict[str, Any] = json.loads(json.dumps(told), parse_constant=lambda name: None)
    return finite


def compare(plan: Plan, reference: Image, *, progress: Progress | None = None) -> Comparison:
    """Trace photons once, find the points of the picture once, and evaluate every method.

    Times alone are taken as often as the plan says.

    Parameters
    ----------
    plan : Plan
        What to compare.
    reference : Image
        What to measure errors against: ``radiance`` of the same view, and ``caustic`` if known;
        otherwise direct light is taken off.
    progress : callable, optional
        Called as ``progress(stage, done, total)``.

    Returns
    -------
    Comparison

    Raises
    ------
    TypeError, ValueError
        If the reference has another size, is black or not finite, or no photon is stored.
    ImportError
        If what measures errors is not installed.
    """
    metrics.check_installed()
    check_reference(reference, plan)
    return run_methods(plan, progress=progress).against(reference)


@dataclass(frozen=True, eq=False)
class Runs:
    """Methods that ran, not measured yet.

    A reference may take long: it is better computed when nothing else can fail.

    Attributes
    ----------
    plan : Plan
        What was asked for.
    each : tuple of Run
        In the order of the columns.
    fixed : dict
        Layers of the view that need no photons.
    known : Known or None
        Its light that is known without photons.
    photon_layers : dict
        See `Comparison`.
    """

    plan: Plan
    each: tuple[Run, ...]
    fixed: dict[str, Floats]
    known: Known | None
    photon_layers: dict[str, Floats]

    def against(self, reference: Image) -> Comparison:
        """Measure the errors; parameters and exceptions are those of `compare`."""
        check_reference(reference, self.plan)
        truth = Truth(reference, self.fixed, self.plan.exposure, self.known)
        entries = tuple(self._measured(run, truth) for run in self.each)
        about = reference.metadata.get(ABOUT, "a picture given")
        return Comparison(self.plan, entries, reference, about, truth, self.photon_layers)

    def _measured(self, run: Run, truth: Truth) -> Entry:
        caustic = np.asarray(run.image.layers["caustic"])
        image, errors = truth.measured(caustic)
        made = vars(run) | {"image": Image(image.layers, run.image.metadata)}
        return Entry(**made, errors=errors, known_errors=truth.against_known(caustic))


def run_methods(plan: Plan, *, progress: Progress | None = None) -> Runs:
    """Do all of `compare` that needs no reference; parameters and exceptions are the same."""
    return _Bench(plan, _traced(plan, progress), progress).runs()


@dataclass(frozen=True)
class _Cast:
    """Photons, the seconds that tracing them takes, and those that their spectra add."""

    photons: PhotonMap
    seconds: float
    spectra: float


def _traced(plan: Plan, progress: Progress | None) -> _Cast:
    """Trace the photons; where some carry spectra, without these as well, to tell their time."""
    shares = [METHODS[name].frequency_share(how) for name, how in plan.columns().values()]
    plain, with_spectra = [], []
    for _ in range(plan.rounds):
        photons, seconds = _cast(plan, 0.0, progress)
        plain.append(seconds)
        if max(shares) > 0.0:
            photons, seconds = _cast(plan, max(shares), progress)
            with_spectra.append(seconds)
    surplus = median(with_spectra) - median(plain) if with_spectra else 0.0
    return _Cast(photons, median(plain), max(surplus, 0.0))


def _cast(plan: Plan, share: float, progress: Progress | None) -> tuple[PhotonMap, float]:
    started = perf_counter()
    photons = plan.subject.photons(
        plan.n_emitted,
        seed=plan.seed,
        sampler=plan.sampler,
        frequency_share=share,
        n_threads=plan.n_threads,
        progress=progress,
    )
    return photons, perf_counter() - started


class _Bench:
    """What all methods share, and what is kept of those that ran."""

    def __init__(self, plan: Plan, cast: _Cast, progress: Progress | None) -> None:
        self._photon_layers: dict[str, Floats] = {}
        self._plan = plan
        self._cast = cast
        self._progress = progress
        views = [self._look() for _ in range(plan.rounds)]
        self._view = views[0]
        self._camera = median(view.seconds for view in views)

    def runs(self) -> Runs:
        """Run all methods in turns, as often as they are timed."""
        plan = self._plan
        columns = plan.columns()
        self._warm_up()
        made: dict[str, Run] = {}
        seconds: dict[str, list[dict[str, float]]] = {name: [] for name in columns}
        for _ in range(plan.rounds):
            for name in columns:
                field, caustic, taken = self._run(name)
                seconds[name].append(taken)
                if name not in made:
                    made[name] = self._kept(name, field, caustic)
        each = tuple(
            replace(run, seconds=self._shared(run.method) | _medians(seconds[name]))
            for name, run in made.items()
        )
        known = plan.subject.known(self._view)
        return Runs(plan, each, self._view.fixed, known, self._photon_layers)

    def _look(self) -> View:
        plan = self._plan
        return plan.subject.view(
            plan.supersampling,
            plan.max_depth,
            n_threads=plan.n_threads,
            progress=self._progress,
        )

    def _warm_up(self) -> None:
        """Gather a little: the first method timed should not pay for threads and memory."""
        field = prepare(PLAIN_METHOD, self._task(Settings(), None))
        hits = self._view.bands[0].hits
        field(hits.position, hits.normal)

    def _run(self, name: str) -> tuple[Field, Floats, dict[str, float]]:
        """Run a method; return its photons prepared, its picture and its seconds by stage."""
        method, settings = self._plan.columns()[name]
        progress = prefixed(self._progress, name)
        started = perf_counter()
        field = prepare(method, self._task(settings, progress))
        prepared = perf_counter()
        caustic = self._view.caustic(field, progress)
        now = perf_counter()
        # Trees that nothing but gathering needs are part of it.
        trees = max(prepared - started - sum(field.seconds.values()), 0.0)
        return field, caustic, field.seconds | {"gather": now - prepared + trees}

    def _task(self, settings: Settings, progress: Progress | None) -> MethodInput:
        plan = self._plan
        return MethodInput(
            self._cast.photons, settings, plan.subject.scene, plan.n_threads, progress
        )

    def _kept(self, name: str, field: Field, caustic: Floats) -> Run:
        plan, photons = self._plan, self._cast.photons
        method, _ = plan.columns()[name]
        self._keep_photon_layers(field, method)
        used = field.used | {"supersampling": plan.supersampling, "max_depth": plan.max_depth}
        told = photon_header(photons, scene=plan.subject.name, method=method, settings=used)
        image = Image({"caustic": caustic}, told)
        return Run(name, method, image, plan.n_emitted, len(photons), {}, field.used)

    def _shared(self, method: str) -> dict[str, float]:
        """Return the seconds of what was done for all methods, or for those with spectra."""
        spectra = {"spectra": self._cast.spectra} if METHODS[method].needs_spectra else {}
        return {"cast": self._cast.seconds, **spectra, "camera": self._camera}

    def _keep_photon_layers(self, field: Field, method: str) -> None:
        """Keep what the photons carry: SJ13's if they are there, else with constraints if known."""
        kept = self._photon_layers
        more = field.structure is not None and "photons.constraint" not in kept
        if not kept or more or method == DEFAULT_METHOD:
            self._photon_layers = photon_layers(self._view, field)


def _medians(seconds: list[dict[str, float]]) -> dict[str, float]:
    return {stage: median(each[stage] for each in seconds) for stage in seconds[0]}


COST = "photonrelax.reference_cost"
"""Where the metadata of a reference say what it took, as JSON."""


def reference_cost(reference: Image) -> dict[str, Any]:
    """Return photons emitted and stored, and seconds of a reference, as far as they are known."""
    cost: dict[str, Any] = json.loads(reference.metadata.get(COST, "{}"))
    return cost


def machine() -> str:
    """Return what times were taken on."""
    return f"{platform.system()} {platform.machine()}, {os.cpu_count()} processors"
