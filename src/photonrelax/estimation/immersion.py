"""Parts of surfaces by the closed dielectrics that they are in.

Light changes abruptly where a dielectric ends at a surface: at the waterline of a pool, or around
the foot of a glass. Estimates on both sides of such a line take photons of their own side.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .._util.parallel import thread_count
from .._util.validation import Floats
from ..scene.scene import SceneObject
from ..surfaces.boundaries import Part
from ..surfaces.surface import Surface
from ..transport.optics import from_behind
from ..transport.raycast import RayCaster

# Start of rays above their surface, over what rays resolve.
_ABOVE = 2.0
# Direction of rays, or the opposite: along no edges of usual models.
_DIRECTION = np.array([0.413, 0.271, 0.869])
# Dielectrics that labels tell apart; more in one scene do not bound surfaces.
_MOST = 62


class Immersion:
    """Tells by labels which closed dielectrics points of surfaces are in.

    Parameters
    ----------
    objects : sequence of SceneObject
    ids : sequence of int
        Closed dielectrics among them.
    n_threads : int, optional
        Threads; all available by default. Labels do not depend on it.
    """

    def __init__(
        self, objects: Sequence[SceneObject], ids: Sequence[int], n_threads: int | None = None
    ) -> None:
        self._objects, self._ids = objects, tuple(ids)
        self._casters = [RayCaster(objects, [i]) for i in ids]
        self._n_threads = thread_count(n_threads)

    @classmethod
    def of(
        cls,
        objects: Sequence[SceneObject],
        points: Floats,
        normals: Floats,
        n_threads: int | None = None,
    ) -> Immersion:
        """That of the dielectrics that have any of some points (n, 3) in them."""
        near = [i for i, item in enumerate(objects) if _may_be_in(item, points)]
        closed = [i for i in near if Surface.of(objects[i]).solid is not None][:_MOST]
        label = cls(objects, closed, n_threads).labels(points, normals)
        used = [i for bit, i in enumerate(closed) if (label >> bit & 1).any()]
        return cls(objects, used, n_threads)

    def labels(self, points: Floats, normals: Floats) -> NDArray[np.int64]:
        """Label (n,) of the part of the surfaces that points (n, 3) are on: a bit a dielectric.

        `normals` (n, 3) are of the side of interest, and need not be unit.
        """
        label = np.zeros(len(points), dtype=np.int64)
        for bit, (i, caster) in enumerate(zip(self._ids, self._casters, strict=True)):
            rows = np.flatnonzero(_in_bounds(self._objects[i], points))
            inside = _contains(caster, points[rows], normals[rows], self._n_threads)
            label[rows] |= inside.astype(np.int64) << bit
        return label

    def part(self, label: int) -> Part:
        """The part of the surfaces that has a label."""
        inside = frozenset(i for bit, i in enumerate(self._ids) if label >> bit & 1)
        return Part(inside, frozenset(self._ids) - inside)


def _may_be_in(item: SceneObject, points: Floats) -> bool:
    return item.material.has_inside and bool(_in_bounds(item, points).any())


def _in_bounds(item: SceneObject, points: Floats) -> NDArray[np.bool_]:
    low, high = item.mesh.bounds
    inside: NDArray[np.bool_] = ((points >= low) & (points <= high)).all(axis=1)
    return inside


def _contains(
    caster: RayCaster, points: Floats, normals: Floats, n_threads: int
) -> NDArray[np.bool_]:
    """True for points (n, 3) from which a ray meets the back of the caster's dielectric first."""
    side = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    direction = np.where(side @ _DIRECTION < 0.0, -1.0, 1.0)[:, np.newaxis] * _DIRECTION
    start = points + _ABOVE * caster.resolution.at(points)[:, np.newaxis] * side
    found = caster.intersect(start, direction, n_threads=n_threads)
    # Normals are NaN, and the comparison false, where nothing is met.
    return from_behind(direction, found.geometric_normal)
