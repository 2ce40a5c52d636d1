"""Direct irradiance from emitters, by shadow rays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._ext.transport.direct_light import ShadowRays, add_unoccluded, shadow_rays
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


def direct_irradiance(
    scene: Scene,
    caster: RayCaster,
    position: ArrayLike,
    normal: ArrayLike,
    *,
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
    light = _DirectLight(scene, caster)

    def add(rows: slice) -> None:
        light.add(total[rows], position[rows], normal[rows])

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

    def __init__(self, scene: Scene, caster: RayCaster) -> None:
        self._caster, self._materials = caster, Materials(scene.material_table())
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

    def add(self, total: Floats, position: Floats, normal: Floats) -> None:
        """Add the irradiance (m, 3) at points to `total`."""
        for source in self._sources:
            light = _light_at(source.emitter, position, source.offset)
            rays = shadow_rays(self._caster.frame, position, normal, **light._asdict())
            occluded = self._occluded(rays, source)
            irradiance = rays.irradiance
            # No surface lies between: all of the way is in the medium at the emitter.
            if source.absorption.any():
                irradiance *= beer_lambert(source.absorption, np.minimum(rays.distance, _FARTHEST))
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


def _light_at(emitter: Emitter, position: Floats, offset: float) -> DirectLight:
    """Light of an emitter at points (m, 3), as arrays of checked shapes."""
    direction, distance, irradiance = emitter.direct(position, offset)
    name, m = f"{type(emitter).__name__}.direct", len(position)
    return DirectLight(
        float_array(direction, f"direction of {name}", (m, 3), finite=False),
        float_array(distance, f"distance of {name}", (m,), finite=False),
        float_array(irradiance, f"irradiance of {name}", (m, 3), finite=False),
    )
