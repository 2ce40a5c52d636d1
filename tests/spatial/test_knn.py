"""Every path of the search finds the neighbours of a sort of all distances, bit for bit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import photonrelax as pr
from photonrelax._ext.relaxation import relax
from tests.helpers import simd_paths
from tests.helpers.neighbours import nearest

# Around one block, one group of blocks and the chunks keys are looked at in; many levels.
SIZES = [0, 1, 2, 15, 16, 17, 63, 64, 65, 255, 256, 257, 272, 273, 1025, 4096, 5000]
on_each_path = simd_paths.each("path")


def assert_same(found, expected):
    np.testing.assert_array_equal(found.ids, expected[0])
    np.testing.assert_array_equal(found.distance, expected[1])


def assert_nearest(points, k, n_metric=3, *, rows=None, queries=None, **ranges):
    """Compare searches from the points themselves, some rows of them, and from elsewhere."""
    tree = pr.KDTree(points, n_metric, n_threads=1)
    rows = np.arange(len(points)) if rows is None else rows
    for exclude in (False, True):
        excluded = rows if exclude else None
        expected = nearest(points, points[rows], k, n_metric, excluded=excluded, **ranges)
        found = tree.query_self(k, exclude_self=exclude, n_threads=1, **ranges)
        assert_same(pr.Neighbours(found.ids[rows], found.distance[rows]), expected)
    if queries is not None:
        found = tree.query(queries, k, n_threads=1, **ranges)
        assert_same(found, nearest(points, queries, k, n_metric, **ranges))


def some_rows(rng, n, most=40):
    return rng.permutation(n)[:most]


def uniform(rng, n, d):
    return rng.random((n, d))


def lattice(rng, n, d):
    return rng.integers(0, 4, (n, d)) * 0.25


def few_places(rng, n, d):
    return rng.random((3, d))[rng.integers(0, 3, n)]


def one_place(rng, n, d):
    return np.ones((n, d))


def line(rng, n, d):
    return np.outer(rng.random(n), np.ones(d))


def sheet(rng, n, d):
    return np.column_stack([np.sin(4 * rng.random((n, 2))), rng.random((n, d))])[:, :d]


def clusters(rng, n, d):
    """Blocks of 16 that differ in density by up to 1e24, each far from the last."""
    number = np.arange(n) // 16
    size = 10.0 ** rng.uniform(-8, 0, n // 16 + 1)[number]
    points = rng.random((n, d)) * size[:, np.newaxis]
    points[:, 0] += 3.0 * number
    return points


def half_at_one_place(rng, n, d):
    points = rng.random((n, d))
    points[rng.random(n) < 0.5] = 0.5
    return points


KINDS = [uniform, lattice, few_places, one_place, line, sheet, clusters, half_at_one_place]


@on_each_path
@pytest.mark.parametrize("n", SIZES)
def test_every_number_of_points(path, n):
    rng = np.random.default_rng(n)
    points = rng.random((n, 3))
    queries = rng.normal(size=(20, 3))
    with simd_paths.forced(path):
        for k in (1, 16, 64, 65, n + 1) if n < 1000 else (1, 50, 65):
            assert_nearest(points, k, rows=some_rows(rng, n), queries=queries)


@pytest.mark.kernels_run_elsewhere
@on_each_path
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("d", [3, 5, 6])
def test_every_kind_of_points(path, kind, d):
    rng = np.random.default_rng(d)
    points = kind(rng, 1500, d)
    queries = points[some_rows(rng, 1500)] + 0.01 * rng.normal(size=(40, d))
    ranges = {} if d == 3 else {"range_radius": 0.4}
    with simd_paths.forced(path):
        for k in (4, 50, 100):
            assert_nearest(points, k, rows=some_rows(rng, 1500), queries=queries, **ranges)


def range_forms(rng, m, n_axes):
    yield {}
    yield {"range_radius": 0.4}
    yield {"range_radius": rng.random(m)}
    yield {"half_range": 0.3}
    yield {"half_range": np.where(np.arange(n_axes) > 0, np.inf, 0.2)}
    yield {"half_range": rng.random((m, n_axes)), "range_radius": rng.random(m)}
    yield {"range_radius": 0.0, "half_range": 0.0}
    yield {"range_radius": np.inf}


@on_each_path
@pytest.mark.parametrize(
    ("n_metric", "d"), [(1, 1), (1, 3), (2, 2), (2, 5), (3, 4), (3, 8), (4, 6)]
)
def test_every_number_of_axes_and_form_of_range(path, n_metric, d):
    rng = np.random.default_rng(10 * n_metric + d)
    points = lattice(rng, 200, d) if d % 2 else rng.random((200, d))
    forms = range_forms(rng, 200, d - n_metric) if d > n_metric else [{}]
    with simd_paths.forced(path):
        for ranges in forms:
            assert_nearest(points, 20, n_metric, queries=rng.random((200, d)), **ranges)


@st.composite
def searches(draw):
    """Points, queries, and all else that a search takes."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    d = draw(st.integers(3, 7))
    n_metric = draw(st.sampled_from([3, 3, 3, 1, 2, 4]).filter(lambda m: m <= d))
    n = draw(st.integers(1, 90) | st.integers(1, 700) | st.sampled_from(SIZES[1:]))
    points = draw(st.sampled_from(KINDS))(rng, n, d)
    rows = some_rows(rng, n, 24)
    away = draw(st.sampled_from([0.0, 1e-9, 0.1, 1e3]))
    queries = points[rows] + away * rng.normal(size=(len(rows), d))
    k = draw(st.integers(1, 80) | st.sampled_from([1, n, n + 3]).filter(lambda k: k < 200))
    ranges = {}
    if d > n_metric:
        ranges["half_range"] = draw(st.none() | st.sampled_from([0.0, 0.25, 0.5, np.inf]))
        ranges["range_radius"] = draw(st.none() | st.sampled_from([0.0, 0.3, 1.0, np.inf]))
    return points, k, {"n_metric": n_metric, "rows": rows, "queries": queries, **ranges}


