"""Rendering: tracing, a method's preparation and its evaluation, with times and counts."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import Executor
from dataclasses import asdict, replace
from functools import partial
from time import perf_counter
from typing import Any, NamedTuple, Unpack

import numpy as np

from .._util.progress import Progress, Reporter
from .._util.validation import Floats, check_choice, check_seed, count
from .._util.workers import Workers, checked_executor
from ..estimation.envelope.envelope import EnvelopeSettings
from ..estimation.envelope.field import EnvelopeField
from ..estimation.field import Field
from ..estimation.indirect import IndirectField, widening_settings
from ..estimation.methods import (
    MethodInput,
    Settings,
    StageSettings,
    method_named,
    prepare,
    settings_of,
)
from ..estimation.nearest import GatherSettings
from ..imaging.image import Image
from ..photons.photon_map import NothingStoredError, PhotonMap
from ..scene.digest import light_digest
from ..scene.scene import Scene
from ..transport.direct_light import samples_light
from ..transport.emission import PATHS, SAMPLERS, EmissionPlan, plan_emission
from ..transport.trace import trace_photons
from .bands import BandRenderer
from .budget import check_render_fits, kept_limit, rays_within
from .envelope_target import (
    DivisionLimits,
    EnvelopeAttempt,
    Parts,
    divide_to_goal,
    envelope_summary,
)
from .error_target import Goal, render_to_goal
from .final_gather import FinalGather
from .metadata import ledger_values, metadata, photon_metadata
from .plan import Plan, plan
from .presets import Choice, choose, work_of
from .view import View, concatenate_bands


class RenderSettings(StageSettings, total=False):
    """Settings of the stages and of the camera, what a render is to reach and may take.

    Attributes
    ----------
    supersampling : int
        s·s samples a pixel, by default 2.
    max_depth : int
        Maximum number of specular surfaces on a camera path, by default 8.
    crop : (int, int, int, int)
        x0, y0, x1 and y1 of the pixels [x0, x1) × [y0, y1) to render, from the upper left, which
        are those of the whole image; by default all.
    light_samples : int
        Shadow rays from a sample to an extended emitter, or to all of many lamps, by default enough
        for noise below 2 % of a pixel.
    indirect : GatherSettings
        Of indirect light, see `photonrelax.estimation.indirect`.
    final_gather : int
        Rays of a final gather from each piece of surface in a pixel, see
        `photonrelax.rendering.final_gather`, by default 0 for none.
    preset : str
        Method, photons, samples and settings, where they are not given; see
        `photonrelax.rendering.presets`.
    error : float
        Relative L1 of ``radiance`` over pixels: photons are added until the estimate of it,
        see `photonrelax.rendering.error_target`, is not more.
    seconds : float
        Time after which no more photons are added.
    memory : float
        Bytes, by default nine tenths of what is free.
    """

    supersampling: int | None
    max_depth: int
    crop: tuple[int, int, int, int] | None
    light_samples: int | None
    indirect: GatherSettings | None
    final_gather: int
    preset: str | None
    error: float | None
    seconds: float | None
    memory: float | None


def render(
    scene: Scene,
    *,
    method: str | None = None,
    n_emitted: int | None = None,
    n_global: int | None = None,
    components: Iterable[str] | None = None,
    seed: int = 0,
    sampler: str = "halton",
    photons: PhotonMap | None = None,
    n_threads: int | None = None,
    progress: Progress | None = None,
    executor: Executor | None = None,
    **settings: Unpack[RenderSettings],
) -> Image:
    """Render the view of a scene's camera: direct light, caustics and indirect light.

    Parameters
    ----------
    scene, method : Scene, str
        With a camera; the estimate of caustics from photons, see `photonrelax.irradiance_field`.
    n_emitted, n_global, components : int, int, iterable of str
        Photons to emit for caustics, by default a million, and for indirect light, light to model;
        see `photonrelax.plan`.
    seed, sampler : int, str
        Of the photons; see `photonrelax.trace_photons`.
    photons : PhotonMap, optional
        Photons of caustics traced before in this scene, in place of new ones; see `check_scene`.
    n_threads, progress : int, callable, optional
        Threads, by default all; called as ``progress(stage, done, total)``.
    executor : concurrent.futures.Executor, optional
        Traces photons and renders bands of rows in its workers; see docs/scaling.md.
    **settings
        See `RenderSettings`; stages' are those of `photonrelax.irradiance_field`.

    Returns
    -------
    Image
        Layers of `photonrelax.rendering.layers.LAYERS`, of what is modelled; seconds and counts of
        the stages in `stats`; settings, ledger, version and what else made it in `metadata`.

    Raises
    ------
    TypeError, ValueError
        If an argument is invalid, no photon of a caustic is stored, or those given do not fit.
    MemoryError
        If more memory is estimated to be taken than may be.
    """
    goal = Goal(settings.pop("error", None), settings.pop("seconds", None))
    name = settings.pop("preset", None)
    choice = _chosen(scene, method, name, goal)
    view = _view(scene, choice, settings, seed=seed, n_threads=n_threads)
    light = _Light(photons, n_global, components)
    workers = Workers(checked_executor(executor), n_threads or 1)
    job = _Job(view, choice, light, partial(_Stages, progress, workers, sampler=sampler), settings)
    n_emitted = choice.n_emitted if n_emitted is None else n_emitted
    if not goal.is_given:
        return job.image(n_emitted, seed)
    return job.to_goal(goal, n_emitted, seed, is_free=method is None and name is None)


def _chosen(scene: Scene, method: str | None, name: str | None, goal: Goal) -> Choice:
    choice = choose(scene, method, name, goal.preset_error)
    if goal.is_given:
        # Errors of samples alone are in no estimate.
        choice = replace(choice, supersampling=max(choice.supersampling, _LEAST_SAMPLES))
    return choice


def _view(scene: Scene, choice: Choice, settings: RenderSettings, **others: Any) -> View:
    """View of a scene by the settings of its camera, which are taken from all settings."""
    s = settings.pop("supersampling", None)
    return View(
        scene,
        supersampling=choice.supersampling if s is None else s,
        max_depth=settings.pop("max_depth", 8),
        light_samples=settings.pop("light_samples", None),
        crop=settings.pop("crop", None),
        **others,
    )


class _Light(NamedTuple):
    """Light to model and photons of it; see `render`."""

    photons: PhotonMap | None
    n_global: int | None
    components: Iterable[str] | None


class _Job:
    """Renders of one view with one choice of settings, by any number of photons."""

    def __init__(
        self,
        view: View,
        choice: Choice,
        light: _Light,
        stages: Callable[..., _Stages],
        settings: RenderSettings,
    ) -> None:
        self._view, self._choice, self._light, self._stages = view, choice, light, stages
        self._memory = settings.pop("memory", None)
        self._indirect: GatherSettings | Callable[[int], GatherSettings] | None
        self._indirect = settings.pop("indirect", None)
        self._final_gather = settings.pop("final_gather", 0)
        given = settings_of("render", dict(settings)).given
        self._given, self._has_given = choice.settings.given | given, bool(given)

    def image(
        self,
        n_emitted: int,
        seed: int,
        method: str | None = None,
        light: _Light | None = None,
        **changed: EnvelopeSettings,
    ) -> Image:
        """Image by a number of photons and a seed; other method, light or settings if given."""
        view, method = self._view, method or self._choice.method
        settings = Settings(**self._given | changed)
        stages = self._stages(view if seed == view.seed else view.variant(seed=seed), seed=seed)
        stages.plan(light or self._light, n_emitted)
        settings = stages.fitted(method, settings, self._memory)
        stages.prepare_caustic(method, settings)
        stages.prepare_indirect(self._indirect, self._final_gather)
        return stages.image(method)

    def to_goal(self, goal: Goal, n_emitted: int, seed: int, *, is_free: bool) -> Image:
        """Image by as many photons, or as finely divided envelopes, as reach a goal.

        The method follows from the scene if it `is_free`, unless settings are given.
        """
        if self._light.photons is not None:
            raise ValueError(
                "photons should not be given with error or seconds, which trace their own"
            )
        self._view.keep_bands(kept_limit(self._memory))
        # So that the error of indirect light falls with photons.
        self._indirect = self._indirect or widening_settings
        envelope = self._given.get("envelope", EnvelopeSettings())

        def divide(limits: DivisionLimits, only: Iterable[str] | None) -> Image:
            changed = limits.applied_to(envelope)
            return self._of_goal(n_emitted, seed, only, "envelope", envelope=changed)

        # A final gather needs the light of caustics too.
        is_whole = self._final_gather > 0
        scene, components = self._view.scene, self._light.components
        parts = Parts.of(scene, divide, self._of_goal, components, is_whole=is_whole)
        if not method_named(self._choice.method).needs_photons:
            return divide_to_goal(parts, goal, seed)
        is_free = is_free and not self._has_given and not is_whole
        other = EnvelopeAttempt(parts, work_of(scene), seed) if is_free else None
        return render_to_goal(self._of_goal, goal, n_emitted, seed, "radiance", alternative=other)

    def _of_goal(
        self,
        n_emitted: int,
        seed: int,
        only: Iterable[str] | None = None,
        method: str | None = None,
        **changed: EnvelopeSettings,
    ) -> Image:
        """Image of some components; photons of indirect light are as many, unless given."""
        light = self._light
        light = light._replace(
            n_global=n_emitted if light.n_global is None else light.n_global,
            components=light.components if only is None else only,
        )
        return self.image(n_emitted, seed, method, light, **changed)


# Samples a side of pixels whose error is estimated, at least.
_LEAST_SAMPLES = 2
# Far more than any gather needs.
_MOST_RAYS = 65536
# Relative. Emission regions are spheres around objects, which finer meshes fill a little more.
_SAME_FLUX = 0.01


def check_scene(photons: PhotonMap, scene: Scene) -> None:
    """Raise ValueError if the photons are of another scene.

    Its digest tells, if they have one, or else the flux of their ledger, if its emitters do not
    emit it. Without a ledger, as after ``photons.replace(ledger=None)``, nothing is checked.
    """
    if not isinstance(photons, PhotonMap):
        raise TypeError(
            f"photons should be a PhotonMap, but is {type(photons).__name__}; "
            "the number to trace is n_emitted"
        )
    if photons.emitted_ranges is not None:
        raise ValueError(
            "photons should be of a whole emission, but are of the ranges "
            f"{photons.emitted_ranges.tolist()} of {photons.n_emitted}: join its parts by "
            "PhotonMap.concatenate"
        )
    ledger, paths, sampler = photons.ledger, photons.paths, photons.sampler
    if ledger is None or paths not in PATHS or sampler not in SAMPLERS:
        return
    if photons.scene_digest == light_digest(scene):
        return
    # As many photons of each emitter, as they decide on the emission regions; none are traced.
    n_emitted = np.sum(list(ledger.ends.values()), axis=0).tolist()
    plan = partial(plan_emission, scene, n_emitted, paths, seed=photons.seed or 0, sampler=sampler)
    other = _difference(ledger.emitted, len(scene.emitters), plan)
    if not other and photons.scene_digest is not None:
        other = "which sends out the same flux, but differs in objects or emitters from theirs"
    if other:
        raise ValueError(
            f"photons should be of the scene rendered, {other}; they are taken as they are without "
            "their ledger: photons.replace(ledger=None)"
        )


def _difference(emitted: Floats, n_emitters: int, plan: Callable[[], EmissionPlan]) -> str:
    """Description of the difference between a scene and that which emitted a flux, "" if none."""
    if len(emitted) != n_emitters:
        return f"which has {n_emitters} emitters, but are of one with {len(emitted)}"
    try:
        sent = plan().flux
    except ValueError as error:
        return f"in which they cannot have been traced: {error}"
    same = np.isclose(sent, emitted, rtol=_SAME_FLUX, atol=0.0).all(axis=1)
    if same.all():
        return ""
    number = int(same.argmin())
    return (
        f"whose emitter {number} sends out {sent[number].tolist()} W, "
        f"but it sent out {emitted[number].tolist()} W for them"
    )


def on_surfaces(photons: PhotonMap) -> PhotonMap:
    """Photons without those on sensors, which cameras do not see."""
    on_sensor = photons.on_sensor
    return photons.subset(~on_sensor) if on_sensor.any() else photons


def _joined(maps: list[PhotonMap]) -> PhotonMap:
    """Positions, normals and flux of the photons of several maps."""
    names = ("position", "normal", "flux")
    return PhotonMap(*(np.concatenate([getattr(each, name) for each in maps]) for name in names))


class _Stages:
    """The stages of a render, with the seconds and counts of those that ran."""

    _plan: Plan

    def __init__(
        self, progress: Progress | None, workers: Workers, view: View, **sequence: Any
    ) -> None:
        self._view = view
        self._progress = progress
        self._workers = workers
        check_seed(sequence["seed"])
        check_choice(sequence["sampler"], "sampler", SAMPLERS)
        self._sequence = sequence
        self._stages: dict[str, dict[str, float]] = {}
        self._photons: PhotonMap | None = None
        self._caustic: Field | None = None
        self._indirect: IndirectField | None = None
        self._gather: FinalGather | None = None

    def plan(self, light: _Light, n_emitted: int) -> None:
        view = self._view
        if light.photons is not None:
            check_scene(light.photons, view.scene)
            self._photons = on_surfaces(light.photons)
        self._plan = plan(
            view.scene,
            n_emitted=n_emitted,
            **light._asdict(),
            caster=view.caster,
            n_threads=view.n_threads,
        )

    def fitted(self, method: str, settings: Settings, memory: float | None) -> Settings:
        """Settings with as many rays of envelopes as fit, where others are not asked for.

        Raises MemoryError if more memory is estimated to be taken than may be.
        """
        record = method_named(method)
        n_emitted = self._plan.n_emitted if record.needs_photons else 0
        emitted = {"caustic": n_emitted, "indirect": self._plan.n_global}
        n_given = 0 if self._photons is None or not record.needs_photons else len(self._photons)
        envelope = settings.of("envelope")
        n_rays = envelope.n_rays_certain
        if not (record.needs_photons or n_rays):
            most = rays_within(self._view, envelope.n_rays, memory)
            if most != envelope.n_rays:
                n_rays = most or 0
                changed = replace(envelope, n_rays=most)
                settings = Settings(**{**settings.given, "envelope": changed})
        check_render_fits(self._view, emitted, memory, n_given=n_given, n_rays=n_rays)
        return settings

    def prepare_caustic(self, method: str, settings: Settings) -> None:
        """Trace the photons of caustics, unless they are given, and prepare their field."""
        record = method_named(method)
        share = record.frequency_share(settings)
        if not self._plan.models("caustic"):
            return
        if not record.needs_photons:
            self._prepare(method, None, self._to_pixels(settings))
            return
        if self._photons is None:
            n = self._plan.n_emitted
            self._photons = self._trace("trace", n, frequency_share=share)
        self._prepare(method, self._photons, settings)

    def _to_pixels(self, settings: Settings) -> Settings:
        """Settings of envelopes resolved to pixels, with photons as planned, if none are given."""
        given = settings.of("envelope")
        changed = replace(
            given,
            footprint=given.footprint or self._view.pixel_side(),
            n_photons=given.n_photons or self._plan.n_emitted or None,
        )
        return Settings(**{**settings.given, "envelope": changed})

    def _prepare(self, method: str, photons: PhotonMap | None, settings: Settings) -> None:
        view = self._view
        # Photons of unknown objects cannot be held on these.
        known = photons is None or photons.object_id is not None
        scene = view.scene if known else None
        inputs = MethodInput(
            photons, settings, scene, view.n_threads, self._progress, caster=view.caster
        )
        self._caustic = prepare(method, inputs)
        n_photons = {} if photons is None else {"photons": len(photons)}
        for stage, seconds in self._caustic.seconds.items():
            self._record(stage, seconds, **n_photons)

    def prepare_indirect(
        self, settings: GatherSettings | Callable[[int], GatherSettings] | None, n_rays: int
    ) -> None:
        """Trace the photons of indirect light, if there is any, and prepare their estimates.

        Settings may depend on the number of photons stored.
        """
        n_rays = count(n_rays, "final_gather", low=0, high=_MOST_RAYS)
        if not self._plan.models("indirect"):
            return
        try:
            photons = self._trace("trace indirect", self._plan.n_global, paths="global")
        except NothingStoredError as error:
            photons = error.photons
            self._record("trace indirect", 0.0, emitted=self._plan.n_global, stored=0)
        started, view = perf_counter(), self._view
        if callable(settings):
            settings = settings(len(photons))
        self._indirect = IndirectField(
            photons, settings, scene=view.scene, n_threads=view.n_threads
        )
        self._record("indirect", perf_counter() - started, photons=len(photons))
        if n_rays:
            caustic = self._photons
            if isinstance(self._caustic, EnvelopeField) and len(photons):
                # As bright as those of indirect light, with which they are gathered.
                n_photons = round(self._caustic.flux.sum() / photons.flux.sum() * len(photons))
                n_photons = min(max(n_photons, 1), self._plan.n_emitted)
                caustic = self._caustic.envelope.photons(n_photons, n_threads=view.n_threads)
            maps = [photons] if caustic is None else [photons, caustic]
            self._gather = FinalGather(view, _joined(maps), n_rays, self._sequence["seed"])

    def _trace(self, stage: str, n_emitted: int, **options: Any) -> PhotonMap:
        view = self._view
        started = perf_counter()
        photons = trace_photons(
            view.scene,
            n_emitted,
            **self._sequence,
            **options,
            n_threads=view.n_threads,
            progress=self._progress,
            caster=view.caster,
            sensors=False,
            executor=self._workers.executor,
        )
        self._record(stage, perf_counter() - started, emitted=n_emitted, stored=len(photons))
        return photons

    def image(self, method: str) -> Image:
        """Image of the view, with all that is known of it."""
        layers = self._layers()
        total = sum(stage["seconds"] for stage in self._stages.values())
        stats = {"stages": self._stages, "seconds": total, "ledger": self._ledger()}
        if isinstance(self._caustic, EnvelopeField):
            stats["envelope"] = envelope_summary(self._caustic)
        return Image(layers, self._metadata(method), stats)

    def _ledger(self) -> dict[str, Any] | None:
        """Balance of the flux of caustics, for JSON; None if it is not known."""
        if isinstance(self._caustic, EnvelopeField):
            ledger = self._caustic.envelope.ledger._asdict()
            return {name: flux.tolist() for name, flux in ledger.items()}
        return None if self._photons is None else ledger_values(self._photons)

    def _layers(self) -> dict[str, Floats]:
        started, view = perf_counter(), self._view
        report = Reporter(self._progress, "render", view.shape[0])
        models = self._plan.models("direct"), self._plan.models("emission")
        renderer = BandRenderer(view, *models, self._caustic, self._gather or self._indirect)
        parts, n_hit_points = [], 0
        at_once = self._bands_at_once()
        with self._workers.or_threads(at_once) as workers:
            rows = view.row_ranges(workers.n_tasks, at_once)
            for band in workers.map(BandRenderer.layers, renderer, rows):
                parts.append(band.layers)
                n_hit_points += band.n_hit_points
                report.advance(len(band.layers["albedo"]))
        self._record("render", perf_counter() - started, hit_points=n_hit_points)
        return concatenate_bands(parts)

    def _bands_at_once(self) -> int:
        """Bands that threads render in turn; one that all render where it may take long.

        An interrupt waits for those under way.
        """
        view = self._view
        is_long = self._gather is not None or samples_light(view.scene, view.light_samples)
        return 1 if is_long or self._workers.executor is not None else view.n_threads

    def _metadata(self, method: str) -> dict[str, str]:
        used = {} if self._caustic is None else self._caustic.used
        others: dict[str, Any] = {}
        if self._indirect is not None:
            used = used | {"indirect": asdict(self._indirect.settings)}
            counts = self._stages["trace indirect"]
            others = {f"indirect_{name}": counts[name] for name in ("emitted", "stored")}
        others["settings"] = used | self._view.settings
        others |= {"scene": self._view.scene.name, "method": method}
        if self._photons is None:
            return metadata(**self._sequence, ledger=self._ledger(), **others)
        return photon_metadata(self._photons, **others)

    def _record(self, stage: str, seconds: float, **counts: int) -> None:
        self._stages[stage] = {"seconds": seconds, **counts}
