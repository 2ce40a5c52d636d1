"""Searches decided at an edge: of a limit, of float32 precision, of a list."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import photonrelax as pr
from tests.helpers import simd_paths
from tests.helpers.neighbours import nearest
from tests.spatial.test_knn import assert_nearest, assert_same, lattice, moved, uniform

on_each_path = simd_paths.each("path")


def directions(rng, n, d):
    offsets = rng.normal(size=(n, d))
    return offsets / np.linalg.norm(offsets, axis=1, keepdims=True)


def nudged(x):
    """A number, its neighbours, and some that float32 hardly separates from it."""
    return [x, np.nextafter(x, 0.0), np.nextafter(x, np.inf), *(x * (1 + s) for s in NUDGES)]


NUDGES = (-1e-6, -1e-7, -1e-10, 1e-10, 1e-7, 1e-6)


# Ranges


@on_each_path
@pytest.mark.parametrize("radii", [[0.5, np.inf], [0.0, 0.5], [0.0, np.inf], [0.0, 1e-7, 50.0]])
def test_queries_with_ranges_next_to_queries_with_others(path, radii):
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.random((600, 3)), 100.0 * rng.random((600, 1))])
    points[::3] = points[0]
    radius = rng.choice(radii, 600)
    with simd_paths.forced(path):
        assert_nearest(points, 7, range_radius=radius, queries=points)
        found = pr.KDTree(points).farthest(7, range_radius=radius)
    distance = nearest(points, points, 7, range_radius=radius)[1]
    expected = np.where(np.isfinite(distance), distance, 0.0).max(axis=1)
    np.testing.assert_array_equal(found, expected)


@on_each_path
@pytest.mark.parametrize("origin", [0.0, 1e6])
@pytest.mark.parametrize("radius", nudged(5.0))
def test_points_on_the_rim_of_a_range(path, radius, origin):
    """Of 3, 4 and 5 the squares are exact."""
    rng = np.random.default_rng(2)
    points = np.hstack([rng.random((900, 3)), rng.integers(-5, 6, (900, 2)).astype(float)])
    points[::2, 3:] *= 1 + 3e-7 * rng.normal(size=(450, 2))
    points[:, 3:] += origin
    rows = rng.permutation(900)[:60]
    with simd_paths.forced(path):
        assert_nearest(points, 40, range_radius=radius, rows=rows, queries=points[rows])


# Limits


def moved_by_definition(points, k, limit):
    """Positions after a move by SJ13 Eq. 8, and squared distances to the farthest neighbours."""
    squared = ((points[:, np.newaxis] - points) ** 2).sum(axis=-1)
    positions, farthest = points.copy(), np.zeros(len(points))
    for i, row in enumerate(squared):
        ids = np.argsort(row, kind="stable")[:k]
        ids = ids[row[ids] <= limit * limit]
        farthest[i] = row[ids].max()
        if len(ids) >= 4 and farthest[i] > 0.0:
            others = ids[row[ids] > 0.0]
            weight = np.sqrt(farthest[i] / row[others]) - 1.0
            offsets = points[i] - points[others]
            positions[i] += (weight[:, np.newaxis] * offsets).sum(axis=0) / len(ids)
    return positions, farthest


@on_each_path
@pytest.mark.parametrize("limit", nudged(5.0))
@pytest.mark.parametrize("k", [50, 69, 100])
def test_neighbours_at_the_very_limit(path, k, limit):
    """81 points of a lattice are within 5, of which 12 at 5; 69 within less."""
    x, y = np.meshgrid(np.arange(20.0), np.arange(20.0))
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(400)])
    with simd_paths.forced(path):
        tree = pr.KDTree(points)
        found = moved(tree, 25.0, k, np.full(400, limit))
    ids = np.asarray(tree.kernel.ids)
    positions, squared = moved_by_definition(points, k, limit)
    np.testing.assert_array_equal(found[1], squared[ids])
    np.testing.assert_allclose(found[0], positions[ids], rtol=0, atol=1e-12)


# Floats


@st.composite
def shells(draw):
    """Points all about as far from all queries."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    d = draw(st.sampled_from([1, 2, 3, 3, 8, 12, 13]))
    n = draw(st.sampled_from([40, 400, 900]))
    spread = draw(st.sampled_from([0.0, 1e-15, 1e-10, 1e-7, 1e-6, 1e-4]))
    centre = draw(st.sampled_from([0.0, 1.0, 1e6, 1e15]))
    points = centre + directions(rng, n, d) * (1 + spread * rng.normal(size=(n, 1)))
    queries = centre + spread * rng.normal(size=(20, d))
    return points, queries, draw(st.sampled_from([1, 5, n // 2, n - 1, n]))


@on_each_path
@settings(max_examples=60, deadline=None)
@given(search=shells())
def test_points_all_about_as_far_away(path, search):
    points, queries, k = search
    with simd_paths.forced(path):
        found = pr.KDTree(points, points.shape[1]).query(queries, k, n_threads=1)
        assert_same(found, nearest(points, queries, k, points.shape[1]))


@pytest.mark.kernels_run_elsewhere
@on_each_path
@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    fineness=st.sampled_from([0.1, 1e-2, 3e-3, 1e-3, 3e-4, 1e-6, 1e-12, 1e-160]),
    k=st.sampled_from([1, 6, 20, 130]),
    kind=st.sampled_from([uniform, lattice]),
)
@example(seed=0, fineness=3e-3, k=6, kind=uniform)
def test_batches_of_which_some_look_far_and_some_near(path, seed, fineness, k, kind):
    """Floats that are fine enough for some of their queries are too coarse for others."""
    rng = np.random.default_rng(seed)
    dense = 0.4 + fineness * kind(rng, 700, 3)
    points = np.concatenate([kind(rng, 300, 3), dense])[rng.permutation(1000)]
    queries = np.concatenate([rng.random((24, 3)), dense[:24] + 0.1 * fineness])
    with simd_paths.forced(path):
        assert_nearest(points, k, rows=rng.permutation(1000)[:30], queries=queries)


@on_each_path
@pytest.mark.parametrize(("n_metric", "d"), [(12, 12), (13, 13), (3, 12), (3, 13), (11, 14)])
def test_as_many_axes_as_floats_serve_for_and_more(path, n_metric, d):
    rng = np.random.default_rng(d)
    with simd_paths.forced(path):
        for points in (
            rng.random((300, d)),
            lattice(rng, 300, d),
            np.outer(rng.random(300), np.ones(d)),
        ):
            ranges = {"range_radius": rng.choice([0.2, 0.9], 300)} if d > n_metric else {}
            assert_nearest(points, 9, n_metric, queries=points + 1e-5, **ranges)


# Lists


@pytest.mark.kernels_run_elsewhere
@on_each_path
@pytest.mark.parametrize(("k", "n"), [(1, 4000), (5, 4000), (60, 4000), (800, 2000)])
def test_what_is_left_out_of_many_candidates_stays_out(path, k, n):
    """Of k + 64 blocks the farthest are dropped, part by part; for many neighbours none is."""
    rng = np.random.default_rng(k)
    half = rng.random((n, 3))
    half[rng.random(n) < 0.5] = 0.5
    for points in (half, lattice(rng, n, 3), np.round(rng.random((n, 3)), 1)):
        with simd_paths.forced(path):
            tree = pr.KDTree(points)
            found = tree.query(points[::-1], k, exclude_self=True, n_threads=1)
        rows = np.concatenate([np.arange(40), rng.permutation(n)[:40]])
        expected = nearest(points, points[::-1][rows], k, excluded=rows)
        assert_same(pr.Neighbours(found.ids[rows], found.distance[rows]), expected)
        with simd_paths.forced(path):
            assert_nearest(points, k, rows=rows)


def test_queries_whose_squared_distances_overflow_find_nothing():
    points = np.random.default_rng(3).random((400, 3))
    queries = np.array([[1e308, 0.0, 0.0], [-1e308, 0.0, 0.0], [0.5, 0.5, 0.5]])
    found = pr.KDTree(points).query(queries, 3)
    nearest = np.argsort(np.linalg.norm(points - queries[2], axis=1))[:3]
    np.testing.assert_array_equal(found.ids[2], nearest)
    assert (found.ids[:2] == len(points)).all()
    assert np.isinf(found.distance[:2]).all()
