"""Direct irradiance from emitters, by shadow rays."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._ext.transport.direct_light import (
    ShadowRays,
    add_unoccluded,
    emitter_samples,
    shadow_rays,
)
from .._ext.transport.materials import Materials
from .._util.parallel import for_each_slice, thread_count
from .._util.validation import Floats, float_array, unit_vectors
from ..scene.emitters import DirectLight, Emitter
from ..scene.scene import Scene
from .hidden import first_hits
from .media import Media, MediaFinder
from .optics import beer_lambert
from .raycast import RayCaster

# Clear channels of a medium absorb nothing over infinite distances either.
_FARTHEST = np.finfo(np.float64).max
# Points whose shadow rays are cast together.
_CHUNK = 32768
# Samples of extended emitters are of other random numbers than their photons.
_STREAM = 1 << 48
# Shadow rays of a pixel by which its noise in a penumbra is below 2 %.
_RAYS_OF_PIXEL = 80


class LightSamples(NamedTuple):
    """Samples of extended emitters at points.

    Attributes
    ----------
    n : int
        Samples of each extended emitter at each point.
    seed : int
        Of their random numbers.
    pixel : (m,) int64, optional
        Points of one pixel share a sequence of samples; by default each point has its own.
    """

    n: int
    seed: int = 0
    pixel: NDArray[np.int64] | None = None


def default_light_samples(scene: Scene, n_points: int) -> int:
    """Samples of extended emitters at each of n points in a pixel; 1 in scenes without any."""
    if not any(emitter.is_extended for emitter in scene.emitters):
        return 1
    return -(-_RAYS_OF_PIXEL // n_points)


def direct_irradiance(
    scene: Scene,
    caster: RayCaster,
    position: ArrayLike,
    normal: ArrayLike,
    *,
    samples: LightSamples | None = None,
    n_threads: int | None = None,
) -> Floats:
    """Return the irradiance at points from the emitters they see.

    Every object occludes, transparent ones too: light that passes through them is carried by
    photons. Surfaces of dielectrics inside of one of larger priority are not there, and do not. An
    absorbing dielectric that emitter and point both lie in absorbs. Points nearer to an emitter
    than `Scene.emitter_offset` get no light from it, because the inverse square of their distance
    is no measure of the mean over a pixel.

    Parameters
    ----------
    scene, caster : Scene, RayCaster
        The emitters, and the objects that occlude them.
    position, normal : (m, 3)
        Points on surfaces, and normals on the lit side.
    samples : LightSamples, optional
        Of extended emitters; by default so many at each point that it may be a pixel.
    n_threads : int, optional
        Threads to use; None for every core.

    Returns
    -------
    (m, 3)
        W/m².

    Raises
    ------
    TypeError, ValueError
        If shapes differ, values are not finite or a normal is zero.
    """
    position = float_array(position, "position", (None, 3))
    threads = thread_count(n_threads)
    normal = unit_vectors(normal, "normal", (len(position), 3), threads)
    total = np.zeros_like(position)
    samples = samples or LightSamples(default_light_samples(scene, 1))
    light = _DirectLight(scene, caster, samples, len(position))

    def add(rows: slice) -> None:
        light.add(total[rows], position[rows], normal[rows], rows)

    for_each_slice(add, len(position), _CHUNK, threads)
    return total


class _Source(NamedTuple):
    # An emitter of a scene, the media that it lies in, and what these absorb, 1/m.
    emitter: Emitter
    offset: float
    media: np.uint64
    absorption: Floats


class _DirectLight:
    """A scene prepared for the direct light of its emitters."""

    def __init__(self, scene: Scene, caster: RayCaster, samples: LightSamples, n: int) -> None:
        self._caster, self._samples = caster, samples
        self._materials = Materials(scene.material_table())
        if any(emitter.is_extended for emitter in scene.emitters):
            pixel = np.arange(n, dtype=np.int64) if samples.pixel is None else samples.pixel
            self._pixel, self._number = pixel, samples.n * _number_in_pixel(pixel)
        media = self._media_at_emitters(scene)
        self._sources = [
            _Source(
                emitter, scene.emitter_offset(emitter), stack, self._materials.absorption_in(stack)
            )
            for emitter, stack in zip(scene.emitters, media, strict=True)
        ]

    def _media_at_emitters(self, scene: Scene) -> Media:
        """Media at the emitters (n_emitters,), none where nothing follows from them."""
        if not (self._materials.table.absorption.any() or self._materials.has_hidden):
            return np.zeros(len(scene.emitters), dtype=np.uint64)
        return MediaFinder(scene, self._caster, self._materials).at_emitters()

    def add(self, total: Floats, position: Floats, normal: Floats, rows: slice) -> None:
        """Add the irradiance (m, 3) at points, which are rows of all, to `total`."""
        frame, m = self._caster.frame, len(position)
        for number, source in enumerate(self._sources):
            emitter = source.emitter
            lights: Iterable[DirectLight]
            if emitter.is_extended:
                n, lights = self._samples.n, self._sampled(number, position, normal, rows)
            else:
                n, lights = 1, [emitter.direct(position, source.offset)]
            for light in lights:
                checked = _checked(light, emitter, m)
                aimed = emitter.surface is not None
                rays = shadow_rays(frame, position, normal, aimed=aimed, **checked._asdict())
                self._add(total, rays, source, n)

    def _sampled(
        self, emitter_id: int, position: Floats, normal: Floats, rows: slice
    ) -> Iterator[DirectLight]:
        """Yield samples of the light of an extended emitter at points."""
        source, samples, stream = self._sources[emitter_id], self._samples, _STREAM + emitter_id
        for number in range(samples.n):
            sample = emitter_samples(
                samples.seed, stream, self._pixel[rows], self._number[rows] + number
            )
            yield source.emitter.sampled(position, normal, source.offset, sample)

    def _add(self, total: Floats, rays: ShadowRays, source: _Source, n_samples: int) -> None:
        """Add the mean irradiance of rays that are not occluded."""
        occluded = self._occluded(rays, source)
        irradiance = rays.irradiance
        # No surface lies between: all of the way is in the medium at the emitter.
        if source.absorption.any():
            irradiance *= beer_lambert(source.absorption, np.minimum(rays.distance, _FARTHEST))
        if n_samples > 1:
            irradiance /= n_samples
        add_unoccluded(total, rays.row, irradiance, occluded.view(np.uint8))

    def _occluded(self, rays: ShadowRays, source: _Source) -> NDArray[np.bool_]:
        """Mask (n,) of the shadow rays that meet a surface that is there."""
        limit = rays.distance - source.offset
        occluded = self._caster.occluded(
            rays.origin, rays.direction, limit, origin_offset=rays.origin_offset
        )
        if not self._materials.has_hidden or source.media == 0:
            return occluded
        # The same medium rules all along an unoccluded ray, whatever else is entered and left.
        rows = np.flatnonzero(occluded)
        hits, _ = first_hits(
            self._caster,
            self._materials,
            (rays.origin[rows], rays.direction[rows], rays.origin_offset[rows]),
            np.full(len(rows), source.media),
            n_threads=1,
        )
        occluded[rows] = hits.distance < limit[rows]
        return occluded


def _number_in_pixel(pixel: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number (m,) of each point among those of its pixel."""
    order = np.argsort(pixel, kind="stable")
    in_order = pixel[order]
    number = np.empty(len(pixel), dtype=np.int64)
    number[order] = np.arange(len(pixel)) - np.searchsorted(in_order, in_order)
    return number


def _checked(light: DirectLight, emitter: Emitter, m: int) -> DirectLight:
    """Light of an emitter at m points, as arrays of checked shapes."""
    name = f"{type(emitter).__name__}.{'sampled' if emitter.is_extended else 'direct'}"
    return DirectLight(
        float_array(light.direction, f"direction of {name}", (m, 3), finite=False),
        float_array(light.distance, f"distance of {name}", (m,), finite=False),
        float_array(light.irradiance, f"irradiance of {name}", (m, 3), finite=False),
    )
