"""Projection of displaced photons onto the objects they lie on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._ext.relaxation.projection import (
    DOWN,
    SURFACE_POSITION,
    UP,
    Displacements,
    SurfacePositions,
)
from .._util.parallel import for_each_slice
from .._util.validation import Floats, Rows
from ..photons.axes import MIN_NORMAL_COSINE
from ..photons.photon_map import PhotonMap
from ..scene.scene import Scene
from ..transport.raycast import RayCaster
from ..transport.sensors import sensor_casters

# Distance from a displaced photon to the origin of its ray over what rays resolve where it landed.
_RAY_OFFSET = 2.0
# Photons a thread projects at a time.
_CHUNK = 16384


class SurfaceProjector:
    """The objects of a scene, and the position of each of n photons on them.

    Photons on sensors are projected onto these, and others as if there were none.

    Parameters
    ----------
    scene : Scene
        The objects the photons lie on.
    photons : PhotonMap
        Their first positions.
    n_threads : int
        Threads to use; the result does not depend on it.
    caster : RayCaster, optional
        Of the scene: building it takes time.
    at : (n,) array of SURFACE_POSITION, optional
        Positions on objects that `at` of another projector had, of photons that moved since.

    Raises
    ------
    ValueError
        If the map has no `object_id`, or one that is not of the scene.
    """

    def __init__(
        self,
        scene: Scene,
        photons: PhotonMap,
        n_threads: int,
        caster: RayCaster | None = None,
        at: NDArray | None = None,
    ) -> None:
        if photons.object_id is None:
            raise ValueError("photons should have an object_id to be kept on the scene's objects")
        surface = _surfaces_of(photons.object_id, scene)
        if surface is not photons.object_id:
            photons = photons.replace(object_id=surface)
        self._n_photons, self._n_threads = len(photons), n_threads
        self._parts: list[tuple[_Part, NDArray[np.intp] | None]] = []
        on_sensor = np.isin(surface, scene.sensors)
        if not on_sensor.all():
            self._add(caster or RayCaster(scene.surfaces), photons, ~on_sensor, at)
        for sensor, caster in zip(scene.sensors, sensor_casters(scene), strict=True):
            self._add(caster, photons, surface == sensor, at)

    def _add(
        self,
        caster: RayCaster,
        photons: PhotonMap,
        mine: NDArray[np.bool_],
        at: NDArray | None,
    ) -> None:
        """Add the photons of a mask, which lie on the objects of a caster."""
        if not mine.any():
            return
        row_of_part = None
        if not mine.all():
            row_of_part = np.where(mine, np.cumsum(mine) - 1, -1)
            photons, at = photons.subset(mine), None if at is None else at[mine]
        part = _Part(caster, photons, self._n_threads, at)
        self._parts.append((part, row_of_part))

    @property
    def at(self) -> NDArray:
        """Positions (n,) on objects, of SURFACE_POSITION, for another projector."""
        at = np.zeros(self._n_photons, SURFACE_POSITION)
        for part, row_of_part in self._parts:
            at[slice(None) if row_of_part is None else row_of_part >= 0] = part.at
        return at

    def project(
        self, position: Floats, normal: Floats, target: Floats, rows: Rows
    ) -> tuple[Floats, Floats]:
        """Return the projections of displaced photons onto their objects, and the normals there.

        A displacement that ends on nothing, on another object or on a face turned away has left
        the photon's surface and is rejected: the photon stays. A photon above or below the
        triangle it lay on, no farther than rays resolve, is projected onto that triangle whatever
        else is that near.

        Parameters
        ----------
        position, normal : (m, 3)
            Of the photons, from the map or from the last call, m.
        target : (m, 3)
            The displaced positions, m.
        rows : slice or (m,) intp
            The photons' rows in the map, each at most once.
        """
        photons = rows if isinstance(rows, np.ndarray) else np.arange(self._n_photons)[rows]
        projected, projected_normal = np.empty_like(position), np.empty_like(normal)
        for part, row_of_part in self._parts:
            if row_of_part is None:
                part.project((position, normal, target, photons), projected, projected_normal)
                continue
            mine = np.flatnonzero(row_of_part[photons] >= 0)
            columns = position[mine], normal[mine], target[mine], row_of_part[photons[mine]]
            found = np.empty_like(columns[0]), np.empty_like(columns[1])
            part.project(columns, *found)
            projected[mine], projected_normal[mine] = found
        return projected, projected_normal


def _surfaces_of(object_id: NDArray[np.int32], scene: Scene) -> NDArray[np.int32]:
    """Indices (n,) of the surfaces of a scene that photons are on, by their `object_id`."""
    ids, surface = scene.surface_ids, object_id
    known = object_id.min() >= 0 and object_id.max() <= ids[-1]
    if known and ids[-1] >= len(ids):
        surface = np.searchsorted(ids, object_id).astype(np.int32)
        known = bool((ids[surface] == object_id).all())
    if not known:
        raise ValueError(
            f"object_id should be of the scene's {len(scene.objects)} objects, but ranges from "
            f"{object_id.min()} to {object_id.max()}"
        )
    return surface


class _Part:
    """Photons on objects whose rays a caster casts, and their positions on these objects."""

    def __init__(
        self, caster: RayCaster, photons: PhotonMap, n_threads: int, at: NDArray | None
    ) -> None:
        self._caster = caster
        self.at = _unknown(caster, photons) if at is None else at
        self._positions = SurfacePositions(
            caster.frame, caster.triangles, self.at, min_cosine=MIN_NORMAL_COSINE
        )
        self._n_threads = n_threads
        if at is None:
            position, normal = photons.position, photons.normal
            self._for_chunks((position, normal, position, np.arange(len(photons))))

    def project(
        self, columns: tuple[np.ndarray, ...], projected: Floats, projected_normal: Floats
    ) -> None:
        """Write the projections and normals of displaced photons, given by their columns."""
        self._for_chunks(columns, projected=projected, projected_normal=projected_normal)

    def _for_chunks(self, columns: tuple[np.ndarray, ...], **results: Floats) -> None:
        """Project the displacements whose columns these are, some at a time."""

        def project(chunk: slice) -> None:
            into = {name: column[chunk] for name, column in results.items()}
            self._project(Displacements(*(column[chunk] for column in columns), **into))

        for_each_slice(project, len(columns[0]), _CHUNK, self._n_threads)

    def _project(self, displacements: Displacements) -> None:
        """Project without rays where possible, then down the normals, then up."""
        self._positions.project(displacements)
        for sign in (DOWN, UP):
            if displacements.n_pending:
                self._positions.write_rays(displacements, sign)
                hits = self._caster.find(displacements.origins, displacements.directions)
                self._positions.project_hits(displacements, hits, sign)


def _unknown(caster: RayCaster, photons: PhotonMap) -> NDArray:
    """Positions (n,) of photons on objects whose triangles have to be found."""
    at = np.zeros(len(photons), SURFACE_POSITION)
    at["ray_offset"] = _RAY_OFFSET * caster.resolution.at(photons.position)
    at["object_id"], at["triangle"] = photons.object_id, -1
    return at
