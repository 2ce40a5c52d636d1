"""Sums over all points within a radius, against brute force."""

import numpy as np
import pytest
from photonrelax._ext.spatial.radius import RadiusGather

from photonrelax.estimation.kernels import KERNELS
from photonrelax.spatial.kdtree import KDTree

# Mean of the Gaussian over the disc it is cut off at.
MEAN = 2 * 0.41**2 * (1 - np.exp(-0.5 / 0.41**2))
WEIGHTS = {
    "constant": lambda ratio: np.ones_like(ratio),
    "cone": lambda ratio: 3.0 * (1.0 - ratio),
    "epanechnikov": lambda ratio: 2.0 * (1.0 - ratio**2),
    "gaussian": lambda ratio: np.exp(-0.5 * (ratio / 0.41) ** 2) / MEAN,
}


def gathered(points, values, queries, radius, *, n_metric=3, kernel="constant", **how):
    """Return sums and counts around the queries, from a tree of the points."""
    ball, n_threads = how.get("ball", -1.0), how.get("n_threads", 2)
    tree = KDTree(points, n_metric)
    rows = np.asarray(tree.kernel.ids)
    gather = RadiusGather(
        tree.kernel, values, rows, KERNELS[kernel], normal_range=ball, n_threads=n_threads
    )
    out, counts = np.full((len(queries), values.shape[1]), np.nan), np.full(len(queries), -1)
    order = how.get("order", np.arange(len(queries)))
    gather.sums(queries, order, radius, out=out, counts=counts, n_threads=n_threads)
    return out, counts


def brute_force(points, values, queries, radius, *, n_metric=3, kernel="constant", ball=np.inf):
    """The definition."""
    gaps = queries[:, np.newaxis, : points.shape[1]] - points
    distance = np.linalg.norm(gaps[..., :n_metric], axis=2)
    apart = np.linalg.norm(gaps[..., n_metric:], axis=2)
    inside = (distance <= radius[:, np.newaxis]) & (apart <= ball)
    weights = np.where(inside, WEIGHTS[kernel](distance / radius[:, np.newaxis]), 0.0)
    return weights @ values, inside.sum(axis=1)


def cloud(n, m, n_axes=3, seed=1):
    """Points, values of them, queries among and off them, and radii from none to all."""
    rng = np.random.default_rng(seed)
    points, values = rng.random((n, n_axes)), rng.random((n, 4))
    queries = rng.uniform(-0.3, 1.3, (m, n_axes))
    return points, values, queries, rng.choice([0.01, 0.1, 0.4, 3.0], m)


@pytest.mark.parametrize("n", [10, 1003, 5003])
def test_radii_whose_square_is_infinite_reach_all_points_and_no_more(n):
    """Lanes and boxes without a point hold infinity, which is as large as the square."""
    points, values, queries, _ = cloud(n, 20)
    out, counts = gathered(points, values, queries, np.full(20, 1e160))
    assert (counts == n).all()
    np.testing.assert_allclose(out, np.tile(values.sum(axis=0), (20, 1)), rtol=1e-11)


@pytest.mark.parametrize("kernel", WEIGHTS)
@pytest.mark.parametrize("n", [1, 15, 16, 17, 300, 5000])
def test_sums_and_counts_are_those_of_brute_force(n, kernel):
    given = cloud(n, 200)
    out, counts = gathered(*given, kernel=kernel)
    expected, number = brute_force(*given, kernel=kernel)
    np.testing.assert_array_equal(counts, number)
    np.testing.assert_allclose(out, expected, rtol=1e-11, atol=1e-13)
    assert counts.min() == 0
    assert counts.max() == n


