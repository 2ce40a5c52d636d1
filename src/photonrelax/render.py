"""The pipeline: stages in order, with the time and the counts of each."""

from __future__ import annotations

import json
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import __version__, _arrays
from ._arrays import Floats
from ._progress import Progress, Reporter
from .camera import MAX_DEPTH, HitPoints, direct_irradiance, trace_hit_points
from .estimate import Estimate, Field, GatherSettings
from .image import Image
from .methods import Settings, Task, check_method, prepare
from .photonmap import PhotonMap
from .raycast import RayCaster
from .relax import RelaxSettings
from .scene import Camera, Scene
from .structure import StructureSettings
from .trace import trace_photons

# Camera rays followed at a time, which bounds the memory a picture takes.
_RAYS_PER_BAND = 400_000


def render(
    scene: Scene,
    *,
    method: str = "parameterised",
    n_emitted: int = 1_000_000,
    seed: int = 0,
    structure: StructureSettings | None = None,
    relax: RelaxSettings | None = None,
    gather: GatherSettings | None = None,
    supersampling: int = 2,
    max_depth: int = 8,
    photons: PhotonMap | None = None,
    n_threads: int | None = None,
    progress: Progress | None = None,
) -> Image:
    """Render what a scene's camera sees: caustics from photons, direct light by shadow rays.

    Parameters
    ----------
    scene : Scene
        With a camera.
    method : str
        How irradiance is estimated from photons; see `photonrelax.irradiance_field`.
    n_emitted, seed : int
        Photons to emit; what shifts their sequence and chooses their paths.
    structure, relax, gather : settings, optional
        Of the stages the method has; defaults are the paper's.
    supersampling, max_depth : int
        s·s samples a pixel; smooth surfaces a camera ray may meet.
    photons : PhotonMap, optional
        Traced before; then nothing is emitted.
    n_threads : int, optional
        Threads; all available by default. The picture does not depend on it.
    progress : callable, optional
        Called as ``progress(stage, done, total)``.

    Returns
    -------
    Image
        `LAYERS`, as far as the method and the map have them; `stats` holds seconds and counts of
        each stage, `metadata` settings, seed, counts, ledger and version as text.

    Raises
    ------
    TypeError, ValueError
        If the scene has no camera, an argument is invalid, or no photon is stored.
    """
    if scene.camera is None:
        raise ValueError("scene should have a camera to be rendered")
    supersampling = _arrays.count(supersampling, "supersampling")
    max_depth = _arrays.count(max_depth, "max_depth", low=0, high=MAX_DEPTH)
    check_method(method)
    settings = Settings(structure=structure, relax=relax, gather=gather)
    pipeline = _Pipeline(scene, n_threads, progress)
    photons = pipeline.trace(n_emitted, seed) if photons is None else photons
    field = pipeline.prepare(photons, method, settings)
    layers = pipeline.picture(field, scene.camera, supersampling, max_depth)
    used = field.used | {"supersampling": supersampling, "max_depth": max_depth}
    metadata = _metadata(photons, scene=scene.name, method=method, settings=used)
    return Image(layers, metadata, pipeline.stats(photons))


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


