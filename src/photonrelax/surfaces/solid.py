"""Bodies that closed surfaces enclose."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .._util.products import product
from .._util.validation import Floats
from ..scene.meshes import bounding_box, triangle_bounds
from ..scene.welding import HalfEdges, Ids
from ..scene.winding import generic_rotation, signed_crossings
from ..spatial.box_tree import BoxTree
from .triangles import Triangles

# Faces looked at to tell whether all of an object is in another.
_MAX_SAMPLES = 1024


@dataclass(frozen=True, eq=False)
class Solid(Triangles):
    """Closed surfaces, wound outwards, and what they enclose.

    Attributes
    ----------
    beyond : (f, 3, 3)
        For each edge of a face the corner of the face beyond it that is not on the edge.
    """

    beyond: Floats

    @cached_property
    def _turned(self) -> tuple[Floats, Floats, BoxTree]:
        """A rotation, the rotated triangles and the tree of their bounding boxes."""
        rotation = generic_rotation()
        turned = self.corners @ rotation
        return rotation, turned, BoxTree(*triangle_bounds(turned))

    def contains(self, points: Floats) -> NDArray[np.bool_]:
        """True for points (n, 3) inside; on the surface it is either."""
        rotation, turned, tree = self._turned
        start = product(points, rotation)
        end = start.copy()
        end[:, 2] = np.maximum(end[:, 2], turned[..., 2].max())
        ray, face = tree.pairs_within(start, end)
        crossings = signed_crossings(start[ray], turned[face])
        return np.bincount(ray, crossings, len(points)) > 0.0

    def surrounds(self, corners: Floats, normals: Floats, margin: float) -> tuple[bool, bool]:
        """True if triangles (f, 3, 3) are inside or in the surface; true if some are inside.

        Those of which one side, a margin above or below, is inside and the other is not are in the
        surface.
        """
        (low, high), (own_low, own_high) = bounding_box(corners), self.bounds
        if (low < own_low - margin).any() or (high > own_high + margin).any():
            return False, False
        rows = np.linspace(0, len(corners) - 1, min(len(corners), _MAX_SAMPLES)).astype(np.intp)
        centre, offset = corners[rows].mean(axis=1), margin * normals[rows]
        above, below = self.contains(centre + offset), self.contains(centre - offset)
        return bool((above | below).all()), bool((above & below).any())


def corners_beyond(corners: Floats, half_edges: HalfEdges) -> Floats:
    """For each edge of faces (f, 3, 3) of closed parts the corner (f, 3, 3) beyond it.

    Of edges of more than two faces one is taken whose face winds the other way. What is returned
    for faces of other parts is of no use.
    """
    face, j = np.divmod(_twins(half_edges, 3 * len(corners)), 3)
    return corners[face, (j + 2) % 3].reshape(-1, 3, 3)


def _twins(half_edges: HalfEdges, n: int) -> Ids:
    """For each of n half-edges one of the same edge that runs the other way."""
    order = np.lexsort((half_edges.forward, half_edges.edge))
    ids, edge, forward = (x[order] for x in (half_edges.ids, half_edges.edge, half_edges.forward))
    n_all, n_back = np.bincount(edge), np.bincount(edge, ~forward).astype(np.intp)
    first = np.cumsum(n_all) - n_all
    step = np.where(forward, -n_back[edge], n_back[edge])
    # As many run forward as back in closed parts; those of others may have no twin.
    twin = np.minimum(np.arange(len(edge)) + step, (first + n_all - 1)[edge])
    twins = np.zeros(n, dtype=np.intp)
    twins[ids] = ids[twin]
    return twins
