"""Charts: rectangles of an emitter's coordinates around what can cast a caustic.

A chart maps the unit square to rays of its emitter. That of parallel light is a rectangle across
it; that of a point is one on a plane before it (gnomonic), six of them where casters are all
around. Straight lines are straight in both, so the rectangle around the vertices of a caster is
around all of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..._util.validation import Floats
from ...scene.emission_region import axis_frame
from ...scene.emitters import CollimatedEmitter, Emitter
from ...scene.materials import Dielectric, Mirror
from ...scene.scene import Scene
from ...transport.aim import LUMINANCE

# Share of its sides by which a chart is larger than its casters.
_MARGIN = 1e-3
# Ratio of the variances of casters along two axes up to which they have none, and skewness along
# one up to which neither end is before the other.
_ROUND, _EVEN = 1.01, 1e-6
# Points along each side by which the power of a chart is summed.
_MIDDLES = 256
# Casters farther than this from the axis of a chart, as a tangent, get charts all around.
_WIDEST = 2.0


class ChartRays(NamedTuple):
    """Rays of an emitter at points of a chart, and the power around them.

    Attributes
    ----------
    origin, direction : (n, 3) float64
        m, and unit vectors.
    power : (n, 3) float64
        W per area of the chart, which is 1 in all.
    """

    origin: Floats
    direction: Floats
    power: Floats


@dataclass(frozen=True, eq=False)
class Chart:
    """A rectangle of the coordinates of one emitter.

    Attributes
    ----------
    emitter, emitter_id : Emitter, int
        The emitter, and its index in the scene.
    corner : (3,) float64
        Where the chart's (0, 0) is: on a plane before all objects for parallel light, m; relative
        to its point for others, on a plane at distance 1.
    u, v : (3,) float64
        Its sides, perpendicular to each other.
    start : float
        Distance from the point at which rays start, m.
    """

    emitter: Emitter
    emitter_id: int
    corner: Floats
    u: Floats
    v: Floats
    start: float = 0.0

    @property
    def sides(self) -> Floats:
        """Lengths (2,) of the sides."""
        return np.linalg.norm([self.u, self.v], axis=1)

    @property
    def coords_width(self) -> int:
        """Number of emitter coordinates: 2 of a plane, 3 of directions."""
        return 2 if self.emitter.point is None else 3

    def coords(self, places: Floats) -> tuple[Floats, Floats]:
        """Emitter coordinates (n, 2), m, or (n, 3) at places, and luminance (n,) per m² or sr."""
        rays = self.rays(places)
        area = float(np.prod(self.sides))
        sent = rays.power @ LUMINANCE / area
        if self.emitter.point is None:
            axes = np.array([self.u, self.v]) / self.sides[:, np.newaxis]
            return rays.origin @ axes.T, sent
        distance = np.linalg.norm(self._at(places), axis=1)
        return rays.direction, sent * distance**3

    @cached_property
    def emitted(self) -> Floats:
        """Flux (3,) through the chart, W, by the midpoint rule."""
        # Parallel light is the same everywhere.
        n = 1 if self.emitter.point is None else _MIDDLES
        middles = (np.arange(n) + 0.5) / n
        u, v = np.meshgrid(middles, middles)
        mean: Floats = self.rays(np.column_stack([u.ravel(), v.ravel()])).power.mean(axis=0)
        return mean

    def rays(self, places: Floats) -> ChartRays:
        """Rays at places (n, 2) in the unit square."""
        at = self._at(places)
        area = float(np.prod(self.sides))
        point = self.emitter.point
        if point is None:
            along = np.cross(self.u, self.v) / area
            power = area * self.emitter.direct(at, 0.0).irradiance
            return ChartRays(at, np.tile(along, (len(at), 1)), power)
        distance = np.linalg.norm(at, axis=1)[:, np.newaxis]
        direction = at / distance
        # At distance 1 irradiance is intensity, and the plane is seen aslant.
        intensity = self.emitter.direct(point + direction, 0.0).irradiance
        origin = point + self.start * direction
        return ChartRays(origin, direction, intensity * area / distance**3)

    def _at(self, places: Floats) -> Floats:
        """Points (n, 3) of the rectangle."""
        at: Floats = self.corner + places[:, :1] * self.u + places[:, 1:] * self.v
        return at


def charts_of(scene: Scene) -> list[Chart]:
    """Charts around all that casts caustics, of the emitters of a scene.

    Those with a size have none: their coordinates are more than two.
    """
    charts: list[Chart] = []
    for emitter_id, emitter in enumerate(scene.emitters):
        if emitter.is_extended:
            continue
        if isinstance(emitter, CollimatedEmitter):
            charts += parallel_charts(scene, emitter, emitter_id)
        elif emitter.point is not None:
            charts += _charts_around_point(scene, emitter, emitter_id)
    return charts


def _casters(scene: Scene) -> list[Floats]:
    """Vertices of each object that may cast a caustic and that are of any face, m."""
    return [
        np.asarray(item.mesh.vertices)[item.mesh.referenced_vertices]
        for item in scene.objects
        if isinstance(item.material, Dielectric | Mirror)
    ]


def parallel_charts(scene: Scene, emitter: CollimatedEmitter, emitter_id: int) -> list[Chart]:
    """Charts of parallel light, which need not be that of the scene's emitter of the number."""
    casters, whole = _casters(scene), scene.bounding_sphere()
    region = emitter.emission_region(whole, whole, scene.emitter_offset(emitter))
    frame = _aligned(region.frame, [_along(each, region.frame[:2]) for each in casters])
    shift = frame[:2] @ region.origin
    boxes = [_box(_along(each, frame[:2])) - shift for each in casters]
    return [
        Chart(
            emitter,
            emitter_id,
            region.origin + low @ frame[:2],
            (high - low)[0] * frame[0],
            (high - low)[1] * frame[1],
        )
        for low, high in _disjoint(boxes)
    ]


