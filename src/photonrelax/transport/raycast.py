"""Ray casting: the only module that uses embree.

Embree works in float32, and reads out of bounds where array lengths differ. So rays are checked
here and transformed to embree's recentred frame in float64, and hits are refined in float64.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._ext.transport.hit_points import CameraPaths
from .._ext.transport.raycast import EmbreeFrame, EmbreeHits, Triangles
from .._ext.transport.trace import Paths
from .._util.parallel import for_each_slice, thread_count
from .._util.parcels import kept
from .._util.validation import Floats, float_array
from ..scene.digest import objects_digest
from ..scene.meshes import nondegenerate_faces, vertices_of
from ..scene.resolution import MAX_SPREAD, ROUNDING, Resolution
from ..scene.scene import SceneObject, object_label
from .contacts import open_contacts, overlap_contacts, warn_of_thin_objects
from .split_triangles import Pieces, split_triangles

# Rays per call of embree: limits the float32 copies and is the grain size of parallel work.
_CHUNK = 65536
# Surfaces in a row that a ray passes as they are not there. Along a sharp edge float32 may lead it
# through the same ones again and again: those beyond are events, at which it goes straight on.
MAX_HIDDEN = 1000
# Length of embree's frame: far from the extremes of float32, whose squares it takes.
_EMBREE_SIZE = 100.0
# Coordinates of a scene over those where its triangles are fine, above which rays from outside of
# the fine part are moved there.
_MANY_TIMES = 8.0
_NO_RAYS = np.empty((0, 3))
_NO_LIMITS = np.empty(0)


@dataclass(frozen=True, eq=False)
class Intersections:
    """First hits of n rays.

    Attributes
    ----------
    object_id, face_id : (n,) int32
        The object and the face in its mesh; -1 where nothing is hit.
    distance : (n,)
        From the ray's origin, m; inf where nothing is hit.
    position : (n, 3)
        m; NaN where nothing is hit, like the normals.
    geometric_normal : (n, 3)
        Unit normal by the winding of the face: outward for closed meshes.
    shading_normal : (n, 3)
        Interpolated between vertex normals on smooth objects, else the geometric normal; always
        on the same side of the face as the geometric normal.
    step : (n,)
        Distance, m, that rays which leave are moved off the surface: what float32 may displace the
        face by. NaN where nothing is hit.
    """

    object_id: NDArray[np.int32]
    face_id: NDArray[np.int32]
    distance: Floats
    position: Floats
    geometric_normal: Floats
    shading_normal: Floats
    step: Floats

    def __len__(self) -> int:
        return len(self.object_id)

    @property
    def hit(self) -> NDArray[np.bool_]:
        """Mask (n,) of the rays that hit anything."""
        return self.object_id >= 0

    @property
    def offset(self) -> Floats:
        """Vectors (n, 3) along the normals by which rays that leave are moved, m."""
        return self.step[:, np.newaxis] * self.geometric_normal

    def __getitem__(self, rows: slice | NDArray) -> Intersections:
        """Return the intersections of some of the rays: views for a slice."""
        return Intersections(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


class RayCaster:
    """Objects in an acceleration structure for rays.

    Can be used from several threads at once: embree runs without the GIL.

    Parameters
    ----------
    objects : sequence of SceneObject
        At least one; positions in the sequence are the `object_id` of hits.
    object_ids : iterable of int, optional
        Those of the objects that rays hit; by default all but sensors.

    Attributes
    ----------
    frame : EmbreeFrame
        Embree's frame, for kernels that transform their rays to it.
    triangles : Triangles
        The triangles, for kernels that refine the hits of `find`.
    resolution : Resolution
        Distance that rays resolve, by position.

    Raises
    ------
    ImportError
        If embreex is not installed.
    """

    def __init__(
        self, objects: Sequence[SceneObject], object_ids: Iterable[int] | None = None
    ) -> None:
        if not objects:
            raise ValueError("objects should not be empty")
        ids = _visible_ids(objects) if object_ids is None else list(object_ids)
        self._objects, self._ids = objects, ids
        # The frame needs an extent, if only that of objects that rays do not hit.
        whole = _concatenate_parts(
            {i: _nondegenerate_part(objects[i]) for i in ids or range(len(objects))}
        )
        vertices, faces = whole.corners[:, :3], whole.faces[:, :3]
        self.resolution = Resolution.of(vertices, faces)
        transparent = np.array([item.material.has_inside for item in objects])
        of_glass = transparent[whole.faces[:, 3]]
        warn_of_thin_objects(
            vertices,
            faces[of_glass],
            whole.faces[of_glass, 3],
            [object_label(i, item) for i, item in enumerate(objects)],
            self.resolution,
        )
        priority = np.array([item.material.row().priority for item in objects], dtype=np.int64)
        overlap_contacts(
            vertices, faces[of_glass], whole.faces[of_glass, 3], priority, self.resolution
        )
        open_contacts(vertices, faces, of_glass, self.resolution)
        vertices -= self.resolution.origin
        self.frame = _frame(vertices, self.resolution)
        self._cubes = _cubes(np.abs(vertices).max(), self.resolution.radius)
        self._pieces = split_triangles(vertices, faces, self.resolution.radius)
        whole_faces = _not_split(self._pieces, len(faces))
        self._face = np.concatenate([whole_faces, self._pieces.face]).astype(np.int32)
        self._scene: Any = _EmptyScene()
        if ids:
            self._scene = _embree_scene(
                self.frame.scale * vertices, faces, self._pieces, whole_faces
            )
        smooth = np.array([item.smooth for item in objects], dtype=np.uint8)
        self.triangles = Triangles(self.frame, whole.corners, whole.faces, whole.face_id, smooth)

    def __reduce__(self) -> tuple[Any, tuple[Sequence[SceneObject], list[int]]]:
        return _kept_caster, (self._objects, self._ids)

    def find(self, origins: NDArray[np.float32], directions: NDArray[np.float32]) -> EmbreeHits:
        """Return embree's hits of rays (n, 3) in its own frame.

        Raises
        ------
        ValueError
            If shapes, types or layout are not those that embree requires without checking.
        """
        for rays in (origins, directions):
            of_type = rays.dtype == np.float32 and rays.flags.c_contiguous
            if rays.shape != (len(origins), 3) or not of_type:
                raise ValueError(
                    f"rays should be C-contiguous float32 of shape ({len(origins)}, 3), "
                    f"but are {rays.dtype} of shape {rays.shape} and strides {rays.strides}"
                )
        found = self._scene.run(origins, directions, query="INTERSECT", output=True)
        hits = EmbreeHits(found, len(origins))
        if len(self._pieces):
            hits.to_faces(self._face, self._pieces.uv)
        return hits

    def find_paths(self, paths: Paths | CameraPaths) -> EmbreeHits:
        """Embree's hits of the live rays of a batch of paths, on surfaces that are there."""
        if len(self._cubes) > 1:
            _, origins, directions = paths.live_rays()
            self._start_near(origins, directions, *paths.rays)
        found = self.find(*paths.rays)
        self.find_beyond(paths, found)
        return found

    def find_beyond(self, paths: Paths | CameraPaths, found: EmbreeHits) -> None:
        """Replace hits of live rays on surfaces that are not there by those beyond."""
        for _ in range(MAX_HIDDEN if paths.has_hidden else 0):
            rows, positions, directions = paths.pass_hidden(found)
            if len(rows) == 0:
                return
            rays = [array[rows] for array in paths.rays]
            self._start_near(positions, directions, *rays)
            found.replace(rows, self.find(*rays))

    def _start_near(
        self,
        origins: Floats,
        directions: Floats,
        embree_origins: NDArray[np.float32],
        embree_directions: NDArray[np.float32],
    ) -> None:
        """Move origins of rays from afar, in embree's frame, to where triangles are fine.

        Distant origins are coarse in float32. Only rays with nothing before that are moved, in
        steps: to cubes around the origin each of which is a fraction of the one before.
        """
        blocked = np.zeros(len(origins), dtype=bool)
        for outer, half_side in pairwise(self._cubes):
            rows, near, limits = self.frame.far_rays(origins, directions, half_side, outer)
            ahead = ~blocked[rows]
            if not ahead.any():
                continue
            rows, near = rows[ahead], near[ahead]
            rays = embree_origins[rows], embree_directions[rows]
            blocked[rows] = self._scene.run(*rays, limits[ahead], query="OCCLUDED") >= 0
            free = ~blocked[rows]
            embree_origins[rows[free]] = near[free]

    def intersect(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        *,
        origin_offset: ArrayLike | None = None,
        n_threads: int | None = 1,
    ) -> Intersections:
        """Return the first hits of rays.

        Parameters
        ----------
        origins, directions : (n, 3)
            Directions need not be unit.
        origin_offset : (n, 3), optional
            `Intersections.offset` of the hit each ray starts from, of either sign; a row of zeros
            or NaN where it starts in free space. Keeps rays from hitting their own surface.
        n_threads : int, optional
            Threads to use; None for every core.

        Raises
        ------
        TypeError, ValueError
            If shapes differ, an origin is not finite or a direction is not finite or zero.
        """
        origins, directions, origin_offset = _check_rays(origins, directions, origin_offset)
        out = empty_intersections(len(origins))

        def intersect_rows(rows: slice) -> None:
            o, d = origins[rows], directions[rows]
            rays = self._to_embree(o, d, origin_offset[rows], _NO_LIMITS, first=rows.start)
            self._start_near(o, d, rays[0], rays[1])
            self.triangles.refine_hits(o, d, self.find(*rays[:2]), out[rows])

        for_each_slice(intersect_rows, len(origins), _CHUNK, thread_count(n_threads))
        return out

    def occluded(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        max_distance: ArrayLike,
        *,
        origin_offset: ArrayLike | None = None,
        n_threads: int | None = 1,
    ) -> NDArray[np.bool_]:
        """Mask (n,) of the rays that hit anything nearer than `max_distance`.

        Parameters
        ----------
        origins, directions, origin_offset, n_threads
            As for `intersect`.
        max_distance : float or (n,)
            m, from the origin; inf for rays without end. It is compared in float32: hits nearer
            to it than `resolution` says may go either way.

        Raises
        ------
        TypeError, ValueError
            As for `intersect`, and if a `max_distance` is negative or NaN.
        """
        origins, directions, origin_offset = _check_rays(origins, directions, origin_offset)
        limits = _check_limits(max_distance, len(origins))
        out = np.empty(len(origins), dtype=bool)

        def test_rows(rows: slice) -> None:
            rays = self._to_embree(
                origins[rows], directions[rows], origin_offset[rows], limits[rows], first=rows.start
            )
            out[rows] = self._scene.run(*rays, query="OCCLUDED") >= 0

        for_each_slice(test_rows, len(origins), _CHUNK, thread_count(n_threads))
        return out

    def _to_embree(
        self,
        origins: Floats,
        directions: Floats,
        origin_offset: Floats,
        limits: Floats,
        *,
        first: int,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """Return rays and their lengths in embree's frame; `first` numbers them in errors."""
        out = (
            np.empty(origins.shape, dtype=np.float32),
            np.empty(origins.shape, dtype=np.float32),
            np.empty(limits.shape, dtype=np.float32),
        )
        bad = self.frame.to_embree(
            *(origins, directions, origin_offset, limits),
            out_origins=out[0],
            out_directions=out[1],
            out_limits=out[2],
        )
        if bad >= 0:
            raise ValueError(
                "origins and directions should be finite and directions not zero, but ray "
                f"{first + bad} goes from {origins[bad]} towards {directions[bad]}"
            )
        return out


def _kept_caster(objects: Sequence[SceneObject], object_ids: list[int]) -> RayCaster:
    """Caster of some objects, built once in a process that unpickles it again and again."""
    key = f"caster of {objects_digest(objects)} {object_ids}"
    return kept(key, lambda: RayCaster(objects, object_ids))


@dataclass(frozen=True)
class _Part:
    """Faces of an object that have an area, numbered by themselves; see `Triangles`."""

    corners: Floats
    faces: NDArray[np.int32]
    face_id: NDArray[np.int32]


def _nondegenerate_part(item: SceneObject) -> _Part:
    face_id, faces = nondegenerate_faces(item.mesh)
    corners = np.zeros((len(item.mesh.vertices), 6))
    corners[:, :3] = item.mesh.vertices
    if item.smooth:
        shading = item.shading_normals
        faces = shading.faces[face_id]
        corners = np.hstack([corners[shading.vertex, :3], shading.normal])
    # Vertices of no face would enlarge the frame, and with it rounding errors.
    used = vertices_of(faces, len(corners))
    numbered = np.zeros((len(faces), 4), dtype=np.int32)
    numbered[:, :3] = (np.cumsum(used, dtype=np.int32) - 1)[faces]
    return _Part(corners[used], numbered, face_id.astype(np.int32))


def _concatenate_parts(parts: dict[int, _Part]) -> _Part:
    """Concatenate the vertices and faces of objects, by their ids, and write those of the faces."""
    first = 0
    for object_id, part in parts.items():
        part.faces[:, :3] += first
        part.faces[:, 3] = object_id
        first += len(part.corners)
    columns = ([getattr(part, f.name) for part in parts.values()] for f in fields(_Part))
    return _Part(*(np.concatenate(column) for column in columns))


def _visible_ids(objects: Sequence[SceneObject]) -> list[int]:
    return [i for i, item in enumerate(objects) if not item.material.is_sensor]


class _EmptyScene:
    """Embree's scene without triangles, which all rays miss."""

    def run(
        self, origins: NDArray, *_: NDArray, query: str, output: bool = False
    ) -> NDArray | dict[str, NDArray]:
        missed = np.full(len(origins), -1, dtype=np.int32)
        nowhere = np.zeros(len(origins), dtype=np.float32)
        return {"primID": missed, "u": nowhere, "v": nowhere.copy()} if output else missed


def _not_split(pieces: Pieces, n_faces: int) -> NDArray[np.intp]:
    whole = np.ones(n_faces, dtype=bool)
    whole[pieces.face] = False
    return np.flatnonzero(whole)


def _embree_scene(
    vertices: Floats, faces: NDArray[np.int32], pieces: Pieces, whole: NDArray[np.intp]
) -> Any:
    """Embree's scene of the faces that are whole, then of the pieces of the others.

    It is made from the parts of trimesh's `RayMeshIntersector`, which has the origin of its frame
    at the lowest corner of the mesh.
    """
    try:
        from trimesh.ray.ray_pyembree import TriangleMesh, rtcore_scene
    except ImportError as error:
        raise ImportError(
            "tracing rays needs embreex, which is not installed: `pip install embreex`. It has "
            "no wheel for Linux on ARM; there, trace photons on another machine and load them "
            "with PhotonMap.load."
        ) from error
    scene = rtcore_scene.EmbreeScene()
    corners = pieces.corners(vertices, faces).reshape(-1, 3)
    numbers = np.arange(len(corners), dtype=np.int32).reshape(-1, 3) + np.int32(len(vertices))
    TriangleMesh(
        scene=scene,
        vertices=np.concatenate([vertices, corners]).astype(np.float32),
        indices=np.concatenate([faces[whole], numbers]).astype(np.int32),
    )
    # The first run builds the scene, which must not happen in two threads at once.
    one_ray = np.ones((1, 3), dtype=np.float32)
    scene.run(one_ray, one_ray)
    return scene


def _frame(relative: Floats, resolution: Resolution) -> EmbreeFrame:
    low, high = relative.min(axis=0), relative.max(axis=0)
    # Rays that start on the box start in front of all triangles, although rounded.
    margin = 0.01 * (high - low) + resolution.radius
    return EmbreeFrame(
        resolution.origin,
        low - margin,
        high + margin,
        scale=_EMBREE_SIZE / np.abs(relative).max(),
        rounding=ROUNDING,
        local_rounding=ROUNDING * MAX_SPREAD,
        least_distance=resolution.radius,
    )


def _cubes(extent: float, radius: float) -> list[float]:
    """Half sides of cubes around the origin: infinite, then down to where triangles are fine.

    The infinite one alone in scenes whose coordinates, up to an extent, are all as float32 rounds
    there anyway.
    """
    half_sides = [MAX_SPREAD * radius]
    if extent < _MANY_TIMES * half_sides[0]:
        return [np.inf]
    while MAX_SPREAD * half_sides[-1] < extent:
        half_sides.append(MAX_SPREAD * half_sides[-1])
    return [np.inf, *reversed(half_sides)]


def _check_rays(
    origins: ArrayLike, directions: ArrayLike, origin_offset: ArrayLike | None
) -> tuple[Floats, Floats, Floats]:
    """Return rays of checked shapes; their values are checked when they are transformed."""
    origins = float_array(origins, "origins", (None, 3), finite=False)
    directions = float_array(directions, "directions", (len(origins), 3), finite=False)
    if origin_offset is None:
        return origins, directions, _NO_RAYS
    shape = (len(origins), 3)
    return origins, directions, float_array(origin_offset, "origin_offset", shape, finite=False)


def _check_limits(max_distance: ArrayLike, n: int) -> Floats:
    limits = float_array(max_distance, "max_distance", finite=False)
    if limits.shape not in ((), (n,)):
        raise ValueError(
            f"max_distance should be one number or have shape ({n},), but has {limits.shape}"
        )
    if not (limits >= 0.0).all():
        raise ValueError(f"max_distance should not be negative or NaN, but has {limits.min()}")
    return np.ascontiguousarray(np.broadcast_to(limits, (n,)))


def empty_intersections(n: int) -> Intersections:
    """Return uninitialised intersections of n rays."""
    return Intersections(
        object_id=np.empty(n, dtype=np.int32),
        face_id=np.empty(n, dtype=np.int32),
        distance=np.empty(n),
        position=np.empty((n, 3)),
        geometric_normal=np.empty((n, 3)),
        shading_normal=np.empty((n, 3)),
        step=np.empty(n),
    )
