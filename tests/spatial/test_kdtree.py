"""The tree gives exactly what a brute-force search gives: ids, counts and distances."""

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import photonrelax as pr
from tests.helpers.neighbours import nearest


def assert_exact(points, queries, k, n_metric=3, **ranges):
    """Compare a query with brute force, bit for bit."""
    found = pr.KDTree(points, n_metric).query(queries, k, **ranges)
    ids, distance = nearest(points, queries, k, n_metric, **ranges)
    np.testing.assert_array_equal(found.ids, ids)
    np.testing.assert_array_equal(found.distance, distance)


def clouds(rng, d):
    """Point sets that have broken trees."""
    uniform = rng.random((700, d))
    yield uniform
    yield np.column_stack([np.sin(3 * uniform[:, :2]), uniform])[:, :d]  # a folded sheet
    yield uniform[rng.integers(0, 40, 700)]  # duplicates
    yield np.stack(np.meshgrid(*[np.arange(3.0)] * d, indexing="ij"), -1).reshape(-1, d)  # ties
    yield np.outer(rng.random(500), np.ones(d))  # collinear
    yield uniform + 1e6
    yield uniform**9  # clusters
    yield uniform[:5]
    yield uniform[:1]


RANGES = {
    "none": lambda rng, m, axes: {},
    "half_range scalar": lambda rng, m, axes: {"half_range": 0.3},
    "half_range per axis": lambda rng, m, axes: {"half_range": 0.5 * rng.random(axes) + 0.1},
    "half_range per query": lambda rng, m, axes: {"half_range": rng.random((m, axes))},
    "range_radius scalar": lambda rng, m, axes: {"range_radius": 0.3},
    "range_radius per query": lambda rng, m, axes: {"range_radius": rng.random(m)},
    "both": lambda rng, m, axes: {"range_radius": 0.6, "half_range": 0.5},
}


CASES = [(3, "none"), *((d, form) for d in (4, 5, 6) for form in RANGES)]


@pytest.mark.parametrize(("d", "form"), CASES)
def test_ids_and_distances_equal_brute_force(d, form):
    rng = np.random.default_rng(d)
    for points in clouds(rng, d):
        near = points[:20] + 0.1 * rng.normal(size=points[:20].shape)
        queries = np.concatenate([points[:20], near])
        for k in (1, 2, 15, 50, 64):
            assert_exact(points, queries, k, **RANGES[form](rng, len(queries), d - 3))


@pytest.mark.parametrize("n_metric", [1, 2, 4])
def test_any_number_of_metric_axes(n_metric):
    points = np.random.default_rng(1).random((400, 5))
    assert_exact(points, points, 7, n_metric, half_range=0.4)


coordinates = st.floats(-2, 2, width=16) | st.sampled_from([0.0, 1.0, 1e6, -1e6])


@settings(max_examples=150, deadline=None)
@given(data=st.data(), d=st.integers(3, 6), n=st.integers(1, 90), k=st.integers(1, 64))
def test_hypothesis_made_points(data, d, n, k):
    points = data.draw(hnp.arrays(np.float64, (n, d), elements=coordinates))
    queries = data.draw(hnp.arrays(np.float64, (3, d), elements=coordinates))
    ranges = {}
    if d > 3:
        ranges["half_range"] = data.draw(st.none() | st.floats(0, 3))
        ranges["range_radius"] = data.draw(st.none() | st.floats(0, 3))
    assert_exact(points, queries, k, **ranges)


@pytest.mark.parametrize("exclude_self", [False, True])
def test_query_self_may_leave_the_point_itself_out(exclude_self):
    points = np.random.default_rng(2).integers(0, 6, (500, 5)).astype(float)
    found = pr.KDTree(points).query_self(20, range_radius=1.5, exclude_self=exclude_self)
    excluded = np.arange(500) if exclude_self else None
    ids, distance = nearest(points, points, 20, range_radius=1.5, excluded=excluded)
    np.testing.assert_array_equal(found.ids, ids)
    np.testing.assert_array_equal(found.distance, distance)


def test_bounds_of_a_range_belong_to_it():
    points = np.array([[0, 0, 0, 0.0], [0, 0, 0, 0.25], [0, 0, 0, 0.5]])
    for ranges in ({"half_range": 0.25}, {"range_radius": 0.25}):
        found = pr.KDTree(points).query(points[:1], 3, **ranges)
        np.testing.assert_array_equal(found.ids, [[0, 1, 3]])
        np.testing.assert_array_equal(found.distance, [[0.0, 0.0, np.inf]])


