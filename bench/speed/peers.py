"""Searches to compare with: k-d trees of other packages, and recipes of NumPy and SciPy."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import version
from typing import Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from bench.speed.inputs import Floats, Ids, RangedPhotons, morton_order

KnnResult = tuple[Ids, Floats]
"""Ids and distances, (m, k) each, nearest first."""


class UnavailableError(Exception):
    """An alternative that cannot be measured here; the message gives the reason."""


@dataclass(frozen=True)
class Peer:
    """A tree from another package.

    Attributes
    ----------
    name : str
        Name in tables.
    package : str
        Name of its distribution.
    needs : tuple of str
        Modules to import.
    build : callable
        Tree of points.
    query : callable
        Ids and distances of neighbours, given tree, queries, k, largest distance and threads.
    """

    name: str
    package: str
    needs: tuple[str, ...]
    build: Callable[[Floats], Any]
    query: Callable[[Any, Floats, int, float, int], KnnResult]

    @property
    def version(self) -> str:
        return version(self.package)


def _scipy_build(points: Floats) -> Any:
    return cKDTree(points, leafsize=16)


def _scipy_query(tree: cKDTree, queries: Floats, k: int, limit: float, n_threads: int) -> KnnResult:
    distance, ids = tree.query(queries, k, distance_upper_bound=limit, workers=n_threads)
    return ids, distance


def _pykdtree_build(points: Floats) -> Any:
    from pykdtree.kdtree import KDTree

    return KDTree(points)


def _pykdtree_query(tree: Any, queries: Floats, k: int, limit: float, n_threads: int) -> KnnResult:
    bound = None if np.isinf(limit) else limit
    distance, ids = tree.query(queries, k, distance_upper_bound=bound)
    return ids, distance


def _numba_build(points: Floats) -> Any:
    import numba_kdtree

    # compact=True finds wrong neighbours in 0.6.0.
    return numba_kdtree.KDTree(points, leafsize=16)


def _numba_query(tree: Any, queries: Floats, k: int, limit: float, n_threads: int) -> KnnResult:
    distance, ids, _ = tree.query_parallel(queries, k, distance_upper_bound=limit)
    return ids, distance


ALL = (
    Peer("scipy", "scipy", (), _scipy_build, _scipy_query),
    Peer(
        "pykdtree",
        "pykdtree",
        ("pykdtree.kdtree", "threadpoolctl"),
        _pykdtree_build,
        _pykdtree_query,
    ),
    Peer("numba-kdtree", "numba-kdtree", ("numba_kdtree",), _numba_build, _numba_query),
)


@cache
def missing() -> dict[str, str]:
    """Return the reasons why peers cannot be measured here, by their names."""
    reasons = {}
    for peer in ALL:
        try:
            for module in peer.needs:
                import_module(module)
        except ImportError as error:
            reasons[peer.name] = f"{peer.name} is left out ({error}): pip install '.[bench]'"
    return reasons


@cache
def available() -> tuple[Peer, ...]:
    """Return the peers that are installed, compiled where that happens at the first call."""
    peers = tuple(peer for peer in ALL if peer.name not in missing())
    few = np.eye(3)
    for peer in peers:
        peer.query(peer.build(few), few, 1, np.inf, 1)
    return peers


def named(name: str) -> Peer:
    """Return the peer of a name; an UnavailableError gives the reason if there is none."""
    for peer in available():
        if peer.name == name:
            return peer
    raise UnavailableError(missing().get(name, f"there is no peer {name}"))


@contextmanager
def threads(n: int) -> Iterator[None]:
    """Limit peers whose searches have no argument for it to n threads.

    pykdtree uses OpenMP, whose library comes with its wheel; numba has a setting of its own.
    """
    # Limits hold for libraries that have been loaded.
    available()
    if "numba" in sys.modules:
        sys.modules["numba"].set_num_threads(n)
    if "threadpoolctl" not in sys.modules:
        yield
        return
    with sys.modules["threadpoolctl"].threadpool_limits(n):
        yield


class Ordered:
    """Search of a peer, with points and queries in Morton order, which suits it best.

    Parameters
    ----------
    peer : Peer
    points : (n, 3) float array
        In any order.
    queries : (m, 3) float array, optional
        In any order; the points themselves by default.
    """

    def __init__(self, peer: Peer, points: Floats, queries: Floats | None = None) -> None:
        self._peer = peer
        self._order = morton_order(points)
        ordered = np.ascontiguousarray(points[self._order])
        self._tree = peer.build(ordered)
        self._query_order = self._order if queries is None else morton_order(queries)
        self._ordered_queries = ordered if queries is None else queries[self._query_order]
        self.points, self.queries = points, points if queries is None else queries

    def search(self, k: int, n_threads: int, limit: float = np.inf) -> KnnResult:
        """Return the neighbours in Morton order, by the rows of the tree: this is timed."""
        return self._peer.query(self._tree, self._ordered_queries, k, limit, n_threads)

    def answers(self, found: KnnResult, rows: Ids) -> KnnResult:
        """Return the neighbours of some queries; ids and rows are those of the given arrays."""
        n = len(self._order)
        place = np.empty(len(self._query_order), dtype=np.intp)
        place[self._query_order] = np.arange(len(place))
        ids, distance = (array[place[rows]] for array in found)
        # Packages mark empty slots by different ids.
        none = (ids < 0) | (ids >= n)
        ids = np.append(self._order, n)[np.where(none, n, ids).astype(np.intp)]
        return ids, np.where(none, np.inf, distance)


# Photons of a block of the first recipe, and those that the second one lists together.
_BLOCK_SIZE, _LISTS_AT_ONCE = 32, 2000


def constrained_by_block(photons: RangedPhotons, k: int, n_threads: int = 1) -> KnnResult:
    """Return the exact k nearest in range, by blocks of photons that are near on the emitter.

    Each photon of a block is compared with all photons in range of the block: the fastest recipe
    known that calls NumPy and SciPy alone.
    """
    tree = cKDTree(photons.coords)
    order = morton_order(photons.coords)
    ids = np.empty((len(order), k), dtype=np.intp)
    distance = np.empty((len(order), k))

    def work(rows: Ids) -> None:
        ids[rows], distance[rows] = _block(photons, tree, rows, k)

    blocks = [order[first : first + _BLOCK_SIZE] for first in range(0, len(order), _BLOCK_SIZE)]
    with ThreadPoolExecutor(n_threads) as pool:
        for _ in pool.map(work, blocks):
            pass
    return ids, distance


def _block(photons: RangedPhotons, tree: cKDTree, rows: Ids, k: int) -> KnnResult:
    coords = photons.coords[rows]
    centre = 0.5 * (coords.min(axis=0) + coords.max(axis=0))
    apart = np.linalg.norm(coords - centre, axis=1)
    reach = (apart + photons.radius[rows]).max() * (1.0 + 1e-9)
    near = np.array(tree.query_ball_point(centre, reach))
    squared = cdist(photons.position[rows], photons.position[near], "sqeuclidean")
    out = cdist(coords, photons.coords[near], "sqeuclidean") > photons.radius[rows, np.newaxis] ** 2
    squared[out] = np.inf
    return _nearest(np.broadcast_to(near, squared.shape), squared, k, len(photons.position))


def constrained_by_ball(photons: RangedPhotons, k: int, n_threads: int = 1) -> KnnResult:
    """Return the exact k nearest in range, from a list of the photons in range of each: the
    obvious recipe.
    """
    tree = cKDTree(photons.coords)
    order = morton_order(photons.coords)
    ids = np.empty((len(order), k), dtype=np.intp)
    distance = np.empty((len(order), k))
    for first in range(0, len(order), _LISTS_AT_ONCE):
        rows = order[first : first + _LISTS_AT_ONCE]
        lists = tree.query_ball_point(
            photons.coords[rows], photons.radius[rows], workers=n_threads, return_sorted=False
        )
        ids[rows], distance[rows] = _nearest_listed(photons.position, rows, lists, k)
    return ids, distance


def _nearest_listed(position: Floats, rows: Ids, lists: Any, k: int) -> KnnResult:
    counts = np.fromiter(map(len, lists), np.intp, len(lists))
    near = np.concatenate(lists).astype(np.intp, copy=False)
    row = np.repeat(np.arange(len(rows)), counts)
    column = np.arange(len(near)) - np.repeat(np.cumsum(counts) - counts, counts)
    offset = position[near] - position[rows[row]]
    table = np.full((len(rows), max(counts.max(), k)), len(position), dtype=np.intp)
    squared = np.full(table.shape, np.inf)
    table[row, column] = near
    squared[row, column] = np.einsum("ij,ij->i", offset, offset)
    return _nearest(table, squared, k, len(position))


def _nearest(near: Ids, squared: Floats, k: int, n: int) -> KnnResult:
    """Return ids and distances of the k least of each row, nearest first; n in empty slots."""
    ids = np.full((len(near), k), n, dtype=np.intp)
    distance = np.full((len(near), k), np.inf)
    k = min(k, near.shape[1])
    best = np.argpartition(squared, k - 1, axis=1)[:, :k]
    smallest = np.take_along_axis(squared, best, axis=1)
    order = np.argsort(smallest, axis=1)
    distance[:, :k] = np.sqrt(np.take_along_axis(smallest, order, axis=1))
    ids[:, :k] = np.take_along_axis(near, np.take_along_axis(best, order, axis=1), axis=1)
    ids[np.isinf(distance)] = n
    return ids, distance


RECIPES = {"block recipe": constrained_by_block, "ball recipe": constrained_by_ball}
