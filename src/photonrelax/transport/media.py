"""Media that emitters and cameras lie in, found by rays from there.

A ray through all surfaces leaves the dielectrics that its origin lies in, the innermost first. So
the first face of a dielectric that it meets says whether the origin is inside: it is where the ray
meets that face from behind. `photonrelax._ext.transport.media` has the stacks. Counts of rays that
the nesting of bodies contradicts come from there and from the kernels that follow rays.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from weakref import WeakKeyDictionary, WeakSet

import numpy as np
from numpy.typing import NDArray

from .._ext.transport.materials import Materials
from .._util.validation import Floats
from ..scene.scene import Scene, surface_label
from .optics import from_behind
from .raycast import Intersections, RayCaster

Media = NDArray[np.uint64]
"""A stack of media for each ray."""
NestingFaults = NDArray[np.int64]
"""Surfaces (k, 3): index, rays that left it unentered, rays that entered it beyond a full stack."""

# Rays that leave a dielectric unentered by rounding at its edges: one, or this share of all.
_STRAY, _STRAYS = 1, 1e-4
_UNENTERED = (
    "and was taken to have been in it since the surface before: close the mesh, and its contacts "
    "with others."
)
_OVERFLOWED = (
    "and the outermost of those of least priority was forgotten until the ray left it: index and "
    "absorption are wrong where that one alone is left. Nest objects less deeply."
)
_warned_of: WeakSet[Scene] = WeakSet()
_at_emitters: WeakKeyDictionary[Scene, tuple[Media, list[NestingFaults]]] = WeakKeyDictionary()
# Directions of the rays from emitters, along no edges of usual models.
_PROBES = np.array([[0.413, 0.271, 0.869], [-0.782, 0.561, 0.271], [0.319, -0.847, -0.425]])


class MediaFinder:
    """A scene prepared for finding the media at points, from several threads at once.

    Attributes
    ----------
    faults : list of (k, 3) int64
        `NestingFaults` of the rays so far.
    """

    def __init__(self, scene: Scene, caster: RayCaster, materials: Materials) -> None:
        self._scene, self._caster, self._materials = scene, caster, materials
        self._ids = materials.dielectrics
        low, high = (corner[self._ids] for corner in scene.object_bounds)
        # Points may lie on surfaces.
        margin = caster.resolution.at(np.concatenate([low, high])).max(initial=0.0)
        self._low, self._high = low - margin, high + margin
        self.faults: list[NestingFaults] = []

    def at_emitters(self) -> Media:
        """Media at the emitters of the scene, (n_emitters,).

        They are those where light leaves along the axis of the emitter: that of a beam in the
        middle of it. Two of three rays decide, so that holes in meshes matter less.
        """
        if len(self._ids) == 0:
            return np.zeros(len(self._scene.emitters), dtype=np.uint64)
        origin = np.repeat(self._emitter_points(), len(_PROBES), axis=0)
        direction = np.tile(_PROBES, (len(self._scene.emitters), 1))
        media = self.along(origin, direction, self._caster.intersect(origin, direction))
        first, second, third = media.reshape(-1, 3).T
        return np.where(second == third, second, first)

    def _emitter_points(self) -> Floats:
        scene, whole = self._scene, self._scene.bounding_sphere()
        regions = [
            emitter.emission_region(whole, whole, float(offset))
            for emitter, offset in zip(scene.emitters, scene.emitter_offsets, strict=True)
        ]
        return np.array([r.origin + r.start_distance * r.frame[2] for r in regions])

    def may_be_inside(self, origin: Floats) -> bool:
        """False if no dielectric has any of the points (n, 3) in its bounding box."""
        return bool(self._near(origin).any())

    def _near(self, origin: Floats) -> NDArray[np.bool_]:
        """Mask of the dielectrics whose bounding boxes meet that of points (n, 3)."""
        near: NDArray[np.bool_] = np.all(
            (self._low <= origin.max(axis=0)) & (self._high >= origin.min(axis=0)), axis=1
        )
        return near

    def along(self, origin: Floats, direction: Floats, found: Intersections) -> Media:
        """Media at the origins of rays (n, 3), by their first hits and those beyond, (n,)."""
        media = np.zeros(len(origin), dtype=np.uint64)
        near = self._near(origin)
        if not near.any():
            return media
        box = self._low[near].min(axis=0), self._high[near].max(axis=0)
        rows = np.flatnonzero(_in_box(origin, *box))
        if len(rows) == 0:
            return media
        crossings = [np.empty((3, 0), dtype=np.intp)]
        for ray, hits in self._surfaces(rows, direction, found[rows], box):
            behind = from_behind(direction[ray], hits.geometric_normal)
            crossings.append(np.array([ray, hits.object_id, behind]))
        self._stack(media, origin, *np.concatenate(crossings, axis=1))
        return media

    def _surfaces(
        self, rows: NDArray, direction: Floats, found: Intersections, box: tuple[Floats, Floats]
    ) -> Iterator[tuple[NDArray, Intersections]]:
        """Yield rays and their hits, surface by surface, until they have left a box."""
        while True:
            inside = _in_box(found.position, *box)
            rows, found = rows[inside], found[inside]
            if len(rows) == 0:
                return
            yield rows, found
            found = self._caster.intersect(
                found.position, direction[rows], origin_offset=found.offset
            )

    def _stack(
        self, media: Media, origin: Floats, ray: NDArray, object_id: NDArray, behind: NDArray
    ) -> None:
        """Write the stacks of rays that cross surfaces in this order."""
        _, first = np.unique(ray * len(self._scene.surfaces) + object_id, return_index=True)
        first = first[behind[first] > 0]
        dielectric = np.isin(object_id[first], self._ids)
        first = first[dielectric]
        number = np.searchsorted(self._ids, object_id[first])
        inside = _in_box(origin[ray[first]], self._low[number], self._high[number])
        first, number = first[inside], number[inside]
        priority = self._materials.table.priority[self._ids][number]
        order = np.lexsort((first, -priority, ray[first]))
        ray, number = ray[first][order], number[order]
        # The largest priority first, then innermost first: depth is the place among those of a ray.
        depth = np.arange(len(ray)) - np.searchsorted(ray, ray)
        kept = depth < self._materials.max_depth
        shifted = (1 + number[kept]).astype(np.uint64) << (
            self._materials.bits * depth[kept]
        ).astype(np.uint64)
        np.bitwise_or.at(media, ray[kept], shifted)
        lost, times = np.unique(self._ids[number[~kept]], return_counts=True)
        if len(lost):
            self.faults.append(np.column_stack([lost, np.zeros_like(times), times]))


def media_at_emitters(
    scene: Scene, caster: RayCaster, materials: Materials
) -> tuple[Media, list[NestingFaults]]:
    """Media at the emitters of a scene, and the faults of the rays that tell; found once for it."""
    if scene not in _at_emitters:
        finder = MediaFinder(scene, caster, materials)
        _at_emitters[scene] = finder.at_emitters(), finder.faults
    return _at_emitters[scene]


def warn_of_faults(
    scene: Scene, faults: Sequence[NestingFaults], n_rays: int, materials: Materials
) -> None:
    """Warn once a scene of what the nesting of its dielectrics contradicts, if anything does.

    `faults` are those of `n_rays` rays of emitters or cameras.
    """
    count = np.zeros((len(scene.surfaces), 2), dtype=np.int64)
    for rows in faults:
        np.add.at(count, rows[:, 0], rows[:, 1:])
    unentered, overflowed = count.T
    unentered[unentered <= max(_STRAY, _STRAYS * n_rays)] = 0
    beyond = f"was in more than {materials.max_depth} dielectrics at once"
    texts = [
        _fault_text(scene, unentered, "left a dielectric that it had not entered", _UNENTERED),
        _fault_text(scene, overflowed, beyond, _OVERFLOWED),
    ]
    if any(texts) and scene not in _warned_of:
        _warned_of.add(scene)
        warnings.warn(" ".join(filter(None, texts)), stacklevel=3)


def _fault_text(scene: Scene, count: NDArray[np.int64], event: str, remedy: str) -> str:
    """Events of rays with their counts (surfaces,) by surface; empty if there are none."""
    ids = [int(i) for i in np.argsort(-count, kind="stable") if count[i]]
    objects = ", ".join(f"{surface_label(i, scene)} {count[i]}" for i in ids)
    return f"{count.sum()} times a ray {event} ({objects}), {remedy}" if ids else ""


def _in_box(points: Floats, low: Floats, high: Floats) -> NDArray[np.bool_]:
    """True for points (n, 3) in boxes; false for NaN."""
    inside: NDArray[np.bool_] = np.all((points >= low) & (points <= high), axis=1)
    return inside
