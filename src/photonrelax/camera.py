"""What the camera sees: pixel rays, and the diffuse points they reach.

Rays that meet smooth surfaces split into reflection and refraction until they reach a diffuse
surface. Direct light at such points is found by shadow rays.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._arrays import Floats, count, float_array, positive, thread_count, unit_vectors
from ._ext.transport.hit_points import Surfaces
from .raycast import Intersections, RayCaster
from .scene import (
    DIELECTRIC,
    DIFFUSE,
    Camera,
    CollimatedEmitter,
    Emitter,
    LambertianEmitter,
    MaterialTable,
    Scene,
)

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
    leaving: Floats  # normal of the surface left, NaN at the camera
    weight: Floats  # without the division by the number of samples
    medium: NDArray[np.int32]  # object the ray is inside of, or -1
    pixel: NDArray[np.int64]

    def __getitem__(self, rows: NDArray) -> _Rays:
        return _Rays(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


def pixel_rays(
    camera: Camera,
    rows: range,
    supersampling: int = 1,
    *,
    offset: tuple[float, float] = (0.5, 0.5),
) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Return the rays of some rows of the picture, row 0 at the top.

    Parameters
    ----------
    camera : Camera
        Pinhole or orthographic.
    rows : range
        Rows of pixels.
    supersampling : int
        s·s samples per pixel, on a regular grid.
    offset : (float, float)
        Where in the cells of that grid samples are, to the right and down, in [0, 1).

    Returns
    -------
    origins, directions : (m, 3)
        Unit directions; the samples of a pixel follow one another.
    pixel : (m,) int64
        Index of the pixel, row · width + column.

    Raises
    ------
    ValueError
        If there are no rows, or rows that are not in the picture.
    """
    if not len(rows) or min(rows) < 0 or max(rows) >= camera.height:
        raise ValueError(f"rows should be some of [0, {camera.height}), but are {rows}")
    s = count(supersampling, "supersampling")
    row, column, i, j = np.meshgrid(rows, range(camera.width), range(s), range(s), indexing="ij")
    # In half heights of the picture from its centre.
    x = ((2 * (column + (j + offset[0]) / s) - camera.width) / camera.height).ravel()
    y = (1 - 2 * (row + (i + offset[1]) / s) / camera.height).ravel()
    pixel = (row * camera.width + column).astype(np.int64).ravel()
    return *_film_rays(camera, x[:, None], y[:, None]), pixel


def _film_rays(camera: Camera, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    right, up, forward = camera.axes()
    origin = np.asarray(camera.origin)
    if camera.orthographic_height is not None:
        half = 0.5 * camera.orthographic_height
        origins = origin + half * (x * right + y * up)
        return origins, np.tile(forward, (len(x), 1))
    half = np.tan(np.radians(0.5 * camera.vertical_fov))
    directions = forward + half * (x * right + y * up)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.tile(origin, (len(x), 1)), directions


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
            rays.origin, rays.direction, leaving=rays.leaving, n_threads=n_threads
        )


def _camera_rays(origins: Floats, directions: Floats, pixel: NDArray[np.int64]) -> _Rays:
    return _Rays(
        origins,
        directions,
        leaving=np.full_like(origins, np.nan),
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
        leaving=found.geometric_normal[parent],
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
    photons' part. Points nearer to an emitter than `Scene.emitter_gap` get nothing from it: the
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
        direction, distance, irradiance = _arriving(emitter, position, scene.emitter_gap)
        irradiance *= np.maximum(np.einsum("ij,ij->i", direction, normal), 0.0)[:, None]
        lit = np.flatnonzero(irradiance.any(axis=1))
        blocked = caster.occluded(
            position[lit],
            direction[lit],
            distance[lit] - scene.emitter_gap,
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
