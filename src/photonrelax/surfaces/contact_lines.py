"""Contact lines: where solids stand on a surface or cut it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats
from ..scene.meshes import triangle_bounds
from ..scene.resolution import Resolution
from ..scene.welding import Ids
from .segments import Segments, Spans, clip
from .solid import Solid
from .surface import Side

# Pairs of faces looked at together, which need some hundred bytes each.
_CHUNK = 1 << 18


class _Pairs(NamedTuple):
    """Faces (p,) of a surface and of a solid, and where the corners of the solid's are.

    Heights (p, 3) are above the plane of the surface's face; `side` has their signs, 0 in the
    plane.
    """

    face: Ids
    other: NDArray
    height: Floats
    side: NDArray[np.int8]

    def rows(self, which: NDArray) -> _Pairs:
        return _Pairs(*(column[which] for column in self))


def contact_lines(surface: Side, solid: Solid, resolution: Resolution) -> Segments:
    """Segments on a surface around the parts that a solid of another object covers.

    Covered is what has the solid just above it. Corners of the solid that are nearer to the plane
    of a face than `resolution` count as in it. Along edges at which the surface ends there are no
    contact lines.
    """
    pairs = _meeting(surface, solid, resolution)
    lines = _intersections(pairs, surface, solid)
    tolerance = resolution.at(lines.ends).min(axis=1)
    part = clip(lines.ends, surface.corners[pairs.face], lines.normals, tolerance)
    # A line along an edge is that of the covered one of its faces.
    covered = np.einsum("nec,nc->ne", part.inward, _left(lines)) < 0.0
    has_line = (~part.along | (covered & ~surface.ends[pairs.face])).all(axis=1)
    length = np.linalg.norm(lines.ends[:, 1] - lines.ends[:, 0], axis=1) * (part.end - part.start)
    rows = np.flatnonzero(has_line & (length > tolerance))
    return lines.parts(Spans(rows, part.start[rows], part.end[rows]))


def _meeting(surface: Side, solid: Solid, resolution: Resolution) -> _Pairs:
    """Pairs of faces at whose common line what is just above the surface becomes covered."""
    face, other = _near(surface, solid, resolution)
    chunks = [slice(i, i + _CHUNK) for i in range(0, max(len(face), 1), _CHUNK)]
    parts = [_crossing(face[i], other[i], surface, solid, resolution) for i in chunks]
    return _Pairs(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _near(surface: Side, solid: Solid, resolution: Resolution) -> tuple[Ids, NDArray]:
    """Faces (p,) of a surface and of a solid whose bounding boxes are nearer than `resolution`."""
    low, high = solid.bounds
    margin = resolution.at(np.array(solid.bounds)).max()
    rows = surface.tree.pairs_within(low[np.newaxis], high[np.newaxis], margin).box
    query, other = solid.tree.pairs_within(*triangle_bounds(surface.corners[rows]), margin)
    return rows[query].astype(np.intp), other


def _heights(
    points: Floats, face: Ids, surface: Side, resolution: Resolution
) -> tuple[Floats, NDArray[np.int8]]:
    """Heights (p, k) of points (p, k, 3) above the planes of faces (p,), and their signs."""
    offset = points - surface.corners[face, :1]
    height = np.einsum("pkc,pc->pk", offset, surface.normals[face])
    side = np.where(np.abs(height) <= resolution.at(points), 0.0, np.sign(height))
    return height, side.astype(np.int8)


def _crossing(
    face: Ids, other: NDArray, surface: Side, solid: Solid, resolution: Resolution
) -> _Pairs:
    """Pairs with a line in the plane of the face, above which it is the end of the solid.

    The face of the solid goes through the plane; or it has an edge in the plane and the rest above,
    and the face beyond that edge is not above as well.
    """
    pairs = _Pairs(face, other, *_heights(solid.corners[other], face, surface, resolution))
    n_above, n_below = (pairs.side > 0).sum(axis=1), (pairs.side < 0).sum(axis=1)
    stands = np.flatnonzero((n_above == 1) & (n_below == 0))
    edge = (pairs.side[stands].argmax(axis=1) + 1) % 3
    beyond = solid.beyond[other[stands], edge][:, np.newaxis]
    side = _heights(beyond, face[stands], surface, resolution)[1][:, 0]
    through = np.flatnonzero((n_above > 0) & (n_below > 0))
    return pairs.rows(np.sort(np.concatenate([through, stands[side <= 0]])))


def _intersections(pairs: _Pairs, surface: Side, solid: Solid) -> Segments:
    """Segments in which faces of the solid meet planes, what is outside of it to the left.

    They run between two of six points: corners in the plane, but for what is not resolved, and
    points on edges through it.
    """
    corners, side = solid.corners[pairs.other], pairs.side
    following = np.roll(pairs.height, -1, axis=1)
    through = side * np.roll(side, -1, axis=1) < 0
    share = np.where(through, pairs.height, 0.0) / np.where(through, pairs.height - following, 1.0)
    on_edges = corners + share[..., np.newaxis] * (np.roll(corners, -1, axis=1) - corners)
    normals = surface.normals[pairs.face]
    in_plane = corners - pairs.height[..., np.newaxis] * normals[:, np.newaxis]
    meets = np.concatenate([side == 0, through], axis=1)
    points = np.concatenate([in_plane, on_edges], axis=1)[meets].reshape(-1, 2, 3)
    lines = Segments(points, normals)
    solid_left = np.einsum("nc,nc->n", _left(lines), solid.normals[pairs.other]) < 0.0
    lines.ends[solid_left] = lines.ends[solid_left, ::-1]
    return lines


def _left(lines: Segments) -> Floats:
    return np.cross(lines.normals, lines.ends[:, 1] - lines.ends[:, 0])
