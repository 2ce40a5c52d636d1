"""Checks of results against SciPy and against all photons; of ties any may be chosen."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

import photonrelax as pr
from bench.speed.inputs import Floats, Ids, RangedPhotons
from bench.speed.peers import KnnResult, Ordered

_SAMPLE = 2000
# Distances that differ by less than this, relatively, are ties.
_TIE = 1e-9
# Neighbours lie on faces at angles of at most 60°: the chord between their unit normals.
_MAX_NORMAL_CHORD = 1.0


def sample(n: int) -> Ids:
    """Return some rows of n, evenly spaced."""
    return np.unique(np.linspace(0, n - 1, min(n, _SAMPLE)).astype(np.intp))


def assert_nearest(
    found: KnnResult, points: Floats, queries: Floats, limit: float = np.inf
) -> None:
    """Check ids and counts of neighbours against SciPy's.

    Parameters
    ----------
    found : (ids, distance)
        Each (m, k), nearest first; an id of n or more in empty slots.
    points, queries : (n, 3) and (m, 3) float arrays
    limit : float
        Largest distance.
    """
    k = found[0].shape[1]
    distance, ids = cKDTree(points).query(queries, k + 1, distance_upper_bound=limit)
    _assert_same(found, (ids, distance), len(points))


def assert_nearest_by_peer(found: KnnResult, tree: Ordered, limit: float) -> None:
    """Check some of the neighbours that a peer found for all queries of its tree."""
    rows = sample(len(tree.queries))
    assert_nearest(tree.answers(found, rows), tree.points, tree.queries[rows], limit)


def assert_nearest_in_range(found: KnnResult, photons: RangedPhotons, k: int) -> None:
    """Check ids and counts of neighbours in range against all photons, on some of the rows."""
    n = len(photons.position)
    rows = sample(n)[::20]
    expected = np.full((len(rows), k + 1), n), np.full((len(rows), k + 1), np.inf)
    for i, row in enumerate(rows):
        apart = np.linalg.norm(photons.coords - photons.coords[row], axis=1)
        near = np.flatnonzero(apart <= photons.radius[row])
        distance = np.linalg.norm(photons.position[near] - photons.position[row], axis=1)
        best = np.argsort(distance, kind="stable")[: k + 1]
        expected[0][i, : len(best)] = near[best]
        expected[1][i, : len(best)] = distance[best]
    _assert_same((found[0][rows], found[1][rows]), expected, n)


def assert_neighbourhoods(structure: pr.Structure, photons: pr.PhotonMap, k: int) -> None:
    """Check counts and radii of structure detection against all photons, on some of the rows."""
    rows = sample(len(photons))[::20]
    first = _first_at_their_points(structure, photons)
    alone = np.unique(first)
    expected = np.array(
        [_neighbourhood(structure, photons, (row, alone), k) for row in first[rows]]
    )
    np.testing.assert_array_equal(structure.n_found[rows], expected[:, 0])
    np.testing.assert_allclose(structure.radius[rows], expected[:, 1], rtol=1e-6)


def _first_at_their_points(structure: pr.Structure, photons: pr.PhotonMap) -> Ids:
    """The first photon (n,) at the point of each, on the same face; they count as one.

    Up to cells of the emitter coordinates as large as the largest range: light that left the
    emitter elsewhere is another sheet.
    """
    cells = np.floor(photons.emitter_coords / structure.emitter_range.max())
    _, index, inverse = np.unique(
        np.column_stack([photons.position, photons.normal, cells]),
        axis=0,
        return_index=True,
        return_inverse=True,
    )
    return index[inverse.ravel()]


def _neighbourhood(
    structure: pr.Structure, photons: pr.PhotonMap, among: tuple[int, Ids], k: int
) -> tuple[int, float]:
    """Size, at most k, and radius of the neighbourhood of a photon among others."""
    row, rows = among
    apart = np.linalg.norm(photons.emitter_coords[rows] - photons.emitter_coords[row], axis=1)
    distance = np.linalg.norm(photons.position[rows] - photons.position[row], axis=1)
    near = (apart <= structure.emitter_range[row]) & (distance <= structure.reach[row])
    near &= np.linalg.norm(photons.normal[rows] - photons.normal[row], axis=1) <= _MAX_NORMAL_CHORD
    nearest = np.sort(distance[near])[:k]
    return len(nearest), nearest[-1]


def _assert_same(found: KnnResult, expected: KnnResult, n: int) -> None:
    """Compare k neighbours with k + 1; the last shows whether the k-th is tied."""
    ids, distance = found[0].astype(np.intp), found[1]
    k = ids.shape[1]
    np.testing.assert_array_equal((ids < n).sum(axis=1), (expected[0][:, :k] < n).sum(axis=1))
    filled = ids < n
    np.testing.assert_allclose(distance[filled], expected[1][:, :k][filled], rtol=1e-9, atol=1e-12)
    last, next_one = expected[1][:, k - 1], expected[1][:, k]
    untied = np.isinf(next_one) | (next_one > last * (1.0 + _TIE))
    wanted = np.minimum(np.sort(expected[0][:, :k], axis=1), n)
    np.testing.assert_array_equal(np.minimum(np.sort(ids, axis=1), n)[untied], wanted[untied])
