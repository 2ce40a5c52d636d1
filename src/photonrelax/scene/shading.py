"""Normals that smooth objects are shaded with: given ones, or means up to creases."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats, float_array
from .meshes import divided, face_normals, in_unit_cube, release_arrays
from .welding import HalfEdges, Ids, components, weld

if TYPE_CHECKING:
    import trimesh

# Degrees; that of most modelling programs.
_DEFAULT_CREASE = 30.0
# Degrees by which rounding may change the angle of an edge: those of a cylinder of 12 sides all
# have 30°, and are all smooth.
_ROUNDING = 0.01
# Rounding error of a mesh read from a file and moved, over its size.
_SAME_SHAPE = 1e-6
# Weight of a mean over faces against the edges that a normal at a crease is extrapolated along.
_PRIOR = 1e-3
# Vertex normals within this of the means over faces were not given with the mesh.
_SAME_NORMAL = 1e-6


@dataclass(frozen=True)
class ShadingNormals:
    """Vertices, split where a mesh has a crease, and their normals.

    Attributes
    ----------
    vertex : (s,)
        The vertex of the mesh that each is a copy of.
    normal : (s, 3)
        Not all unit: zero where no face has an area.
    faces : (f, 3)
        Three of them for each face of the mesh.
    """

    vertex: Ids
    normal: Floats
    faces: NDArray

    @classmethod
    def split(cls, faces: NDArray, normal_id: NDArray, normals: Floats) -> ShadingNormals:
        """Split vertices of `faces` whose corners have different normals, `normals[normal_id]`."""
        n = np.int64(len(normals))
        key, corner = np.unique(faces * n + normal_id, return_inverse=True)
        return cls(key // n, normals[key % n], corner.reshape(-1, 3))


def check_smooth(smooth: bool | float) -> bool | float:
    """Return `smooth` as a bool, or as degrees.

    Raises
    ------
    TypeError, ValueError
        If it is neither a bool nor a number from 0 to 180.
    """
    if isinstance(smooth, bool | np.bool_):
        return bool(smooth)
    angle = float(float_array(smooth, "smooth", ()))
    if not 0.0 <= angle <= 180.0:
        raise ValueError(
            f"smooth should be True, False or a crease angle from 0 to 180 degrees, but is {angle}"
        )
    return angle


def shading_normals(mesh: trimesh.Trimesh, smooth: bool | float) -> ShadingNormals:
    """Normals of the faces' corners: with True those that came with the mesh, if any did.

    Else they are means over the faces around a corner, as far as the edges between them turn by no
    more than the crease angle. Vertices at one position count as one. Normals of a mesh with its
    vertices on a sphere are exact, and nearly so at creases and borders.
    """
    if smooth is not True:
        return _creased(mesh, float(smooth))
    given = given_normals(mesh)
    if given is not None:
        return ShadingNormals(np.arange(len(given)), given, np.asarray(mesh.faces))
    return _ply_normals(mesh) or _creased(mesh, _DEFAULT_CREASE)


def given_normals(mesh: trimesh.Trimesh) -> Floats | None:
    """Return the vertex normals (v, 3) that came with a mesh, or None.

    trimesh caches given and computed normals alike; computed ones are recognised by their values,
    so that reading `mesh.vertex_normals` does not change the result.
    """
    if "vertex_normals" not in mesh._cache:
        return None
    cached = np.asarray(mesh.vertex_normals)
    computed = _mean_normals(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    return cached if np.abs(cached - computed).max() > _SAME_NORMAL else None


def _ply_normals(mesh: trimesh.Trimesh) -> ShadingNormals | None:
    """Normals of the PLY file that a mesh was loaded from, or None.

    trimesh drops them from copies, as `trimesh.load_mesh` returns, but keeps what it read. They
    follow the mesh if it was moved, turned or scaled since, and are None if it changed otherwise.
    """
    from trimesh.exchange import ply

    if "_ply_raw" not in mesh.metadata:
        return None
    read = ply._elements_to_kwargs(mesh.metadata["_ply_raw"], fix_texture=False, image=None)
    normals = read.get("vertex_normals")
    if normals is None or not np.isfinite(normals).all():
        return None
    corners = read["vertices"][read["faces"]]
    linear = _linear_map(corners.reshape(-1, 3), mesh.vertices[mesh.faces].reshape(-1, 3))
    if linear is None:
        return None
    # Normals map by the cofactors, whatever the map does to lengths.
    mapped = normals @ np.cross(linear[[1, 2, 0]], linear[[2, 0, 1]])
    mapped = divided(mapped, np.linalg.norm(mapped, axis=1, keepdims=True))
    return ShadingNormals.split(np.asarray(mesh.faces), read["faces"], mapped)


def _linear_map(points: Floats, images: Floats) -> Floats | None:
    """Return the matrix (3, 3) from points to their images, but for an offset, or None."""
    if points.shape != images.shape:
        return None
    points, images = points - points.mean(axis=0), images - images.mean(axis=0)
    size = np.abs(images).max()
    if np.abs(points - images).max() <= _SAME_SHAPE * size:
        return np.eye(3)
    solution, _, rank, _ = np.linalg.lstsq(points, images, rcond=_SAME_SHAPE)
    linear = np.asarray(solution, dtype=np.float64)
    exact = rank == 3 and np.abs(points @ linear - images).max() <= _SAME_SHAPE * size
    return linear if exact else None


def _creased(mesh: trimesh.Trimesh, crease_angle: float) -> ShadingNormals:
    faces = np.asarray(mesh.faces)
    vertices = in_unit_cube(np.asarray(mesh.vertices))
    triangles = vertices[faces]
    fans = _fans(triangles, HalfEdges(weld(vertices, faces)[faces]), crease_angle)
    normal = _vertex_normals(triangles, fans.of_corner)
    _extrapolate(normal, triangles, fans)
    return ShadingNormals.split(faces, fans.of_corner, normal)


@dataclass(frozen=True)
class _Fans:
    """Fans: the faces around a position as far as smooth edges join them.

    `of_corner` (f, 3) numbers them; `is_open` (fans,) is true for those at a crease or border.
    """

    of_corner: NDArray
    is_open: NDArray[np.bool_]


def _fans(triangles: Floats, half_edges: HalfEdges, crease_angle: float) -> _Fans:
    normals = face_normals(triangles)
    least_cosine = np.cos(np.radians(min(crease_angle + _ROUNDING, 180.0)))
    joined = [(np.empty(0, np.intp), np.empty(0, np.intp))]
    sharp = np.zeros(3 * len(triangles), dtype=bool)
    sharp[half_edges.ids] = True
    for rows, others in half_edges.pairs():
        a, b = half_edges.ids[rows], half_edges.ids[others]
        smooth = np.einsum("ij,ij->i", normals[a // 3], normals[b // 3]) >= least_cosine
        # Faces that wind against each other have no common normal.
        smooth &= half_edges.forward[rows] != half_edges.forward[others]
        a, b = a[smooth], b[smooth]
        joined += [(a, _next_corner(b)), (_next_corner(a), b)]
        sharp[a] = sharp[b] = False
    starts, ends = (np.concatenate(side) for side in zip(*joined, strict=True))
    of_corner = components(len(sharp), starts, ends)
    is_open = np.zeros(of_corner.max() + 1, dtype=bool)
    edges = np.flatnonzero(sharp)
    is_open[of_corner[edges]] = is_open[of_corner[_next_corner(edges)]] = True
    return _Fans(of_corner.reshape(-1, 3), is_open)


def _next_corner(corner: Ids) -> Ids:
    return np.where(corner % 3 == 2, corner - 2, corner + 1)


def _vertex_normals(triangles: Floats, fan: NDArray) -> Floats:
    """Normals of fans: means over faces, weighted as by Max (1999).

    The weights, the sine of the angle over the lengths of both edges, make normals exact where
    vertices lie on a sphere, however the triangles are shaped; with weights by angles alone the
    uneven triangles of a lens turned on an axis blur its focus.
    """
    total = np.zeros((fan.max() + 1, 3))
    for i in range(3):
        ahead = triangles[:, (i + 1) % 3] - triangles[:, i]
        back = triangles[:, (i + 2) % 3] - triangles[:, i]
        squares = np.einsum("ij,ij->i", ahead, ahead) * np.einsum("ij,ij->i", back, back)
        normal = divided(np.cross(ahead, back), squares[:, None])
        for axis in range(3):
            total[:, axis] += np.bincount(fan[:, i], normal[:, axis], len(total))
    return divided(total, np.linalg.norm(total, axis=1, keepdims=True))


def _extrapolate(normal: Floats, triangles: Floats, fans: _Fans) -> None:
    """Correct the normals of open fans, whose faces all lie on one side, by closed ones beside.

    An arc has the same angle to its chord at both ends: n · d = -m · d for the normals n and m at
    the ends of an edge d. The mean over faces serves across such edges, by least squares.
    """
    edges = [_open_edges(triangles, fans, i, j) for i in range(3) for j in range(3) if i != j]
    fan, beside, chord = (np.concatenate(part) for part in zip(*edges, strict=True))
    corrected, row = np.unique(fan, return_inverse=True)
    matrix = np.tile(_PRIOR * np.eye(3), (len(corrected), 1, 1))
    np.add.at(matrix, row, chord[:, :, None] * chord[:, None, :])
    right = _PRIOR * normal[corrected]
    np.add.at(right, row, -chord * np.einsum("ij,ij->i", normal[beside], chord)[:, None])
    solved = np.linalg.solve(matrix, right[:, :, None])[:, :, 0]
    normal[corrected] = divided(solved, np.linalg.norm(solved, axis=1, keepdims=True))


def _open_edges(triangles: Floats, fans: _Fans, i: int, j: int) -> tuple[NDArray, NDArray, Floats]:
    """Return the open fans at corners i with closed ones at corners j, those, and unit chords."""
    is_open = fans.is_open[fans.of_corner]
    rows = np.flatnonzero(is_open[:, i] & ~is_open[:, j])
    chord = triangles[rows, i] - triangles[rows, j]
    chord = divided(chord, np.linalg.norm(chord, axis=1, keepdims=True))
    return fans.of_corner[rows, i], fans.of_corner[rows, j], chord


def _mean_normals(vertices: Floats, faces: NDArray) -> Floats:
    """Normals (v, 3) of trimesh: means over faces, weighted by their angles at the vertex."""
    import trimesh

    copy = trimesh.Trimesh(vertices, faces, process=False)
    normals = np.asarray(copy.vertex_normals)
    release_arrays(copy)
    return normals
