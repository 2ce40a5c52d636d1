"""Irradiance straight from emitters, by shadow rays."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .._util.parallel import thread_count
from .._util.validation import Floats, float_array, unit_vectors
from ..scene.emitters import CollimatedEmitter, Emitter, LambertianEmitter
from ..scene.scene import Scene
from .raycast import RayCaster


def direct_irradiance(
    scene: Scene,
    caster: RayCaster,
    position: ArrayLike,
    normal: ArrayLike,
    *,
    n_threads: int | None = None,
) -> Floats:
    """Return the irradiance at points from emitters in plain sight.

    Every object blocks the light, transparent ones too: what passes through them is the
    photons' part. Points nearer to an emitter than `Scene.emitter_offset` get nothing from it: the
    inverse square of their distance is no measure of what reaches a pixel.

    Parameters
    ----------
    scene, caster : Scene, RayCaster
        The scene and its objects, ready to be hit.
    position, normal : (m, 3)
        Points on surfaces, and normals on the side that is lit.
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
    threads = thread_count(n_threads)
    position = float_array(position, "position", (None, 3))
    normal = unit_vectors(normal, "normal", (len(position), 3))
    total = np.zeros_like(position)
    for emitter in scene.emitters:
        direction, distance, irradiance = _arriving(emitter, position, scene.emitter_offset)
        irradiance *= np.maximum(np.einsum("ij,ij->i", direction, normal), 0.0)[:, None]
        lit = np.flatnonzero(irradiance.any(axis=1))
        blocked = caster.occluded(
            position[lit],
            direction[lit],
            distance[lit] - scene.emitter_offset,
            leaving=normal[lit],
            n_threads=threads,
        )
        total[lit] += np.where(blocked[:, None], 0.0, irradiance[lit])
    return total


def _arriving(emitter: Emitter, position: Floats, gap: float) -> tuple[Floats, Floats, Floats]:
    """Return direction to an emitter, distance, and unblocked irradiance facing it, per point.

    Direction and irradiance are zero for points nearer than the gap.
    """
    if isinstance(emitter, CollimatedEmitter):
        direction = np.tile(-np.asarray(emitter.direction), (len(position), 1))
        irradiance = np.tile(np.asarray(emitter.irradiance), (len(position), 1))
        return direction, np.full(len(position), np.inf), irradiance
    offset = np.asarray(emitter.position) - position
    distance = np.linalg.norm(offset, axis=1)
    inverse = np.divide(1.0, distance, out=np.zeros_like(distance), where=distance > gap)[:, None]
    direction = offset * inverse
    intensity = np.asarray(emitter.power) / (4.0 * np.pi)
    if isinstance(emitter, LambertianEmitter):
        cosine = np.maximum(-direction @ np.asarray(emitter.direction), 0.0)[:, None]
        intensity = np.asarray(emitter.power) / np.pi * cosine
    return direction, distance, intensity * inverse**2