def test_values_identify_the_points_found():
    """Every point has a binary digit of its own in one of the sums."""
    rng = np.random.default_rng(5)
    points, queries = rng.random((150, 3)), rng.random((80, 3))
    values = np.zeros((150, 3))
    values[np.arange(150), np.arange(150) // 50] = 2.0 ** (np.arange(150) % 50)
    radius = rng.uniform(0.0, 0.6, 80)
    out, _ = gathered(points, values, queries, radius)
    inside = np.linalg.norm(queries[:, np.newaxis] - points, axis=2) <= radius[:, np.newaxis]
    digits = (out.astype(np.int64)[:, :, np.newaxis] >> np.arange(50)) & 1
    np.testing.assert_array_equal(digits.reshape(80, 150).astype(bool), inside)


@pytest.mark.parametrize("n_metric", [2, 3])
def test_the_ball_over_the_range_axes_leaves_points_out(n_metric):
    points, values, queries, radius = cloud(3000, 300, n_axes=n_metric + 3)
    how = {"n_metric": n_metric, "kernel": "cone", "ball": 0.4}
    out, counts = gathered(points, values, queries, radius, **how)
    expected, number = brute_force(points, values, queries, radius, **how)
    np.testing.assert_array_equal(counts, number)
    np.testing.assert_allclose(out, expected, rtol=1e-11, atol=1e-13)
    assert 0 < counts.sum() < gathered(points, values, queries, radius, n_metric=n_metric)[1].sum()


def test_a_point_at_the_radius_itself_is_within():
    points, values = np.array([[3.0, 4.0, 0.0]]), np.array([[7.0]])
    queries, radius = np.zeros((2, 3)), np.array([5.0, np.nextafter(5.0, 0.0)])
    out, counts = gathered(points, values, queries, radius)
    np.testing.assert_array_equal(counts, [1, 0])
    np.testing.assert_array_equal(out, [[7.0], [0.0]])


def test_coincident_points_all_count():
    points = np.tile([0.25, 0.5, 0.75], (1000, 1))
    out, counts = gathered(points, np.ones((1000, 1)), points[:1], np.array([1e-9]))
    assert (out.item(), counts.item()) == (1000.0, 1000)


def test_no_points_are_found_where_there_are_none():
    queries = np.random.default_rng(0).random((40, 3))
    out, counts = gathered(np.empty((0, 3)), np.empty((0, 2)), queries, np.ones(40))
    np.testing.assert_array_equal(out, np.zeros((40, 2)))
    np.testing.assert_array_equal(counts, np.zeros(40))


def test_only_the_rows_named_are_written():
    points, values, queries, radius = cloud(500, 50)
    order = np.array([7, 3, 40])
    out, counts = gathered(points, values, queries, radius, order=order)
    np.testing.assert_array_equal(np.flatnonzero(counts >= 0), np.sort(order))
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(out).all(axis=1)), np.sort(order))


def test_same_bits_for_every_number_of_threads_and_order():
    points, values, queries, radius = cloud(4000, 3000)
    expected = gathered(points, values, queries, radius, kernel="cone", n_threads=1)
    turned = np.random.default_rng(2).permutation(3000)
    for n_threads, order in ((2, np.arange(3000)), (7, turned)):
        how = {"n_threads": n_threads, "order": order}
        again = gathered(points, values, queries, radius, kernel="cone", **how)
        for one, other in zip(again, expected, strict=True):
            assert one.tobytes() == other.tobytes()


def test_same_bits_for_every_order_of_the_points():
    points, values, queries, radius = cloud(4000, 300)
    turned = np.random.default_rng(2).permutation(4000)
    expected = gathered(points, values, queries, radius)
    again = gathered(points[turned], values[turned], queries, radius)
    for one, other in zip(again, expected, strict=True):
        assert one.tobytes() == other.tobytes()


def test_what_does_not_fit_is_refused():
    points, values, queries, radius = cloud(100, 20)
    with pytest.raises(ValueError, match="do not fit one another"):
        gathered(points, values, queries, radius[:-1])
    with pytest.raises(ValueError, match="do not fit one another"):
        gathered(points, values, np.ascontiguousarray(queries[:, :2]), radius)
    ranged = cloud(100, 20, n_axes=5)
    with pytest.raises(ValueError, match="do not fit one another"):
        gathered(*ranged[:2], queries, radius, ball=1.0)
