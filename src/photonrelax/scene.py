"""What is rendered: objects with materials, emitters, a camera.

Everything here is frozen data, validated once when it is made. Lengths are in scene units, here
called m; power in W. Meshes are `trimesh.Trimesh`, but nothing here imports trimesh.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import UnionType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._arrays import Floats, count, float_array, positive, rgb, unit_vectors
from ._meshes import check_mesh, check_winding, hittable_vertices

if TYPE_CHECKING:
    import trimesh

DIFFUSE, MIRROR, DIELECTRIC = 0, 1, 2
"""Values of `MaterialTable.kind`."""

_EMITTER_GAP = 1e-5  # of the scene's size
# Sine of the smallest angle between a camera's `up` and its line of sight.
_MIN_UP_SINE = 1e-6


@dataclass(frozen=True, eq=False)
class Diffuse:
    """Lambertian surface, the same from both sides.

    Parameters
    ----------
    albedo : (3,) or float
        Reflected fraction of the light per channel, in [0, 1].
    """

    albedo: ArrayLike = (0.8, 0.8, 0.8)

    def __post_init__(self) -> None:
        _set(self, "albedo", rgb(self.albedo, "albedo", high=1.0))


@dataclass(frozen=True, eq=False)
class Mirror:
    """Perfectly smooth metal, reflecting from both sides.

    Parameters
    ----------
    reflectance : (3,) or float
        Reflected fraction of the light per channel, in [0, 1].
    """

    reflectance: ArrayLike = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        _set(self, "reflectance", rgb(self.reflectance, "reflectance", high=1.0))


@dataclass(frozen=True, eq=False)
class Dielectric:
    """Perfectly smooth transparent body; the faces of its mesh wind outwards.

    Parameters
    ----------
    ior, exterior_ior : float
        Index of refraction inside the mesh and outside it.
    absorption : (3,) or float
        Absorption inside the mesh per channel, 1/m (Beer–Lambert).
    """

    ior: float = 1.5
    exterior_ior: float = 1.0
    absorption: ArrayLike = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "ior", positive(self.ior, "ior"))
        object.__setattr__(self, "exterior_ior", positive(self.exterior_ior, "exterior_ior"))
        _set(self, "absorption", rgb(self.absorption, "absorption"))


Material = Diffuse | Mirror | Dielectric


@dataclass(frozen=True, eq=False)
class SceneObject:
    """A mesh and what it is made of.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        Triangles, at least one of them with an area; faces of no area are never hit. Closed
        dielectrics wind outwards.
    material : Diffuse, Mirror or Dielectric
        The material of the whole mesh.
    name : str
        For people.
    smooth : bool
        Shade with interpolated vertex normals rather than face normals.
    """

    mesh: trimesh.Trimesh
    material: Material
    name: str = ""
    smooth: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.material, Material):
            raise TypeError(
                "material should be a Diffuse, Mirror or Dielectric, "
                f"but is {type(self.material).__name__}"
            )
        check_mesh(self.mesh)
        if isinstance(self.material, Dielectric):
            check_winding(self.mesh)


@dataclass(frozen=True, eq=False)
class CollimatedEmitter:
    """Parallel light from infinitely far away, covering the scene.

    Parameters
    ----------
    direction : (3,)
        Where the light travels to; any length.
    irradiance : (3,) or float
        W/m² on a plane facing the light.
    """

    direction: ArrayLike
    irradiance: ArrayLike = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        _set(self, "direction", unit_vectors(self.direction, "direction", (3,)))
        _set(self, "irradiance", rgb(self.irradiance, "irradiance"))


@dataclass(frozen=True, eq=False)
class PointEmitter:
    """A point that shines alike in all directions, with intensity power/4π.

    Parameters
    ----------
    position : (3,)
        m.
    power : (3,) or float
        Total emitted flux, W.
    """

    position: ArrayLike
    power: ArrayLike = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        _set(self, "position", float_array(self.position, "position", (3,)))
        _set(self, "power", rgb(self.power, "power"))


@dataclass(frozen=True, eq=False)
class LambertianEmitter:
    """A point that shines into a hemisphere with intensity power/π · cos θ.

    Parameters
    ----------
    position : (3,)
        m.
    direction : (3,)
        Axis of the hemisphere; any length.
    power : (3,) or float
        Total emitted flux, W.
    """

    position: ArrayLike
    direction: ArrayLike
    power: ArrayLike = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        _set(self, "position", float_array(self.position, "position", (3,)))
        _set(self, "direction", unit_vectors(self.direction, "direction", (3,)))
        _set(self, "power", rgb(self.power, "power"))


Emitter = CollimatedEmitter | PointEmitter | LambertianEmitter


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera, or an orthographic one.

    Parameters
    ----------
    origin, target : (3,)
        Where the camera is and the point at the centre of its picture, m.
    up : (3,)
        The direction that is up in the picture; not along the line of sight.
    vertical_fov : float
        Angle between the lower and upper edge of the picture, degrees, below 180.
    width, height : int
        Pixels.
    orthographic_height : float, optional
        Height of the picture in m; makes the camera orthographic and `vertical_fov` void.
    """

    origin: ArrayLike
    target: ArrayLike
    up: ArrayLike = (0.0, 0.0, 1.0)
    vertical_fov: float = 45.0
    width: int = 600
    height: int = 600
    orthographic_height: float | None = None

    def __post_init__(self) -> None:
        _set(self, "origin", float_array(self.origin, "origin", (3,)))
        _set(self, "target", float_array(self.target, "target", (3,)))
        _set(self, "up", unit_vectors(self.up, "up", (3,)))
        object.__setattr__(self, "vertical_fov", positive(self.vertical_fov, "vertical_fov"))
        if self.vertical_fov >= 180.0:
            raise ValueError(
                f"vertical_fov should be below 180 degrees, but is {self.vertical_fov}"
            )
        object.__setattr__(self, "width", count(self.width, "width"))
        object.__setattr__(self, "height", count(self.height, "height"))
        if self.orthographic_height is not None:
            height = positive(self.orthographic_height, "orthographic_height")
            object.__setattr__(self, "orthographic_height", height)
        self.axes()

    def axes(self) -> tuple[Floats, Floats, Floats]:
        """Return the unit vectors to the right, up and forward of the picture.

        Raises
        ------
        ValueError
            If the target is at the origin, or `up` is along the line of sight.
        """
        sight = np.subtract(self.target, self.origin)
        if not sight.any():
            both = np.asarray(self.target)
            raise ValueError(f"target should differ from origin, but both are {both}")
        forward = unit_vectors(sight, "target - origin", (3,))
        up = np.asarray(self.up)
        right = np.cross(forward, up)
        if np.linalg.norm(right) < _MIN_UP_SINE:
            raise ValueError(
                f"up should not be along the line of sight, but is {up} looking along {forward}"
            )
        right /= np.linalg.norm(right)
        return right, np.cross(right, forward), forward


