"""Rays from points on surfaces to what lights them, for a final gather.

Rays are distributed by the cosine, N from each point, so that every one brings 1/N of the
irradiance. The i-th of all points are one point of the Halton sequence, shifted at random from
point to point (Cranley–Patterson rotation). A ray stands for the solid angle π / (N cos θ), whose
square it carries by ray differentials to the surface it meets.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from .._ext.transport.hit_points import CameraPaths
from .._ext.transport.materials import Materials
from .._util.parallel import ordered_map, thread_executor
from .._util.validation import Floats
from ..scene.emission_region import cosine_directions
from ..scene.scene import Scene
from .hit_points import MIN_WEIGHT, HitPoints, follow_paths, hit_points_of
from .media import MediaFinder
from .raycast import RayCaster, empty_intersections
from .sampling import halton

# Rays followed together.
_BATCH = 16384


class GatherRays:
    """A scene prepared for gathering light at points.

    Parameters
    ----------
    scene, caster : Scene, RayCaster
        The scene, and a caster of its objects.
    max_depth : int
        Largest number of specular events of a ray; what lies beyond is black.
    n_threads : int
        Threads; results do not depend on it.
    """

    def __init__(self, scene: Scene, caster: RayCaster, *, max_depth: int, n_threads: int) -> None:
        self._scene, self._caster = scene, caster
        self._max_depth, self._n_threads = max_depth, n_threads
        self._materials = Materials(scene.material_table())
        self._media = MediaFinder(scene, caster, self._materials)
        self._extent = scene.scale

    def __reduce__(self) -> tuple[Any, tuple[Scene, RayCaster]]:
        rebuild = partial(GatherRays, max_depth=self._max_depth, n_threads=self._n_threads)
        return rebuild, (self._scene, self._caster)

    def trace(self, position: Floats, normal: Floats, n_rays: int, shifts: Floats) -> HitPoints:
        """Trace rays from points to diffuse surfaces.

        Parameters
        ----------
        position, normal : (m, 3) float array
            Points on surfaces, unit normals on the lit side.
        n_rays : int
            From each point.
        shifts : (m, 2) float array
            Of the sequence at each point, in [0, 1)².

        Returns
        -------
        HitPoints
            `pixel` is the row of the point; `weight` is a share of 1/n_rays.
        """
        per_batch = max(_BATCH // n_rays, 1)
        slices = [slice(i, i + per_batch) for i in range(0, len(position), per_batch)]
        square = halton(1, n_rays, n_threads=1)

        def work(some: slice) -> dict[str, np.ndarray]:
            rays = _cosine_rays(normal[some], (square + shifts[some, np.newaxis]) % 1.0)
            return self._batch(position[some], *rays, first=some.start)

        with thread_executor(self._n_threads) as executor:
            seen = list(ordered_map(work, slices, executor))
            return hit_points_of(seen, self._materials, self._scene, executor)

    def _batch(
        self, position: Floats, direction: Floats, spread: Floats, *, first: int
    ) -> dict[str, np.ndarray]:
        n_rays = len(direction) // len(position)
        origin = np.repeat(position, n_rays, axis=0)
        paths = CameraPaths(
            self._materials,
            self._caster.frame,
            self._caster.triangles,
            least_weight=MIN_WEIGHT,
            longest_edge=self._extent,
        )
        row = np.repeat(np.arange(first, first + len(position)), n_rays)
        paths.start_gather(origin, direction, row, spread)
        found = self._caster.find_paths(paths)
        if paths.leave_surfaces(found):
            found = self._caster.find_paths(paths)
        if self._media.may_be_inside(position):
            hits = empty_intersections(len(row))
            self._caster.triangles.refine_hits(origin, direction, found, hits)
            paths.set_media(self._media.along(origin, direction, hits))
            self._caster.find_beyond(paths, found)
        follow_paths(paths, self._caster, found, self._max_depth)
        seen = paths.seen_points()
        seen["weight"] /= n_rays
        return seen


def _cosine_rays(normal: Floats, samples: Floats) -> tuple[Floats, Floats]:
    """Directions (m n, 3) around normals (m, 3), by samples (m, n, 2), and spreads (m n,)."""
    n = samples.shape[1]
    directions, cosine = cosine_directions(np.repeat(normal, n, axis=0), samples.reshape(-1, 2))
    return directions, np.sqrt(np.pi / (n * cosine))