class _Pipeline:
    """The stages, with the seconds and counts of those that ran."""

    def __init__(self, scene: Scene, n_threads: int | None, progress: Progress | None) -> None:
        self._scene = scene
        self._n_threads = _arrays.thread_count(n_threads)
        self._progress = progress
        self._stages: dict[str, dict[str, float]] = {}

    def trace(self, n_emitted: int, seed: int) -> PhotonMap:
        started = perf_counter()
        photons = trace_photons(
            self._scene, n_emitted, seed=seed, n_threads=self._n_threads, progress=self._progress
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

    def picture(
        self, field: Field, camera: Camera, supersampling: int, max_depth: int
    ) -> dict[str, Floats]:
        started = perf_counter()
        picture = _Picture(self._scene, camera, field, supersampling, max_depth)
        layers = picture.layers(self._n_threads, self._progress)
        self._finished("render", perf_counter() - started, hit_points=picture.n_hit_points)
        return layers

    def stats(self, photons: PhotonMap) -> dict[str, Any]:
        total = sum(stage["seconds"] for stage in self._stages.values())
        return {"stages": self._stages, "seconds": total, "ledger": _ledger(photons)}

    def _finished(self, stage: str, seconds: float, **counts: int) -> None:
        self._stages[stage] = {"seconds": seconds, **counts}


def _ledger(photons: PhotonMap) -> dict[str, Any] | None:
    return None if photons.ledger is None else photons.ledger.to_dict()


def _metadata(photons: PhotonMap, **others: Any) -> dict[str, str]:
    """Return what an EXR header says; as text, since its integers wrap at 32 bits."""
    values = {
        "version": __version__,
        "photons_emitted": photons.n_emitted,
        "photons_stored": len(photons),
        "ledger": _ledger(photons),
        **{name: getattr(photons, name) for name in ("seed", "sampler", "paths")},
        **others,
    }
    return {f"photonrelax.{name}": _text(value) for name, value in values.items()}


def _text(value: Any) -> str:
    """Return text as it is and anything else as JSON, which has no word for infinity but null."""
    if isinstance(value, str):
        return value
    finite = json.loads(json.dumps(value), parse_constant=lambda name: None)
    return json.dumps(finite)


class _Picture:
    """One picture in the making, band of rows by band."""

    def __init__(
        self,
        scene: Scene,
        camera: Camera,
        field: Field,
        supersampling: int,
        max_depth: int,
    ) -> None:
        self.n_hit_points = 0
        self._scene = scene
        self._camera = camera
        self._caster = RayCaster(scene.objects)
        self._supersampling = supersampling
        self._max_depth = max_depth
        self._attributes = _photon_attributes(field)
        self._densities = _weighted_densities(field, self._attributes)

    def layers(self, n_threads: int, progress: Progress | None) -> dict[str, Floats]:
        """Return all layers of the picture."""
        height, width = self._camera.height, self._camera.width
        report = Reporter(progress, "render", height)
        rows_per_band = max(_RAYS_PER_BAND // (width * self._supersampling**2), 1)
        bands = []
        for top in range(0, height, rows_per_band):
            rows = range(top, min(top + rows_per_band, height))
            bands.append(self._band(rows, n_threads))
            report.advance(len(rows))
        return {name: np.concatenate([band[name] for band in bands]) for name in bands[0]}

    def _band(self, rows: range, n_threads: int) -> dict[str, Floats]:
        hits, first = trace_hit_points(
            self._scene,
            self._caster,
            self._camera,
            rows,
            supersampling=self._supersampling,
            max_depth=self._max_depth,
            n_threads=n_threads,
        )
        self.n_hit_points += len(hits)
        shape = (len(rows), self._camera.width)
        pixel = hits.pixel - rows.start * self._camera.width
        densities = self._densities(hits.position, hits.normal)
        direct = direct_irradiance(
            self._scene, self._caster, hits.position, hits.normal, n_threads=n_threads
        )
        reflected = hits.weight * hits.albedo / np.pi
        caustic = _pixel_sums(pixel, reflected * densities[:, :3], shape)
        direct = _pixel_sums(pixel, reflected * direct, shape)
        return {
            "radiance": caustic + direct,
            "caustic": caustic,
            "direct": direct,
            "albedo": _pixel_sums(pixel, hits.weight * hits.albedo, shape),
            "N": first.normal,
            "Z": first.depth,
            **self._attribute_layers(hits, pixel, densities[:, 3:], shape),
        }

    def _attribute_layers(
        self, hits: HitPoints, pixel: NDArray, densities: Floats, shape: tuple[int, int]
    ) -> dict[str, Floats]:
        """Return the means, weighted with flux, of what the photons in each pixel carry."""
        weight = hits.weight.mean(axis=1, keepdims=True)
        sums = _pixel_sums(pixel, weight * densities, shape)
        total = sums[..., :1]
        means = np.divide(sums[..., 1:], total, out=np.zeros_like(sums[..., 1:]), where=total > 0)
        layers, first = {}, 0
        for name, values in self._attributes.items():
            layer = means[..., first : first + values.shape[1]]
            layers[name] = layer[..., 0] if values.shape[1] == 1 else layer
            first += values.shape[1]
        return layers


def _pixel_sums(pixel: NDArray, values: Floats, shape: tuple[int, int]) -> Floats:
    """Return the sums over hit points (m, c) in each pixel, (height, width, c)."""
    sums = np.zeros((shape[0] * shape[1], values.shape[1]))
    for channel, column in enumerate(values.T):
        sums[:, channel] = np.bincount(pixel, column, minlength=len(sums))
    return sums.reshape(*shape, -1)


def _photon_attributes(field: Field) -> dict[str, Floats]:
    """Return what photons carry beside flux, by layer, each (n, 1) or (n, 3)."""
    photons, attributes = field.photons, {}
    if field.structure is not None:
        attributes["photons.constraint"] = field.structure.constraint[:, np.newaxis]
    if photons.emitter_coords is not None:
        attributes["photons.emitter"] = emitter_colours(photons.emitter_coords)
    if photons.n_bounces is not None:
        attributes["photons.bounces"] = photons.n_bounces[:, np.newaxis].astype(np.float64)
    return attributes


def _weighted_densities(field: Field, attributes: dict[str, Floats]) -> Estimate:
    """Return densities of flux in three channels, mean flux, and attributes times mean flux."""
    mean = field.photons.flux.mean(axis=1, keepdims=True)
    weighted = [mean * values for values in attributes.values()]
    return field.densities(np.hstack([field.photons.flux, mean, *weighted]))


def emitter_colours(emitter_coords: Floats) -> Floats:
    """Return emitter coordinates as colours (n, 3) in [0, 1], for pictures as SJ13 Fig. 6e.

    Each coordinate is stretched over the range it has in the map; on emitter planes blue falls
    as red and green rise.
    """
    low = emitter_coords.min(axis=0, initial=np.inf)
    extent = emitter_coords.max(axis=0, initial=-np.inf) - low
    colours = np.divide(
        emitter_coords - low, extent, out=np.zeros_like(emitter_coords), where=extent > 0.0
    )
    if colours.shape[1] == 2:
        colours = np.column_stack([colours, 1.0 - colours.mean(axis=1)])
    return colours
