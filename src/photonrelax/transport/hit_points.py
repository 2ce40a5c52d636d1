"""What the camera sees: pixel rays, and the diffuse points they reach.

Rays that meet smooth surfaces split into reflection and refraction until they reach a diffuse
surface. Direct light at such points is found by shadow rays.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from .._ext.transport.hit_points import Surfaces
from .._util.parallel import thread_count
from .._util.validation import Floats, count, positive
from ..scene.camera import Camera, pixel_rays
from ..scene.materials import DIELECTRIC, DIFFUSE, MaterialTable
from ..scene.scene import Scene
from .raycast import Intersections, RayCaster

# Between parallel mirrors rays of no loss never end.
MAX_DEPTH = 10_000


@dataclass(frozen=True, eq=False)
class HitPoints:
    """Points on diffuse surfaces that pixels see directly or through smooth surfaces.

    Attributes
    ----------
    pixel : (m,) int64
        Index of the pixel, row · width + column.
    position : (m, 3)
        m.
    normal : (m, 3)
        Unit shading normal on the side that is seen.
    albedo : (m, 3)
        Of the surface.
    weight : (m, 3)
        What the point's radiance is multiplied by in the sum that is the pixel's radiance;
        includes the division by the number of samples per pixel.
    object_id : (m,) int32
        The object the point is on.
    """

    pixel: NDArray[np.int64]
    position: Floats
    normal: Floats
    albedo: Floats
    weight: Floats
    object_id: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.pixel)


@dataclass(frozen=True, eq=False)
class FirstSurfaces:
    """The surfaces nearest to the camera in some rows of the picture, smooth ones included.

    Attributes
    ----------
    normal : (rows, width, 3)
        Shading normal on the side that is seen, the mean over the samples of the pixel; zero for
        samples that see nothing.
    depth : (rows, width)
        Distance along the viewing axis, m, the least over the samples; inf where nothing is seen.
    """

    normal: Floats
    depth: Floats


@dataclass(frozen=True, eq=False)
class _Rays:
    """Rays on their way from the camera."""

    origin: Floats
    direction: Floats
    origin_normal: Floats  # normal of the surface left, NaN at the camera
    weight: Floats  # without the division by the number of samples
    medium: NDArray[np.int32]  # object the ray is inside of, or -1
    pixel: NDArray[np.int64]

    def __getitem__(self, rows: NDArray) -> _Rays:
        return _Rays(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


def trace_hit_points(
    scene: Scene,
    caster: RayCaster,
    camera: Camera,
    rows: range,
    *,
    supersampling: int = 1,
    offset: tuple[float, float] = (0.5, 0.5),
    max_depth: int = 8,
    min_weight: float = 1e-3,
    n_threads: int | None = None,
) -> tuple[HitPoints, FirstSurfaces]:
    """Follow the rays of some rows of the picture to diffuse surfaces.

    At a dielectric a ray goes on as two, weighted by Fresnel's reflectance and the rest; the
    refracted one also by (n_camera/n_other)², as radiance is. Beer–Lambert applies inside, though
    not between a camera in glass and another object in the same glass: the camera is taken to be
    outside unless the first thing met is a dielectric from behind.

    Parameters
    ----------
    scene, caster : Scene, RayCaster
        The scene and its objects, ready to be hit.
    camera : Camera
        The camera, which may be another than the scene's.
    rows : range
        Rows of pixels.
    supersampling, offset : int, (float, float)
        s·s samples per pixel; where in the cells of their grid they are.
    max_depth : int
        Smooth surfaces a ray may meet; what lies beyond is black.
    min_weight : float
        Rays of less weight than this in every channel are not followed.
    n_threads : int, optional
        Threads to use; None for every core. The result does not depend on it.

    Returns
    -------
    HitPoints, FirstSurfaces
        The diffuse points; normal and depth of the first surface seen.

    Raises
    ------
    ValueError
        If rows are none or not in the picture, or a number is out of its range.
    """
    threads = thread_count(n_threads)
    least = positive(min_weight, "min_weight")
    count(max_depth, "max_depth", low=0, high=MAX_DEPTH)
    rays = _camera_rays(*pixel_rays(camera, rows, supersampling, offset=offset))
    found = caster.intersect(rays.origin, rays.direction, n_threads=threads)
    table = scene.material_table()
    points = []
    for onward, reached in _levels(caster, rays, found, table, min_weight=least, n_threads=threads):
        diffuse = table.kind[reached.object_id] == DIFFUSE
        points.append(_hit_points(onward[diffuse], reached[diffuse], table, supersampling**2))
        if len(points) > max_depth:
            break
    return _joined(points), _first_surfaces(camera, rays, found)


def _levels(
    caster: RayCaster,
    rays: _Rays,
    found: Intersections,
    table: MaterialTable,
    *,
    min_weight: float,
    n_threads: int,
) -> Iterator[tuple[_Rays, Intersections]]:
    """Yield rays and what they hit, misses left out: from the camera, then after each split."""
    while True:
        rays, found = rays[found.hit], found[found.hit]
        rays = _absorb(rays, found, table)
        yield rays, found
        smooth = table.kind[found.object_id] != DIFFUSE
        if not smooth.any():
            return
        rays = _split(
            rays[smooth], found[smooth], table, min_weight=min_weight, n_threads=n_threads
        )
        found = caster.intersect(
            rays.origin, rays.direction, origin_normal=rays.origin_normal, n_threads=n_threads
        )


def _camera_rays(origins: Floats, directions: Floats, pixel: NDArray[np.int64]) -> _Rays:
    return _Rays(
        origins,
        directions,
        origin_normal=np.full_like(origins, np.nan),
        weight=np.ones_like(origins),
        medium=np.full(len(origins), -1, dtype=np.int32),
        pixel=pixel,
    )


def _first_surfaces(camera: Camera, rays: _Rays, found: Intersections) -> FirstSurfaces:
    samples = (-1, camera.width, np.count_nonzero(rays.pixel == rays.pixel[0]))
    depth = found.distance * (rays.direction @ camera.axes()[2])
    normal = np.where(found.hit[:, None], _seen_normal(rays, found), 0.0)
    return FirstSurfaces(
        normal=normal.reshape(*samples, 3).mean(axis=2), depth=depth.reshape(samples).min(axis=2)
    )


def _from_behind(rays: _Rays, found: Intersections) -> NDArray[np.bool_]:
    return np.einsum("ij,ij->i", rays.direction, found.geometric_normal) > 0.0


def _seen_normal(rays: _Rays, found: Intersections) -> Floats:
    """Return shading normals on the side of the face that the ray comes from."""
    return np.where(_from_behind(rays, found), -1.0, 1.0)[:, None] * found.shading_normal


def _absorb(rays: _Rays, found: Intersections, table: MaterialTable) -> _Rays:
    """Apply Beer–Lambert on the way to the hits.

    Meeting a dielectric from behind is being inside it, whatever was entered before.
    """
    leaves = _from_behind(rays, found) & (table.kind[found.object_id] == DIELECTRIC)
    medium = np.where(leaves, found.object_id, rays.medium)
    inside = np.flatnonzero(medium >= 0)
    weight = rays.weight.copy()
    depth = table.absorption[medium[inside]] * found.distance[inside, None]
    weight[inside] *= np.exp(-depth)
    return replace(rays, weight=weight)


def _split(
    rays: _Rays, found: Intersections, table: MaterialTable, *, min_weight: float, n_threads: int
) -> _Rays:
    """Return reflections and refractions of rays at smooth surfaces, less the faint ones."""
    n = len(found)
    direction, weight = np.empty((2 * n, 3)), np.empty((2 * n, 3))
    medium = np.empty(2 * n, dtype=np.int32)
    Surfaces(table).split(
        rays.direction,
        rays.weight,
        rays.medium,
        found,
        out_direction=direction,
        out_weight=weight,
        out_medium=medium,
        n_threads=n_threads,
    )
    kept = np.flatnonzero(weight.max(axis=1) >= min_weight)
    parent = kept // 2
    return _Rays(
        origin=found.position[parent],
        direction=direction[kept],
        origin_normal=found.geometric_normal[parent],
        weight=weight[kept],
        medium=medium[kept],
        pixel=rays.pixel[parent],
    )


def _hit_points(
    rays: _Rays, found: Intersections, table: MaterialTable, n_samples: int
) -> HitPoints:
    return HitPoints(
        pixel=rays.pixel,
        position=found.position,
        normal=_seen_normal(rays, found),
        albedo=table.reflectance[found.object_id],
        weight=rays.weight / n_samples,
        object_id=found.object_id,
    )


def _joined(parts: list[HitPoints]) -> HitPoints:
    return HitPoints(
        **{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(HitPoints)}
    )
