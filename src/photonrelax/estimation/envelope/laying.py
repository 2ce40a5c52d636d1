"""Straight triangles of the images of elements, and squares around single photons."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._ext.estimation.envelope_pieces import MOST, pieces
from ..._util.validation import Floats
from ...transport.splitting import Signatures
from .borders import cut, joined
from .elements import areas, luminances, sags, six_places
from .refinement import Refinement
from .sheets import Points, spacings

# Largest mean distance of a straight piece from its image, in footprints.
_FARTHEST = 1.0 / 3.0
# Share of the light that may be misplaced that images may misplace; the rest is of their chords.
OF_IMAGES = 0.6


class Laid(NamedTuple):
    """Straight triangles of light.

    Attributes
    ----------
    position : (n, 3, 3) float64
        Corners, m.
    normal, flux : (n, 3) float64
        Unit normals, and W.
    place : (n, 3, 2) float32
        Corners in the unit square of the chart.
    sheet : (n,) uint64
    misplaced : (n,) float64
        Luminance of each that may lie a footprint away, W.
    """

    position: Floats
    normal: Floats
    flux: Floats
    place: NDArray[np.float32]
    sheet: Signatures
    misplaced: Floats


def laid(refinement: Refinement, n_rays: float, n_threads: int) -> tuple[list[Laid], Points]:
    """Triangles of all light of a chart, in parts, and points of that without smooth images.

    Borders are cut by at most so many rays.
    """
    whole = refinement.patches.is_whole
    smooth = whole & ~refinement.measures.jumps
    pieces = cut(refinement.lattice, refinement.leaves, refinement.patches[~whole], n_rays)
    # What borders misplace is told where they are.
    lost = luminances(pieces.flux)
    if lost.sum() > 0.0:
        lost *= min(refinement.measures.score[~whole].sum() / lost.sum(), 1.0)
    borders = Laid(
        pieces.position,
        _unit(pieces.normal),
        pieces.flux,
        pieces.place.astype(np.float32),
        pieces.sheet,
        lost,
    )
    return (
        [_curved(refinement, np.flatnonzero(smooth), n_threads), borders],
        joined(
            Points,
            [_of_images(refinement, whole & refinement.measures.jumps), refinement.missed_points],
        ),
    )


def squares(points: Points, footprint: float) -> Laid:
    """Squares around points, of a footprint at least."""
    side = np.maximum(points.side, footprint)
    u, v = 0.5 * square_edges(points.normal, side).transpose(1, 0, 2)
    at = points.position
    corners = np.stack([at - u - v, at + u - v, at + u + v, at - u + v], axis=1)
    return Laid(
        corners[:, [[0, 1, 2], [2, 3, 0]]].reshape(-1, 3, 3),
        np.repeat(points.normal, 2, axis=0),
        np.repeat(0.5 * points.flux, 2, axis=0),
        np.repeat(points.place, 6, axis=0).reshape(-1, 3, 2).astype(np.float32),
        np.repeat(points.sheet, 2),
        np.repeat(0.5 * luminances(points.flux), 2),
    )


def square_edges(normals: Floats, side: Floats) -> Floats:
    """Edges (n, 2, 3) of squares of sides (n,) in the tangent planes of normals of any length."""
    u = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    u *= (side / np.linalg.norm(u, axis=1))[:, np.newaxis]
    v = np.cross(normals, u) / np.linalg.norm(normals, axis=1)[:, np.newaxis]
    return np.stack([u, v], axis=1)


def _of_images(refinement: Refinement, rows: NDArray[np.bool_]) -> Points:
    """Light of images at the nodes in the middle of their sides."""
    lattice, patches = refinement.lattice, refinement.patches[rows]
    area = np.repeat(areas(lattice, refinement.leaves.corners)[patches.element] / 3.0, 3)
    arrival = patches.arrival[:, 3:].ravel()
    place = six_places(refinement.leaves.corners[patches.element])[:, 3:].reshape(-1, 2)
    position = lattice.arrivals.position[arrival]
    return Points(
        position,
        lattice.arrivals.normal[arrival],
        lattice.light[arrival] * area[:, np.newaxis],
        lattice.in_unit(place),
        np.repeat(patches.sheet, 3),
        spacings(position),
    )


def _curved(refinement: Refinement, rows: NDArray[np.intp], n_threads: int) -> Laid:
    """Smooth images as straight triangles, as many as their curvature asks for."""
    patches = refinement.patches[rows]
    area = areas(refinement.lattice, refinement.leaves.corners)[patches.element]
    images = _Images(
        refinement.lattice.arrivals.position[patches.arrival],
        _unit(refinement.lattice.arrivals.normal[patches.arrival].sum(axis=1)),
        refinement.lattice.light[patches.arrival] * area[:, np.newaxis, np.newaxis],
        refinement.lattice.in_unit(six_places(refinement.leaves.corners[patches.element])),
        patches.sheet,
        refinement.measures.score[rows],
    )
    n, of_chords = _divisions(images, refinement.score, refinement.footprint)
    images = images._replace(score=images.score + of_chords)
    return _divided(images, n, n_threads)


class _Images(NamedTuple):
    """Smooth images of elements.

    Attributes
    ----------
    position, light : (n, 6, 3)
        Of the nodes, m, and W if all light were as there.
    normal : (n, 3)
    place : (n, 6, 2)
    sheet, score : (n,)
    """

    position: Floats
    normal: Floats
    light: Floats
    place: Floats
    sheet: Signatures
    score: Floats


def _divisions(
    images: _Images, misplaced: float, footprint: float
) -> tuple[NDArray[np.intp], Floats]:
    """Parts (n,) of the sides of images, and luminance (n,) that their chords misplace, W.

    Images misplace `misplaced`, and chords as much more as leaves these their share of all.

    Pieces are fewest, for Σ flux · distance given, at distances as (√bend / flux)^(2/3).
    """
    # The mean distance over an image is at most that of the middles of its sides, of 4 y z = 1/3.
    bend = sags(images.position).mean(axis=1)
    flux = np.maximum(luminances(images.light[:, 3:].mean(axis=1)), 1e-300)
    weight = np.cbrt(bend) * flux ** (-2.0 / 3.0)
    of_all = max(float(flux @ weight), 1e-300)
    most = (1.0 / OF_IMAGES - 1.0) * misplaced
    distance = footprint * np.minimum(weight * (most / of_all), _FARTHEST)
    n = np.ceil(np.sqrt(bend / np.maximum(distance, 1e-300)))
    n = np.clip(n, 1, MOST)
    return n.astype(np.intp), flux * np.minimum(bend / (n**2 * footprint), 1.0)


def _divided(images: _Images, n: NDArray[np.intp], n_threads: int) -> Laid:
    """Images, each in n² straight triangles."""
    ends = np.cumsum(n**2)
    n_pieces = int(ends[-1]) if len(n) else 0
    found = Laid(
        np.empty((n_pieces, 3, 3)),
        np.repeat(images.normal, n**2, axis=0),
        np.empty((n_pieces, 3)),
        np.empty((n_pieces, 3, 2), np.float32),
        np.repeat(images.sheet, n**2),
        np.repeat(images.score / n**2, n**2),
    )
    pieces(
        *(images.position, images.light, images.place, n, ends - n**2),
        corners=found.position,
        flux=found.flux,
        places=found.place,
        n_threads=n_threads,
    )
    return found


def _unit(vectors: Floats) -> Floats:
    units: Floats = vectors / np.linalg.norm(vectors, axis=1)[:, np.newaxis]
    return units