@on_each_path
@settings(max_examples=80, deadline=None)
@given(search=searches(), offset=st.sampled_from([0.0, 0.0, 1e6]))
def test_hypothesis_made_searches(path, search, offset):
    points, k, options = search
    options["queries"] = options["queries"] + offset
    with simd_paths.forced(path):
        assert_nearest(points + offset, k, **options)


@on_each_path
@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    kind=st.sampled_from([uniform, lattice, clusters, few_places, half_at_one_place]),
    exponent=st.integers(-168, 140),
    k=st.integers(1, 70),
    away=st.sampled_from([1.0, 1e6]),
)
def test_squares_that_underflow_or_nearly_overflow(path, seed, *, kind, exponent, k, away):
    rng = np.random.default_rng(seed)
    points = kind(rng, 200, 3) * 10.0**exponent
    queries = away * 10.0**exponent * rng.normal(size=(20, 3))
    with simd_paths.forced(path):
        assert_nearest(points, k, queries=queries)


@on_each_path
def test_queries_so_far_away_that_squares_overflow_find_nothing(path):
    with simd_paths.forced(path):
        found = pr.KDTree(np.zeros((40, 3))).query([[1e200, 0.0, 0.0], [1e150, 0.0, 0.0]], 3)
    np.testing.assert_array_equal(found.ids, [[40, 40, 40], [0, 1, 2]])
    np.testing.assert_array_equal(found.distance, [[np.inf] * 3, [1e150] * 3])


@on_each_path
def test_queries_that_have_little_in_common(path):
    """All blocks overlap the bounds of a batch: it lists them in parts and drops the farthest."""
    rng = np.random.default_rng(1)
    queries = rng.random((16, 6)) * [1, 1, 1, 0, 0, 0] + 0.3
    for points in (rng.random((5000, 6)), lattice(rng, 5000, 6), one_place(rng, 5000, 6)):
        with simd_paths.forced(path):
            tree = pr.KDTree(points)
            for k in (1, 40, 700):
                for ranges in ({}, {"range_radius": 0.7}):
                    found = tree.query(queries, k, n_threads=1, **ranges)
                    assert_same(found, nearest(points, queries, k, **ranges))


