"""Direct irradiance from emitters, by shadow rays.

Few lamps, which are points or parallel light, are summed; of many some are chosen at each point, by
the light that they bring (`photonrelax._ext.transport.light_tree`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from copy import copy
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._ext.transport.direct_light import (
    ShadowRays,
    add_unoccluded,
    emitter_samples,
    shadow_rays,
)
from .._ext.transport.light_tree import LightTree, sample_shifts, sampled_shadow_rays
from .._ext.transport.materials import Materials
from .._util.parallel import for_each_slice, thread_count
from .._util.validation import Floats, float_array, unit_vectors
from ..scene.emitters import DirectLight, Emitter
from ..scene.lamps import PARALLEL, UNIFORM, LampTable
from ..scene.scene import Scene
from .hidden import first_hits
from .light_tree import light_tree
from .media import Media, media_at_emitters
from .optics import beer_lambert
from .raycast import RayCaster

# Clear channels of a medium absorb nothing over infinite distances either.
_FARTHEST = np.finfo(np.float64).max
# Points whose shadow rays are cast together.
_CHUNK = 32768
# Samples of extended emitters are of other random numbers than their photons.
_STREAM = 1 << 48
# Shadow rays of a pixel by which its noise in a penumbra is below 2 %: to an extended emitter, and
# to many lamps together: that shine in all directions, that are aimed alike, and aimed
# in others, of which walls may hide half and of which neighbours have less in common.
_RAYS_OF_PIXEL, _POINTS_OF_PIXEL, _AIMED_OF_PIXEL, _SCATTERED_OF_PIXEL = 80, 48, 64, 192
# Length of the mean axis of lamps that are aimed alike.
_ALIKE = 0.99
# Lamps up to which all are summed, and lamps for each sample: about as long takes their choice.
_MOST_SUMMED, _SUMMED_PER_SAMPLE = 32, 2


class LightSamples(NamedTuple):
    """Samples of extended emitters, and of many lamps, at points.

    Attributes
    ----------
    n : int
        Samples of each extended emitter at each point, and of all lamps where these are many.
    seed : int
        Of their random numbers.
    pixel : (m,) int64, optional
        Points of one pixel share a sequence of samples; by default each point has its own.
    """

    n: int
    seed: int = 0
    pixel: NDArray[np.int64] | None = None


def default_light_samples(scene: Scene, n_points: int) -> int:
    """Samples of light at each of n points in a pixel; 1 in scenes where one sums all lamps."""
    of_pixel = max(_samples_of_pixel(group) for group in _lamp_groups(scene))
    if any(emitter.is_extended for emitter in scene.emitters):
        of_pixel = max(of_pixel, _RAYS_OF_PIXEL)
    # All lamps may be summed in place of n samples, but not of one.
    return -(-of_pixel // n_points) if samples_light(scene, 1) else 1


def _samples_of_pixel(lamps: LampTable) -> int:
    """Samples of a pixel to lamps that are points or parallel light; 1 if all are summed."""
    if not _are_many(len(lamps), 1):
        return 1
    axes = lamps.axis[lamps.kind != UNIFORM]
    if len(axes) == 0:
        return _POINTS_OF_PIXEL
    are_alike = np.linalg.norm(axes.mean(axis=0)) > _ALIKE
    return _AIMED_OF_PIXEL if are_alike else _SCATTERED_OF_PIXEL


def samples_light(scene: Scene, n: int) -> bool:
    """Whether n samples matter: of an extended emitter, or of more lamps than are summed."""
    return any(emitter.is_extended for emitter in scene.emitters) or has_many_lamps(scene, n)


def has_many_lamps(scene: Scene, n: int = 1) -> bool:
    """Whether a scene has more lamps than are summed in place of n samples."""
    return any(_are_many(len(group), n) for group in _lamp_groups(scene))


def _are_many(n_lamps: int, n_samples: int) -> bool:
    return n_lamps > max(_MOST_SUMMED, _SUMMED_PER_SAMPLE * n_samples)


def _lamp_groups(scene: Scene) -> list[LampTable]:
    """The lamps of a scene that are points, and those that are parallel light."""
    lamps = scene.lamps
    is_parallel = lamps.kind == PARALLEL
    return [lamps[~is_parallel], lamps[is_parallel]]


def direct_irradiance(
    scene: Scene,
    caster: RayCaster,
    position: ArrayLike,
    normal: ArrayLike,
    *,
    samples: LightSamples | None = None,
    n_threads: int | None = None,
) -> Floats:
    """Return the irradiance at points from the emitters they see; see `Lights.irradiance`.

    Parameters
    ----------
    scene, caster : Scene, RayCaster
        The emitters, and the objects that occlude them.
    position, normal, samples, n_threads
        As of `Lights.irradiance`.
    """
    lights = Lights(scene, caster)
    return lights.irradiance(position, normal, samples=samples, n_threads=n_threads)


class Lights:
    """Emitters of a scene, prepared for their direct light.

    Parameters
    ----------
    scene, caster : Scene, RayCaster
        The emitters, and the objects that occlude them.
    """

    def __init__(self, scene: Scene, caster: RayCaster) -> None:
        self._scene, self._caster = scene, caster
        self._materials = Materials(scene.material_table())
        self._offset = scene.emitter_offsets
        self._media = self._media_at_emitters()
        self._absorption = np.array([self._materials.absorption_in(m) for m in self._media])
        self._is_absorbed = bool(self._absorption.any())
        self._groups = [
            _LampGroup.of(lamps, self._offset)
            for lamps in _lamp_groups(scene)
            if _are_many(len(lamps), 1)
        ]
        self._is_extended = any(emitter.is_extended for emitter in scene.emitters)
        self._shining = [i for i, emitter in enumerate(scene.emitters) if _shines(emitter)]

    def _media_at_emitters(self) -> Media:
        """Media at the emitters (n_emitters,), none where nothing follows from them."""
        if not (self._materials.table.absorption.any() or self._materials.has_hidden):
            return np.zeros(len(self._scene.emitters), dtype=np.uint64)
        return media_at_emitters(self._scene, self._caster, self._materials)[0]

    def irradiance(
        self,
        position: ArrayLike,
        normal: ArrayLike,
        *,
        samples: LightSamples | None = None,
        n_threads: int | None = None,
    ) -> Floats:
        """Return the irradiance at points from the emitters they see.

        Every object occludes, transparent ones too: light that passes through them is carried by
        photons. Surfaces of dielectrics inside of one of larger priority are not there, and do not.
        An absorbing dielectric that emitter and point both lie in absorbs. Points nearer to an
        emitter than `Scene.emitter_offset` get no light from it, because the inverse square of
        their distance is no measure of the mean over a pixel.

        Parameters
        ----------
        position, normal : (m, 3)
            Points on surfaces, and normals on the lit side.
        samples : LightSamples, optional
            Of extended emitters and many lamps; by default so many at each point that it may be a
            pixel.
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
        samples = samples or LightSamples(default_light_samples(self._scene, 1))
        groups = [group for group in self._groups if _are_many(len(group.emitter_id), samples.n)]
        chosen = {int(i) for group in groups for i in group.emitter_id}
        summed = [i for i in self._shining if i not in chosen]
        sampling = _Sampling(samples, len(position), is_used=bool(groups) or self._is_extended)

        def add(rows: slice) -> None:
            at = position[rows], normal[rows]
            for emitter_id in summed:
                self._add_emitter(total[rows], at, emitter_id, sampling.of(rows))
            for number, group in enumerate(groups):
                self._add_lamps(total[rows], at, group, sampling.of(rows), number)

        rays_of_point = samples.n if groups else 1
        for_each_slice(add, len(position), max(_CHUNK // rays_of_point, 1), threads)
        return total

    def _add_emitter(
        self, total: Floats, at: tuple[Floats, Floats], emitter_id: int, sampling: _Sampling
    ) -> None:
        """Add the irradiance (m, 3) from an emitter to `total`."""
        emitter, offset = self._scene.emitters[emitter_id], self._offset[emitter_id]
        lights: Iterable[DirectLight]
        if emitter.is_extended:
            n = sampling.n
            lights = (
                emitter.sampled(*at, offset, sample) for sample in sampling.in_squares(emitter_id)
            )
        else:
            n, lights = 1, [emitter.direct(at[0], offset)]
        for light in lights:
            checked = _checked(light, emitter, len(total))
            aimed = emitter.surface is not None
            rays = shadow_rays(self._caster.frame, *at, aimed=aimed, **checked._asdict())
            self._add(total, rays, emitter_id, n)

    def _add_lamps(
        self,
        total: Floats,
        at: tuple[Floats, Floats],
        group: _LampGroup,
        sampling: _Sampling,
        number: int,
    ) -> None:
        """Add an estimate of the irradiance (m, 3) from the lamps of a group to `total`."""
        marks = sampling.marks(len(self._scene.emitters) + number)
        rays, lamp = sampled_shadow_rays(
            self._caster.frame, group.tree, *at, n=sampling.n, shift=marks
        )
        self._add(total, rays, group.emitter_id[lamp])

    def _add(
        self,
        total: Floats,
        rays: ShadowRays,
        emitter_id: int | NDArray[np.intp],
        n_samples: int = 1,
    ) -> None:
        """Add the mean irradiance of rays that are not occluded, to an emitter or to one each."""
        occluded = self._occluded(rays, emitter_id)
        irradiance = rays.irradiance
        # No surface lies between: all of the way is in the medium at the emitter.
        if self._is_absorbed:
            absorption = self._absorption[emitter_id]
            irradiance *= beer_lambert(absorption, np.minimum(rays.distance, _FARTHEST))
        if n_samples > 1:
            irradiance /= n_samples
        add_unoccluded(total, rays.row, irradiance, occluded.view(np.uint8))

    def _occluded(self, rays: ShadowRays, emitter_id: int | NDArray[np.intp]) -> NDArray[np.bool_]:
        """Mask (n,) of the shadow rays, to an emitter or one each, that meet a surface there."""
        limit = rays.distance - self._offset[emitter_id]
        occluded = self._caster.occluded(
            rays.origin, rays.direction, limit, origin_offset=rays.origin_offset
        )
        if not self._materials.has_hidden:
            return occluded
        # The same medium rules all along an unoccluded ray, whatever else is entered and left.
        starts = np.broadcast_to(self._media[emitter_id], len(limit))
        rows = np.flatnonzero(occluded & (starts != 0))
        if len(rows) == 0:
            return occluded
        hits, _ = first_hits(
            self._caster,
            self._materials,
            (rays.origin[rows], rays.direction[rows], rays.origin_offset[rows]),
            starts[rows],
            n_threads=1,
        )
        occluded[rows] = hits.distance < limit[rows]
        return occluded


class _LampGroup(NamedTuple):
    """Many lamps in a tree, and their indices among the emitters of the scene."""

    tree: LightTree
    emitter_id: NDArray[np.intp]

    @classmethod
    def of(cls, lamps: LampTable, offset: Floats) -> _LampGroup:
        """The lamps in a tree, given the offsets of all emitters."""
        tree, in_order = light_tree(lamps, offset[lamps.emitter_id])
        return cls(tree, in_order.emitter_id)


class _Sampling:
    """Samples of light at points, of which each has a number in its pixel."""

    def __init__(self, samples: LightSamples, n_points: int, *, is_used: bool) -> None:
        self.n, self._seed, pixel = samples
        self._pixel = np.arange(n_points, dtype=np.int64) if pixel is None else pixel
        self._number = number_in_pixel(self._pixel) if is_used else self._pixel

    def of(self, rows: slice) -> _Sampling:
        """Those of some points."""
        some = copy(self)
        some._pixel, some._number = self._pixel[rows], self._number[rows]
        return some

    def in_squares(self, emitter_id: int) -> Iterator[Floats]:
        """Yield samples (m, 2) in [0, 1)² of an extended emitter."""
        for number in range(self.n):
            in_pixel = self.n * self._number + number
            yield emitter_samples(self._seed, _STREAM + emitter_id, self._pixel, in_pixel)

    def marks(self, stream: int) -> Floats:
        """First marks (m,) of a group of lamps."""
        return sample_shifts(self._seed, _STREAM + stream, self._pixel, self._number)


def _shines(emitter: Emitter) -> bool:
    """False for lamps that are black."""
    lamp = emitter.lamp
    return lamp is None or bool(np.any(lamp.intensity))


def number_in_pixel(pixel: NDArray[np.int64]) -> NDArray[np.int64]:
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
