"""Methods on one photon map, seen at the same points, measured against the same reference."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np

from .. import __version__, _arrays, measures
from .._arrays import Floats
from .._progress import Progress, prefixed
from ..camera import MAX_DEPTH
from ..estimate import Field
from ..image import Image, srgb
from ..measures import Errors
from ..methods import METHODS, Settings, Task, check_method, frequency_share, prepare
from ..photonmap import PhotonMap
from .subject import Subject
from .view import View

METHODS_OF_SJ13 = ("standard", "relaxation", "diffusion", "parameterised", "progressive")
"""What SJ13's Table I compares, in its order."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """What is to be compared, and how.

    Attributes
    ----------
    subject : Subject
        What photons are of, and seen on: `SceneSubject` or `DistributionSubject`.
    methods : tuple of str
        By default those of `METHODS_OF_SJ13` that there are.
    n_emitted, seed, sampler : int, int, str
        Of the photons, which all methods share; see `photonrelax.trace_photons`.
    settings : Settings
        Of the stages of all methods.
    supersampling, max_depth : int
        s·s samples a pixel; smooth surfaces a camera ray may meet.
    exposure : float
        Pictures are shown, and SSIM and FLIP measured, times 2^exposure.
    n_threads : int, optional
        Threads; all available by default. Only times depend on it.

    Raises
    ------
    TypeError, ValueError
        If a method is not known or a number is out of its range.
    """

    subject: Subject
    methods: tuple[str, ...] = ()
    n_emitted: int = 1_000_000
    seed: int = 0
    sampler: str = "halton"
    settings: Settings = field(default_factory=Settings)
    supersampling: int = 2
    max_depth: int = 8
    exposure: float = 0.0
    n_threads: int | None = None

    def __post_init__(self) -> None:
        methods = tuple(dict.fromkeys(self.methods)) or tuple(
            name for name in METHODS_OF_SJ13 if name in METHODS
        )
        for method in methods:
            check_method(method)
        object.__setattr__(self, "methods", methods)
        _arrays.count(self.n_emitted, "n_emitted")
        _arrays.count(self.supersampling, "supersampling")
        _arrays.count(self.max_depth, "max_depth", low=0, high=MAX_DEPTH)


@dataclass(frozen=True, eq=False)
class Entry:
    """One method: its picture, how long it took, how far it is from the reference.

    Attributes
    ----------
    method : str
        Its name.
    image : Image
        The layers of a picture, ``difference`` from the reference and ``flip``.
    n_emitted, n_stored : int
        Photons it used.
    seconds : dict
        Of its stages in order; those before its own, ``cast`` and ``camera``, ran once for all
        methods that share photons.
    settings : dict
        It used, by stage.
    errors : Errors
        Of the caustic, and of the picture on a display.
    """

    method: str
    image: Image
    n_emitted: int
    n_stored: int
    seconds: dict[str, float]
    settings: dict[str, Any]
    errors: Errors


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
    photon_layers : dict
        ``caustic`` and what photons carry (`photonrelax.picture.PhotonLayers`).
    """

    plan: Plan
    entries: tuple[Entry, ...]
    reference: Image
    about_reference: str
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
            "methods": {entry.method: _told(entry) for entry in self.entries},
        }


_TOLD = ("n_emitted", "seed", "sampler", "supersampling", "max_depth", "exposure")


def _told(entry: Entry) -> dict[str, Any]:
    told = {
        "n_emitted": entry.n_emitted,
        "n_stored": entry.n_stored,
        "seconds": entry.seconds,
        "total_seconds": sum(entry.seconds.values()),
        "errors": entry.errors.to_dict(),
        "settings": entry.settings,
    }
    # JSON has no word for infinity but null.
    finite: dict[str, Any] = json.loads(json.dumps(told), parse_constant=lambda name: None)
    return finite


