"""Orders of points against their definitions, written out in NumPy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from photonrelax._ext.spatial import build, morton

BLOCK = 16


def split_order(points, axis_scale):
    """Return the order of the leaves by splitting every node of every level with a full sort."""
    n_blocks = -(-len(points) // BLOCK)

    def below(ids, level, node):
        first, middle, end = ((m * n_blocks) >> (level + 1) for m in range(2 * node, 2 * node + 3))
        if end - first < 2:
            return np.sort(ids)
        extent = np.ptp(points[ids], axis=0) * axis_scale
        axis = np.argmax(np.where(axis_scale > 0.0, extent, -1.0))
        sorted_ids = ids[np.lexsort((ids, points[ids, axis]))]
        lower, upper = np.split(sorted_ids, [BLOCK * (middle - first)])
        return np.concatenate(
            [below(lower, level + 1, 2 * node), below(upper, level + 1, 2 * node + 1)]
        )

    return below(np.arange(len(points)), 0, 0)


def morton_order(points):
    """Return the order along the curve from keys put together bit by bit."""
    low, extent = points.min(axis=0), np.ptp(points, axis=0)
    extent[extent <= 1e-290] = 0.0
    if not extent.any():
        return np.arange(len(points))
    shares = np.zeros(len(extent), int)
    axis_of_bit = []
    for _ in range(32):
        axis = np.argmax(extent / 2.0**shares)
        axis_of_bit.append(axis)
        shares[axis] += 1
    key = np.zeros(len(points), np.int64)
    for bit, axis in enumerate(axis_of_bit):
        n_cells = 2.0 ** shares[axis]
        cell = (points[:, axis] - low[axis]) * (n_cells / extent[axis])
        cell = np.minimum(cell.astype(np.int64), int(n_cells) - 1)
        n_lower = axis_of_bit[bit + 1 :].count(axis)
        key = 2 * key + (cell >> n_lower) % 2
    return np.argsort(key, kind="stable")


def lattice(rng, n, d):
    return rng.integers(0, 4, (n, d)) * 0.1


def few_places(rng, n, d):
    return rng.random((3, d))[rng.integers(0, 3, n)]


def mostly_coincident(rng, n, d):
    points = rng.random((n, d))
    points[rng.random(n) < 0.8] = 0.5
    return points


def collinear(rng, n, d):
    return np.repeat(rng.random((n, 1)), d, axis=1)


def many_scales(rng, n, d):
    return np.exp(30.0 * rng.normal(size=(n, d)))


def far_off(rng, n, d):
    return 1e6 + 1e-8 * rng.random((n, d))


def one_outlier(rng, n, d):
    points = rng.random((n, d))
    points[:1] = 1e12
    return points


def signed_zeros(rng, n, d):
    return rng.choice([-0.0, 0.0], (n, d))


def tiny(rng, n, d):
    return rng.integers(-9, 9, (n, d)) * 5e-324


def enormous(rng, n, d):
    return 1e149 * rng.normal(size=(n, d))


def generic(rng, n, d):
    return rng.normal(size=(n, d)) / rng.random((n, 1))


KINDS = [
    generic,
    lattice,
    few_places,
    mostly_coincident,
    collinear,
    many_scales,
    far_off,
    one_outlier,
    signed_zeros,
    tiny,
    enormous,
]


def any_points(counts, most_axes):
    """Choose a kind of points, how many, how many axes, threads and a seed."""
    axes, threads, seeds = st.integers(1, most_axes), st.integers(1, 4), st.integers(0, 2**32)
    return st.sampled_from(KINDS), counts, axes, threads, seeds


@given(*any_points(st.integers(0, 700), 9))
@settings(max_examples=300, deadline=None)
def test_every_node_is_split_at_its_median(kind, n, d, n_threads, seed):
    rng = np.random.default_rng(seed)
    points = kind(rng, n, d)
    axis_scale = rng.choice([0.0, 0.25, 1.0, 1.0], d)
    axis_scale[rng.integers(d)] = 1.0
    expected = split_order(points, axis_scale)
    np.testing.assert_array_equal(build.median_order(points, axis_scale, n_threads), expected)


@pytest.mark.parametrize("kind", KINDS)
def test_many_points_are_split_at_their_medians_by_any_number_of_threads(kind):
    points = kind(np.random.default_rng(1), 60_001, 3)
    axis_scale = np.array([1.0, 0.5, 1.0])
    expected = split_order(points, axis_scale)
    for n_threads in (1, 2, 3, 7):
        np.testing.assert_array_equal(build.median_order(points, axis_scale, n_threads), expected)


@pytest.mark.parametrize("d", [10, 20, 255])
def test_points_may_have_many_axes(d):
    points = np.random.default_rng(2).random((1000, d))
    expected = split_order(points, np.ones(d))
    np.testing.assert_array_equal(build.median_order(points, np.ones(d), 2), expected)


def test_axes_of_scale_zero_are_as_good_as_absent():
    points = np.random.default_rng(3).random((5000, 300))
    axis_scale = np.zeros(300)
    axis_scale[[1, 4]] = 1.0
    expected = build.median_order(points[:, [1, 4]].copy(), np.ones(2), 1)
    np.testing.assert_array_equal(build.median_order(points, axis_scale, 1), expected)


def test_without_an_axis_to_split_on_ids_ascend():
    points = np.random.default_rng(4).random((100, 2))
    np.testing.assert_array_equal(build.median_order(points, np.zeros(2), 1), np.arange(100))


@pytest.mark.parametrize(
    ("d", "axis_scale", "message"),
    [(3, np.ones(2), "axis_scale.*3.*2"), (256, np.ones(256), "axis_scale.*255.*256")],
)
def test_scales_that_do_not_fit_are_refused(d, axis_scale, message):
    with pytest.raises(ValueError, match=message):
        build.median_order(np.zeros((20, d)), axis_scale, 1)


@given(*any_points(st.integers(1, 300), 5))
@settings(max_examples=200, deadline=None)
def test_points_follow_the_curve(kind, n, n_axes, n_threads, seed):
    rng = np.random.default_rng(seed)
    points = kind(rng, n, n_axes) * rng.choice([0.01, 1.0, 3.0], n_axes)
    ordered = morton.morton_order(np.hstack([points, rng.random((n, 1))]), n_axes, n_threads)
    np.testing.assert_array_equal(ordered, morton_order(points))


@pytest.mark.parametrize("kind", KINDS)
def test_many_points_follow_the_curve_with_any_number_of_threads(kind):
    points = kind(np.random.default_rng(5), 60_001, 3)
    expected = morton_order(points)
    for n_threads in (1, 2, 3, 7):
        np.testing.assert_array_equal(morton.morton_order(points, 3, n_threads), expected)


@pytest.mark.parametrize("n_axes", [1, 2, 3, 6])
def test_points_that_follow_each_other_are_near(n_axes):
    points = np.random.default_rng(6).random((20_000, n_axes))
    along = np.diff(points[morton.morton_order(points, n_axes, 1)], axis=0)
    at_random = np.diff(points, axis=0)
    mean_step = [np.linalg.norm(step, axis=1).mean() for step in (along, at_random)]
    assert mean_step[0] < 2.0 * 20_000 ** (-1 / n_axes) < mean_step[1]


@pytest.mark.parametrize(("n", "n_axes"), [(0, 3), (1, 3), (5, 0)])
def test_there_may_be_nothing_to_follow(n, n_axes):
    np.testing.assert_array_equal(morton.morton_order(np.ones((n, 3)), n_axes, 2), np.arange(n))


@pytest.mark.parametrize("n_axes", [-1, 4])
def test_axes_that_are_not_there_are_refused(n_axes):
    with pytest.raises(ValueError, match=f"n_axes.*3.*{n_axes}"):
        morton.morton_order(np.ones((5, 3)), n_axes, 1)
