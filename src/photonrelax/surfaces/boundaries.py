"""The boundary of the surfaces of a scene that store photons."""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats
from ..scene.resolution import Resolution
from ..scene.scene import SceneObject
from ..spatial.box_tree import BoxTree
from ..spatial.kdtree import KDTree
from .contact_lines import contact_lines
from .covered import apart, uncovered
from .segments import NO_SEGMENTS, Segments, concatenated
from .solid import Solid
from .surface import Side, Surface


class Part(NamedTuple):
    """A part of all surfaces, which ends where dielectrics meet them.

    Attributes
    ----------
    inside, outside : frozenset of int
        Ids of closed dielectrics that it is in, and of those that it is not in.
    """

    inside: frozenset[int] = frozenset()
    outside: frozenset[int] = frozenset()


WHOLE = Part()


@dataclass(frozen=True, eq=False)
class SurfaceBoundary:
    """Segments at which surfaces that store photons end, turn or are covered.

    A segment is a free edge of a mesh, one side of a crease, where the normals of two faces are
    more than 60° apart, or a piece of a contact line, along which a closed mirror or diffuse object
    stands on a surface or cuts it. Parts of edges that such an object covers, or that lie within
    another object's surface in the same plane, are left out. Where two surfaces abut the edges of
    both are there, in opposite directions.

    Attributes
    ----------
    segments : (n, 2, 3)
        Ends, m. The surface lies to the left of the way from the first to the second, as seen from
        the tip of the normal.
    normals : (n, 3)
        Unit normals of the faces on which they lie.
    one_sided : (n,) bool
        True where the surface ends only for light that arrives on the side of the normal: closed
        objects get light from outside alone, and a box on a sheet covers one side of it. The others
        count, with their ends and the normal reversed, for the other side as well.

    Notes
    -----
    Places that are nearer to each other than rays resolve count as one. An object wholly inside of
    a closed one is taken to be lit there: the other is a room to it, and covers nothing of it.

    Open sheets cover nothing, nor do parts of objects whose windings are inconsistent; nor does an
    object cover parts of itself. Contact lines of two solids that share a wall, one inside of the
    other, count twice, as do those on two sheets in one place.
    """

    segments: Floats
    normals: Floats
    one_sided: NDArray[np.bool_]

    @classmethod
    def of(
        cls,
        objects: Sequence[SceneObject],
        among: Container[int] | None = None,
        part: Part = WHOLE,
    ) -> SurfaceBoundary:
        """Boundary of the diffuse objects and sensors among the objects of a scene.

        With `among` only of those whose numbers are in it; the others cover parts of them all the
        same. With `part` of what is in some dielectrics and not in others.
        """
        divides = part.inside | part.outside
        numbers = [
            i for i, item in enumerate(objects) if i in divides or not item.material.has_inside
        ]
        items = [objects[i] for i in numbers]
        stores = [
            i
            for i, item in enumerate(items)
            if not item.material.is_specular and (among is None or numbers[i] in among)
        ]
        if not stores:
            return cls(*NO_SEGMENTS, np.empty(0, dtype=bool))
        scene = _Surfaces(items, stores, {numbers.index(i) for i in part.inside})
        segments, one_sided = zip(*(scene.boundary(i) for i in stores), strict=True)
        ends, normals = (np.ascontiguousarray(column) for column in concatenated(segments))
        return cls(ends, normals, np.concatenate(one_sided))


