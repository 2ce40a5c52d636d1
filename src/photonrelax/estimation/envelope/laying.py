"""Straight triangles of the images of elements, and squares around single photons."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._util.validation import Floats
from ...spatial.kdtree import KDTree
from .borders import cut, joined
from .elements import areas, bends, luminances, shape_functions
from .refinement import Refinement

# Share of all light that straight pieces of one image may misplace by a footprint, and the limits
# of their distance from it, in footprints.
_STRAIGHT, _TOLERANCES = 1e-6, (0.002, 0.5)
# Sides of an image are divided into at most so many.
_MOST_PIECES = 16
# Points of light that the square around each is as large as.
_NEIGHBOURS = 8


class Laid(NamedTuple):
    """Triangles (n, 3, 3), m, with their normals (n, 3) and fluxes (n, 3), W.

    `misplaced` (n,) is the luminance of each that may lie a footprint away, W.
    """

    position: Floats
    normal: Floats
    flux: Floats
    misplaced: Floats


class Points(NamedTuple):
    """Positions (n, 3), m, normals (n, 3) and fluxes (n, 3), W, of light that has no image."""

    position: Floats
    normal: Floats
    flux: Floats


def laid(refinement: Refinement) -> tuple[Laid, Points]:
    """Triangles of all light of a chart, and points of that without smooth images."""
    whole = refinement.patches.is_whole
    smooth = whole & ~refinement.jumps & ~refinement.is_given_up
    torn = ~whole & ~refinement.is_given_up
    pieces = cut(refinement.lattice, refinement.leaves, refinement.patches[torn])
    # What borders misplace is told where they are.
    lost = np.zeros(len(pieces.flux)) if not torn.any() else luminances(pieces.flux)
    total = refinement.scores[torn].sum()
    if lost.sum() > 0.0:
        lost *= min(total / lost.sum(), 1.0)
    borders = Laid(pieces.position, _unit(pieces.normal), pieces.flux, lost)
    points = joined(Points, [_of_images(refinement, ~(smooth | torn)), _singles(refinement)])
    return joined(Laid, [_curved(refinement, np.flatnonzero(smooth)), borders]), points


def squares(points: Points, footprint: float) -> Laid:
    """Squares around points, each as large as that to its eighth neighbour, or a footprint."""
    n = len(points.position)
    if n == 0:
        return Laid(np.empty((0, 3, 3)), np.empty((0, 3)), np.empty((0, 3)), np.empty(0))
    side = np.full(n, footprint)
    if n > _NEIGHBOURS:
        distance = KDTree(points.position).query_self(_NEIGHBOURS).distance
        side = np.maximum(distance[:, -1] * np.sqrt(np.pi), footprint)
    u, v = 0.5 * square_edges(points.normal, side).transpose(1, 0, 2)
    at = points.position
    corners = np.stack([at - u - v, at + u - v, at + u + v, at - u + v], axis=1)
    return Laid(
        corners[:, [[0, 1, 2], [2, 3, 0]]].reshape(-1, 3, 3),
        np.repeat(points.normal, 2, axis=0),
        np.repeat(0.5 * points.flux, 2, axis=0),
        np.repeat(0.5 * luminances(points.flux), 2),
    )


def square_edges(normals: Floats, side: Floats) -> Floats:
    """Edges (n, 2, 3) of squares of sides (n,) in the tangent planes of normals of any length."""
    u = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    u *= (side / np.linalg.norm(u, axis=1))[:, np.newaxis]
    v = np.cross(normals, u) / np.linalg.norm(normals, axis=1)[:, np.newaxis]
    return np.stack([u, v], axis=1)


def _of_images(refinement: Refinement, rows: NDArray[np.bool_]) -> Points:
    """Light of images that jump or whose sheets are given up, at their nodes."""
    lattice, patches = refinement.lattice, refinement.patches[rows]
    area = areas(lattice, refinement.leaves.corners)[patches.element]
    weight = np.zeros((len(patches), 6))
    whole = patches.is_whole
    weight[whole, 3:] = 1.0 / 3.0
    weight[~whole] = 1.0 / 6.0
    image, node = np.nonzero((weight > 0.0) & (patches.arrival >= 0))
    arrival = patches.arrival[image, node]
    flux = lattice.light[arrival] * (area[image] * weight[image, node])[:, np.newaxis]
    return Points(lattice.arrivals.position[arrival], lattice.arrivals.normal[arrival], flux)


def _singles(refinement: Refinement) -> Points:
    """Single photons of the nodes that count in the quadrature over the leaves."""
    lattice, leaves = refinement.lattice, refinement.leaves
    area = np.repeat(areas(lattice, leaves.corners) / 3.0, 3)
    weight = np.bincount(leaves.nodes[:, 3:].ravel(), area, minlength=len(lattice))
    node = lattice.singles.node
    flux = lattice.singles.throughput * lattice.power[node] * weight[node, np.newaxis]
    used = weight[node] > 0.0
    return Points(lattice.singles.position[used], lattice.singles.normal[used], flux[used])


def _curved(refinement: Refinement, rows: NDArray[np.intp]) -> Laid:
    """Smooth images as straight triangles, as many as their curvature asks for."""
    lattice = refinement.lattice
    patches, score = refinement.patches[rows], refinement.scores[rows]
    position = lattice.arrivals.position[patches.arrival]
    normal = _unit(lattice.arrivals.normal[patches.arrival].sum(axis=1))
    light = lattice.light[patches.arrival]
    area = areas(lattice, refinement.leaves.corners)[patches.element]
    bend, _ = bends(position)
    flux = luminances(area[:, np.newaxis] * light[:, 3:].mean(axis=1))
    tolerance = np.clip(_STRAIGHT * refinement.luminance / flux, *_TOLERANCES)
    n = np.ceil(np.sqrt(bend / (tolerance * refinement.footprint)))
    n = np.clip(n, 1, _MOST_PIECES).astype(np.intp)
    parts = []
    for divided in np.unique(n):
        mine = np.flatnonzero(n == divided)
        corners, centres = _grid(int(divided))
        at = np.einsum("tks,psc->ptkc", corners, position[mine])
        flux = np.einsum("ts,psc->ptc", centres, light[mine])
        flux *= (area[mine] / divided**2)[:, np.newaxis, np.newaxis]
        # The sum over the parts is the quadrature over the whole.
        wanted = area[mine, np.newaxis] * light[mine, 3:].mean(axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            scale = np.where(wanted > 0.0, wanted / flux.sum(axis=1), 0.0)
        m = divided**2
        parts.append(
            Laid(
                at.reshape(-1, 3, 3),
                np.repeat(normal[mine], m, axis=0),
                (flux * scale[:, np.newaxis]).reshape(-1, 3),
                np.repeat(score[mine] / m, m),
            )
        )
    if not parts:
        return squares(Points(*np.empty((3, 0, 3))), refinement.footprint)
    return joined(Laid, parts)


def _grid(n: int) -> tuple[Floats, Floats]:
    """Weights of the six nodes at the corners (n², 3, 6) and centres (n², 6) of n² parts."""
    up = [(i, j) for i in range(n) for j in range(n - i)]
    down = [(i, j) for i in range(n - 1) for j in range(n - 1 - i)]
    triangles = [[(i, j), (i + 1, j), (i, j + 1)] for i, j in up]
    triangles += [[(i + 1, j + 1), (i, j + 1), (i + 1, j)] for i, j in down]
    at = np.array(triangles, dtype=np.float64) / n
    at = np.concatenate([1.0 - at.sum(axis=2, keepdims=True), at], axis=2)
    corners = shape_functions(at.reshape(-1, 3)).reshape(-1, 3, 6)
    return corners, shape_functions(at.mean(axis=1))


def _unit(vectors: Floats) -> Floats:
    units: Floats = vectors / np.linalg.norm(vectors, axis=1)[:, np.newaxis]
    return units
