"""Objects from meshes of files, as they are or mended."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..scene.materials import Material
from ..scene.meshes import in_unit_cube, nondegenerate_faces
from ..scene.scene import SceneObject
from ..scene.welding import HalfEdges, weld
from ..scene.winding import EdgeDefects, check_surface, closed_faces

if TYPE_CHECKING:
    import trimesh

# Degrees; mended meshes have lost their normals.
_CREASE = 30.0
_WHOLE = EdgeDefects(0, 0)
# Volume of a body over the cube of its size, at least.
_FLAT = 1e-9
# Open edges over all edges, half as many again as faces, of surfaces that are open on purpose.
_BORDER_SHARE = 0.05


@dataclass(frozen=True)
class Finding:
    """Something about a scene that deserves a look.

    Attributes
    ----------
    text : str
        The object, the count, and what to do.
    spoils : bool
        Images would be wrong, or there would be none.
    stays : bool
        It spoils images of the mended scene too, in which nothing is found of it.
    """

    text: str
    spoils: bool = True
    stays: bool = False


class ObjectMaker:
    """Makes objects of meshes as they are."""

    def make(
        self,
        mesh: trimesh.Trimesh,
        material: Material,
        name: str,
        smooth: bool | float,
    ) -> SceneObject:
        """An object; raises ValueError if its mesh cannot be that of its material."""
        return SceneObject(mesh, material, name, smooth)

    def closes(self, mesh: trimesh.Trimesh, name: str) -> bool:
        """True if `make` closes the holes of a mesh."""
        return False


class MendingMaker(ObjectMaker):
    """Makes objects of meshes that it mends, and keeps what it finds.

    Attributes
    ----------
    findings : list of Finding
    """

    def __init__(self) -> None:
        self.findings: list[Finding] = []

    def make(
        self,
        mesh: trimesh.Trimesh,
        material: Material,
        name: str,
        smooth: bool | float,
    ) -> SceneObject:
        """An object whose mesh is welded, closed and wound outwards, as far as trimesh can."""
        n_flat = len(mesh.faces) - len(nondegenerate_faces(mesh)[0])
        if n_flat:
            text = f"{name!r} has {n_flat} triangles without an area, which light never meets"
            self.findings.append(Finding(text, spoils=False))
        if not material.has_inside:
            return SceneObject(mesh, material, name, smooth)
        defects, inverted = _defects(mesh)
        if defects == _WHOLE and not inverted:
            return SceneObject(mesh, material, name, smooth)
        mended = mended_mesh(mesh)
        self.findings.append(Finding(_text(name, defects, inverted)))
        if _defects(mended)[1]:
            mended.invert()
        return SceneObject(mended, material, name, _CREASE if smooth else False)

    def closes(self, mesh: trimesh.Trimesh, name: str) -> bool:
        """True if the holes of a mesh can be filled, and it is a body then.

        A mesh that is closed but for holes that are too large is a finding: it is no thin wall.
        """
        mended = mended_mesh(mesh)
        size = float(np.linalg.norm(np.ptp(np.asarray(mended.vertices), axis=0)))
        if _defects(mended) == (_WHOLE, False):
            return float(mended.volume) > _FLAT * size**3
        n_open = _defects(mesh)[0].open
        if n_open < _BORDER_SHARE * 1.5 * len(mesh.faces):
            text = f"{name!r} is of glass, and has {n_open} open edges, too many to fill: close it"
            self.findings.append(Finding(text, stays=True))
        return False


def mended_mesh(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A mesh with equal positions joined, holes filled, and its parts wound outwards."""
    import trimesh

    vertices = np.asarray(mesh.vertices)
    position = weld(in_unit_cube(vertices), np.asarray(mesh.faces))
    first = np.unique(position, return_index=True)[1]
    faces = position[nondegenerate_faces(mesh)[1]]
    mended = trimesh.Trimesh(vertices[first], faces, process=False)
    mended.update_faces(mended.unique_faces())
    trimesh.repair.fix_winding(mended)
    mended.fill_holes()
    faces = np.asarray(mended.faces).copy()
    corners = np.asarray(mended.vertices)
    inward = closed_faces(corners[faces], HalfEdges(faces))[1]
    faces[inward] = faces[inward, ::-1]
    return trimesh.Trimesh(corners, faces, process=False)


def _defects(mesh: trimesh.Trimesh) -> tuple[EdgeDefects, bool]:
    """Edge defects of a mesh, and whether a closed part winds inwards."""
    try:
        return check_surface(mesh), False
    except ValueError:
        return _WHOLE, True


def _text(name: str, defects: EdgeDefects, inverted: bool) -> str:
    if inverted:
        return f"{name!r} is of glass, and its faces wind inwards: turn its normals"
    return (
        f"{name!r} is of glass, and has {defects.open} open edges and {defects.inconsistent} whose "
        "faces wind against each other: close it, and make its normals consistent"
    )