@dataclass(frozen=True, eq=False)
class MaterialTable:
    """The materials of n objects as arrays, for kernels.

    Attributes
    ----------
    kind : (n,) int32
        `DIFFUSE`, `MIRROR` or `DIELECTRIC`.
    reflectance : (n, 3)
        Albedo or reflectance; 1 for dielectrics.
    ior, exterior_ior : (n,)
        Indices of refraction; 1 for other materials.
    absorption : (n, 3)
        1/m; 0 for other materials.
    """

    kind: NDArray[np.int32]
    reflectance: Floats
    ior: Floats
    exterior_ior: Floats
    absorption: Floats


@dataclass(frozen=True, eq=False)
class Scene:
    """Objects, emitters and perhaps a camera.

    Meshes are kept, not copied, and what is computed from them once is kept: do not change them.

    Parameters
    ----------
    objects : sequence of SceneObject
        At least one; an object's position in the sequence is its `object_id`.
    emitters : sequence of CollimatedEmitter, PointEmitter or LambertianEmitter
        At least one; an emitter's position in the sequence is its `emitter_id`.
    camera : Camera, optional
        Needed to render, not to trace photons.
    name : str
        For people.
    """

    objects: Sequence[SceneObject]
    emitters: Sequence[Emitter]
    camera: Camera | None = None
    name: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "objects", _members(self.objects, "objects", SceneObject))
        object.__setattr__(self, "emitters", _members(self.emitters, "emitters", Emitter))
        if self.camera is not None and not isinstance(self.camera, Camera):
            raise TypeError(f"camera should be a Camera, but is {type(self.camera).__name__}")

    @property
    def specular_objects(self) -> tuple[int, ...]:
        """The ids of the mirrors and dielectrics."""
        return tuple(
            i for i, item in enumerate(self.objects) if not isinstance(item.material, Diffuse)
        )

    @cached_property
    def scale(self) -> float:
        """Length of the diagonal of the box around all objects, m; computed once."""
        low, high = self._bounds(range(len(self.objects)))
        return float(np.linalg.norm(high - low))

    @property
    def emitter_gap(self) -> float:
        """How far off a point-like emitter its rays start, for it may lie on a surface, m."""
        return _EMITTER_GAP * self.scale

    def bounding_sphere(self, object_ids: Iterable[int] | None = None) -> tuple[Floats, float]:
        """Return centre (3,) and radius of a sphere around objects: all of them, or those named.

        The centre is that of their bounding box; the radius is the largest distance to a vertex.

        Raises
        ------
        ValueError
            If `object_ids` is empty.
        """
        ids = tuple(range(len(self.objects)) if object_ids is None else object_ids)
        if not ids:
            raise ValueError("object_ids should name at least one object, but is empty")
        low, high = self._bounds(ids)
        centre = low + 0.5 * (high - low)
        reach = [np.linalg.norm(self._vertices[i] - centre, axis=1).max() for i in ids]
        return centre, float(max(reach))

    def material_table(self) -> MaterialTable:
        """Return the materials of all objects as arrays."""
        materials = [item.material for item in self.objects]
        n = len(materials)
        table = MaterialTable(
            kind=np.zeros(n, dtype=np.int32),
            reflectance=np.ones((n, 3)),
            ior=np.ones(n),
            exterior_ior=np.ones(n),
            absorption=np.zeros((n, 3)),
        )
        for i, material in enumerate(materials):
            _tabulate(table, i, material)
        return table

    @cached_property
    def _vertices(self) -> tuple[Floats, ...]:
        """The vertices of each object that belong to a face rays can hit."""
        return tuple(hittable_vertices(item.mesh) for item in self.objects)

    def _bounds(self, object_ids: Iterable[int]) -> tuple[Floats, Floats]:
        vertices = [self._vertices[i] for i in object_ids]
        corners = [(v.min(axis=0), v.max(axis=0)) for v in vertices]
        return np.min([c[0] for c in corners], axis=0), np.max([c[1] for c in corners], axis=0)


