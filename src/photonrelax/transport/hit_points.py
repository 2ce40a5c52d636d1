"""Hit points of camera rays on diffuse surfaces.

Rays that hit specular surfaces split into reflection and refraction until they reach a diffuse
surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._ext.transport.hit_points import CameraPaths
from .._ext.transport.materials import Materials
from .._ext.transport.raycast import EmbreeHits
from .._util.parallel import ordered_map, thread_count, thread_executor
from .._util.validation import MAX_REPEATS, Floats, count
from ..scene.camera import Camera, film_corners, pixel_rays, places_of, sample_changes
from ..scene.emitters import Emitter
from ..scene.scene import Scene
from .media import MediaFinder, NestingFaults, warn_of_faults
from .raycast import RayCaster, empty_intersections

# Between parallel mirrors without loss rays never end.
MAX_DEPTH = 10_000
# Rays of less weight than this in every channel are not traced.
MIN_WEIGHT = 1e-3
# Camera rays followed together, at least a row of the image.
_BATCH = 16384


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
    footprint : (m, 2, 3), optional
        Edges of the part of the surface that the point stands for, m: the changes of its position
        over the width and the height of a sample, by ray differentials (Igehy 1999).
    emission : (m, 3), optional
        Radiance that the point emits to the camera, W/(m² sr); None where no surface emits.
    n_specular : (m,) int32, optional
        Specular surfaces between the camera and the point.
    """

    pixel: NDArray[np.int64]
    position: Floats
    normal: Floats
    albedo: Floats
    weight: Floats
    object_id: NDArray[np.int32]
    footprint: Floats | None = None
    emission: Floats | None = None
    n_specular: NDArray[np.int32] | None = None

    def __len__(self) -> int:
        return len(self.pixel)


@dataclass(frozen=True, eq=False)
class FirstSurfaces:
    """The surfaces nearest to the camera in some rows of the image, specular ones included.

    Attributes
    ----------
    normal : (rows, columns, 3)
        Shading normal on the side of the camera, the mean over the samples of the pixel; zero for
        samples that hit nothing.
    depth : (rows, columns)
        Distance along the viewing axis, m, the least over the samples; inf where nothing is hit.
    background : (rows, columns, 3), optional
        Radiance of what is behind everything and of specular surfaces that emit, also in mirrors
        and through glass, W/(m² sr); None in scenes without.
    """

    normal: Floats
    depth: Floats
    background: Floats | None = None


