"""Hit points of camera rays on diffuse surfaces.

Rays that hit specular surfaces split into reflection and refraction until they reach a diffuse
surface.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from .._ext.transport.hit_points import split
from .._ext.transport.materials import Materials
from .._util.parallel import thread_count
from .._util.validation import Floats, count
from ..scene.camera import Camera, pixel_rays
from ..scene.scene import Scene
from .media import Media, MediaFinder, warn_of_overflows
from .optics import from_behind
from .raycast import Intersections, RayCaster

# Between parallel mirrors without loss rays never end.
MAX_DEPTH = 10_000
# Rays of less weight than this in every channel are not traced.
_MIN_WEIGHT = 1e-3


@dataclass(frozen=True, eq=False)
class HitPoints:
    """Points on diffuse surfaces that pixels see, directly or by way of specular surfaces.

    Attributes
    ----------
    pixel : (m,) int64
        Index of the pixel, row · width + column.
    position : (m, 3)
        m.
    normal : (m, 3)
        Unit shading normal on the side of the camera ray.
    albedo : (m, 3)
        Of the surface.
    weight : (m, 3)
        Factor of the point's radiance in the sum that is the pixel's radiance; includes the
        division by the number of samples per pixel.
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
    """The surfaces nearest to the camera in some rows of the image, specular ones included.

    Attributes
    ----------
    normal : (rows, width, 3)
        Shading normal on the side of the camera, the mean over the samples of the pixel; zero for
        samples that hit nothing.
    depth : (rows, width)
        Distance along the viewing axis, m, the least over the samples; inf where nothing is hit.
    """

    normal: Floats
    depth: Floats


@dataclass(frozen=True, eq=False)
class _Rays:
    """Segments of camera paths."""

    origin: Floats
    direction: Floats
    origin_offset: Floats  # `Intersections.offset` of where the ray starts, NaN at the camera
    weight: Floats  # without the division by the number of samples
    media: Media
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
    n_threads: int | None = None,
) -> tuple[HitPoints, FirstSurfaces]:
    """Trace the rays of some rows of the image to diffuse surfaces.

    At a dielectric a ray splits in two, weighted by the Fresnel reflectance and its complement; the
    refracted one also by (n_camera/n_other)², as radiance is. Beer–Lambert applies inside. The
    media that the camera is in are those that its ray leaves.

    Parameters
    ----------
    scene, caster : Scene, RayCaster
        The scene, and a caster of its objects.
    camera : Camera
        It need not be that of the scene.
    rows : range
        Rows of pixels.
    supersampling, offset : int, (float, float)
        s·s samples per pixel; their position in the cells of the sample grid.
    max_depth : int
        Largest number of specular events of a ray; what lies beyond is black.
    n_threads : int, optional
        Threads to use; None for every core. The result does not depend on it.

    Returns
    -------
    HitPoints, FirstSurfaces
        The diffuse points; normal and depth of the first surfaces.

    Raises
    ------
    ValueError
        If there are no rows, rows are not in the image, or a number is out of its range.
    """
    threads = thread_count(n_threads)
    count(max_depth, "max_depth", low=0, high=MAX_DEPTH)
    rays = _camera_rays(*pixel_rays(camera, rows, supersampling, offset=offset))
    found = _camera_hits(caster, rays, threads)
    materials = Materials(scene.material_table())
    finder = MediaFinder(scene, caster, materials)
    rays = replace(rays, media=finder.along(rays.origin, rays.direction, found))
    points = []
    for segments, hits in _levels(caster, rays, found, materials, n_threads=threads):
        diffuse = materials.diffuse[hits.object_id]
        points.append(_hit_points(segments[diffuse], hits[diffuse], materials, supersampling**2))
        if len(points) > max_depth:
            break
    return _concatenate_points(points), _first_surfaces(camera, rays, found)


