"""Direct irradiance from emitters, by shadow rays."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .._ext.transport.direct_light import add_unoccluded, shadow_rays
from .._ext.transport.materials import Materials
from .._util.parallel import for_each_slice, thread_count
from .._util.validation import Floats, float_array, unit_vectors
from ..scene.emitters import DirectLight, Emitter
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
    threads = thread_count(n_threads)
    normal = unit_vectors(normal, "normal", (len(position), 3), threads)
    total = np.zeros_like(position)
    light = _DirectLight(scene, caster)

    def add(rows: slice) -> None:
        light.add(total[rows], position[rows], normal[rows])

    for_each_slice(add, len(position), _CHUNK, threads)
    return total


class _DirectLight:
    """A scene prepared for the direct light of its emitters."""

    def __init__(self, scene: Scene, caster: RayCaster) -> None:
        self._caster = caster
        self._emitters = [
            (emitter, scene.emitter_offset(emitter), absorption)
            for emitter, absorption in zip(
                scene.emitters, _absorption_at_emitters(scene, caster), strict=True
            )
        ]

    def add(self, total: Floats, position: Floats, normal: Floats) -> None:
        """Add the irradiance (m, 3) at points to `total`."""
        for emitter, offset, absorption in self._emitters:
            light = _light_at(emitter, position, offset)
            rays = shadow_rays(self._caster.frame, position, normal, **light._asdict())
            occluded = self._caster.occluded(
                rays.origin,
                rays.direction,
                rays.distance - offset,
                origin_offset=rays.origin_offset,
            )
            irradiance = rays.irradiance
            # No surface lies between: all of the way is in the medium at the emitter.
            if absorption.any():
                irradiance *= beer_lambert(absorption, np.minimum(rays.distance, _FARTHEST))
            add_unoccluded(total, rays.row, irradiance, occluded.view(np.uint8))


def _light_at(emitter: Emitter, position: Floats, offset: float) -> DirectLight:
    """Light of an emitter at points (m, 3), as arrays of checked shapes."""
    direction, distance, irradiance = emitter.direct(position, offset)
    name, m = f"{type(emitter).__name__}.direct", len(position)
    return DirectLight(
        float_array(direction, f"direction of {name}", (m, 3), finite=False),
        float_array(distance, f"distance of {name}", (m,), finite=False),
        float_array(irradiance, f"irradiance of {name}", (m, 3), finite=False),
    )


def _absorption_at_emitters(scene: Scene, caster: RayCaster) -> Floats:
    """Absorption (n_emitters, 3) of the media that emitters lie in, 1/m."""
    table = scene.material_table()
    if not table.absorption.any():
        return np.zeros((len(scene.emitters), 3))
    materials = Materials(table)
    media = MediaFinder(scene, caster, materials).at_emitters()
    return np.array([materials.absorption_in(stack) for stack in media])