def trace_hit_points(
    scene: Scene,
    caster: RayCaster,
    camera: Camera,
    rows: range,
    *,
    columns: range | None = None,
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
    camera, rows, columns : Camera, range, range, optional
        The camera, which need not be that of the scene; its pixels, by default of all columns.
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
        If there are no rows or columns, some are not in the image, or a number is out of its range.
    """
    threads = thread_count(n_threads)
    count(max_depth, "max_depth", low=0, high=MAX_DEPTH)
    count(supersampling, "supersampling", high=MAX_REPEATS)
    columns = range(camera.width) if columns is None else columns
    tracer = _CameraTracer(
        *(scene, caster, camera, columns),
        supersampling=supersampling,
        offset=offset,
        max_depth=max_depth,
    )
    n_rays = len(columns) * supersampling**2
    per_batch = max(_BATCH // max(n_rays, 1), 1)
    batches = [rows[i : i + per_batch] for i in range(0, len(rows), per_batch)] or [rows]
    with thread_executor(min(threads, len(batches))) as executor:
        done = list(ordered_map(tracer.trace, batches, executor))
        hits = hit_points_of([batch.seen for batch in done], tracer.materials, scene, executor)
    faults = [*tracer.media.faults, *(batch.faults for batch in done)]
    warn_of_faults(scene, faults, len(rows) * n_rays, tracer.materials)
    return hits, _joined([batch.first for batch in done])


def _joined(parts: Sequence[FirstSurfaces]) -> FirstSurfaces:
    """The first surfaces of all rows, of those of some."""
    return FirstSurfaces(
        np.concatenate([part.normal for part in parts]),
        np.concatenate([part.depth for part in parts]),
        _concatenated([part.background for part in parts]),
    )


def _concatenated(parts: list[Floats | None]) -> Floats | None:
    """Arrays as one; None if there are none."""
    given = [part for part in parts if part is not None]
    return np.concatenate(given) if given else None


class _Batch(NamedTuple):
    # Columns of `HitPoints`, but for the albedo.
    seen: dict[str, NDArray]
    first: FirstSurfaces
    faults: NestingFaults


class _CameraTracer:
    """A scene and a camera, prepared for tracing rows of the image from several threads at once."""

    def __init__(
        self,
        scene: Scene,
        caster: RayCaster,
        camera: Camera,
        columns: range,
        *,
        supersampling: int,
        offset: tuple[float, float],
        max_depth: int,
    ) -> None:
        self.materials = Materials(scene.material_table())
        self._caster, self._camera, self._columns = caster, camera, columns
        self._supersampling, self._offset = supersampling, offset
        self._max_depth = max_depth
        self.media = MediaFinder(scene, caster, self.materials)
        self._may_be_inside = self.media.may_be_inside(film_corners(camera))
        self._changes = sample_changes(camera, supersampling)
        self._axis = camera.axes()[2]
        self._extent = scene.scale
        self._backgrounds = [emitter for emitter in scene.emitters if emitter.is_background]
        self._shining = {
            number: emitter
            for number, emitter in _emitting_surfaces(scene)
            if number in scene.specular_objects
        }
        self._n_objects = len(scene.objects)

    @property
    def _shines(self) -> bool:
        """Light is seen that no diffuse point emits."""
        return bool(self._backgrounds or self._shining)

    def trace(self, rows: range) -> _Batch:
        """Trace the rays of some rows of the image."""
        paths = CameraPaths(
            self.materials,
            self._caster.frame,
            self._caster.triangles,
            least_weight=MIN_WEIGHT,
            longest_edge=self._extent,
            first_emitter=self._n_objects if self._shines else -1,
        )
        first, found = self._start(paths, rows)
        follow_paths(paths, self._caster, found, self._max_depth)
        seen = paths.seen_points()
        seen["weight"] /= self._supersampling**2
        if self._shines:
            first = self._with_background(first, seen, rows)
            on_surface = ~np.isin(seen["object_id"], [-1, *self._shining])
            seen = {name: column[on_surface] for name, column in seen.items()}
        return _Batch(seen, first, paths.faults.take())

    def _with_background(
        self, first: FirstSurfaces, seen: dict[str, NDArray], rows: range
    ) -> FirstSurfaces:
        """First surfaces with what rays of their pixels escape to, or meet and go on from."""
        surface, weight = seen["object_id"], seen["weight"]
        light = np.zeros_like(weight)
        escaped = surface < 0
        towards = seen["normal"][escaped], seen["footprint"][escaped]
        for emitter in self._backgrounds:
            light[escaped] += weight[escaped] * emitter.background_means(*towards)
        for number, shining in self._shining.items():
            met = surface == number
            light[met] = weight[met] * shining.surface_radiance(seen["from_behind"][met])
        radiance = np.zeros(first.normal.shape)
        pixel = places_of(seen["pixel"], rows, self._columns, self._camera.width)
        np.add.at(radiance.reshape(-1, 3), pixel, light)
        return replace(first, background=radiance)

    def _start(self, paths: CameraPaths, rows: range) -> tuple[FirstSurfaces, EmbreeHits]:
        """Start the rays of some rows, in their media and off the surfaces that they start on.

        Returns the surfaces that they hit, and embree's hits.
        """
        s = self._supersampling
        origin, direction, pixel = pixel_rays(
            self._camera, rows, s, offset=self._offset, columns=self._columns
        )
        origin_change, film_change = self._changes
        paths.start(
            *(origin, direction, pixel),
            axis=self._axis,
            origin_change=origin_change,
            film_change=film_change,
        )
        found = self._caster.find_paths(paths)
        normal, depth, n_moved = paths.first_surfaces(found, self._axis, s * s)
        if n_moved:
            found = self._caster.find_paths(paths)
            normal, depth, _ = paths.first_surfaces(found, self._axis, s * s)
        if self._may_be_inside:
            hits = empty_intersections(len(pixel))
            self._caster.triangles.refine_hits(origin, direction, found, hits)
            paths.set_media(self.media.along(origin, direction, hits))
            if self.materials.has_hidden:
                self._caster.find_beyond(paths, found)
                normal, depth, _ = paths.first_surfaces(found, self._axis, s * s)
        shape = len(rows), len(self._columns)
        return FirstSurfaces(normal.reshape(*shape, 3), depth.reshape(shape)), found


def follow_paths(paths: CameraPaths, caster: RayCaster, found: EmbreeHits, max_depth: int) -> None:
    """Follow rays from their first hits to diffuse surfaces, through some specular ones at most."""
    for _ in range(max_depth):
        if not paths.advance(found):
            return
        found = caster.find_paths(paths)
    paths.advance(found)


def hit_points_of(
    batches: list[dict[str, NDArray]],
    materials: Materials,
    scene: Scene,
    executor: Executor | None = None,
) -> HitPoints:
    """Hit points of the columns of some batches, with what materials and emitters say of them."""
    names = list(batches[0])
    joined = ordered_map(
        lambda name: np.concatenate([some[name] for some in batches]), names, executor
    )
    columns = dict(zip(names, joined, strict=True))
    surface, from_behind = columns.pop("object_id"), columns.pop("from_behind")
    albedo = _albedo(scene, materials, surface, columns.pop("face_id"), columns)
    return HitPoints(
        **columns,
        albedo=albedo,
        object_id=scene.ids_of(surface),
        emission=_emission(scene, surface, from_behind),
    )


def _albedo(
    scene: Scene,
    materials: Materials,
    surface: NDArray,
    face: NDArray,
    columns: dict[str, NDArray],
) -> Floats:
    """Albedo (m, 3) at points on faces of surfaces, of textures the mean over the footprint."""
    albedo: Floats = np.take(materials.table.reflectance, surface, axis=0)
    for number, texture in enumerate(scene.textures):
        if texture is not None:
            rows = np.flatnonzero(surface == number)
            at = columns["position"][rows], columns["footprint"][rows]
            albedo[rows] = texture.at(scene.surfaces[number], face[rows], *at)
    return albedo


def _emission(scene: Scene, surface: NDArray, from_behind: NDArray[np.bool_]) -> Floats | None:
    """Radiance (m, 3) that points emit to the camera; None in scenes where nothing emits."""
    emitters = _emitting_surfaces(scene)
    if not emitters:
        return None
    emission = np.zeros((len(surface), 3))
    for number, emitter in emitters:
        seen = surface == number
        emission[seen] = emitter.surface_radiance(from_behind[seen])
    return emission


def _emitting_surfaces(scene: Scene) -> list[tuple[int, Emitter]]:
    """Emitters that are surfaces, with the indices of these."""
    emitters = [emitter for emitter in scene.emitters if emitter.surface is not None]
    return list(enumerate(emitters, len(scene.objects)))