def _levels(
    caster: RayCaster,
    rays: _Rays,
    found: Intersections,
    materials: Materials,
    *,
    n_threads: int,
) -> Iterator[tuple[_Rays, Intersections]]:
    """Yield rays and their hits, without misses: from the camera, then after each split."""
    while True:
        rays, found = rays[found.hit], found[found.hit]
        rays = _absorb(rays, found, materials)
        yield rays, found
        specular = ~materials.diffuse[found.object_id]
        if not specular.any():
            return
        rays = _split(rays[specular], found[specular], materials, n_threads)
        found = caster.intersect(
            rays.origin, rays.direction, origin_offset=rays.origin_offset, n_threads=n_threads
        )


def _camera_rays(origins: Floats, directions: Floats, pixel: NDArray[np.int64]) -> _Rays:
    return _Rays(
        origins,
        directions,
        origin_offset=np.full_like(origins, np.nan),
        weight=np.ones_like(origins),
        media=np.zeros(len(origins), dtype=np.uint64),
        pixel=pixel,
    )


def _camera_hits(caster: RayCaster, rays: _Rays, n_threads: int) -> Intersections:
    """Hits of the camera's rays, but not on surfaces that the camera lies on."""
    found = caster.intersect(rays.origin, rays.direction, n_threads=n_threads)
    height = found.distance * np.abs(np.einsum("ij,ij->i", rays.direction, found.geometric_normal))
    if not (height <= found.step).any():
        return found
    offset = np.where((height <= found.step)[:, np.newaxis], found.offset, np.nan)
    return caster.intersect(rays.origin, rays.direction, origin_offset=offset, n_threads=n_threads)


def _first_surfaces(camera: Camera, rays: _Rays, found: Intersections) -> FirstSurfaces:
    samples = (-1, camera.width, np.count_nonzero(rays.pixel == rays.pixel[0]))
    depth = found.distance * (rays.direction @ camera.axes()[2])
    normal = np.where(found.hit[:, None], _seen_normal(rays, found), 0.0)
    return FirstSurfaces(
        normal=normal.reshape(*samples, 3).mean(axis=2), depth=depth.reshape(samples).min(axis=2)
    )


def _seen_normal(rays: _Rays, found: Intersections) -> Floats:
    """Shading normals on the side of the face that the ray comes from."""
    behind = from_behind(rays.direction, found.geometric_normal)
    return np.where(behind, -1.0, 1.0)[:, None] * found.shading_normal


def _absorb(rays: _Rays, found: Intersections, materials: Materials) -> _Rays:
    """Apply Beer–Lambert on the way to the hits."""
    media, transmitted = materials.arrive(rays.direction, found, rays.media)
    return replace(rays, media=media, weight=rays.weight * transmitted)


def _split(rays: _Rays, found: Intersections, materials: Materials, n_threads: int) -> _Rays:
    """Reflections and refractions of rays at specular surfaces, without the faint ones."""
    n = len(found)
    direction, weight = np.empty((2 * n, 3)), np.empty((2 * n, 3))
    media = np.empty(2 * n, dtype=np.uint64)
    overflows = split(
        materials,
        found,
        direction=rays.direction,
        weight=rays.weight,
        media=rays.media,
        out_direction=direction,
        out_weight=weight,
        out_media=media,
        n_threads=n_threads,
    )
    warn_of_overflows(overflows, materials)
    kept = np.flatnonzero(weight.max(axis=1) >= _MIN_WEIGHT)
    parent = kept // 2
    return _Rays(
        origin=found.position[parent],
        direction=direction[kept],
        origin_offset=found.offset[parent],
        weight=weight[kept],
        media=media[kept],
        pixel=rays.pixel[parent],
    )


def _hit_points(
    rays: _Rays, found: Intersections, materials: Materials, n_samples: int
) -> HitPoints:
    return HitPoints(
        pixel=rays.pixel,
        position=found.position,
        normal=_seen_normal(rays, found),
        albedo=materials.table.reflectance[found.object_id],
        weight=rays.weight / n_samples,
        object_id=found.object_id,
    )


def _concatenate_points(parts: list[HitPoints]) -> HitPoints:
    return HitPoints(
        **{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(HitPoints)}
    )
