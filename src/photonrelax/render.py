"""The pipeline: stages in order, with the time and the counts of each."""

from __future__ import annotations

import json
from time import perf_counter
from typing import Any

import numpy as np

from . import __version__, _arrays
from ._arrays import Floats
from ._progress import Progress, Reporter
from .camera import MAX_DEPTH
from .emit import PATHS, plan_emission
from .estimate import Field
from .image import Image
from .methods import Settings, Task, check_method, frequency_share, prepare, settings_of
from .photonmap import PhotonMap
from .picture import Band, PhotonLayers, bands, joined
from .scene import Scene
from .trace import trace_photons


def render(
    scene: Scene,
    *,
    method: str = "parameterised",
    n_emitted: int = 1_000_000,
    seed: int = 0,
    sampler: str = "halton",
    supersampling: int = 2,
    max_depth: int = 8,
    photons: PhotonMap | None = None,
    n_threads: int | None = None,
    progress: Progress | None = None,
    **settings: Any,
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
    check_method(method)
    chosen = settings_of("render", settings)
    if photons is None:
        share = frequency_share(method, chosen)
        photons = pipeline.trace(n_emitted, seed=seed, sampler=sampler, frequency_share=share)
    else:
        _check_scene(photons, scene)
    field = pipeline.prepare(photons, method, chosen)
    layers = pipeline.picture(field, **view)
    metadata = photon_header(photons, scene=scene.name, method=method, settings=field.used | view)
    return Image(layers, metadata, pipeline.stats(photons))


# Emitters are aimed at spheres around objects, to which finer meshes come a little nearer.
_SAME_FLUX = 0.01

LAYERS = {
    "radiance": "caustic + direct, W/(m² sr)",
    "caustic": "radiance from photons",
    "direct": "radiance from emitters in plain sight",
    "albedo": "of the diffuse surfaces seen",
    "N": "normal of the first surface",
    "Z": "distance of the first surface along the viewing axis, m",
    "photons.constraint": "mean constraint of the photons gathered, in [0, 1]",
    "photons.emitter": "mean of their emitter coordinates as colours (SJ13 Fig. 5c)",
    "photons.bounces": "mean of their specular events",
}
"""What a picture holds; means over photons are weighted with their flux."""


def _checked_view(supersampling: int, max_depth: int) -> dict[str, int]:
    return {
        "supersampling": _arrays.count(supersampling, "supersampling"),
        "max_depth": _arrays.count(max_depth, "max_depth", low=0, high=MAX_DEPTH),
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
        aims = plan_emission(scene, len(emitted), paths).aims
    except ValueError as error:
        return f"in which they cannot have been traced: {error}"
    for number, (aim, flux) in enumerate(zip(aims, emitted, strict=True)):
        if not np.allclose(aim.flux, flux, rtol=_SAME_FLUX, atol=0.0):
            return (
                f"whose emitter {number} sends out {aim.flux.tolist()} W, "
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
        self._n_threads = _arrays.thread_count(n_threads)
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
        task = Task(photons, settings, scene, self._n_threads, self._progress)
        field = prepare(method, task)
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


def _layers(band: Band, photon_layers: PhotonLayers) -> dict[str, Floats]:
    """Return the layers of some rows, in the order of `LAYERS`."""
    fixed, of_photons = band.fixed_layers(), photon_layers(band)
    radiance = of_photons["caustic"] + fixed["direct"]
    return {"radiance": radiance, "caustic": of_photons.pop("caustic"), **fixed, **of_photons}


def _ledger(photons: PhotonMap) -> dict[str, Any] | None:
    return None if photons.ledger is None else photons.ledger.to_dict()


def photon_header(photons: PhotonMap, **others: Any) -> dict[str, str]:
    """Return what the header of a picture says, of the photons it was made from as well."""
    return header(
        photons_emitted=photons.n_emitted,
        photons_stored=len(photons),
        ledger=_ledger(photons),
        **{name: getattr(photons, name) for name in ("seed", "sampler", "paths")},
        **others,
    )


def header(**values: Any) -> dict[str, str]:
    """Return what is told of a picture as its metadata; as text, since integers of EXR headers
    wrap at 32 bits.
    """
    values = {"version": __version__, **values}
    return {f"photonrelax.{name}": _text(value) for name, value in values.items()}


def _text(value: Any) -> str:
    """Return text as it is and anything else as JSON, which has no word for infinity but null."""
    if isinstance(value, str):
        return value
    finite = json.loads(json.dumps(value), parse_constant=lambda name: None)
    return json.dumps(finite)
