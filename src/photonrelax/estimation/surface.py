"""Surfaces that light is estimated on: their edges, and where there is none.

A kernel that hangs over an edge has photons on one side of it alone, so that estimates there would
be too dark. They are divided by the part of their kernel that is on surface, and radii that k
photons set follow from areas of surface; docs/methods/edges.md has the derivation.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from .._ext.estimation import surface_edges as _edges
from .._util.parcels import state_without_caches
from .._util.validation import Floats
from ..photons.blocks import BlockedPhotons
from ..photons.photon_map import PhotonMap
from ..scene.scene import Scene
from ..spatial.box_tree import BoxTree
from ..surfaces.boundaries import WHOLE, Part, SurfaceBoundary
from ..surfaces.surface_proximity import SurfaceProximity
from .footprint import half_diagonals

_Edged = tuple[frozenset[int], Part]
# Edges of scenes in use by the ids of the objects, which do not change: fields share them.
_EDGES: WeakKeyDictionary[Scene, dict[_Edged, Any]] = WeakKeyDictionary()


class Surface:
    """The surfaces of a scene that store light.

    Parameters
    ----------
    scene : Scene
    n_threads : int
    among : iterable of int, optional
        Ids of the objects whose edges count, by default all but sensors; see `lit_objects`.
    part : Part, optional
        Of the surfaces, bounded by dielectrics; by default they are whole.

    Attributes
    ----------
    edges : SurfaceEdges or None
        Free edges, creases and contact lines as kernels read them; None if there are none.
    """

    def __init__(
        self,
        scene: Scene,
        n_threads: int,
        among: Iterable[int] | None = None,
        part: Part = WHOLE,
    ) -> None:
        self._scene = scene
        self._part = part
        self._n_threads = n_threads
        self._among = frozenset(_no_sensors(scene) if among is None else among)

    __getstate__ = state_without_caches

    @property
    def edges(self) -> Any:
        known = _EDGES.setdefault(self._scene, {})
        key = self._among, self._part
        if key not in known:
            known[key] = _edges_of(self._scene, *key, self._n_threads)
        return known[key]

    @cached_property
    def _proximity(self) -> SurfaceProximity:
        return SurfaceProximity(self._scene.surfaces)

    def near_edges(self, points: Floats, radius: float) -> NDArray[np.bool_]:
        """Mask (m,) of the points with an edge within reach of kernels up to a radius."""
        if self.edges is None:
            return np.zeros(len(points), dtype=bool)
        near: NDArray[np.bool_] = _edges.near_edges(self.edges, points, radius, self._n_threads)
        return near

    def largest_radii(self, points: Floats, normals: Floats, radius: float) -> Floats:
        """Radii (m,), m, of the discs with as much surface as one without edges has.

        The radius itself if it is infinite.
        """
        if not np.isfinite(radius):
            return np.full(len(points), radius)
        radii: Floats = _edges.largest_radii(
            *(self.edges, points, normals),
            radius=radius,
            n_threads=self._n_threads,
        )
        return radii

    def shares(self, points: Floats, normals: Floats, radius: Floats, kernel: int) -> Floats:
        """Parts (m,) that are on surface of the kernels of given radii (m,) at points."""
        shares: Floats = _edges.shares(
            *(self.edges, points, normals, radius), kernel=kernel, n_threads=self._n_threads
        )
        return shares

    def mark_absent(
        self,
        densities: Floats,
        points: Floats,
        normals: Floats,
        *,
        footprint: Floats | None,
        reach: float,
    ) -> None:
        """Set densities (m, c) to NaN where no surface is within reach of points or footprints.

        Only where they are zero: a photon that counts is on a surface. Warns if there are any.
        """
        dark = np.flatnonzero(~densities[:, :1].any(axis=1))
        dark = dark[~densities[dark].any(axis=1)]
        if not len(dark):
            return
        radius = reach + half_diagonals(None if footprint is None else footprint[dark], len(dark))
        near = self._proximity.within(
            points[dark], normals[dark], radius, n_threads=self._n_threads
        )
        absent = dark[~near]
        if len(absent):
            densities[absent] = np.nan
            warnings.warn(
                f"{len(absent)} of {len(points)} points have no surface of the scene that stores "
                f"light within {radius[~near].max():.3g} m and 60° of their normal: what is "
                "estimated there is NaN",
                stacklevel=4,
            )


def lit_objects(scene: Scene, photons: PhotonMap) -> list[int]:
    """Ids of the objects that photons may be on: sensors if any are, others if any others are."""
    on_sensor = photons.on_sensor
    if photons.object_id is None or not on_sensor.any():
        return _no_sensors(scene)
    sensors = np.unique(photons.object_id[on_sensor]).tolist()
    return sensors if on_sensor.all() else [*_no_sensors(scene), *sensors]


def objects_lit_in_blocks(scene: Scene, photons: BlockedPhotons) -> list[int]:
    """Ids of the objects that photons in blocks may be on; see `lit_objects`."""
    if not photons.shared["sensor_ids"] or "object_id" not in photons.columns:
        return _no_sensors(scene)
    rows = zip(photons.segments.first, photons.segments.stop, strict=True)
    lit = {i for start, stop in rows for i in lit_objects(scene, photons.photons(start, stop))}
    return sorted(lit)


def _no_sensors(scene: Scene) -> list[int]:
    return [i for i in range(len(scene.surfaces)) if i not in scene.sensors]


def _edges_of(scene: Scene, among: frozenset[int], part: Part, n_threads: int) -> Any:
    """Edges of a part of a scene's surfaces as kernels read them, None if there are none."""
    boundary = SurfaceBoundary.of(scene.surfaces, among, part)
    ends = boundary.segments
    if not len(ends):
        return None
    tree = BoxTree(ends.min(axis=1), ends.max(axis=1), n_threads=n_threads)
    return _edges.SurfaceEdges(tree.kernel, ends, boundary.normals, boundary.one_sided)
