"""Final gather: indirect light at points, from the light that surrounding surfaces get.

What a ray meets has all light that arrives there: direct light by shadow rays, caustics and
indirect light from their photons together, as means over the part of the surface that the ray
stands for. At points, folds of caustics would turn into fireflies. Such estimates are blurred; near
a point, where that would show, a few rays of a gather of its own replace them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._ext.transport.light_tree import sample_shifts
from .._util.validation import Floats
from ..estimation.indirect import IndirectField
from ..photons.photon_map import PhotonMap
from ..transport.direct_light import LightSamples, number_in_pixel
from ..transport.gather_rays import GatherRays
from .view import Band, View, pixel_sums

# Streams of random numbers beside those of emitters: shifts of sequences, keys of what rays meet.
_RIGHT, _UP, _KEY = (1 << 49) + 1, (1 << 49) + 2, (1 << 49) + 3
# Different keys; random numbers have so many bits.
_KEYS = 2.0**53
# Rays traced together.
_RAYS_PER_CHUNK = 1 << 18
# Rays of a gather at what a ray has met nearby. Few are enough: they are many together.
_NEARBY = 4


class FinalGather:
    """Indirect irradiance at points by rays that gather light.

    Parameters
    ----------
    view : View
        Of the scene.
    photons : PhotonMap
        Of all light but direct.
    n_rays, seed : int
        Rays from each point, and the seed of their sequences.
    """

    def __init__(self, view: View, photons: PhotonMap, n_rays: int, seed: int) -> None:
        self._view = view
        self._field = IndirectField(photons, scene=view.scene, n_threads=view.n_threads)
        self._n_rays = n_rays
        self._seed = seed
        self._rays = GatherRays(
            view.scene, view.caster, max_depth=view.max_depth, n_threads=view.n_threads
        )

    def __call__(self, band: Band) -> tuple[Floats, NDArray[np.intp]]:
        """Irradiance (p, 3) on the pieces of surface of a band, W/m², and that of each point."""
        pieces = band.pieces()
        normal = pieces.normal / np.linalg.norm(pieces.normal, axis=1, keepdims=True)
        pixel = np.empty(len(normal), dtype=np.int64)
        pixel[pieces.of_hit] = band.hits.pixel
        at = pieces.position, normal, self._keys(pixel)
        return self._gathered(at, self._n_rays, nearby=True), pieces.of_hit

    def _keys(self, of: NDArray[np.int64]) -> NDArray[np.int64]:
        """Keys (m,) of points from the keys of what they are of, whatever else is gathered."""
        return (sample_shifts(self._seed, _KEY, of, number_in_pixel(of)) * _KEYS).astype(np.int64)

    def _shifts(self, keys: NDArray[np.int64]) -> Floats:
        """Shifts (m, 2) of the sequences of points by their keys."""
        number = np.zeros(len(keys), dtype=np.int64)
        return np.column_stack(
            [sample_shifts(self._seed, stream, keys, number) for stream in (_RIGHT, _UP)]
        )

    def _gathered(
        self, points: tuple[Floats, Floats, NDArray[np.int64]], n_rays: int, nearby: bool
    ) -> Floats:
        """Irradiance (m, 3) at points, which have unit normals and keys, by rays from each."""
        position, normal, keys = points
        out = np.zeros((len(position), 3))
        step = max(_RAYS_PER_CHUNK // n_rays, 1)
        for first in range(0, len(position), step):
            some = slice(first, first + step)
            shifts = self._shifts(keys[some])
            hits = self._rays.trace(position[some], normal[some], n_rays, shifts)
            met = self._keys(keys[some][hits.pixel])
            at = hits.position, hits.normal
            irradiance = self._field(*at, footprint=hits.footprint)
            if nearby:
                away = np.linalg.norm(hits.position - position[some][hits.pixel], axis=1)
                near = np.flatnonzero(away < self._field.reach)
                nearer = hits.position[near], hits.normal[near], met[near]
                irradiance[near] = self._gathered(nearer, _NEARBY, nearby=False)
            light = irradiance + self._direct(*at, met)
            weight = hits.weight * hits.albedo
            shape = len(position[some]), 1
            out[some] = pixel_sums(hits.pixel, light, shape, weight=weight)[:, 0]
        return out

    def _direct(self, position: Floats, normal: Floats, keys: NDArray[np.int64]) -> Floats:
        """Direct irradiance; one sample of what is sampled is enough, as rays are many."""
        view, samples = self._view, LightSamples(1, self._seed, keys)
        return view.lights.irradiance(position, normal, samples=samples, n_threads=view.n_threads)
