"""Methods evaluated on the same photons at the same hit points, against the same reference."""

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
from ..rendering.layers import fixed_layers, photon_layers
from ..rendering.metadata import photon_metadata
from ..rendering.view import StoredView
from .analytic_pixels import AnalyticPixels
from .reference import Reference, check_reference
from .request import ComparisonRequest


@dataclass(frozen=True, eq=False)
class Run:
    """Image and times of one method.

    Attributes
    ----------
    name : str
        Name of the column: the method's, or the variant's.
    method : str
        Name of the method.
    image : Image
        Layer ``caustic``; those of an `Entry` are more.
    n_emitted, n_stored : int
        Number of photons.
    seconds : dict
        By stage, in order. Those of ``cast`` and ``camera`` are shared by all methods; ``spectra``
        is the additional time of tracing photons with spectra, for methods that need them.
    settings : dict
        By stage.
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
    """A run with its errors.

    Attributes
    ----------
    name, method, n_emitted, n_stored, seconds, settings
        See `Run`.
    image : Image
        All layers, the ``difference`` from the reference and ``flip``.
    errors : Errors
        Of the caustic, and of the image on a display.
    analytic_errors : dict
        Of the caustic where it is known analytically; empty if it is nowhere.
    """

    errors: Errors
    analytic_errors: dict[str, float]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Entries of all methods, their reference, and the attributes of the photons.

    Attributes
    ----------
    request : ComparisonRequest
        Parameters of the comparison.
    entries : tuple of Entry
        One a column.
    reference : Reference
        Reference of the errors.
    photon_layers : dict
        ``caustic`` and means of photon attributes (`photonrelax.rendering.layers.FieldEstimates`).
    """

    request: ComparisonRequest
    entries: tuple[Entry, ...]
    reference: Reference
    photon_layers: dict[str, Floats]

    def to_dict(self) -> dict[str, Any]:
        """Parameters, times and errors, without images."""
        request, reference = self.request, self.reference
        width, height = request.subject.size
        return {
            "version": __version__,
            "scene": request.subject.name,
            "width": width,
            "height": height,
            **{name: getattr(request, name) for name in _PARAMETERS},
            "reference": reference.description,
            "reference_cost": reference.cost,
            "clipped": reference.clipped,
            "known_share": reference.analytic_share,
            "reference_known_errors": reference.analytic_errors,
            "n_threads": thread_count(request.n_threads),
            "machine": machine(),
            "methods": {entry.name: _summary(entry) for entry in self.entries},
        }


_PARAMETERS = ("n_emitted", "seed", "sampler", "supersampling", "max_depth", "exposure", "rounds")


def _summary(entry: Entry) -> dict[str, Any]:
    """Times, errors and settings of an entry as JSON allows them."""
    summary = {
        "method": entry.method,
        "n_emitted": entry.n_emitted,
        "n_stored": entry.n_stored,
        "seconds": entry.seconds,
        "total_seconds": sum(entry.seconds.values()),
        "errors": entry.errors.to_dict(),
        "known_errors": entry.analytic_errors,
        "settings": entry.settings,
    }
    # JSON has no infinity: null.
    finite: dict[str, Any] = json.loads(json.dumps(summary), parse_constant=lambda name: None)
    return finite


def machine() -> str:
    """Operating system, architecture and number of processors."""
    return f"{platform.system()} {platform.machine()}, {os.cpu_count()} processors"


def compare(
    request: ComparisonRequest, reference: Image, *, progress: Progress | None = None
) -> Comparison:
    """Trace photons and camera rays once, evaluate every method, and measure the errors.

    All work is repeated in every round of the request, for its times.

    Parameters
    ----------
    request : ComparisonRequest
        Parameters of the comparison.
    reference : Image
        Reference of the errors: ``radiance`` of the same view, and ``caustic``, by default the
        difference to direct light.
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
        If a package that errors are measured with is not installed.
    """
    metrics.check_installed()
    check_reference(reference, request)
    return run_methods(request, progress=progress).measure(reference)


@dataclass(frozen=True, eq=False)
class Runs:
    """Runs of all methods, before their errors are measured.

    A reference can take long to compute: with its runs done, little else can fail.

    Attributes
    ----------
    request : ComparisonRequest
        Parameters of the comparison.
    runs : tuple of Run
        In the order of the columns.
    fixed : dict
        Layers of the view that do not depend on photons.
    analytic : AnalyticPixels or None
        Caustic that is known analytically.
    photon_layers : dict
        See `Comparison`.
    """

    request: ComparisonRequest
    runs: tuple[Run, ...]
    fixed: dict[str, Floats]
    analytic: AnalyticPixels | None
    photon_layers: dict[str, Floats]

    def measure(self, image: Image) -> Comparison:
        """Measure the errors against a reference; parameters and exceptions as of `compare`."""
        check_reference(image, self.request)
        reference = Reference(image, self.fixed, self.request.exposure, self.analytic)
        entries = tuple(_entry(run, reference) for run in self.runs)
        return Comparison(self.request, entries, reference, self.photon_layers)


def _entry(run: Run, reference: Reference) -> Entry:
    caustic = np.asarray(run.image.layers["caustic"])
    image, errors = reference.measure(caustic)
    values = vars(run) | {"image": Image(image.layers, run.image.metadata)}
    analytic_errors = reference.errors_where_analytic(caustic)
    return Entry(**values, errors=errors, analytic_errors=analytic_errors)