def _charts_around_point(scene: Scene, emitter: Emitter, emitter_id: int) -> list[Chart]:
    casters, whole = _casters(scene), scene.bounding_sphere()
    region = emitter.emission_region(whole, whole, scene.emitter_offset(emitter))
    towards = [each - region.origin for each in casters]
    units = [each / np.linalg.norm(each, axis=1)[:, np.newaxis] for each in towards]
    axis = sum(each.mean(axis=0) for each in units)
    length = np.linalg.norm(axis)
    frame = axis_frame(axis / length) if length > 0.0 else np.eye(3)
    if length > 0.0:
        frame = _aligned(frame, [_along(each, frame[:2]) for each in units])
    local = [_along(each, frame) for each in towards]
    if all((np.hypot(p[:, 0], p[:, 1]) <= _WIDEST * p[:, 2]).all() for p in local):
        boxes = _disjoint([_box(p[:, :2] / p[:, 2:]) for p in local])
        frames = [frame] * len(boxes)
    else:
        boxes = [np.array([[-1.0, -1.0], [1.0, 1.0]])] * 6
        frames = [axis_frame(side * np.eye(3)[i]) for i in range(3) for side in (1.0, -1.0)]
    return [
        Chart(
            emitter,
            emitter_id,
            low @ turned[:2] + turned[2],
            (high - low)[0] * turned[0],
            (high - low)[1] * turned[1],
            region.start_distance,
        )
        for turned, (low, high) in zip(frames, boxes, strict=True)
    ]


def _aligned(frame: Floats, casters: list[Floats]) -> Floats:
    """A frame turned about its third axis to the axes of casters, so that charts turn with these.

    `casters` (v, 2) are their coordinates along the other axes of the frame. It stays where they
    are as wide along all directions.
    """
    across = np.concatenate(casters)
    across -= across.mean(axis=0)
    variance, axes = np.linalg.eigh(np.einsum("vi,vj->ij", across, across))
    if variance[1] <= _ROUND * variance[0]:
        return frame
    u = axes[:, 1]
    distance = across[:, 0] * u[0] + across[:, 1] * u[1]
    cubes = distance * distance * distance
    lean = cubes.sum()
    if abs(lean) <= _EVEN * np.abs(cubes).sum():
        lean = -u[np.abs(u).argmax()]
    turned = (u if lean >= 0.0 else -u) @ frame[:2]
    return np.array([turned, np.cross(frame[2], turned), frame[2]])


def _along(vectors: Floats, axes: Floats) -> Floats:
    """Coordinates (v, k) of vectors (v, 3) along axes (k, 3).

    Matrices so narrow are not worth the threads of a library of linear algebra. Each coordinate is
    in sequence, as their extremes are then found faster.
    """
    columns: Floats = np.einsum("vc,kc->kv", vectors, axes)
    return columns.T


def _box(points: Floats) -> Floats:
    """Corners (2, 2) of the rectangle around points (n, 2), and a little more."""
    low, high = points.min(axis=0), points.max(axis=0)
    margin = _MARGIN * (high - low).max()
    return np.array([low - margin, high + margin])


def _disjoint(boxes: list[Floats]) -> list[Floats]:
    """Rectangles that hold all boxes and do not overlap."""
    boxes = list(boxes)
    i = 0
    while i < len(boxes):
        low, high = boxes[i]
        met = [j for j in range(i) if (boxes[j][0] < high).all() and (low < boxes[j][1]).all()]
        if met:
            both = np.array([boxes[j] for j in (*met, i)])
            boxes = [box for j, box in enumerate(boxes) if j not in (*met, i)]
            boxes.insert(0, np.array([both[:, 0].min(axis=0), both[:, 1].max(axis=0)]))
            i = 0
        i += 1
    return boxes
