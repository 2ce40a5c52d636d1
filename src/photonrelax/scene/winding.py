"""Surfaces of dielectrics: open edges, and windings of connected parts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats
from .meshes import in_unit_cube
from .welding import HalfEdges, Ids, components, weld

if TYPE_CHECKING:
    import trimesh

# Rounding error of a part's volume over the sum of the volumes its faces span.
_ROUNDING = 1e-12


class EdgeDefects(NamedTuple):
    """Numbers of edges at which a surface is not closed.

    Attributes
    ----------
    open : int
        Edges of an odd number of faces: borders of holes.
    inconsistent : int
        Other edges along which faces do not run equally often in both directions.
    """

    open: int
    inconsistent: int


@dataclass(frozen=True)
class _Parts:
    """Connected parts of a mesh: `of_face` (f,) numbers them; `closed` and `volume` are (parts,).

    Volumes are negative where faces wind inwards, and 0 where that is not known for rounding.
    """

    of_face: Ids
    closed: NDArray[np.bool_]
    volume: Floats


def check_surface(mesh: trimesh.Trimesh) -> EdgeDefects:
    """Count the edges at which the surface of a dielectric is open or inconsistently wound.

    Vertices at one position count as one: meshes with vertex normals often split them.

    Raises
    ------
    ValueError
        If a closed part of the surface winds inwards and does not lie in another part, as the inner
        wall of a hollow body does.
    """
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    triangles = vertices[faces]
    half_edges = HalfEdges(faces)
    if _unbalanced(half_edges).any():
        half_edges = HalfEdges(weld(in_unit_cube(vertices), faces)[faces])
    unbalanced = _unbalanced(half_edges)
    _check_parts(triangles, _parts(triangles, half_edges, unbalanced))
    n_faces = np.bincount(half_edges.edge)
    return EdgeDefects(
        open=int(np.count_nonzero(n_faces % 2)),
        inconsistent=int(np.count_nonzero((n_faces % 2 == 0) & unbalanced)),
    )


def closed_faces(triangles: Floats, half_edges: HalfEdges) -> tuple[NDArray, NDArray]:
    """Masks (f,) of the faces of closed parts, and of those among them that wind inwards.

    Walls of hollows, which wind inwards and lie in another part, are not among the latter.
    """
    parts = _parts(triangles, half_edges, _unbalanced(half_edges))
    inward = np.flatnonzero(parts.closed & (parts.volume < 0.0))
    wrong = inward[~_nested(triangles, parts, inward)] if len(inward) else inward
    return parts.closed[parts.of_face], np.isin(parts.of_face, wrong)


def _unbalanced(half_edges: HalfEdges) -> NDArray[np.bool_]:
    """Mask of the edges along which faces do not run equally often in both directions."""
    direction = np.where(half_edges.forward, 1.0, -1.0)
    return np.bincount(half_edges.edge, direction) != 0.0


def _parts(triangles: Floats, half_edges: HalfEdges, unbalanced: NDArray[np.bool_]) -> _Parts:
    face = half_edges.ids // 3
    chained = np.flatnonzero(half_edges.edge[1:] == half_edges.edge[:-1])
    of_face = components(len(triangles), face[chained], face[chained + 1])
    n_parts = of_face.max() + 1
    closed = np.ones(n_parts, dtype=bool)
    closed[of_face[face[unbalanced[half_edges.edge]]]] = False
    # Relative to a corner of the part, so that its distance costs no digits.
    corner = np.empty((n_parts, 3))
    corner[of_face] = triangles[:, 0]
    a, b, c = np.moveaxis(triangles - corner[of_face][:, None], 1, 0)
    spanned = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
    volume = np.bincount(of_face, spanned)
    sure = np.abs(volume) > _ROUNDING * np.bincount(of_face, np.abs(spanned))
    return _Parts(of_face, closed, np.where(sure, volume, 0.0))


def _check_parts(triangles: Floats, parts: _Parts) -> None:
    inward = np.flatnonzero(parts.closed & (parts.volume < 0.0))
    if len(inward) == 0:
        return
    wrong = inward[~_nested(triangles, parts, inward)]
    if len(wrong) == 0:
        return
    volume = f"(volume {parts.volume[wrong].sum():.3g})"
    if len(wrong) == len(parts.closed):
        raise ValueError(
            "mesh of a Dielectric should wind outwards, but its faces wind inwards "
            f"{volume}: turn them with mesh.invert()"
        )
    n_faces = np.count_nonzero(np.isin(parts.of_face, wrong))
    raise ValueError(
        f"mesh of a Dielectric should wind outwards, but {len(wrong)} of its {len(parts.closed)} "
        f"connected parts, of {n_faces} faces from face {np.argmax(np.isin(parts.of_face, wrong))} "
        f"on, wind inwards {volume} and lie in no other part: turn them with "
        "trimesh.repair.fix_inversion(mesh, multibody=True)"
    )


def _nested(triangles: Floats, parts: _Parts, inward: Ids) -> NDArray[np.bool_]:
    """Mask of the inward parts around a point of which other closed parts wind outwards.

    Winding numbers: a line from the point leaves the other parts more often than it enters them.
    """
    order = np.argsort(parts.of_face, kind="stable")
    first = np.searchsorted(parts.of_face, np.arange(len(parts.closed) + 1), sorter=order)
    turned = triangles[order] @ generic_rotation()
    # By axis, so that comparisons run along rows.
    low, high = (np.ascontiguousarray(f(turned[..., :2], axis=1).T) for f in (np.min, np.max))
    part_low = np.minimum.reduceat(low, first[:-1], axis=1)
    part_high = np.maximum.reduceat(high, first[:-1], axis=1)
    nested = np.empty(len(inward), dtype=bool)
    for i, part in enumerate(inward):
        point = turned[first[part]].mean(axis=0)
        around = parts.closed & _contain(part_low, part_high, point)
        around[part] = False
        number = 0
        for other in np.flatnonzero(around):
            faces = slice(first[other], first[other + 1])
            met = _contain(low[:, faces], high[:, faces], point)
            number += int(signed_crossings(point, turned[faces][met]).sum())
        nested[i] = number > 0
    return nested


def _contain(low: Floats, high: Floats, point: Floats) -> NDArray[np.bool_]:
    """Mask (n,) of the rectangles, bounds (2, n), that a point lies in as seen from above."""
    x, y = point[:2]
    inside: NDArray[np.bool_] = (low[0] <= x) & (x <= high[0]) & (low[1] <= y) & (y <= high[1])
    return inside


def signed_crossings(points: Floats, triangles: Floats) -> NDArray[np.int64]:
    """Crossings (n,) of triangles (n, 3, 3) by rays along the third axis from points (n, 3).

    1 through a triangle that faces along the ray, -1 through one that faces against it, 0 past it:
    their sum over the triangles of a closed surface is its winding number around a point. One point
    (3,) serves all triangles.
    """
    a, b, c = np.moveaxis(triangles - points[..., np.newaxis, :], 1, 0)
    # Twice the areas that the point and each edge span, seen along the ray.
    areas = np.stack([p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0] for p, q in ((b, c), (c, a), (a, b))])
    total = areas.sum(axis=0)
    inside = (areas > 0.0).all(axis=0) | (areas < 0.0).all(axis=0)
    height = (areas * np.stack([a[:, 2], b[:, 2], c[:, 2]])).sum(axis=0) * np.sign(total)
    return (np.sign(total) * (inside & (height > 0.0))).astype(np.int64)


def generic_rotation() -> Floats:
    """Rotation (3, 3) that lines no edges of usual models up with an axis."""
    return np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
