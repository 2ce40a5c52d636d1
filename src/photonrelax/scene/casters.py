"""Groups of connected parts of specular objects, and the spheres that emitters aim at."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

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


def bounding_sphere(vertices: Floats) -> Sphere:
    """Sphere around the centre of the bounding box of vertices (v, 3), to the farthest of them."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre = low + 0.5 * (high - low)
    return Sphere(centre, float(np.linalg.norm(vertices - centre, axis=1).max()))


def group_spheres(meshes: Iterable[trimesh.Trimesh], max_groups: int) -> tuple[Sphere, ...]:
    """Bounding spheres of groups of connected parts, the largest first; one if parts are close.

    A sphere's outline is its area as seen from an emitter. Groups are those of a tree of the parts
    whose outlines are least in sum, and less than the outline of them all by a fifth at least.
    """
    vertices, part = _labelled(meshes)
    order = np.argsort(part, kind="stable")
    first = np.searchsorted(part[order], np.arange(part.max() + 2))
    low = np.minimum.reduceat(vertices[order], first[:-1])
    high = np.maximum.reduceat(vertices[order], first[:-1])
    spheres = [
        bounding_sphere(vertices[order[_ranges(first, parts)]])
        for parts in _groups(low, high, max_groups)
    ]
    return tuple(sorted(spheres, key=lambda sphere: -sphere.radius))


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


@dataclass
class _Node:
    """A node of the tree of parts: `area` is the squared diagonal of its bounding box."""

    parts: Ids
    area: float
    children: Sequence[_Node] = ()

    def groups(self) -> tuple[float, list[Ids]]:
        """The least area in sum that this node or its descendants have, and their parts."""
        if not self.children:
            return self.area, [self.parts]
        below = [child.groups() for child in self.children]
        area = sum(each[0] for each in below)
        if area > SAVING * self.area:
            return self.area, [self.parts]
        return area, [parts for each in below for parts in each[1]]


def _groups(low: Floats, high: Floats, max_groups: int) -> list[Ids]:
    """Parts of the groups, by the bounding boxes (p, 3) of all parts."""
    root = _node(low, high, np.arange(len(low)))
    # The widest is split next; the number tells equally wide ones apart.
    open_nodes, n_groups = [(-root.area, 0, root)], 1
    while open_nodes and n_groups < max_groups:
        node = heapq.heappop(open_nodes)[2]
        if len(node.parts) == 1:
            continue
        node.children = tuple(_split(low, high, node.parts))
        n_groups += 1
        for number, child in enumerate(node.children):
            heapq.heappush(open_nodes, (-child.area, 2 * n_groups + number, child))
    return root.groups()[1]


def _node(low: Floats, high: Floats, parts: Ids) -> _Node:
    diagonal = high[parts].max(axis=0) - low[parts].min(axis=0)
    return _Node(parts, float(diagonal @ diagonal))


def _split(low: Floats, high: Floats, parts: Ids) -> Iterator[_Node]:
    """The two halves, along an axis, whose areas are least in sum."""
    candidates = []
    for axis in range(3):
        order = parts[np.argsort(low[parts, axis] + high[parts, axis], kind="stable")]
        before = np.maximum.accumulate(high[order]) - np.minimum.accumulate(low[order])
        order_back = order[::-1]
        after = np.maximum.accumulate(high[order_back]) - np.minimum.accumulate(low[order_back])
        area = (before[:-1] ** 2).sum(axis=1) + (after[::-1][1:] ** 2).sum(axis=1)
        best = int(area.argmin())
        candidates.append((area[best], axis, order[: best + 1], order[best + 1 :]))
    _, _, *halves = min(candidates, key=lambda each: each[:2])
    return (_node(low, high, half) for half in halves)
