"""Scenes: objects with materials, emitters and a camera.

All classes are frozen and validate their fields when constructed. Lengths are in scene units,
called m; power is in W. Meshes are `trimesh.Trimesh`, but nothing here imports trimesh.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._util.frozen import set_field
from .._util.parcels import state_without_caches
from .._util.validation import Floats
from .camera import Camera
from .casters import MAX_GROUPS, Targets, bounding_sphere, group_spheres
from .emission_region import Sphere
from .emitters import Emitter
from .lamps import LampTable
from .materials import Material, MaterialTable
from .meshes import check_mesh, nondegenerate_triangles, nondegenerate_vertices
from .resolution import Resolution
from .shading import ShadingNormals, check_smooth, shading_normals
from .textures import FaceTexture, face_texture
from .winding import EdgeDefects, check_surface

if TYPE_CHECKING:
    import trimesh

# Least distance from a point-like emitter to the origins of its rays over what rays resolve there.
_EMITTER_OFFSET = 2.0
# Emission regions of all emitters together, a few tens of microseconds each.
_MAX_REGIONS = 1 << 16


@dataclass(frozen=True, eq=False)
class SceneObject:
    """A mesh and its material.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        Triangles, at least one of them with an area; faces of no area are never hit. Dielectrics
        are closed and wind outwards, but walls of hollows inwards; a `Scene` warns of those that
        are open or wound inconsistently.
    material : Diffuse, Mirror, Dielectric, Sensor or other Material
        The material of the whole mesh.
    name : str
        A label.
    smooth : bool or float
        False shades with face normals. A number is a crease angle in degrees: normals are means
        over the faces around a corner, and interpolated, but edges at which the surface turns by
        more stay sharp. True keeps the vertex normals that came with the mesh
        (``trimesh.Trimesh(..., vertex_normals=...)``, files with normals); without any, it is a
        crease angle of 30°. Vertices at one position count as one, so that seams and the separate
        triangles of STL files do not show.

    Attributes
    ----------
    edge_defects : EdgeDefects
        Numbers of open and of inconsistently wound edges; counted for dielectrics only.

    Raises
    ------
    TypeError, ValueError
        If a field is of the wrong kind, or a closed part of a dielectric winds inwards and does not
        lie in another part, as the inner wall of a hollow body does.

    Notes
    -----
    Given normals that equal those trimesh computes cannot be told from them, and are not kept:
    files of flat facets with the normals of their faces need ``smooth=False``.
    """

    mesh: trimesh.Trimesh
    material: Material
    name: str = ""
    smooth: bool | float = False
    edge_defects: EdgeDefects = field(default=EdgeDefects(0, 0), init=False, repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.material, Material):
            raise TypeError(
                "material should be a Diffuse, Mirror, Dielectric or Sensor, "
                f"but is {type(self.material).__name__}"
            )
        check_mesh(self.mesh)
        set_field(self, "smooth", check_smooth(self.smooth))
        # Checks texture coordinates.
        face_texture(self)
        if self.material.has_inside:
            set_field(self, "edge_defects", check_surface(self.mesh))

    @cached_property
    def shading_normals(self) -> ShadingNormals:
        """The normals that are interpolated where the object is smooth."""
        return shading_normals(self.mesh, self.smooth)


@dataclass(frozen=True, eq=False)
class Scene:
    """Objects, emitters and an optional camera.

    Meshes are not copied, and quantities computed from them are cached: do not modify them.

    Parameters
    ----------
    objects : sequence of SceneObject
        At least one; an object's position in the sequence is its `object_id`.
    emitters : sequence of CollimatedEmitter, PointEmitter, LambertianEmitter, SpotEmitter, …
        At least one; an emitter's position in the sequence is its `emitter_id`.
    camera : Camera, optional
        Needed to render, not to trace photons.
    name : str
        A label.
    aim : Targets, optional
        What emitters aim at, in place of spheres around the objects: photons of scenes with the
        same emitters and aim have the same emitter coordinates, as in the frames of an animation.
    """

    objects: Sequence[SceneObject]
    emitters: Sequence[Emitter]
    camera: Camera | None = None
    name: str = ""
    aim: Targets | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        set_field(self, "objects", _members(self.objects, "objects", SceneObject))
        set_field(self, "emitters", _members(self.emitters, "emitters", Emitter))
        if self.camera is not None and not isinstance(self.camera, Camera):
            raise TypeError(f"camera should be a Camera, but is {type(self.camera).__name__}")
        for i, item in enumerate(self.objects):
            if any(item.edge_defects):
                warnings.warn(_defects_text(i, item), stacklevel=3)

    __getstate__ = state_without_caches

    @cached_property
    def surfaces(self) -> tuple[SceneObject, ...]:
        """The objects, then the surfaces of emitters: what rays meet."""
        emitting = (emitter.surface for emitter in self.emitters)
        return (*self.objects, *(item for item in emitting if item is not None))

    @cached_property
    def surface_ids(self) -> NDArray[np.int32]:
        """The `object_id` of photons on each of the surfaces.

        That of an emitter is the number of objects plus its index among all emitters: these are
        the indices of the surfaces unless an emitter without a surface comes before.
        """
        n = len(self.objects)
        emitting = [n + i for i, each in enumerate(self.emitters) if each.surface is not None]
        return np.array([*range(n), *emitting], dtype=np.int32)

    def ids_of(self, surface: NDArray[np.int32]) -> NDArray[np.int32]:
        """The `object_id` of photons on surfaces, by their indices; the same array if it may be."""
        ids = self.surface_ids
        return surface if ids[-1] == len(ids) - 1 else ids[surface]

    @cached_property
    def specular_objects(self) -> tuple[int, ...]:
        """The indices of the surfaces whose material is specular, emitters' included."""
        return tuple(i for i, item in enumerate(self.surfaces) if item.material.is_specular)

    @cached_property
    def sensors(self) -> tuple[int, ...]:
        """The ids of the objects that store the photons that cross them."""
        return tuple(i for i, item in enumerate(self.objects) if item.material.is_sensor)

    @cached_property
    def visible_objects(self) -> tuple[int, ...]:
        """The indices of the surfaces that are no sensors; all where there is no other."""
        ids = tuple(i for i, item in enumerate(self.surfaces) if not item.material.is_sensor)
        return ids or self.sensors

    @cached_property
    def scale(self) -> float:
        """Length of the diagonal of the bounding box of the visible objects, m."""
        low, high = (corner[list(self.visible_objects)] for corner in self.object_bounds)
        return float(np.linalg.norm(high.max(axis=0) - low.min(axis=0)))

    @cached_property
    def resolution(self) -> Resolution:
        """Distance that rays to the visible objects resolve, by position."""
        meshes = (self.surfaces[i].mesh for i in self.visible_objects)
        return Resolution.of(*nondegenerate_triangles(meshes))

    def emitter_offset(self, emitter: Emitter) -> float:
        """Return the least distance from an emitter to the origins of its rays, m.

        A point-like emitter may lie on a surface, which its rays must not hit; one that is a
        surface must not occlude itself.
        """
        if emitter.surface is not None:
            vertices = nondegenerate_vertices(emitter.surface.mesh)
            return _EMITTER_OFFSET * float(self.resolution.at(vertices).max())
        point = emitter.point
        return 0.0 if point is None else _EMITTER_OFFSET * float(self.resolution.at(point))

    @cached_property
    def emitter_offsets(self) -> Floats:
        """The `emitter_offset` of each emitter, (n_emitters,)."""
        # Of many points together: each alone takes far longer.
        points = {
            i: emitter.point
            for i, emitter in enumerate(self.emitters)
            if emitter.surface is None and emitter.point is not None
        }
        offsets = np.zeros(len(self.emitters))
        if points:
            at = np.array(list(points.values()))
            offsets[list(points)] = _EMITTER_OFFSET * self.resolution.at(at)
        for i, emitter in enumerate(self.emitters):
            if emitter.surface is not None:
                offsets[i] = self.emitter_offset(emitter)
        return offsets

    @cached_property
    def lamps(self) -> LampTable:
        """The lamps among the emitters that are not black."""
        return LampTable.of(self.emitters)

    def bounding_sphere(self, object_ids: Iterable[int] | None = None) -> Sphere:
        """Return centre (3,) and radius of a sphere around surfaces, by default the visible ones.

        The centre is that of their bounding box; the radius is the largest distance to a vertex.

        Raises
        ------
        ValueError
            If `object_ids` is empty.
        """
        ids = tuple(self.visible_objects if object_ids is None else object_ids)
        if not ids:
            raise ValueError("object_ids should name at least one object, but is empty")
        return bounding_sphere(np.concatenate([self._vertices[i] for i in ids]))

    @cached_property
    def caster_spheres(self) -> tuple[Sphere, ...]:
        """Spheres around groups of the specular objects' parts, apart from one another.

        Empty without specular objects.
        """
        if not self.specular_objects:
            return ()
        max_groups = max(1, min(MAX_GROUPS, _MAX_REGIONS // len(self.emitters)))
        meshes = [self.surfaces[i].mesh for i in self.specular_objects]
        return group_spheres(meshes, max_groups)

    @cached_property
    def targets(self) -> Targets:
        """Spheres that emitters aim at."""
        if self.aim is not None:
            return self.aim
        casters = self.bounding_sphere(self.specular_objects) if self.specular_objects else None
        return Targets(self.caster_spheres, casters, self.bounding_sphere())

    @cached_property
    def object_bounds(self) -> tuple[Floats, Floats]:
        """The lowest and the highest coordinates of each surface, (n, 3) both."""
        low = np.array([vertices.min(axis=0) for vertices in self._vertices])
        return low, np.array([vertices.max(axis=0) for vertices in self._vertices])

    def material_table(self) -> MaterialTable:
        """The materials of all surfaces as arrays."""
        table = MaterialTable.of(item.material for item in self.surfaces)
        return replace(table, textures=self.textures)

    @property
    def has_dispersion(self) -> bool:
        """Whether indices of refraction of surfaces depend on the wavelength."""
        return any(item.material.row().dispersion is not None for item in self.surfaces)

    @cached_property
    def textures(self) -> tuple[FaceTexture | None, ...]:
        """The textures of all surfaces; None for those of one colour."""
        return tuple(face_texture(item) for item in self.surfaces)

    @cached_property
    def _vertices(self) -> tuple[Floats, ...]:
        """The vertices of each surface that belong to a face with an area."""
        return tuple(nondegenerate_vertices(item.mesh) for item in self.surfaces)


def surface_label(surface: int, scene: Scene) -> str:
    """Index and name of an object of a scene, or of an emitter by its surface, for messages."""
    n = len(scene.objects)
    if surface < n:
        return object_label(surface, scene.objects[surface])
    return f"emitters[{scene.surface_ids[surface] - n}]"


def object_label(object_id: int, item: SceneObject) -> str:
    """Index and name of an object of a scene, for messages."""
    return f"objects[{object_id}]" + (f" ({item.name!r})" if item.name else "")


def _defects_text(object_id: int, item: SceneObject) -> str:
    defects = item.edge_defects
    return (
        f"{object_label(object_id, item)} is a Dielectric and should be closed and wind outwards, "
        f"but has {defects.open} open edges and {defects.inconsistent} edges whose faces wind "
        "against each other. Light that passes them refracts and is absorbed as if on the wrong "
        "side: repair the mesh with mesh.merge_vertices(), trimesh.repair.fix_winding(mesh) and "
        "mesh.fill_holes()"
    )


_DESCRIPTIONS = {
    SceneObject: "a SceneObject",
    Emitter: "an Emitter, such as a CollimatedEmitter, PointEmitter, SpotEmitter or AreaEmitter",
}


def _members(values: Iterable, name: str, kind: type) -> tuple:
    if not isinstance(values, Iterable):
        raise TypeError(f"{name} should be a sequence, but is {type(values).__name__}")
    members = tuple(values)
    if not members:
        raise ValueError(f"{name} should not be empty")
    for i, member in enumerate(members):
        if not isinstance(member, kind):
            raise TypeError(
                f"{name}[{i}] should be {_DESCRIPTIONS[kind]}, but is {type(member).__name__}"
            )
    return members
