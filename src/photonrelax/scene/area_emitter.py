"""Light from surfaces."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._util.frozen import frozen, set_field
from .._util.validation import Floats, rgb
from .emission_region import EmissionRegion, area_region
from .emission_region import Sphere as BoundingSphere
from .emitters import DirectLight, Emitter
from .materials import Diffuse, Material
from .meshes import face_normals, nondegenerate_triangles
from .scene import SceneObject
from .shapes import Disk, Rectangle, Sphere

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True, eq=False)
class AreaEmitter(Emitter):
    """A surface that emits the same radiance everywhere and in all directions.

    It is seen by cameras and in mirrors, occludes, and reflects by its material. The `object_id`
    of photons on it is the number of objects in the scene plus its own index among the emitters.

    Parameters
    ----------
    shape : Rectangle, Disk, Sphere or trimesh.Trimesh
        Emits on the side of its normals, those of the winding of its faces.
    radiance : (3,) or float, optional
        W/(m² sr).
    power : (3,) or float, optional
        Total emitted flux, W. One of radiance and power has to be given.
    two_sided : bool
        Emits on both sides.
    material : Diffuse or other Material
        Of its surface, no sensor; black by default. One of a `Dielectric` is closed, and emits on
        its outside alone.
    """

    shape: Rectangle | Disk | Sphere | trimesh.Trimesh
    _: KW_ONLY
    radiance: ArrayLike | None = None
    power: ArrayLike | None = None
    two_sided: bool = False
    material: Material = field(default_factory=lambda: Diffuse((0.0, 0.0, 0.0)))

    def __post_init__(self) -> None:
        if (self.radiance is None) == (self.power is None):
            raise ValueError(
                f"one of radiance and power should be given, but radiance is {self.radiance} and "
                f"power is {self.power}"
            )
        for name in ("radiance", "power"):
            if getattr(self, name) is not None:
                set_field(self, name, frozen(rgb(getattr(self, name), name)))
        set_field(self, "two_sided", bool(self.two_sided))
        # Checks shape and material.
        surface = self.surface
        if self.material.is_sensor:
            raise ValueError(
                "material should not be a Sensor: place an object of that material beside the light"
            )
        if self.material.has_inside and (self.two_sided or any(surface.edge_defects)):
            raise ValueError(
                "shape should be closed and shine on its outside alone where material is a "
                f"Dielectric, but two_sided is {self.two_sided} and the mesh has "
                f"{surface.edge_defects.open} open edges and "
                f"{surface.edge_defects.inconsistent} edges whose faces wind against each other"
            )

    @cached_property
    def surface(self) -> SceneObject:
        """The shape as an object of the scene."""
        shape = self.shape
        mesh = shape.mesh() if isinstance(shape, Rectangle | Disk | Sphere) else shape
        return SceneObject(mesh, self.material)

    @cached_property
    def emitted_radiance(self) -> Floats:
        """Radiance (3,) of the shining sides, W/(m² sr)."""
        if self.radiance is not None:
            return np.asarray(self.radiance)
        sides = 2.0 if self.two_sided else 1.0
        return np.asarray(self.power) / (np.pi * sides * self._area)

    def surface_radiance(self, from_behind: NDArray[np.bool_]) -> Floats:
        """Return the radiance of the shining side, and zeros on the other."""
        shines = self.two_sided | ~from_behind
        return np.outer(shines, self.emitted_radiance)

    @property
    def is_extended(self) -> bool:
        return True

    @cached_property
    def _triangles(self) -> Floats:
        """Corners (f, 3, 3) of the faces that have an area, m."""
        vertices, faces = nondegenerate_triangles([self.surface.mesh])
        return np.ascontiguousarray(vertices[faces], dtype=np.float64)

    @cached_property
    def _normals(self) -> Floats:
        return face_normals(self._triangles)

    @cached_property
    def _areas(self) -> Floats:
        """Of the faces (f,), m²."""
        a, b, c = np.moveaxis(self._triangles, 1, 0)
        areas: Floats = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
        return areas

    @property
    def _area(self) -> float:
        return float(self._areas.sum())

    @cached_property
    def _cumulative(self) -> Floats:
        """Shares (f,) of the area up to each face, the last of which is 1."""
        shares = np.cumsum(self._areas)
        shares /= shares[-1]
        return shares

    def emission_region(
        self, target: BoundingSphere, scene: BoundingSphere, emitter_offset: float
    ) -> EmissionRegion:
        """Return all rays from the surface to the target."""
        return area_region(
            self._triangles,
            self._normals,
            self._cumulative,
            flux_per_sr=self._area * self.emitted_radiance,
            target=target,
            two_sided=self.two_sided,
            start=emitter_offset,
        )

    def direct(self, position: Floats, emitter_offset: float) -> DirectLight:
        """Return the light as if all came from the middle of the surface."""
        middle = np.full((len(position), 2), 0.5)
        return self.sampled(position, position, emitter_offset, middle)

    def sampled(
        self, position: Floats, normal: Floats, emitter_offset: float, sample: Floats
    ) -> DirectLight:
        """Return light from points that are uniform over the surface."""
        face, point = self._points(sample)
        outwards = self._normals[face]
        away = position - point
        facing = np.einsum("ni,ni->n", away, outwards)
        # Rays end off the surface, on the side that is seen.
        side = np.where(facing < 0.0, -1.0, 1.0) if self.two_sided else 1.0
        to_light = point + np.multiply(emitter_offset, side * outwards.T).T - position
        distance = np.linalg.norm(to_light, axis=1)
        near = distance <= emitter_offset
        distance[near] = 1.0
        # The cosine at the surface over the squared distance.
        share = np.maximum(side * facing, 0.0) / distance**3
        share[near] = 0.0
        irradiance = np.outer(self._area * share, self.emitted_radiance)
        return DirectLight(to_light / distance[:, np.newaxis], distance, irradiance)

    def _points(self, sample: Floats) -> tuple[NDArray[np.intp], Floats]:
        """Faces (m,) and points (m, 3) on them that are uniform over the area."""
        face = np.searchsorted(self._cumulative, sample[:, 0], side="right")
        face = np.minimum(face, len(self._cumulative) - 1)
        below = np.concatenate([[0.0], self._cumulative])[face]
        within = (sample[:, 0] - below) / (self._cumulative[face] - below)
        along = np.sqrt(np.clip(within, 0.0, 1.0))
        weights = np.column_stack([1.0 - along, along * (1.0 - sample[:, 1]), along * sample[:, 1]])
        return face, np.einsum("nk,nki->ni", weights, self._triangles[face])