@on_each_path
def test_a_batch_of_which_only_some_have_found_all(path):
    """Others may still find what is just as far away as their farthest, whatever its id."""
    points = np.zeros((5000, 4))
    points[2500:, [0, 3]] = 1.0
    # The first batch makes the second start with the largest radius.
    far = np.arange(32) < 24
    queries = np.zeros((32, 4))
    queries[far, 3] = 1.0
    with simd_paths.forced(path):
        found = pr.KDTree(points).query(queries, 20, range_radius=0.5, n_threads=1)
    np.testing.assert_array_equal(found.ids, np.arange(20) + 2500 * far[:, np.newaxis])


@on_each_path
@pytest.mark.parametrize("k", [90, 130])
def test_ties_are_broken_by_id_across_many_blocks(path, k):
    rng = np.random.default_rng(k)
    with simd_paths.forced(path):
        assert_nearest(lattice(rng, 5000, 3), k, rows=some_rows(rng, 5000, 250))


@on_each_path
@pytest.mark.parametrize("k", [3, 16, 17, 40])
def test_density_that_jumps_from_batch_to_batch(path, k):
    """Radii of one batch are no guess for the next: too small by far, or too large."""
    rng = np.random.default_rng(k)
    sparse, dense = rng.random((40, 16, 3)), 1e-6 * rng.random((40, 16, 3))
    places = 2.0 * np.arange(40)[:, np.newaxis, np.newaxis] * [1.0, 0.0, 0.0]
    points = np.concatenate([sparse + places, dense + places + [1.0, 0.5, 0.5]]).reshape(-1, 3)
    with simd_paths.forced(path):
        assert_nearest(points, k, queries=points[some_rows(rng, len(points), 300)])


@pytest.mark.kernels_run_elsewhere
@on_each_path
def test_many_at_one_place_and_few_far_from_it(path):
    rng = np.random.default_rng(2)
    points = np.zeros((2000, 5))
    points[rng.permutation(2000)[:60], :3] = 1e3 * rng.random((60, 3)) ** 6
    points[:, 3:] = rng.integers(0, 3, (2000, 2))
    rows = np.concatenate([np.flatnonzero(points[:, 0]), some_rows(rng, 2000)])
    with simd_paths.forced(path):
        for k in (7, 30, 64, 80):
            assert_nearest(points, k, rows=rows)
            assert_nearest(points, k, rows=rows, range_radius=1.0, queries=points[rows] + 0.5)


@on_each_path
@pytest.mark.parametrize("k", [5, 30, 200])
def test_farthest(path, k):
    rng = np.random.default_rng(k)
    points = np.concatenate([rng.random((200, 5)), lattice(rng, 200, 5)])
    with simd_paths.forced(path):
        tree = pr.KDTree(points)
        for ranges in ({}, {"range_radius": 0.3}, {"range_radius": rng.random(400)}):
            distance = nearest(points, points, k, **ranges)[1]
            expected = np.where(np.isfinite(distance), distance, 0.0).max(axis=1)
            np.testing.assert_array_equal(tree.farthest(k, **ranges), expected)


def test_farthest_of_a_tree_without_range_axes_takes_no_range():
    with pytest.raises(ValueError, match="no range axes: all its 2"):
        pr.KDTree(np.zeros((8, 2)), 2).farthest(1, range_radius=1.0)


# Trees whose points move


