"""Parts of segments that bound nothing: below solids, or within other surfaces."""

from __future__ import annotations

import numpy as np

from .._util.validation import Floats
from ..scene.resolution import Resolution
from ..scene.welding import Ids
from .segments import Segments, Spans, between, clip, in_both
from .solid import Solid
from .surface import Side

# Distances from a segment at which the surface beside it is looked at, over what rays resolve:
# above the face and towards the surface. Objects that touch are nearer than that.
_ABOVE = 2.0
_BESIDE = 1.5
# Cosine of normals of faces in one plane, but for rounding.
_PARALLEL = 1.0 - 1e-6


def uncovered(
    segments: Segments, solid: Solid, resolution: Resolution, inside: bool = False
) -> Spans:
    """Spans of segments at which there is no solid just above the surface; or is, `inside`."""
    margin = _margin(segments, resolution)
    step = _BESIDE * segments.inward() + _ABOVE * segments.normals
    spans = _spans_inside(segments.moved(margin[:, np.newaxis] * step), solid)
    if inside:
        spans = between(spans, len(segments.ends))
    return _without(segments, spans, margin)


def _margin(segments: Segments, resolution: Resolution) -> Floats:
    return resolution.at(segments.ends).max(axis=1)


def _without(segments: Segments, spans: Spans, least_length: Floats) -> Spans:
    """Rest of segments without spans, but for pieces shorter than `least_length` (n,)."""
    left = between(spans, len(segments.ends))
    a, b = np.moveaxis(segments.ends[left.row], 1, 0)
    length = (left.end - left.start) * np.linalg.norm(b - a, axis=1)
    whole = (left.start == 0.0) & (left.end == 1.0)
    return left.rows(whole | (length > least_length[left.row]))


def _spans_inside(segments: Segments, solid: Solid) -> Spans:
    """Spans of segments inside of a solid, from one crossing of its surface to the next."""
    near = np.flatnonzero(segments.meet(solid.bounds))
    row, at = _crossings(segments.rows(near), solid)
    row = near[np.concatenate([np.arange(len(near)), row, np.arange(len(near))])]
    at = np.concatenate([np.zeros(len(near)), at, np.ones(len(near))])
    order = np.lexsort((at, row))
    row, at = row[order], at[order]
    one = np.flatnonzero((row[1:] == row[:-1]) & (at[1:] > at[:-1]))
    spans = Spans(row[one], at[one], at[one + 1])
    middle = spans.points(segments.ends, 0.5 * (spans.start + spans.end))
    return spans.rows(solid.contains(middle))


def _crossings(segments: Segments, solid: Solid) -> tuple[Ids, Floats]:
    """Segments, and where along them, from 0 to 1, they cross the planes of faces they are near."""
    row, face = solid.tree.pairs_within(*segments.bounds())
    offset = segments.ends[row] - solid.corners[face, :1]
    first, last = np.einsum("pkc,pc->kp", offset, solid.normals[face])
    crosses = np.flatnonzero(first * last < 0.0)
    row, first, last = row[crosses], first[crosses], last[crosses]
    return row, first / (first - last)


def apart(segments: Segments, other: Side, resolution: Resolution, *, yields: bool) -> Spans:
    """Spans of segments of a surface that do not lie within another one in the same plane.

    Where both surfaces end at one line, on the same side of it, the one that `yields` has none.
    """
    margin = _margin(segments, resolution)
    row, face = other.tree.pairs_within(*segments.bounds(), margin)
    corners, normals = other.corners[face], other.normals[face]
    height = np.einsum("pkc,pc->pk", segments.ends[row] - corners[:, :1], normals)
    in_plane = (np.abs(height) <= margin[row, np.newaxis]).all(axis=1)
    in_plane &= np.einsum("pc,pc->p", segments.normals[row], normals) >= _PARALLEL
    row, corners, normals = row[in_plane], corners[in_plane], normals[in_plane]
    step = _BESIDE * margin[:, np.newaxis] * segments.inward()
    covered = _spans_on(segments.moved(step), row, corners, normals)
    if not yields:
        beyond = _spans_on(segments.moved(-step), row, corners, normals)
        covered = in_both(covered, beyond, len(segments.ends))
    return _without(segments, covered, margin)


def _spans_on(segments: Segments, row: Ids, corners: Floats, normals: Floats) -> Spans:
    """Spans of segments (p,) on triangles (p, 3, 3) in their planes."""
    part = clip(segments.ends[row], corners, normals, np.zeros(len(row)))
    return Spans(row, part.start, part.end).rows(part.start < part.end)