def run_methods(request: ComparisonRequest, *, progress: Progress | None = None) -> Runs:
    """Runs of all methods, without errors; parameters and exceptions are those of `compare`."""
    return _Workbench(request, _trace(request, progress), progress).runs()


@dataclass(frozen=True)
class _TracedPhotons:
    """Photons, the seconds of tracing them without spectra, and those that spectra add."""

    photons: PhotonMap
    seconds: float
    spectra_seconds: float


def _trace(request: ComparisonRequest, progress: Progress | None) -> _TracedPhotons:
    """Trace the photons; both without and with spectra if any are needed, to time these."""
    columns = request.columns().values()
    share = max(METHODS[method].frequency_share(settings) for method, settings in columns)
    plain, with_spectra = [], []
    for _ in range(request.rounds):
        photons, seconds = _timed_photons(request, 0.0, progress)
        plain.append(seconds)
        if share > 0.0:
            photons, seconds = _timed_photons(request, share, progress)
            with_spectra.append(seconds)
    added = median(with_spectra) - median(plain) if with_spectra else 0.0
    return _TracedPhotons(photons, median(plain), max(added, 0.0))


def _timed_photons(
    request: ComparisonRequest, frequency_share: float, progress: Progress | None
) -> tuple[PhotonMap, float]:
    started = perf_counter()
    photons = request.subject.photons(
        request.n_emitted,
        seed=request.seed,
        sampler=request.sampler,
        frequency_share=frequency_share,
        n_threads=request.n_threads,
        progress=progress,
    )
    return photons, perf_counter() - started


class _Workbench:
    """Photons and view that all methods share, and the photon layers of the methods run."""

    def __init__(
        self, request: ComparisonRequest, traced: _TracedPhotons, progress: Progress | None
    ) -> None:
        self._photon_layers: dict[str, Floats] = {}
        self._request = request
        self._traced = traced
        self._progress = progress
        views = [self._trace_view() for _ in range(request.rounds)]
        self._view = views[0]
        self._camera_seconds = median(view.seconds for view in views)

    def runs(self) -> Runs:
        """Run all methods by turns, in every round."""
        request = self._request
        columns = request.columns()
        self._warm_up()
        runs: dict[str, Run] = {}
        seconds: dict[str, list[dict[str, float]]] = {name: [] for name in columns}
        for _ in range(request.rounds):
            for name in columns:
                field, caustic, taken = self._evaluate(name)
                seconds[name].append(taken)
                if name not in runs:
                    runs[name] = self._run(name, field, caustic)
        timed = tuple(
            replace(run, seconds=self._shared_seconds(run.method) | _medians(seconds[name]))
            for name, run in runs.items()
        )
        analytic = request.subject.analytic_pixels(self._view)
        fixed = fixed_layers(self._view.bands)
        return Runs(request, timed, fixed, analytic, self._photon_layers)

    def _trace_view(self) -> StoredView:
        request = self._request
        return request.subject.view(
            request.supersampling,
            request.max_depth,
            n_threads=request.n_threads,
            progress=self._progress,
        )

    def _warm_up(self) -> None:
        """Gather once: the first timed method should not pay for starting threads."""
        field = prepare(PLAIN_METHOD, self._method_input(Settings(), None))
        self._view.bands[0].estimates(field)

    def _evaluate(self, name: str) -> tuple[Field, Floats, dict[str, float]]:
        """Field, caustic and seconds by stage of a column's method."""
        method, settings = self._request.columns()[name]
        progress = prefixed(self._progress, name)
        started = perf_counter()
        field = prepare(method, self._method_input(settings, progress))
        prepared = perf_counter()
        caustic = self._view.caustic(field, progress)
        now = perf_counter()
        # Trees that only gathering needs are built by no stage: their time is that of gathering.
        trees = max(prepared - started - sum(field.seconds.values()), 0.0)
        return field, caustic, field.seconds | {"gather": now - prepared + trees}

    def _method_input(self, settings: Settings, progress: Progress | None) -> MethodInput:
        request = self._request
        return MethodInput(
            self._traced.photons, settings, request.subject.scene, request.n_threads, progress
        )

    def _run(self, name: str, field: Field, caustic: Floats) -> Run:
        request, photons = self._request, self._traced.photons
        method, _ = request.columns()[name]
        self._keep_photon_layers(field, method)
        view = {"supersampling": request.supersampling, "max_depth": request.max_depth}
        metadata = photon_metadata(
            photons, scene=request.subject.name, method=method, settings=field.used | view
        )
        image = Image({"caustic": caustic}, metadata)
        return Run(name, method, image, request.n_emitted, len(photons), {}, field.used)

    def _shared_seconds(self, method: str) -> dict[str, float]:
        """Seconds of the work that methods share: all of them, or those with spectra."""
        spectra = {"spectra": self._traced.spectra_seconds}
        return {
            "cast": self._traced.seconds,
            **(spectra if METHODS[method].needs_spectra else {}),
            "camera": self._camera_seconds,
        }

    def _keep_photon_layers(self, field: Field, method: str) -> None:
        """Keep the layers of the default method if it is run, else the most that one has."""
        # Those kept include the radiance beside the attributes of photons.
        more = len(field.layers) >= len(self._photon_layers)
        if more or method == DEFAULT_METHOD:
            self._photon_layers = photon_layers(self._view.bands, field)


def _medians(seconds: list[dict[str, float]]) -> dict[str, float]:
    return {stage: median(each[stage] for each in seconds) for stage in seconds[0]}
