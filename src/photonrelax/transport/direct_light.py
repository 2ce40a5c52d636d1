"""Direct irradiance from emitters, by shadow rays."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .._ext.transport.materials import Materials
from .._util.parallel import for_each_slice, thread_count
from .._util.validation import Floats, float_array, unit_vectors
from ..scene.scene import Scene
from .media import MediaFinder
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
    photons. An absorbing dielectric that emitter and point both lie in absorbs. Points nearer to
    an emitter than `Scene.emitter_offset` get no light from it, because the inverse square of their
    distance is no measure of the mean over a pixel.

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
    normal = unit_vectors(normal, "normal", (len(position), 3))
    total = np.zeros_like(position)
    light = _DirectLight(scene, caster)

    def add(rows: slice) -> None:
        light.add(total[rows], position[rows], normal[rows])

    for_each_slice(add, len(position), _CHUNK, thread_count(n_threads))
    return total


class _DirectLight:
    """A scene prepared for the direct light of its emitters."""

    def __init__(self, scene: Scene, caster: RayCaster) -> None:
        self._caster = caster
        materials = Materials(scene.material_table())
        media = MediaFinder(scene, caster, materials).at_emitters()
        self._emitters = [
            (emitter, scene.emitter_offset(emitter), materials.absorption_in(stack))
            for emitter, stack in zip(scene.emitters, media, strict=True)
        ]

    def add(self, total: Floats, position: Floats, normal: Floats) -> None:
        """Add the irradiance (m, 3) at points to `total`."""
        origin_offset = self._caster.resolution.at(position)[:, np.newaxis] * normal
        for emitter, offset, absorption in self._emitters:
            direction, distance, facing = emitter.direct(position, offset)
            cosine = np.maximum(np.einsum("ij,ij->i", direction, normal), 0.0)
            irradiance = facing * cosine[:, None]
            lit = np.flatnonzero(irradiance.any(axis=1))
            occluded = self._caster.occluded(
                position[lit],
                direction[lit],
                distance[lit] - offset,
                origin_offset=origin_offset[lit],
            )
            # No surface lies between: all of the way is in the medium at the emitter.
            if absorption.any():
                irradiance[lit] *= beer_lambert(absorption, np.minimum(distance[lit], _FARTHEST))
            total[lit] += np.where(occluded[:, None], 0.0, irradiance[lit])
