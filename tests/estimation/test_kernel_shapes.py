"""Kernels refuse arrays that do not fit one another, before they read or write beyond any."""

import numpy as np
import pytest

from photonrelax._ext.estimation import diffusion
from photonrelax._ext.estimation import nearest as estimate
from photonrelax._ext.estimation import refinement as adaptive
from photonrelax._ext.estimation import tangent_plane as tangent
from photonrelax.spatial.kdtree import KDTree

N = 40


def tree_and_rows(n_axes=6):
    tree = KDTree(np.random.default_rng(0).random((N, n_axes)), n_metric=3)
    return tree.kernel, np.asarray(tree.kernel.ids)


def gathers(rows_of_tree=slice(None)):
    tree, rows = tree_and_rows()
    how = {"radius": 0.5, "normal_range": 1.0, "n_threads": 1}
    rows = rows[rows_of_tree]
    values, flux = np.ones((N, 3)), np.ones(N)
    yield lambda: estimate.Gather(
        tree, values, rows, 15, estimate.CONSTANT, nearest_scale=1.0, **how
    )
    yield lambda: adaptive.Gather(
        tree,
        values,
        flux,
        rows,
        k_min=5,
        k=15,
        rule=adaptive.BIAS_COMPENSATION,
        kernel=estimate.CONSTANT,
        bias=(0.0, 0.0),
        **how,
    )


@pytest.mark.parametrize(
    ("queries", "out"), [((5, 3), (5, 3)), ((5, 6), (4, 3)), ((5, 6), (5, 2)), ((5, 6), (5, 4))]
)
def test_what_gathers_looks_at_queries_and_densities(queries, out):
    for make in gathers():
        with pytest.raises(ValueError, match="do not fit one another"):
            make().densities(np.zeros(queries), np.arange(5), np.zeros(out), 1)


def test_what_gathers_wants_a_row_for_each_point():
    for make in gathers(slice(5, None)):
        with pytest.raises(ValueError, match="a row for each point"):
            make()


def photons(n_columns, towards=None, rows_of_tree=slice(None)):
    tree, rows = tree_and_rows()
    return tangent.Photons(
        tree,
        rows[rows_of_tree],
        towards,
        np.ones((N, n_columns)),
        normal_range=1.0,
        unit=1.0,
        n_threads=1,
    )


def sites(queries=(5, 6), normals=(5, 3), bandwidths=5):
    return tangent.Sites(np.zeros(queries), np.ones(normals), np.ones(bandwidths))


def test_photons_and_sites_are_as_many_and_have_the_axes_they_need():
    with pytest.raises(ValueError, match="a row for each point"):
        photons(4, rows_of_tree=slice(5, None))
    with pytest.raises(ValueError, match=r"towards should have shape \(m, 3\), but has \(40, 2\)"):
        photons(4, towards=np.ones((N, 2)))
    for odd in ({"queries": (5, 2)}, {"normals": (5, 2)}, {"normals": (4, 3)}, {"bandwidths": 4}):
        with pytest.raises(ValueError, match="do not fit one another"):
            sites(**odd)


@pytest.mark.parametrize(
    ("carried", "queries"), [(4, (5, 3)), (3, (5, 6)), (5, (5, 6))], ids=["axes", "few", "many"]
)
def test_tensors_want_a_flux_and_a_gradient_and_all_axes(carried, queries):
    around, order, given = sites(queries), np.arange(5), photons(carried)
    shaping = diffusion.Shaping(
        edge_threshold=1.0, exponent=2.0, least_eigenvalue=0.1, largest=0.0, isotropic=False
    )
    values = diffusion.Values(np.ones((N, 3)), tree_and_rows()[1], 1)
    with pytest.raises(ValueError, match="gradients do not fit"):
        diffusion.gradients(given, around, order, np.zeros((5, 3)), 1)
    with pytest.raises(ValueError, match="eigenvalues do not fit"):
        diffusion.eigenvalues(given, around, order, np.zeros(5), 1)
    with pytest.raises(ValueError, match="axes do not fit"):
        diffusion.half_axes(given, around, shaping, order, np.zeros((5, 2, 3)), n_threads=1)
    with pytest.raises(ValueError, match="do not fit one another"):
        diffusion.densities(
            given, values, around, shaping, order, out=np.zeros((5, 3)), n_threads=1
        )


def test_searches_want_all_axes_and_a_radius_for_each_query():
    tree, order, how = tree_and_rows()[0], np.arange(5), {"normal_range": 1.0, "n_threads": 1}
    with pytest.raises(ValueError, match="queries do not fit"):
        tangent.farthest(tree, np.zeros((5, 3)), 4, **how)
    for queries, radius in (((5, 3), 5), ((5, 6), 4)):
        with pytest.raises(ValueError, match="queries do not fit"):
            tangent.bandwidths(tree, np.zeros(queries), order, np.ones(radius), k=4, **how)


@pytest.mark.parametrize("n_axes", [3, 6])
@pytest.mark.parametrize("k", [1, 7, N, 10**9])
def test_the_farthest_is_that_of_the_nearest_there_are(k, n_axes):
    points = np.random.default_rng(1).random((N, n_axes))
    tree = KDTree(points, n_metric=3)
    ball = 0.5 if n_axes == 6 else -1.0
    found = tangent.farthest(tree.kernel, points, k, normal_range=ball, n_threads=2)
    distance = np.linalg.norm(points[:, None, :3] - points[:, :3], axis=2)
    apart = np.linalg.norm(points[:, None, 3:] - points[:, 3:], axis=2)
    distance = np.sort(np.where(apart <= max(ball, 0.0), distance, -1.0), axis=1)
    expected = [row[row >= 0.0][:k][-1] for row in distance]
    np.testing.assert_allclose(found, expected, rtol=1e-12)