@on_each_path
@pytest.mark.parametrize("n", [1, 17, 300, 4096])
def test_searches_of_a_refitted_tree_equal_those_of_a_new_one(path, n):
    rng = np.random.default_rng(n)
    points = rng.random((n, 5))
    with simd_paths.forced(path):
        tree = pr.KDTree(points)
        ids = np.asarray(tree.kernel.ids)
        for scale in (1e-3, 0.1, 1e4, 1e-6):
            points[:, :3] += scale * rng.normal(size=(n, 3))
            points[:, 3:] = rng.integers(0, 4, (n, 2))
            tree.kernel.move(points[ids, :3], 0, 1.0, 1)
            tree.kernel.move(0.5 * points[ids, 3:], 3, 2.0, 1)
            tree.kernel.box(1)
            new = pr.KDTree(points, n_threads=1)
            for ranges in ({}, {"range_radius": 1.0}):
                expected = new.query_self(20, n_threads=1, **ranges)
                assert_same(
                    tree.query_self(20, n_threads=1, **ranges), (expected.ids, expected.distance)
                )
                assert_same(
                    tree.query(points[:9], 70, n_threads=1, **ranges),
                    nearest(points, points[:9], 70, **ranges),
                )


def moved(tree, guess, k=16, reach=None):
    """New positions and squared radii, in tree order, of free photons in the plane z = 0."""
    n = tree.n_points
    squared_radius = np.array(np.broadcast_to(guess, n), dtype=float)
    inputs = relax.RelaxInputs(
        rows=np.arange(n),
        normal=np.tile([0.0, 0.0, 1.0], (n, 1)),
        basis=np.tile(np.eye(3)[:2], (n, 1, 1)),
        constraint=np.zeros(n),
        range_radius=None,
        reach=reach,
        largest_step=np.full(n, np.inf),
        squared_radius=squared_radius,
    )
    out = np.empty((n, 3))
    relax.move(tree.kernel, 0, n, inputs, k=k, step=1.0, moved=out, n_threads=1)
    return out, squared_radius


GUESSES = {
    "none": lambda squared: -1.0,
    "what is found": lambda squared: squared,
    "nothing": lambda squared: 0.0,
    "next to nothing": lambda squared: 5e-324,
    "too little": lambda squared: 1e-6 * squared,
    "too much": lambda squared: 1e6 * squared,
    "all there is": lambda squared: np.inf,
    "anything": lambda squared: (
        squared * 10.0 ** np.random.default_rng(0).normal(size=len(squared))
    ),
}


@on_each_path
@pytest.mark.parametrize("guess", GUESSES)
def test_what_is_found_does_not_depend_on_the_guess(path, guess):
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.random((3000, 2)) ** 3, np.zeros(3000)])
    points[:500] = points[500]
    points[600:1600] = np.repeat(points[600:800], 5, axis=0)
    with simd_paths.forced(path):
        tree = pr.KDTree(points)
    places = np.asarray(tree.kernel.ids)
    limits = 0.04 * rng.random(3000)
    for reach in (None, limits):
        position, squared = moved(tree, -1.0, reach=reach)
        again = moved(tree, GUESSES[guess](squared), reach=reach)
        np.testing.assert_array_equal(again[0], position)
        np.testing.assert_array_equal(again[1], squared)
    rows = np.arange(0, 3000, 61)
    distance = nearest(points, points[places[rows]], 16)[1]
    expected = np.where(distance <= limits[rows, np.newaxis], distance, 0.0).max(axis=1)
    np.testing.assert_array_equal(np.sqrt(squared[rows]), expected)


@on_each_path
def test_the_force_of_photons_with_known_radii(path):
    """SJ13 Eq. 8, the repulsion of neighbours at the very same point left out."""
    rng = np.random.default_rng(4)
    points = np.column_stack([rng.random((400, 2)), np.zeros(400)])
    points[100:130] = points[100]
    with simd_paths.forced(path):
        tree = pr.KDTree(points)
        position, squared = moved(tree, -1.0)
        position = moved(tree, squared)[0]
    places = np.asarray(tree.kernel.ids)
    ids, distance = nearest(points, points, 16)
    for place, row in enumerate(places):
        offsets = points[row] - points[ids[row]]
        others = distance[row] > 0.0
        weight = distance[row].max() / distance[row][others] - 1.0 if others.any() else 0.0
        force = (offsets[others] * np.reshape(weight, (-1, 1))).sum(axis=0) / 16
        np.testing.assert_allclose(position[place] - points[row], force, rtol=0, atol=1e-14)