def test_many_coincident_points_do_not_make_the_search_quadratic():
    n = 300_000
    found = pr.KDTree(np.ones((n, 3))).query_self(8)
    np.testing.assert_array_equal(found.ids, np.broadcast_to(np.arange(8), (n, 8)))


def test_same_result_for_every_number_of_threads():
    points = np.random.default_rng(3).random((30_000, 5)) ** 2
    results = [
        pr.KDTree(points, n_threads=t).query_self(12, range_radius=0.2, n_threads=t)
        for t in (1, 2, 7)
    ]
    for result in results[1:]:
        assert result.ids.tobytes() == results[0].ids.tobytes()
        assert result.distance.tobytes() == results[0].distance.tobytes()


def test_an_empty_tree_has_only_empty_slots():
    found = pr.KDTree(np.empty((0, 3))).query(np.zeros((2, 3)), 4)
    np.testing.assert_array_equal(found.ids, np.zeros((2, 4)))
    assert np.isinf(found.distance).all()
    assert pr.KDTree(np.ones((3, 3))).query(np.empty((0, 3)), 4).ids.shape == (0, 4)


def test_the_tree_keeps_its_own_copy():
    points = np.random.default_rng(4).random((100, 3))
    tree = pr.KDTree(points)
    before = tree.query_self(5).ids
    points[:] = 0.0
    np.testing.assert_array_equal(tree.query_self(5).ids, before)


@pytest.mark.parametrize(
    ("points", "n_metric", "error", "message"),
    [
        (np.zeros(3), 3, ValueError, r"points should have shape \(n, n\), but has \(3,\)"),
        (np.zeros((4, 2)), 3, ValueError, "at least n_metric = 3 axes, but have 2"),
        (np.full((4, 3), np.nan), 3, ValueError, "points should be finite"),
        (np.array([[0, 0, 0], [1e200, 0, 0]]), 3, ValueError, "span at most"),
        (np.zeros((4, 3)), 0, ValueError, "n_metric should be at least 1"),
        (np.array([["a"] * 3]), 3, TypeError, "points should be an array of real numbers"),
    ],
)
def test_bad_points_are_refused(points, n_metric, error, message):
    with pytest.raises(error, match=message):
        pr.KDTree(points, n_metric)


@pytest.mark.parametrize(
    ("queries", "k", "options", "error", "message"),
    [
        (np.zeros((2, 3)), 0, {}, ValueError, "k should be at least 1"),
        (np.zeros((2, 3)), 2.5, {}, TypeError, "k should be an integer"),
        (np.zeros((2, 2)), 2, {}, ValueError, "tree's 5 axes, but have 2"),
        (np.zeros((2, 3)), 2, {"half_range": 1.0}, ValueError, "tree's 5 axes, but have 3"),
        (np.full((2, 5), np.inf), 2, {}, ValueError, "queries should be finite"),
        (np.zeros((2, 5)), 2, {"half_range": -1.0}, ValueError, "half_range should hold no neg"),
        (np.zeros((2, 5)), 2, {"range_radius": np.nan}, ValueError, "range_radius should hold no"),
        (np.zeros((2, 5)), 2, {"range_radius": np.ones(3)}, ValueError, r"shape \(2,\)"),
        (np.zeros((2, 5)), 2, {"exclude_self": True}, ValueError, "needs 8 queries"),
        (np.zeros((2, 5)), 2, {"n_threads": 0}, ValueError, "n_threads should be at least 1"),
    ],
)
def test_bad_queries_are_refused(queries, k, options, error, message):
    tree = pr.KDTree(np.zeros((8, 5)))
    with pytest.raises(error, match=message):
        tree.query(queries, k, **options)


def test_a_tree_without_range_axes_takes_no_range():
    with pytest.raises(ValueError, match="no range axes: all its 3"):
        pr.KDTree(np.zeros((8, 3))).query(np.zeros((1, 3)), 1, range_radius=1.0)


def test_tables_larger_than_caches_hold_what_smaller_ones_do():
    rng = np.random.default_rng(2)
    points, some = rng.random((600_000, 3)), rng.integers(600_000, size=3000)
    tree = pr.KDTree(points)
    for threads in (1, 2):
        large, small = tree.query_self(16, n_threads=threads), tree.query(points[some], 16)
        np.testing.assert_array_equal(large.ids[some], small.ids)
        np.testing.assert_array_equal(large.distance[some], small.distance)