def _set(instance: object, name: str, array: Floats) -> None:
    """Store a read-only copy, so that frozen means frozen and the caller's array stays free."""
    frozen = array.copy()
    frozen.setflags(write=False)
    object.__setattr__(instance, name, frozen)


def _members(values: Iterable, name: str, kind: type | UnionType) -> tuple:
    if not isinstance(values, Iterable):
        raise TypeError(f"{name} should be a sequence, but is {type(values).__name__}")
    members = tuple(values)
    if not members:
        raise ValueError(f"{name} should not be empty")
    for i, member in enumerate(members):
        if not isinstance(member, kind):
            wanted = getattr(kind, "__name__", str(kind)).replace("photonrelax.scene.", "")
            raise TypeError(f"{name}[{i}] should be {wanted}, but is {type(member).__name__}")
    return members


def _tabulate(table: MaterialTable, row: int, material: Material) -> None:
    if isinstance(material, Diffuse):
        table.kind[row] = DIFFUSE
        table.reflectance[row] = material.albedo
    elif isinstance(material, Mirror):
        table.kind[row] = MIRROR
        table.reflectance[row] = material.reflectance
    else:
        table.kind[row] = DIELECTRIC
        table.ior[row] = material.ior
        table.exterior_ior[row] = material.exterior_ior
        table.absorption[row] = material.absorption
