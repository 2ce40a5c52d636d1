"""Orders of points against their definitions, written out in NumPy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from photonrelax._ext import order

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


@given(
    st.sampled_from(KINDS),
    st.integers(0, 700),
    st.integers(1, 9),
    st.integers(1, 4),
    st.integers(0, 2**32),
)
@settings(max_examples=300, deadline=None)
def test_every_node_is_split_at_its_median(kind, n, d, n_threads, seed):
    rng = np.random.default_rng(seed)
    points = kind(rng, n, d)
    axis_scale = rng.choice([0.0, 0.25, 1.0, 1.0], d)
    axis_scale[rng.integers(d)] = 1.0
    expected = split_order(points, axis_scale)
    np.testing.assert_array_equal(order.median_order(points, axis_scale, n_threads), expected)


@pytest.mark.parametrize("kind", KINDS)
def test_many_points_are_split_at_their_medians_by_any_number_of_threads(kind):
    points = kind(np.random.default_rng(1), 60_001, 3)
    axis_scale = np.array([1.0, 0.5, 1.0])
    expected = split_order(points, axis_scale)
    for n_threads in (1, 2, 3, 7):
        np.testing.assert_array_equal(order.median_order(points, axis_scale, n_threads), expected)


@pytest.mark.parametrize("d", [10, 20, 255])
def test_points_may_have_many_axes(d):
    points = np.random.default_rng(2).random((1000, d))
    expected = split_order(points, np.ones(d))
    np.testing.assert_array_equal(order.median_order(points, np.ones(d), 2), expected)


def test_axes_of_scale_zero_are_as_good_as_absent():
    points = np.random.default_rng(3).random((5000, 300))
    axis_scale = np.zeros(300)
    axis_scale[[1, 4]] = 1.0
    expected = order.median_order(points[:, [1, 4]].copy(), np.ones(2), 1)
    np.testing.assert_array_equal(order.median_order(points, axis_scale, 1), expected)


def test_without_an_axis_to_split_on_ids_ascend():
    points = np.random.default_rng(4).random((100, 2))
    np.testing.assert_array_equal(order.median_order(points, np.zeros(2), 1), np.arange(100))


@pytest.mark.parametrize(
    ("d", "axis_scale", "message"),
    [(3, np.ones(2), "axis_scale.*3.*2"), (256, np.ones(256), "axis_scale.*255.*256")],
)
def test_scales_that_do_not_fit_are_refused(d, axis_scale, message):
    with pytest.raises(ValueError, match=message):
        order.median_order(np.zeros((20, d)), axis_scale, 1)
