"""The pipeline: stages in order, with the time and the counts of each."""

from __future__ import annotations

from time import perf_counter
from typing import Any, Unpack

import numpy as np

from .._util import validation
from .._util.parallel import thread_count
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
from ..transport.emission import PATHS, plan_emission
from ..transport.hit_points import MAX_DEPTH
from ..transport.trace import trace_photons
from .layers import PhotonLayers, _layers
from .metadata import _ledger, photon_header
from .view import bands, joined


def render(
    scene: Scene,
    *,
    method: str = DEFAULT_METHOD,
    n_emitted: int = 1_000_000,
    seed: int = 0,
    sampler: str = "halton",
    supersampling: int = 2,
    max_depth: int = 8,
    photons: PhotonMap | None = None,
    n_threads: int | None = None,
    progress: Progress | None = None,
    **settings: Unpack[StageSettings],
) -> Image:
    """Render what a scene's camera sees: caustics from photons, direct light by shadow rays.

    Parameters
    ----------
    scene : Scene
        With a camera.
    method : str
        How irradiance is estimated from photons; see `photonrelax.irradiance_field`.
    n_emitted, seed, sampler : int, int, str
        Of the photons to emit; see `photonrelax.trace_photons`.
    supersampling, max_depth : int
        s·s samples a pixel; smooth surfaces a camera ray may meet.
    photons : PhotonMap, optional
        Traced before in this scene; then nothing is emitted. They are not looked for on its
        surfaces, but those whose ledger says that other flux was emitted are refused; without a
        ledger, as after ``photons.replace(ledger=None)``, nothing is checked.
    n_threads, progress : int, callable, optional
        Threads, by default all; called as ``progress(stage, done, total)``.
    **settings
        As in `photonrelax.irradiance_field`; defaults are the papers', save for diffusion's.

    Returns
    -------
    Image
        `LAYERS`, as far as the method and the map have them; `stats` holds seconds and counts of
        each stage, `metadata` settings, seed, counts, ledger and version as text.

    Raises
    ------
    TypeError, ValueError
        If the scene has no camera, an argument is invalid, no photon is stored, or those given
        are of another scene.
    """
    pipeline = _Pipeline(scene, n_threads, progress)
    view = _checked_view(supersampling, max_depth)
    chosen = settings_of("render", dict(settings))
    share = method_named(method).frequency_share(chosen)
    if photons is None:
        photons = pipeline.trace(n_emitted, seed=seed, sampler=sampler, frequency_share=share)
    else:
        _check_scene(photons, scene)
    field = pipeline.prepare(photons, method, chosen)
    layers = pipeline.picture(field, **view)
    metadata = photon_header(photons, scene=scene.name, method=method, settings=field.used | view)
    return Image(layers, metadata, pipeline.stats(photons))


# Emitters are aimed at spheres around objects, to which finer meshes come a little nearer.
_SAME_FLUX = 0.01


def _checked_view(supersampling: int, max_depth: int) -> dict[str, int]:
    return {
        "supersampling": validation.count(supersampling, "supersampling"),
        "max_depth": validation.count(max_depth, "max_depth", low=0, high=MAX_DEPTH),
    }


def _check_scene(photons: PhotonMap, scene: Scene) -> None:
    """Raise ValueError if the scene's emitters do not send out what the photons' ledger says."""
    if photons.ledger is None or photons.paths not in PATHS:
        return
    other = _difference(photons.ledger.emitted, scene, photons.paths)
    if other:
        raise ValueError(
            f"photons should be of the scene rendered, {other}; they are taken as they are without "
            "their ledger: photons.replace(ledger=None)"
        )


def _difference(emitted: Floats, scene: Scene, paths: str) -> str:
    """Return in words how a scene differs from that which emitted such flux, "" if not."""
    if len(emitted) != len(scene.emitters):
        return f"which has {len(scene.emitters)} emitters, but are of one with {len(emitted)}"
    try:
        regions = plan_emission(scene, len(emitted), paths).regions
    except ValueError as error:
        return f"in which they cannot have been traced: {error}"
    for number, (region, flux) in enumerate(zip(regions, emitted, strict=True)):
        if not np.allclose(region.flux, flux, rtol=_SAME_FLUX, atol=0.0):
            return (
                f"whose emitter {number} sends out {region.flux.tolist()} W, "
                f"but it sent out {flux.tolist()} W for them"
            )
    return ""


class _Pipeline:
    """The stages, with the seconds and counts of those that ran."""

    def __init__(self, scene: Scene, n_threads: int | None, progress: Progress | None) -> None:
        if scene.camera is None:
            raise ValueError("scene should have a camera to be rendered")
        self._scene = scene
        self._camera = scene.camera
        self._n_threads = thread_count(n_threads)
        self._progress = progress
        self._stages: dict[str, dict[str, float]] = {}

    def trace(self, n_emitted: int, **how: Any) -> PhotonMap:
        started = perf_counter()
        photons = trace_photons(
            self._scene,
            n_emitted,
            **how,
            n_threads=self._n_threads,
            progress=self._progress,
        )
        self._finished("trace", perf_counter() - started, emitted=n_emitted, stored=len(photons))
        return photons

    def prepare(self, photons: PhotonMap, method: str, settings: Settings) -> Field:
        scene = None if photons.object_id is None else self._scene
        inputs = MethodInput(photons, settings, scene, self._n_threads, self._progress)
        field = prepare(method, inputs)
        for stage, seconds in field.seconds.items():
            self._finished(stage, seconds, photons=len(photons))
        return field

    def picture(self, field: Field, supersampling: int, max_depth: int) -> dict[str, Floats]:
        started = perf_counter()
        report = Reporter(self._progress, "render", self._camera.height)
        photon_layers = PhotonLayers(field)
        parts, n_hit_points = [], 0
        for band in bands(
            self._scene,
            self._camera,
            supersampling=supersampling,
            max_depth=max_depth,
            n_threads=self._n_threads,
        ):
            parts.append(_layers(band, photon_layers))
            n_hit_points += len(band.hits)
            report.advance(len(band.rows))
        self._finished("render", perf_counter() - started, hit_points=n_hit_points)
        return joined(parts)

    def stats(self, photons: PhotonMap) -> dict[str, Any]:
        total = sum(stage["seconds"] for stage in self._stages.values())
        return {"stages": self._stages, "seconds": total, "ledger": _ledger(photons)}

    def _finished(self, stage: str, seconds: float, **counts: int) -> None:
        self._stages[stage] = {"seconds": seconds, **counts}