class _Surfaces:
    """The surfaces of opaque objects and sensors, of which those in `stores` store photons.

    They end at dielectrics among them: those in `around` have them inside, the others outside.
    """

    def __init__(
        self, items: Sequence[SceneObject], stores: Sequence[int], around: Container[int]
    ) -> None:
        self._surfaces = [Surface.of(item) for item in items]
        self._sensors = {i for i, item in enumerate(items) if item.material.is_sensor}
        self._around = around
        self._resolution = _resolution(self._surfaces)
        self._near = _near(self._surfaces, self._resolution)
        self._inside = [self._inside_of(i) for i in range(len(items))]
        self._sides = {i: self._sides_of(i) for i in stores}

    def _inside_of(self, i: int) -> set[int]:
        """The objects inside of a closed one, or in its surface if there are others inside."""
        solid, found, is_room = self._surfaces[i].solid, [], False
        if solid is None:
            return set()
        for j in self._near[i]:
            side = self._surfaces[j].front
            margin = float(self._resolution.at(np.array(side.bounds)).max())
            all_in, some_inside = solid.surrounds(side.corners, side.normals, margin)
            is_room |= all_in and some_inside
            found += [j] if all_in else []
        return set(found) if is_room else set()

    def _sides_of(self, i: int) -> tuple[Side, Side]:
        """Faces that get light on their front, and on their back: of rooms, sensors and sheets."""
        surface = self._surfaces[i]
        lit = ~surface.closed | bool(self._inside[i]) | (i in self._sensors)
        return surface.front, surface.front.rows(lit).back()

    def boundary(self, i: int) -> tuple[Segments, NDArray[np.bool_]]:
        """The boundary of one surface; true for segments that are of one side only."""
        front, back = (self._boundary_of_side(i, side) for side in self._sides[i])
        return _merged(front, back, self._resolution)

    def _boundary_of_side(self, i: int, side: Side) -> Segments:
        if len(side.corners) == 0:
            return NO_SEGMENTS
        solids = self._solids(i)
        parts = [self._edges(i, side)]
        parts += [self._contact_lines(side, j, solid) for j, solid in solids.items()]
        found = concatenated(parts)
        # The solid at which a contact line is; no object has the number of the surface itself.
        source = np.repeat([i, *solids], [len(part.ends) for part in parts])
        for j, solid in solids.items():
            near = (source != j) & self._meet(found, solid.bounds)
            if j in self._around:
                kept = near | (source == j)
                found, source, near = found.rows(kept), source[kept], near[kept]
            left = uncovered(found.rows(near), solid, self._resolution, j in self._around)
            found = found.with_parts(near, left)
            source = np.concatenate([source[~near], source[near][left.row]])
        return found

    def _contact_lines(self, side: Side, j: int, solid: Solid) -> Segments:
        """Contact lines with a solid, which have what is in it on their left if it is around."""
        lines = contact_lines(side, solid, self._resolution)
        return Segments(lines.ends[:, ::-1], lines.normals) if j in self._around else lines

    def _edges(self, i: int, side: Side) -> Segments:
        """Edges that are not within another object's surface; those of sensors all."""
        edges = side.edges()
        if i in self._sensors:
            return edges
        others = [j for j in self._near[i] if j in self._sides and j not in self._sensors]
        for j, other in [(number, side) for number in others for side in self._sides[number]]:
            near = self._meet(edges, other.bounds)
            if near.any():
                left = apart(edges.rows(near), other, self._resolution, yields=i > j)
                edges = edges.with_parts(near, left)
        return edges

    def _meet(self, segments: Segments, box: tuple[Floats, Floats]) -> NDArray[np.bool_]:
        """True for segments whose bounding boxes are nearer to a box than rays resolve."""
        return segments.meet(box, self._resolution.at(segments.ends).max(axis=1))

    def _solids(self, i: int) -> dict[int, Solid]:
        """Solids that cover parts of surface i where they touch it or cut it."""
        solids = {j: self._surfaces[j].solid for j in self._near[i] if j not in self._sensors}
        return {
            j: solid
            for j, solid in solids.items()
            if solid is not None and i not in self._inside[j]
        }


def _merged(
    front: Segments, back: Segments, resolution: Resolution
) -> tuple[Segments, NDArray[np.bool_]]:
    """Segments of two sides, those of both once; true for those of one side."""
    seen = back.reversed()
    if not (len(front.ends) and len(seen.ends)):
        return concatenated([front, back]), np.ones(len(front.ends) + len(seen.ends), dtype=bool)
    nearest = KDTree(_columns(seen, resolution), 9).query(_columns(front, resolution), 1)
    same = nearest.distance[:, 0] <= resolution.at(front.ends).max(axis=1)
    match = nearest.ids[:, 0]
    alone = np.ones(len(seen.ends), dtype=bool)
    alone[match[same]] = False
    one_sided = np.concatenate([~same, np.ones(np.count_nonzero(alone), dtype=bool)])
    return concatenated([front, back.rows(alone)]), one_sided


def _columns(segments: Segments, resolution: Resolution) -> Floats:
    """Ends and normals (n, 9): segments with the same ends but other normals are far apart."""
    return np.hstack([segments.ends.reshape(-1, 6), resolution.radius * segments.normals])


def _resolution(surfaces: Iterable[Surface]) -> Resolution:
    """Distance that rays to surfaces resolve."""
    corners = np.concatenate([surface.front.corners for surface in surfaces])
    return Resolution.of(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


def _near(surfaces: Sequence[Surface], resolution: Resolution) -> list[NDArray]:
    """For each surface the numbers of the others that may meet it, ascending."""
    bounds = np.array([surface.front.bounds for surface in surfaces])
    low, high = np.moveaxis(bounds, 1, 0)
    margin = resolution.at(bounds).max(axis=1)
    row, other = BoxTree(low, high).pairs_within(low, high, margin)
    of_row = np.split(other, np.searchsorted(row, np.arange(1, len(surfaces))))
    return [np.sort(found[found != i]) for i, found in enumerate(of_row)]
