"""Segments on faces, parts of them cut away."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats
from ..scene.welding import Ids


class Segments(NamedTuple):
    """Segments, the surface to their left as seen from the tip of the normal.

    Attributes
    ----------
    ends : (n, 2, 3)
        From, to, m.
    normals : (n, 3)
        Unit normals of the faces on which they lie.
    """

    ends: Floats
    normals: Floats

    def reversed(self) -> Segments:
        """The same segments, seen from the other side of the faces."""
        return Segments(self.ends[:, ::-1], -self.normals)

    def rows(self, which: NDArray) -> Segments:
        """Those of a mask or of row numbers."""
        return Segments(self.ends[which], self.normals[which])

    def parts(self, spans: Spans) -> Segments:
        """The spans of them."""
        ends = [spans.points(self.ends, at) for at in (spans.start, spans.end)]
        return Segments(np.stack(ends, axis=1), self.normals[spans.row])

    def with_parts(self, which: NDArray[np.bool_], spans: Spans) -> Segments:
        """Spans of those of a mask, after the others whole."""
        return concatenated([self.rows(~which), self.rows(which).parts(spans)])

    def inward(self) -> Floats:
        """Unit vectors (n, 3) on the faces, from the segments to the surface."""
        left = np.cross(self.normals, self.ends[:, 1] - self.ends[:, 0])
        return left / np.linalg.norm(left, axis=1, keepdims=True)

    def bounds(self) -> tuple[Floats, Floats]:
        """Least and greatest coordinates, (n, 3) both."""
        return self.ends.min(axis=1), self.ends.max(axis=1)

    def meet(self, box: tuple[Floats, Floats], margin: Floats | float = 0.0) -> NDArray[np.bool_]:
        """True for those whose bounding boxes are within margins of a box."""
        low, high = self.bounds()
        around = np.expand_dims(margin, -1)
        meets = (low <= box[1] + around) & (high >= box[0] - around)
        return np.asarray(meets.all(axis=1))

    def moved(self, by: Floats) -> Segments:
        """Segments moved by vectors (n, 3)."""
        return Segments(self.ends + by[:, np.newaxis], self.normals)


NO_SEGMENTS = Segments(np.empty((0, 2, 3)), np.empty((0, 3)))


def concatenated(parts: Iterable[Segments]) -> Segments:
    """All segments of several parts, of which there may be none."""
    ends, normals = zip(NO_SEGMENTS, *parts, strict=True)
    return Segments(np.concatenate(ends), np.concatenate(normals))


class Spans(NamedTuple):
    """Spans of segments.

    Attributes
    ----------
    row : (s,)
        The segment of each.
    start, end : (s,)
        From 0 to 1 along the segment.
    """

    row: Ids
    start: Floats
    end: Floats

    def rows(self, which: NDArray) -> Spans:
        """Those of a mask or of row numbers."""
        return Spans(self.row[which], self.start[which], self.end[which])

    def points(self, ends: Floats, at: Floats) -> Floats:
        """Points (s, 3) of the segments with these ends (n, 2, 3), from 0 to 1 along each."""
        a, b = np.moveaxis(ends[self.row], 1, 0)
        return (1.0 - at)[:, np.newaxis] * a + at[:, np.newaxis] * b


def between(spans: Spans, n: int) -> Spans:
    """Spans of n segments that are in none of the given ones."""
    every, none, one = np.arange(n), np.zeros(n), np.ones(n)
    row = np.concatenate([every, spans.row, every])
    start = np.concatenate([none - 1.0, spans.start, one])
    end = np.concatenate([none, spans.end, one])
    order = np.lexsort((start, row))
    row, start, end = row[order], start[order], end[order]
    # The greatest end so far, in each row, which lie 2 apart.
    reached = np.maximum.accumulate(end + 2.0 * row) - 2.0 * row
    gap = np.flatnonzero((row[1:] == row[:-1]) & (start[1:] > reached[:-1]))
    return Spans(row[gap], reached[gap], start[gap + 1])


def in_both(spans: Spans, others: Spans, n: int) -> Spans:
    """Spans of n segments that are in both of two sets of them."""
    outside = [between(spans, n), between(others, n)]
    row, start, end = (np.concatenate(columns) for columns in zip(*outside, strict=True))
    return between(Spans(row, start, end), n)


class Clip(NamedTuple):
    """Segments clipped to triangles.

    Attributes
    ----------
    start, end : (n,)
        Along each segment; start exceeds end where none of it is in its triangle.
    along : (n, 3)
        True where a segment lies along the line of an edge of its triangle, which does not clip it.
    inward : (n, 3, 3)
        Unit vectors from each edge into the triangle.
    """

    start: Floats
    end: Floats
    along: NDArray[np.bool_]
    inward: Floats


def clip(ends: Floats, corners: Floats, normals: Floats, tolerance: Floats) -> Clip:
    """Clip segments (n, 2, 3), as seen along the normals, to triangles (n, 3, 3) around these.

    Segments within `tolerance` (n,) of the line of an edge lie along it.
    """
    edge = np.roll(corners, -1, axis=1) - corners
    inward = np.cross(normals[:, np.newaxis], edge)
    inward /= np.linalg.norm(inward, axis=2, keepdims=True)
    depth = np.einsum("nejc,nec->jne", ends[:, np.newaxis] - corners[:, :, np.newaxis], inward)
    along = (np.abs(depth) <= tolerance[:, np.newaxis]).all(axis=0)
    first, last = np.where(along, 0.0, depth)
    change = first - last
    crossing = np.divide(first, change, out=np.zeros_like(first), where=change != 0.0)
    start = np.where((first < 0.0) & (last > 0.0), crossing, 0.0).max(axis=1)
    end = np.where((first > 0.0) & (last < 0.0), crossing, 1.0).min(axis=1)
    outside = ((first <= 0.0) & (last <= 0.0) & ~along).any(axis=1)
    return Clip(np.where(outside, 2.0, start), end, along, inward)
