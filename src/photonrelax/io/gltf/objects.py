"""Objects of a scene, and emitters with a surface, from the meshes of glTF nodes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ..._util.validation import Floats
from ...scene.area_emitter import AreaEmitter
from ...scene.emitters import Emitter
from ...scene.materials import Dielectric, Diffuse, Material
from ...scene.scene import SceneObject
from ...scene.winding import EdgeDefects, check_surface
from ..json_entry import JsonEntry
from ..objects import ObjectMaker
from ..plate import plate
from ..substitutions import Substitutions
from .file import GltfFile
from .materials import MaterialReader, Surface
from .meshes import Triangles, triangles_of
from .nodes import PlacedNode

if TYPE_CHECKING:
    import trimesh

_CLOSED = EdgeDefects(0, 0)
# Members of primitives and nodes without a counterpart, and what is used instead.
_IGNORED = {"targets": "the mesh at rest", "skin": "the mesh at rest"}
# Degrees, of plates: their rims stay sharp.
_CREASE = 30.0


@dataclass
class Built:
    """Objects and emitters made of the nodes of a file."""

    objects: list[SceneObject] = field(default_factory=list)
    emitters: list[Emitter] = field(default_factory=list)


class ObjectBuilder:
    """Builds objects; a mesh under many nodes, and a material, are read once."""

    def __init__(
        self,
        file: GltfFile,
        materials: MaterialReader,
        substitutions: Substitutions,
        maker: ObjectMaker,
    ) -> None:
        self._file, self._materials, self._substitutions = file, materials, substitutions
        self._maker = maker
        self._triangles: dict[tuple[int, int, int | None], Triangles | None] = {}
        self._surfaces: dict[int | None, Surface] = {}

    def build(self, nodes: list[PlacedNode]) -> Built:
        """Objects, and emitters where materials emit.

        Raises
        ------
        ValueError
            If a mesh is damaged, or one of glass is inside out; the message names the node.
        """
        built = Built()
        meshes = self._file.entries("meshes")
        for node in nodes:
            index = node.entry.index("mesh", len(meshes))
            if index is None:
                continue
            primitives = meshes[index].entries("primitives")
            self._add_ignored(node.entry, node.name)
            for i, primitive in enumerate(primitives):
                name = node.name if len(primitives) == 1 else f"{node.name}[{i}]"
                self._add_ignored(primitive, name)
                try:
                    self._add(built, name, (index, i), primitive, node.to_world)
                except ValueError as error:
                    raise ValueError(f"{self._file.path}: object {name!r}: {error}") from None
        return built

    def _add(
        self,
        built: Built,
        name: str,
        number: tuple[int, int],
        primitive: JsonEntry,
        to_world: Floats,
    ) -> None:
        """Add a primitive, by the numbers of its mesh and of itself, at a place."""
        surface = self._surface(primitive)
        uv_set = None if surface.texture is None else surface.texture.uv_set
        key = (*number, uv_set)
        if key not in self._triangles:
            self._triangles[key] = triangles_of(self._file, primitive, uv_set)
        triangles = self._triangles[key]
        if triangles is None:
            self._substitutions.add(name, "points or lines", "nothing of them")
            return
        placed = triangles.placed(to_world)
        if surface.radiance.any():
            built.emitters.append(_lamp(placed, surface))
        else:
            built.objects.append(self._object(name, placed, surface))

    def _object(self, name: str, triangles: Triangles, surface: Surface) -> SceneObject:
        mesh, smooth = triangles.mesh()
        if isinstance(surface.material, Dielectric):
            if _is_open(mesh) and not self._maker.closes(mesh, name):
                return self._plate(name, triangles, surface)
            self._substitutions.add_reading(
                surface.name, "glass around a closed mesh", "solid glass"
            )
        return self._maker.make(mesh, _material(triangles, surface), name, smooth)

    def _plate(self, name: str, triangles: Triangles, surface: Surface) -> SceneObject:
        """Glass of an open mesh, which the standard has as a thin wall."""
        import trimesh

        vertices, faces, thickness = plate(triangles.vertices, triangles.faces)
        self._substitutions.add(
            surface.name,
            f"thin wall, as {name} is open",
            f"a plate {thickness:.3g} m thick",
        )
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        return self._maker.make(mesh, surface.material, name, _CREASE)

    def _surface(self, primitive: JsonEntry) -> Surface:
        materials = self._file.entries("materials")
        index = primitive.index("material", len(materials))
        if index not in self._surfaces:
            if index is None:
                entry, name = JsonEntry({}, f"{primitive.where}.material"), "default material"
            else:
                entry = materials[index]
                name = entry.text("name", f"material {index}")
            self._surfaces[index] = self._materials.read(entry, name)
        return self._surfaces[index]

    def _add_ignored(self, entry: JsonEntry, name: str) -> None:
        for key, used in _IGNORED.items():
            if key in entry:
                self._substitutions.add(name, key, used)
        if "COLOR_0" in entry.entry("attributes"):
            self._substitutions.add(name, "colours of vertices", "the material alone")


def _lamp(triangles: Triangles, surface: Surface) -> AreaEmitter:
    mesh, _ = triangles.mesh()
    return AreaEmitter(
        mesh,
        radiance=surface.radiance,
        two_sided=surface.two_sided and not _winds_outwards(mesh),
        material=_material(triangles, surface),
    )


def _material(triangles: Triangles, surface: Surface) -> Material:
    """The material, its texture on the coordinates of the triangles."""
    if surface.texture is None or triangles.uv is None:
        return surface.material
    return Diffuse(surface.texture.on(triangles.uv))


def _is_open(mesh: trimesh.Trimesh) -> bool:
    try:
        return check_surface(mesh).open > 0
    except ValueError:
        # It winds inwards, and is closed.
        return False


def _winds_outwards(mesh: trimesh.Trimesh) -> bool:
    """True for a closed mesh that does; its inside gets no light."""
    try:
        return check_surface(mesh) == _CLOSED
    except ValueError:
        return False
