"""Transparent objects nearer to themselves or to opaque surfaces than rays resolve.

Of two faces in one place a ray hits either, so light would be stored below glass that it has not
left, fall through what the glass stands on, or count as being in glass that it has left for other.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats
from ..scene.meshes import (
    corners_by_axis,
    cross,
    dot,
    face_bounds,
    face_normals,
    squared,
    vertices_of,
)
from ..scene.resolution import ROUNDING, Resolution

# Width of the gap over what rays resolve.
_GAP = 2.0
# Thickness, over the displacement of faces, below which rays may enter beyond the other side.
_MIN_THICKNESS = 2.0
# Normals of faces at one vertex that differ by less are those of one plane.
_SAME_NORMAL = 1e-6
# Planes nearer than this share of the gap are one.
_SAME_PLANE = 1e-3


def open_contacts(
    vertices: Floats, faces: NDArray, transparent: NDArray[np.bool_], resolution: Resolution
) -> None:
    """Move faces of transparent objects off opaque faces in the same plane, into their object.

    Parameters
    ----------
    vertices : (v, 3)
        m; changed in place.
    faces : (f, 3)
        Of all objects, without common vertices.
    transparent : (f,) bool
        True for faces of transparent objects, which wind outwards.
    resolution : Resolution
        Faces nearer than the gap count as in the same plane.
    """
    candidates = _overlapping(vertices, faces, transparent, resolution)
    inner, outer = faces[candidates & transparent], faces[candidates & ~transparent]
    if not (len(inner) and len(outer)):
        return
    gap, normals = _gap(vertices, inner, resolution), face_normals(vertices[inner])
    touching = _in_planes(vertices, inner, outer, gap) | _in_planes(
        vertices, inner, outer[:, ::-1], gap
    )
    if touching.any():
        movable = np.unique(faces[transparent])
        _move(vertices, movable, inner[touching], -gap[touching] * normals[touching])


def overlap_contacts(
    vertices: Floats,
    faces: NDArray,
    object_id: NDArray[np.int32],
    priority: NDArray[np.int64],
    resolution: Resolution,
) -> None:
    """Move faces of transparent objects off those of others in the same plane.

    Of two such objects the smaller one is moved: into the other where they touch from outside, so
    that rays enter it before they leave the other; off the surface of the other where it lies
    inside, so that rays enter it after the other, or through that surface if it has the larger
    priority, so that the other ends where it begins.

    Parameters
    ----------
    vertices : (v, 3)
        m; changed in place.
    faces, object_id : (f, 3), (f,)
        Of transparent objects, which wind outwards, without common vertices; ids ascend.
    priority : (n_objects,)
        Of all objects.
    resolution : Resolution
        Faces nearer than the gap count as in the same plane.
    """
    ids, first = np.unique(object_id, return_index=True)
    if len(ids) < 2:
        return
    low, high = face_bounds(vertices, faces)
    low_corner, high_corner = np.minimum.reduceat(low, first), np.maximum.reduceat(high, first)
    margin = _GAP * resolution.at(np.concatenate([low_corner, high_corner])).max()
    last = np.append(first[1:], len(faces))
    volume = np.prod(high_corner - low_corner, axis=1)
    for pair in _meeting_boxes(low_corner - margin, high_corner):
        inner, outer = sorted(pair, key=lambda i: volume[i])
        mine, others = (
            rows[_meet(low[rows], high[rows], low_corner[box] - margin, high_corner[box] + margin)]
            for rows, box in (
                (np.arange(first[inner], last[inner]), outer),
                (np.arange(first[outer], last[outer]), inner),
            )
        )
        if len(mine) and len(others):
            movable = np.unique(faces[first[inner] : last[inner]])
            pair_faces = _PairFaces(movable, faces[mine], faces[others])
            rules = bool(priority[ids[inner]] > priority[ids[outer]])
            _shift_contacts(vertices, pair_faces, resolution, inner_rules=rules)


class _PairFaces(NamedTuple):
    # Faces of two objects, and the vertices of the inner one.
    movable: NDArray
    inner: NDArray
    outer: NDArray


def _shift_contacts(
    vertices: Floats, pair: _PairFaces, resolution: Resolution, *, inner_rules: bool
) -> None:
    """Move inner faces in the plane of an outer one.

    They are moved outwards if they face each other, or if the inner object rules; else inwards.
    """
    movable, inner, outer = pair
    gap, normals = _gap(vertices, inner, resolution), face_normals(vertices[inner])
    facing = _in_planes(vertices, inner, outer[:, ::-1], gap)
    flush = _in_planes(vertices, inner, outer, gap) & ~facing
    moved = facing | flush
    if moved.any():
        sign = np.where(facing | inner_rules, 1.0, -1.0)[:, np.newaxis]
        _move(vertices, movable, inner[moved], (sign * gap * normals)[moved])


def _meeting_boxes(low: Floats, high: Floats) -> Iterator[tuple[int, int]]:
    """Yield the pairs of boxes (n, 3) that meet."""
    for i in range(len(low) - 1):
        for j in i + 1 + np.flatnonzero(_meet(low[i + 1 :], high[i + 1 :], low[i], high[i])):
            yield i, int(j)


def _meet(low: Floats, high: Floats, low_corner: Floats, high_corner: Floats) -> NDArray[np.bool_]:
    """True for boxes (n, 3) that meet a box."""
    meets: NDArray[np.bool_] = np.all((low <= high_corner) & (high >= low_corner), axis=1)
    return meets


def _gap(vertices: Floats, faces: NDArray, resolution: Resolution) -> Floats:
    """Gaps (f, 1) that faces are to have, m."""
    return _GAP * resolution.at(vertices[faces]).max(axis=1, keepdims=True)


def _in_planes(vertices: Floats, inner: NDArray, outer: NDArray, gap: Floats) -> NDArray[np.bool_]:
    """True for inner faces nearer than their gaps to the planes of outer ones that face alike."""
    from scipy.spatial import cKDTree

    size = float(np.ptp(vertices[inner], axis=(0, 1)).max())
    origin = vertices[inner[0, 0]]
    own, planes = (
        _planes(face_normals(corners), corners - origin, size)
        for corners in (vertices[inner], vertices[outer])
    )
    # Faces of one plane, of which there may be very many, are one point of the tree.
    cells = np.round(planes / (_SAME_PLANE * gap.min()))
    _, first = np.unique(cells, axis=0, return_index=True)
    reach = np.nextafter(gap.max(), np.inf)
    distance, _ = cKDTree(planes[first]).query(own, 1, distance_upper_bound=reach)
    within: NDArray[np.bool_] = distance < gap[:, 0]
    return within


def _overlapping(
    vertices: Floats, faces: NDArray, transparent: NDArray[np.bool_], resolution: Resolution
) -> NDArray[np.bool_]:
    """True for faces in the bounding box of those of the other kind."""
    inside = np.zeros(len(faces), dtype=bool)
    if transparent.all() or not transparent.any():
        return inside
    for kind in sorted((transparent, ~transparent), key=np.count_nonzero):
        others = vertices[vertices_of(faces[~kind], len(vertices))]
        low, high = others.min(axis=0), others.max(axis=0)
        margin = _GAP * resolution.at(np.array([low, high])).max()
        inside[kind] = _meet(*face_bounds(vertices, faces[kind]), low - margin, high + margin)
        if not inside[kind].any():
            break
    return inside


def _planes(normals: Floats, corners: Floats, size: float) -> Floats:
    """Planes (n, 4) whose distance is about that between them over a length `size`, m."""
    height = np.einsum("ni,nci->nc", normals, corners).mean(axis=1)
    return np.column_stack([size * normals, height])


def _move(vertices: Floats, movable: NDArray, faces: NDArray, offsets: Floats) -> None:
    """Move what meets faces by the offsets (n, 3) of their planes; `movable` are vertices.

    Vertices at one position move together, so that closed meshes stay closed.
    """
    _, of_movable = np.unique(vertices[movable], axis=0, return_inverse=True)
    position = np.zeros(len(vertices), dtype=np.intp)
    position[movable] = of_movable
    corner, offset = position[faces].ravel(), np.repeat(offsets, 3, axis=0)
    direction = np.round(offset / np.linalg.norm(offset, axis=1, keepdims=True) / _SAME_NORMAL)
    _, first = np.unique(np.column_stack([corner, direction]), axis=0, return_index=True)
    shift = np.zeros((of_movable.max() + 1, 3))
    np.add.at(shift, corner[first], offset[first])
    vertices[movable] += shift[of_movable]


def warn_of_thin_objects(
    vertices: Floats,
    faces: NDArray,
    object_id: NDArray[np.int32],
    labels: Sequence[str],
    resolution: Resolution,
) -> None:
    """Warn of transparent objects that are thinner than rays resolve.

    Parameters
    ----------
    vertices : (v, 3)
        m.
    faces, object_id : (f, 3), (f,)
        Of transparent objects; ids ascend.
    labels : sequence of str
        Of all objects, for the message.
    resolution : Resolution
        Distance that rays resolve.
    """
    first = np.flatnonzero(np.diff(object_id, prepend=-1))
    n_faces = np.diff(first, append=len(object_id))
    ids, of_face = object_id[first], np.repeat(np.arange(len(first)), n_faces)
    a, b, c = corners_by_axis(vertices, faces)
    normal = cross(b - a, c - a)
    height = dot(a - a[:, first][:, of_face], normal)
    volume = np.abs(np.bincount(of_face, height)) / 6.0
    area = np.bincount(of_face, np.sqrt(squared(normal))) / 2.0
    # Of a plate; open sheets have no volume, and none of a thickness of their own.
    thickness = 2.0 * volume / area
    distance = np.abs(vertices - resolution.origin).max(axis=1)
    reach = np.maximum.reduce([distance[faces[:, i]] for i in range(3)])
    least = _MIN_THICKNESS * ROUNDING * np.maximum.reduceat(reach, first)
    for i in np.flatnonzero((thickness < least) & (volume > area**1.5 * np.finfo(float).eps)):
        warnings.warn(
            f"{labels[ids[i]]} is about {thickness[i]:.2g} m thick, but rays in this "
            f"scene resolve {least[i]:.2g} m there: light may leak through it. Make it thicker, or "
            "the scene smaller.",
            stacklevel=4,
        )
