"""Groups of connected parts of specular objects, and the spheres that emitters aim at."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .._util.validation import Floats
from .emission_region import Sphere
from .meshes import in_unit_cube, nondegenerate_faces
from .welding import Ids, components, weld

if TYPE_CHECKING:
    import trimesh

# Emitters aim at no more groups than this, each.
MAX_GROUPS = 64
# Groups are aimed at by themselves where their outlines together are this much smaller.
SAVING = 0.8


class Targets(NamedTuple):
    """Spheres that emitters aim at.

    Attributes
    ----------
    casters : tuple of Sphere
        Around groups of the specular objects' parts, the largest first; empty without any.
    around_casters : Sphere, optional
        Around all specular objects; None without any.
    around : Sphere
        Around all visible objects.
    """

    casters: tuple[Sphere, ...]
    around_casters: Sphere | None
    around: Sphere


def bounding_sphere(vertices: Floats) -> Sphere:
    """Sphere around the centre of the bounding box of vertices (v, 3), to the farthest of them."""
    # By axes: NumPy takes several times as long for rows of three.
    along = np.ascontiguousarray(vertices.T)
    low, high = along.min(axis=1), along.max(axis=1)
    centre = low + 0.5 * (high - low)
    squares = (along - centre[:, np.newaxis]) ** 2
    return Sphere(centre, float(np.sqrt(squares.sum(axis=0).max())))


def group_spheres(meshes: Iterable[trimesh.Trimesh], max_groups: int) -> tuple[Sphere, ...]:
    """Bounding spheres of groups of connected parts, the largest first; one if parts are close.

    A sphere's outline is its area as seen from an emitter. Groups are those of a tree of the parts
    whose outlines are least in sum, and less than the outline of them all by a fifth at least.
    """
    vertices, part = _labelled(meshes)
    order = np.argsort(part, kind="stable")
    vertices, part = vertices[order], part[order]
    first = np.searchsorted(part, np.arange(part[-1] + 2))
    spheres = [
        bounding_sphere(vertices[_ranges(first, group)])
        for group in _groups(_Parts.of(vertices, part, first[:-1]), max_groups)
    ]
    return tuple(sorted(spheres, key=lambda sphere: -sphere.radius))


def common_targets(targets: Sequence[Targets], max_groups: int = MAX_GROUPS) -> Targets:
    """Targets that hold those of several scenes, as of one whose objects move.

    Raises
    ------
    ValueError
        If some scenes have specular objects and others have none, or there is no scene.
    """
    casters = [sphere for each in targets for sphere in each.casters]
    around = [each.around_casters for each in targets if each.around_casters is not None]
    if not targets or len(around) not in (0, len(targets)):
        raise ValueError(
            "all scenes should have specular objects, or none, but of "
            f"{len(targets)} scenes {len(around)} have some"
        )
    spheres: list[Sphere] = []
    if casters:
        parts = _Parts.around(casters)
        spheres = [parts.sphere(group) for group in _groups(parts, max_groups)]
    return Targets(
        tuple(sorted(spheres, key=lambda sphere: -sphere.radius)),
        _enclosing(around) if around else None,
        _enclosing([each.around for each in targets]),
    )


def _enclosing(spheres: Sequence[Sphere]) -> Sphere:
    """Sphere around spheres."""
    return _Parts.around(spheres).sphere(np.arange(len(spheres)))


def _ranges(first: Ids, parts: Ids) -> Ids:
    return np.concatenate([np.arange(first[part], first[part + 1]) for part in parts])


def _labelled(meshes: Iterable[trimesh.Trimesh]) -> tuple[Floats, Ids]:
    """Vertices (v, 3) of all meshes that belong to a face with an area, and their parts (v,)."""
    vertices, parts, n_parts = [], [], 0
    for mesh in meshes:
        of_mesh, faces = np.asarray(mesh.vertices, dtype=np.float64), nondegenerate_faces(mesh)[1]
        used = np.unique(faces)
        part = np.unique(_connected(of_mesh, faces)[used], return_inverse=True)[1]
        vertices.append(of_mesh[used])
        parts.append(n_parts + part)
        n_parts += int(part.max()) + 1
    return np.concatenate(vertices), np.concatenate(parts)


def _connected(vertices: Floats, faces: Ids) -> Ids:
    """Connected component (v,) of each vertex; those of seams and of separate faces are welded."""
    part = _components(len(vertices), faces)
    if (part[faces[:, 0]] == part[faces[0, 0]]).all():
        return part
    position = weld(in_unit_cube(vertices), faces)
    return _components(len(vertices), position[faces])[position]


def _components(n: int, faces: Ids) -> Ids:
    return components(n, faces[:, :2].ravel(), faces[:, 1:].ravel())


class _Parts(NamedTuple):
    """Bounding boxes (p, 3) of the parts, and the radii (p,) of spheres around their centres."""

    low: Floats
    high: Floats
    radius: Floats

    @classmethod
    def of(cls, vertices: Floats, part: Ids, first: Ids) -> _Parts:
        """Those of vertices (v, 3) sorted by their parts (v,), of which these are the first."""
        low, high = np.minimum.reduceat(vertices, first), np.maximum.reduceat(vertices, first)
        distance = np.linalg.norm(vertices - (0.5 * (low + high))[part], axis=1)
        return cls(low, high, np.maximum.reduceat(distance, first))

    @classmethod
    def around(cls, spheres: Sequence[Sphere]) -> _Parts:
        """Spheres as parts."""
        centre = np.array([sphere.centre for sphere in spheres])
        radius = np.array([sphere.radius for sphere in spheres])
        return cls(centre - radius[:, np.newaxis], centre + radius[:, np.newaxis], radius)

    def outline(self, ids: Ids) -> float:
        """Squared radius of a sphere around parts."""
        return self.sphere(ids).radius ** 2

    def sphere(self, ids: Ids) -> Sphere:
        """Sphere around parts."""
        low, high, radius = (column[ids] for column in self)
        centre = 0.5 * (low.min(axis=0) + high.max(axis=0))
        distance = np.linalg.norm(0.5 * (low + high) - centre, axis=1)
        return Sphere(centre, float((distance + radius).max()))


@dataclass
class _Node:
    """A node of the tree of parts, with the outline of a sphere around them."""

    ids: Ids
    outline: float
    children: Sequence[_Node] = ()

    def groups(self) -> tuple[float, list[Ids]]:
        """The least outlines in sum that this node or its descendants have, and their parts."""
        if not self.children:
            return self.outline, [self.ids]
        below = [child.groups() for child in self.children]
        outline = sum(each[0] for each in below)
        if outline > SAVING * self.outline:
            return self.outline, [self.ids]
        return outline, [ids for each in below for ids in each[1]]


def _groups(parts: _Parts, max_groups: int) -> list[Ids]:
    """The parts of each group."""
    every = np.arange(len(parts.low))
    root = _Node(every, parts.outline(every))
    # The widest is split next; the number tells equally wide ones apart.
    open_nodes, n_groups = [(-root.outline, 0, root)], 1
    while open_nodes and n_groups < max_groups:
        node = heapq.heappop(open_nodes)[2]
        if len(node.ids) == 1:
            continue
        node.children = [_Node(ids, parts.outline(ids)) for ids in _split(parts, node.ids)]
        n_groups += 1
        for number, child in enumerate(node.children):
            heapq.heappush(open_nodes, (-child.outline, 2 * n_groups + number, child))
    return root.groups()[1]


def _split(parts: _Parts, ids: Ids) -> tuple[Ids, Ids]:
    """Two halves along an axis, whose boxes' squared diagonals are least in sum."""
    candidates = []
    for axis in range(3):
        order = ids[np.argsort((parts.low + parts.high)[ids, axis], kind="stable")]
        total = _diagonals(parts, order)[:-1] + _diagonals(parts, order[::-1])[::-1][1:]
        best = int(total.argmin())
        candidates.append((total[best], axis, order[: best + 1], order[best + 1 :]))
    _, _, one, other = min(candidates, key=lambda each: each[:2])
    return one, other


def _diagonals(parts: _Parts, order: Ids) -> Floats:
    """Squared diagonals (n,) of the boxes around the first 1, 2, … of some parts."""
    low = np.minimum.accumulate(parts.low[order])
    high = np.maximum.accumulate(parts.high[order])
    squared: Floats = ((high - low) ** 2).sum(axis=1)
    return squared
