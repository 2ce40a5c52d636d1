"""Rendering: tracing, a method's preparation and its evaluation, with times and counts."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from time import perf_counter
from typing import Any, Unpack

import numpy as np

from .._util.progress import Progress, Reporter
from .._util.validation import Floats
from ..estimation.field import Field
from ..estimation.methods import (
    DEFAULT_METHOD,
    MethodInput,
    Settings,
    StageSettings,
    method_named,
    prepare,
    settings_of,
)
from ..imaging.image import Image
from ..photons.photon_map import PhotonMap
from ..scene.scene import Scene
from ..transport.emission import PATHS, SAMPLERS, EmissionPlan, plan_emission
from ..transport.trace import trace_photons
from .layers import FieldEstimates, band_layers, with_radiance
from .metadata import ledger_values, photon_metadata
from .view import View, concatenate_bands


def render(
    scene: Scene,
    *,
    method: str = DEFAULT_METHOD,
    n_emitted: int = 1_000_000,
    seed: int = 0,
    sampler: str = "halton",
    supersampling: int = 2,
    max_depth: int = 8,
    light_samples: int | None = None,
    photons: PhotonMap | None = None,
    n_threads: int | None = None,
    progress: Progress | None = None,
    **settings: Unpack[StageSettings],
) -> Image:
    """Render the view of a scene's camera: caustics from photons, direct light by shadow rays.

    Parameters
    ----------
    scene : Scene
        With a camera.
    method : str
        Estimate of irradiance from photons; see `photonrelax.irradiance_field`.
    n_emitted, seed, sampler : int, int, str
        Of the photons to emit; see `photonrelax.trace_photons`.
    supersampling, max_depth : int
        s·s samples a pixel; maximum number of specular surfaces on a camera path.
    light_samples : int, optional
        Shadow rays from each of these samples to each extended emitter; by default enough for noise
        below 2 % of a pixel.
    photons : PhotonMap, optional
        Photons traced before in this scene, in place of new ones; those on sensors are left out.
        They are refused if their ledger has other emitted flux than the scene; without one, as
        after ``photons.replace(ledger=None)``, nothing is checked.
    n_threads, progress : int, callable, optional
        Threads, by default all; called as ``progress(stage, done, total)``.
    **settings
        As in `photonrelax.irradiance_field`; defaults are the papers', except those of diffusion.

    Returns
    -------
    Image
        Layers as in `photonrelax.rendering.layers.LAYERS`; those of photon attributes that the
        photons or the method do not have are missing. `stats` holds seconds and counts of each
        stage, `metadata` settings, seed, counts, ledger and version as text.

    Raises
    ------
    TypeError, ValueError
        If an argument is invalid, no photon is stored, or those given are of another scene.
    """
    view = View(
        scene,
        supersampling=supersampling,
        max_depth=max_depth,
        light_samples=light_samples,
        seed=seed,
        n_threads=n_threads,
    )
    stages = _Stages(view, progress)
    chosen = settings_of("render", dict(settings))
    share = method_named(method).frequency_share(chosen)
    if photons is None:
        photons = stages.trace(n_emitted, seed=seed, sampler=sampler, frequency_share=share)
    else:
        _check_scene(photons, scene)
        photons = on_surfaces(photons)
    field = stages.prepare(photons, method, chosen)
    used = field.used | view.settings
    metadata = photon_metadata(photons, scene=scene.name, method=method, settings=used)
    return Image(stages.render(field), metadata, stages.stats(photons))


# Relative. Emission regions are spheres around objects, which finer meshes fill a little more.
_SAME_FLUX = 0.01


def _check_scene(photons: PhotonMap, scene: Scene) -> None:
    """Raise ValueError if the emitters of a scene do not emit the flux of the photons' ledger."""
    if not isinstance(photons, PhotonMap):
        raise TypeError(
            f"photons should be a PhotonMap, but is {type(photons).__name__}; "
            "the number to trace is n_emitted"
        )
    ledger, paths, sampler = photons.ledger, photons.paths, photons.sampler
    if ledger is None or paths not in PATHS or sampler not in SAMPLERS:
        return
    # As many photons, as they decide on the emission regions; these are not traced.
    n_emitted = max(photons.n_emitted or 0, len(ledger.emitted))
    plan = partial(plan_emission, scene, n_emitted, paths, seed=photons.seed or 0, sampler=sampler)
    other = _difference(ledger.emitted, len(scene.emitters), plan)
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


class _Stages:
    """The stages of a render, with the seconds and counts of those that ran."""

    def __init__(self, view: View, progress: Progress | None) -> None:
        self._view = view
        self._progress = progress
        self._stages: dict[str, dict[str, float]] = {}

    def trace(self, n_emitted: int, **options: Any) -> PhotonMap:
        view = self._view
        started = perf_counter()
        photons = trace_photons(
            view.scene,
            n_emitted,
            **options,
            n_threads=view.n_threads,
            progress=self._progress,
            caster=view.caster,
            sensors=False,
        )
        self._record("trace", perf_counter() - started, emitted=n_emitted, stored=len(photons))
        return photons

    def prepare(self, photons: PhotonMap, method: str, settings: Settings) -> Field:
        view = self._view
        # Photons of unknown objects cannot be held on these.
        scene = None if photons.object_id is None else view.scene
        inputs = MethodInput(photons, settings, scene, view.n_threads, self._progress)
        field = prepare(method, inputs)
        for stage, seconds in field.seconds.items():
            self._record(stage, seconds, photons=len(photons))
        return field

    def render(self, field: Field) -> dict[str, Floats]:
        started = perf_counter()
        report = Reporter(self._progress, "render", self._view.camera.height)
        estimates = FieldEstimates(field)
        parts, n_hit_points = [], 0
        for band in self._view.bands():
            parts.append(with_radiance(band_layers(band, estimates(band))))
            n_hit_points += len(band.hits)
            report.advance(len(band.rows))
        self._record("render", perf_counter() - started, hit_points=n_hit_points)
        return concatenate_bands(parts)

    def stats(self, photons: PhotonMap) -> dict[str, Any]:
        total = sum(stage["seconds"] for stage in self._stages.values())
        return {"stages": self._stages, "seconds": total, "ledger": ledger_values(photons)}

    def _record(self, stage: str, seconds: float, **counts: int) -> None:
        self._stages[stage] = {"seconds": seconds, **counts}
