"""Surfaces that light is estimated on: their edges, and where there is none.

A kernel that hangs over an edge has photons on one side of it alone, so that estimates there would
be too dark. They are divided by the part of their kernel that is on surface, and radii that k
photons set follow from areas of surface; docs/methods/edges.md has the derivation.
"""

from __future__ import annotations

import warnings
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from .._ext.estimation import surface_edges as _edges
from .._util.validation import Floats
from ..scene.scene import Scene
from ..spatial.box_tree import BoxTree
from ..surfaces.boundaries import SurfaceBoundary
from ..surfaces.surface_proximity import SurfaceProximity

# Largest radius near edges, over the gather radius: within it a corner of 22.5° has the surface of
# the disc of the gather radius.
_SURFACE_WITHIN = 4.0

Rows = NDArray[np.intp]
# Edges of scenes in use, which do not change: fields of several methods share them.
_EDGES: WeakKeyDictionary[Scene, Any] = WeakKeyDictionary()


class Surface:
    """The surfaces of a scene that store light.

    Parameters
    ----------
    scene : Scene
    n_threads : int

    Attributes
    ----------
    edges : SurfaceEdges or None
        Free edges, creases and contact lines as kernels read them; None if there are none.
    """

    def __init__(self, scene: Scene, n_threads: int) -> None:
        self._scene = scene
        self._n_threads = n_threads

    @property
    def edges(self) -> Any:
        if self._scene not in _EDGES:
            _EDGES[self._scene] = _edges_of(self._scene)
        return _EDGES[self._scene]

    @cached_property
    def _proximity(self) -> SurfaceProximity:
        return SurfaceProximity(self._scene.objects)

    def near_edges(self, points: Floats, normals: Floats, radius: float) -> tuple[Rows, Floats]:
        """Rows (r,) of points that kernels may hang over an edge at, and their largest radii, m.

        That is the radius of the disc with as much surface as one of the given radius has that
        lies on surface as a whole.
        """
        if self.edges is None:
            return np.empty(0, dtype=np.intp), np.empty(0)
        if not np.isfinite(radius):
            return np.arange(len(points)), np.full(len(points), radius)
        largest = _edges.largest_radii(
            *(self.edges, points, normals),
            radius=radius,
            most=_SURFACE_WITHIN,
            n_threads=self._n_threads,
        )
        rows = np.flatnonzero(largest != radius)
        return rows, largest[rows]

    def shares(self, points: Floats, normals: Floats, radius: Floats, kernel: int) -> Floats:
        """Parts (m,) that are on surface of the kernels of given radii (m,) at points."""
        shares: Floats = _edges.shares(
            *(self.edges, points, normals, radius), kernel=kernel, n_threads=self._n_threads
        )
        return shares

    def mark_absent(
        self, densities: Floats, points: Floats, normals: Floats, radius: Floats
    ) -> None:
        """Set densities (m, c) to NaN where no surface is within radii (m,) of the points.

        Only where they are zero: a photon that counts is on a surface. Warns if there are any.
        """
        dark = np.flatnonzero(~densities.any(axis=1))
        if not len(dark):
            return
        near = self._proximity.within(points[dark], normals[dark], radius[dark])
        absent = dark[~near]
        if len(absent):
            densities[absent] = np.nan
            warnings.warn(
                f"{len(absent)} of {len(points)} points have no surface of the scene that stores "
                f"light within {radius[absent].max():.3g} m and 60° of their normal: what is "
                "estimated there is NaN",
                stacklevel=4,
            )


def _edges_of(scene: Scene) -> Any:
    """Edges of a scene's surfaces as kernels read them, None if there are none."""
    boundary = SurfaceBoundary.of(scene.objects)
    ends = boundary.segments
    if not len(ends):
        return None
    tree = BoxTree(ends.min(axis=1), ends.max(axis=1))
    return _edges.SurfaceEdges(tree.kernel, ends, boundary.normals, boundary.one_sided)