def compare(plan: Plan, reference: Image, *, progress: Progress | None = None) -> Comparison:
    """Trace photons once, find the points of the picture once, and evaluate every method.

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
        If the reference has another size or is black, or no photon is stored.
    ImportError
        If what measures errors is not installed.
    """
    measures.check_installed()
    check_reference(reference, plan)
    started = perf_counter()
    photons = plan.subject.photons(
        plan.n_emitted,
        seed=plan.seed,
        sampler=plan.sampler,
        frequency_share=max(frequency_share(method, plan.settings) for method in plan.methods),
        n_threads=plan.n_threads,
        progress=progress,
    )
    bench = _Bench(plan, photons, perf_counter() - started, reference, progress)
    entries = tuple(bench.entry(method) for method in plan.methods)
    about = reference.metadata.get(ABOUT, "a picture given")
    return Comparison(plan, entries, reference, about, bench.photon_layers)


ABOUT = "photonrelax.reference"
"""Where the metadata of a reference say what it is."""


def check_reference(reference: Image, plan: Plan) -> None:
    """Raise ValueError if a reference does not show what is compared."""
    if "radiance" not in reference.layers:
        raise ValueError(
            f"the reference should have channels R, G and B, but has {sorted(reference.layers)}"
        )
    height, width = np.shape(reference.layers["radiance"])[:2]
    if (width, height) != plan.subject.size:
        wanted = " x ".join(map(str, plan.subject.size))
        raise ValueError(
            f"the reference should have {wanted} pixels as the pictures have, "
            f"but has {width} x {height}"
        )


class _Bench:
    """What all methods share, and what is kept of those that ran."""

    def __init__(
        self,
        plan: Plan,
        photons: PhotonMap,
        cast_seconds: float,
        reference: Image,
        progress: Progress | None,
    ) -> None:
        self.photon_layers: dict[str, Floats] = {}
        self._plan = plan
        self._photons = photons
        self._progress = progress
        self._view = plan.subject.view(
            plan.supersampling,
            plan.max_depth,
            n_threads=plan.n_threads,
            progress=progress,
        )
        self._shared = {"cast": cast_seconds, "camera": self._view.seconds}
        self._truth = _Truth(reference, self._view, plan.exposure)

    def entry(self, method: str) -> Entry:
        """Run a method."""
        plan, progress = self._plan, prefixed(self._progress, method)
        started = perf_counter()
        task = Task(self._photons, plan.settings, plan.subject.scene, plan.n_threads, progress)
        field = prepare(method, task)
        prepared = perf_counter()
        caustic = self._view.caustic(field, progress)
        now = perf_counter()
        # Trees that nothing but gathering needs are part of it.
        trees = max(prepared - started - sum(field.seconds.values()), 0.0)
        self._keep_photon_layers(field, method)
        image, errors = self._truth.measured(caustic)
        return Entry(
            method,
            image,
            plan.n_emitted,
            len(self._photons),
            self._shared | field.seconds | {"gather": now - prepared + trees},
            field.used,
            errors,
        )

    def _keep_photon_layers(self, field: Field, method: str) -> None:
        """Keep what the photons carry: SJ13's if they are there, else with constraints if known."""
        kept = self.photon_layers
        more = field.structure is not None and "photons.constraint" not in kept
        if not kept or more or method == "parameterised":
            self.photon_layers = self._view.photon_layers(field)


class _Truth:
    """The reference, ready to be measured against."""

    def __init__(self, reference: Image, view: View, exposure: float) -> None:
        self._fixed = view.fixed
        self._radiance = np.asarray(reference.layers["radiance"])
        self._caustic = np.asarray(
            reference.layers.get("caustic", self._radiance - view.fixed["direct"])
        )
        self._scale = 2.0**exposure
        self._shown = srgb(self._scale * self._radiance)

    def measured(self, caustic: Floats) -> tuple[Image, Errors]:
        """Return the picture with its difference from the truth, and its errors."""
        radiance = caustic + self._fixed["direct"]
        shown = srgb(self._scale * radiance)
        flip = measures.flip_map(shown, self._shown)
        errors = Errors(
            relative_l1=measures.relative_l1(caustic, self._caustic),
            relative_l2=measures.relative_l2(caustic, self._caustic),
            energy_bias=measures.energy_bias(caustic, self._caustic),
            ssim=measures.ssim(shown, self._shown),
            flip=float(flip.mean()),
        )
        made = {"difference": radiance - self._radiance, "flip": flip}
        return Image({"radiance": radiance, "caustic": caustic, **self._fixed, **made}), errors
