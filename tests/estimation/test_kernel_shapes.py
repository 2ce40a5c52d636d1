"""Kernels refuse arrays that do not fit one another, before they read or write beyond any."""

import numpy as np
import pytest
from photonrelax._ext.estimation.frequency import MaxInRadius
from photonrelax._ext.spatial.blocks import to_soa_blocks
from photonrelax._ext.spatial.radius import RadiusGather

from photonrelax._ext.estimation import diffusion, nearest, refinement
from photonrelax._ext.estimation import tangent_plane as tangent
from photonrelax._ext.spatial import kth_distance
from photonrelax.spatial.kdtree import KDTree

N = 40


def tree_and_rows(n_axes=6):
    tree = KDTree(np.random.default_rng(0).random((N, n_axes)), n_metric=3)
    return tree.kernel, np.asarray(tree.kernel.ids)


def gathers(queries=(5, 6), out=(5, 3), values=(N, 3), flux=N):
    tree, _ = tree_and_rows()
    blocks = to_soa_blocks(np.ones(values), np.arange(values[0]), 1)
    where = tree, blocks, np.zeros(queries), np.arange(5), np.zeros(out)
    how = {"k": 15, "kernel": nearest.CONSTANT, "radius": 0.5, "range_radius": 1.0, "n_threads": 1}
    yield lambda: nearest.gather(*where, kth_scale=1.0, **how)
    rule = {"k_min": 5, "rule": refinement.BIAS_COMPENSATION, "bias": (0.0, 0.0)}
    yield lambda: refinement.gather(*where, flux=np.ones(flux), **rule, **how)


@pytest.mark.parametrize(
    "odd",
    [
        {"queries": (5, 3)},
        {"out": (4, 3)},
        {"out": (5, 2)},
        {"out": (5, 4)},
        {"values": (16, 3)},
    ],
)
def test_what_gathers_looks_at_queries_densities_and_values(odd):
    for gather in gathers(**odd):
        with pytest.raises(ValueError, match="do not fit one another"):
            gather()


def test_refinements_want_the_flux_of_each_photon():
    plain, refined = gathers(flux=N - 5)
    plain()
    with pytest.raises(ValueError, match="do not fit one another"):
        refined()


def photons(n_columns, towards=None, rows_of_tree=slice(None)):
    tree, rows = tree_and_rows()
    return tangent.TangentPhotons(
        tree,
        rows[rows_of_tree],
        towards,
        np.ones((N, n_columns)),
        range_radius=1.0,
        unit=1.0,
        n_threads=1,
    )


def points(queries=(5, 6), rows=5, normals=(5, 3), bandwidths=5):
    return tangent.EvaluationPoints(
        np.zeros(queries), np.arange(rows), np.ones(normals), np.ones(bandwidths)
    )


def test_photons_and_points_are_as_many_and_have_the_axes_they_need():
    with pytest.raises(ValueError, match="a row for each point"):
        photons(4, rows_of_tree=slice(5, None))
    with pytest.raises(ValueError, match=r"towards should have shape \(m, 3\), but has \(40, 2\)"):
        photons(4, towards=np.ones((N, 2)))
    odd_ones = (
        {"queries": (5, 2)},
        {"rows": 4},
        {"normals": (5, 2)},
        {"normals": (4, 3)},
        {"bandwidths": 4},
    )
    for odd in odd_ones:
        with pytest.raises(ValueError, match="do not fit one another"):
            points(**odd)


@pytest.mark.parametrize(
    ("carried", "queries"), [(4, (5, 3)), (3, (5, 6)), (5, (5, 6))], ids=["axes", "few", "many"]
)
def test_tensors_want_a_flux_and_a_gradient_and_all_axes(carried, queries):
    around, given = points(queries), photons(carried)
    shape = diffusion.KernelShape(
        edge_threshold=1.0, exponent=2.0, least_eigenvalue=0.1, largest=0.0, isotropic=False
    )
    values = to_soa_blocks(np.ones((N, 3)), tree_and_rows()[1], 1)
    with pytest.raises(ValueError, match="gradients do not fit"):
        diffusion.gradients(given, around, np.zeros((5, 3)), 1)
    with pytest.raises(ValueError, match="eigenvalues do not fit"):
        diffusion.eigenvalues(given, around, np.zeros(5), 1)
    with pytest.raises(ValueError, match="axes do not fit"):
        diffusion.half_axes(given, around, shape, np.zeros((5, 2, 3)), 1)
    with pytest.raises(ValueError, match="do not fit one another"):
        diffusion.densities(given, values, around, shape, np.zeros((5, 3)), n_threads=1)


def test_maxima_want_values_in_the_blocks_of_the_tree():
    tree, rows = tree_and_rows()
    with pytest.raises(ValueError, match="do not fit the blocks"):
        MaxInRadius(tree, to_soa_blocks(np.ones((N, 1)), rows[:16], 1), range_radius=1.0)


def test_sums_want_a_row_for_each_point():
    tree, rows = tree_and_rows()
    with pytest.raises(ValueError, match="a row for each point"):
        RadiusGather(
            *(tree, np.ones((N, 1)), rows[:16], nearest.CONSTANT), normal_range=1.0, n_threads=1
        )


def test_distances_want_all_axes():
    tree, order = tree_and_rows()[0], np.arange(5)
    for n_axes, range_radius in ((3, 1.0), (3, -1.0)):
        with pytest.raises(ValueError, match="queries do not fit"):
            kth_distance.of_queries(
                tree, np.zeros((5, n_axes)), order, k=4, range_radius=range_radius, n_threads=1
            )


def around(n_axes):
    """Points, a tree of them, the ball over its range axes, and sorted distances in it (N, N)."""
    points = np.random.default_rng(1).random((N, n_axes))
    ball = 0.5 if n_axes == 6 else -1.0
    distance = np.linalg.norm(points[:, None, :3] - points[:, :3], axis=2)
    apart = np.linalg.norm(points[:, None, 3:] - points[:, 3:], axis=2)
    distance = np.sort(np.where(apart <= max(ball, 0.0), distance, np.inf), axis=1)
    return points, KDTree(points, n_metric=3), ball, distance


@pytest.mark.parametrize("n_axes", [3, 6])
@pytest.mark.parametrize("k", [1, 7, N, 10**9])
def test_the_farthest_is_that_of_the_nearest_there_are(k, n_axes):
    points, tree, ball, distance = around(n_axes)
    how = {"k": k, "range_radius": ball, "n_threads": 2}
    found = kth_distance.of_queries(tree.kernel, points, np.arange(N), of_fewer=True, **how)
    expected = [row[np.isfinite(row)][:k][-1] for row in distance]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("radius", [0.3, np.inf])
@pytest.mark.parametrize("n_axes", [3, 6])
@pytest.mark.parametrize("k", [1, 7, N, 10**9])
def test_the_kth_distance_is_infinite_where_fewer_are_within_the_radius(k, n_axes, radius):
    points, tree, ball, distance = around(n_axes)
    order = np.random.default_rng(2).permutation(N)[:30]
    how = {"k": k, "radius": radius, "range_radius": ball, "n_threads": 2}
    found = kth_distance.of_queries(tree.kernel, points, order, **how)
    expected = distance[order, k - 1] if k <= N else np.full(len(order), np.inf)
    np.testing.assert_allclose(found, np.where(expected <= radius, expected, np.inf), rtol=1e-12)
