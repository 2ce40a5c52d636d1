"""The tree of boxes finds exactly those that a brute-force search finds."""

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from photonrelax.spatial.box_tree import BoxTree


def brute_force(boxes, queries, radius):
    """Pairs (query, box) of boxes within a radius of the queries, as a set."""
    (low, high), (least, greatest) = boxes, queries
    gap = np.maximum(low - greatest[:, None], least[:, None] - high).clip(min=0.0)
    squared = gap[..., 0] ** 2 + gap[..., 1] ** 2 + gap[..., 2] ** 2
    found = squared <= np.broadcast_to(radius, len(least))[:, None] ** 2
    return {*zip(*np.nonzero(found), strict=True)}


def assert_exact(boxes, queries, radius):
    found = BoxTree(*boxes).pairs_within(*queries, radius)
    pairs = [*zip(found.query, found.box, strict=True)]
    assert len(pairs) == len({*pairs})
    assert {*pairs} == brute_force(boxes, queries, radius)
    assert (np.diff(found.query) >= 0).all()


def random_boxes(rng, n, size):
    low = rng.random((n, 3))
    return low, low + size * rng.random((n, 3))


@pytest.mark.parametrize("n", [0, 1, 3, 4, 5, 16, 17, 63, 64, 65, 700])
def test_boxes_near_points_equal_brute_force(n):
    rng = np.random.default_rng(n)
    points = rng.random((50, 3))
    for size in (0.0, 0.1, 2.0):
        assert_exact(random_boxes(rng, n, size), (points, points), 0.3 * rng.random(50))


def test_boxes_near_boxes_equal_brute_force():
    rng = np.random.default_rng(1)
    for radius in (0.0, 0.05):
        assert_exact(random_boxes(rng, 500, 0.1), random_boxes(rng, 60, 0.2), radius)


coordinates = st.sampled_from([0.0, 1.0, 2.0, -1e6, 1e100]) | st.floats(-2, 2, width=16)


@settings(deadline=None)
@given(data=st.data(), n=st.integers(0, 40), radius=st.floats(0, 3))
def test_hypothesis_made_boxes(data, n, radius):
    def boxes(n):
        corners = data.draw(hnp.arrays(np.float64, (2, n, 3), elements=coordinates))
        return corners.min(axis=0), corners.max(axis=0)

    assert_exact(boxes(n), boxes(3), radius)


def test_boxes_that_touch_are_found_at_no_distance():
    tree = BoxTree([[0.0, 0.0, 0.0]], [[1.0, 1.0, 1.0]])
    at = [[1.0, 0.5, 0.5], [np.nextafter(1.0, 2.0), 0.5, 0.5]]
    np.testing.assert_array_equal(tree.pairs_within(at, at).query, [0])


def test_the_order_does_not_depend_on_threads():
    rng = np.random.default_rng(2)
    boxes, queries = random_boxes(rng, 40_000, 0.01), random_boxes(rng, 4000, 0.05)
    one, two = (BoxTree(*boxes, n_threads=n).pairs_within(*queries, n_threads=n) for n in (1, 2))
    np.testing.assert_array_equal(one.query, two.query)
    np.testing.assert_array_equal(one.box, two.box)


@pytest.mark.parametrize(
    ("low", "high", "message"),
    [
        ([[0, 0, 1]], [[1, 1, 0]], "low should not exceed high, but does in row 0"),
        ([[0, 0]], [[1, 1]], "low should have shape"),
        ([[0, 0, 0]], [[1, 1, 1], [1, 1, 1]], "high should have shape"),
        ([[0, 0, np.nan]], [[1, 1, 1]], "low should be finite"),
        ([[0, 0, 0]], [[1, 1, 1e200]], "high should be at most 1e[+]150"),
    ],
)
def test_boxes_are_checked(low, high, message):
    with pytest.raises(ValueError, match=message):
        BoxTree(low, high)


def test_radii_are_checked():
    tree = BoxTree([[0, 0, 0]], [[1, 1, 1]])
    with pytest.raises(ValueError, match="radius should hold no negative number"):
        tree.pairs_within([[0, 0, 0]], [[0, 0, 0]], -1.0)
