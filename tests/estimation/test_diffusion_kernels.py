"""The kernels of diffusion: their integral, and their shape at edges."""

from dataclasses import replace

import numpy as np
import pytest

from photonrelax.estimation.diffusion import DiffusionField
from tests.helpers.diffusion_maps import FIXED, LOCAL, half_lit
from tests.helpers.photon_maps import flat_map, plane


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("isotropic", [False, True])
@pytest.mark.parametrize(
    "settings",
    [replace(FIXED, edge_threshold=0.05), LOCAL, replace(LOCAL, k=400, bandwidth=0.2)],
)
def test_every_kernel_integrates_to_one(settings, isotropic):
    """On a fine lattice of photons whose flux makes shapes; what is summed is the lattice's own."""
    side = 200
    grid = (np.arange(side) + 0.5) / side
    xy = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    flux = 1.0 + np.sin(12 * xy[:, 0] + 7 * xy[:, 1] ** 2) * np.cos(9 * xy[:, 1])
    photons = flat_map(xy, side**2).replace(flux=flux / side**2)
    field = DiffusionField(photons, settings, isotropic=isotropic)
    points, normals = plane(np.random.default_rng(1).uniform(0.15, 0.85, (500, 2)))
    axes = np.linalg.norm(field.half_axes(points, normals), axis=2)
    ones = field.densities(np.full((side**2, 1), 1.0 / side**2))(points, normals)
    if isotropic:
        np.testing.assert_allclose(axes[:, 0], axes[:, 1])
    else:
        assert (axes[:, 1] / axes[:, 0]).min() < 0.3
        assert (axes[:, 1] / axes[:, 0]).max() > 0.6
    # A lattice's sum is off by a share of the cells on the rim, which weigh little.
    wide = axes[:, 1] > 0.03
    assert wide.sum() > 200
    np.testing.assert_allclose(ones[wide], 1.0, rtol=0.02)


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("isotropic", [False, True])
def test_the_longest_and_the_smallest_kernels_integrate_to_one(isotropic):
    """Along an edge, on a lattice so fine that ten of its points lie on the short half-axis."""
    ticks = np.arange(-0.135, 0.135, 0.001)
    xy = np.stack(np.meshgrid(ticks, ticks), -1).reshape(-1, 2)
    flux = np.where(xy @ [0.8, 0.6] < 0.0, 1.0, 0.1)
    photons = flat_map(xy, 10**6).replace(flux=flux / 10**6)
    settings = replace(LOCAL, noise_scale=0.02, edge_threshold=1e-5)
    field = DiffusionField(photons, settings, isotropic=isotropic)
    points, normals = plane(np.random.default_rng(2).uniform(-0.02, 0.02, (200, 2)))
    axes = np.linalg.norm(field.half_axes(points, normals), axis=2)
    np.testing.assert_allclose(axes[:, 1], 0.1 * np.sqrt(0.01))
    np.testing.assert_allclose(axes[:, 0], 0.01 if isotropic else 0.1)
    ones = field.densities(np.full((len(xy), 1), 1e-6))(points, normals)
    np.testing.assert_allclose(ones, 1.0, rtol=0.02 if isotropic else 0.005)


@pytest.mark.parametrize("settings", [FIXED, LOCAL])
def test_kernels_are_long_along_an_edge_and_short_across(settings):
    field = DiffusionField(half_lit(), settings)
    edge = plane(np.column_stack([np.full(50, 0.48), np.linspace(0.2, 0.8, 50)]))
    along, across = np.moveaxis(field.half_axes(*edge), 1, 0)
    np.testing.assert_allclose(np.linalg.norm(along, axis=1), 0.1)
    np.testing.assert_allclose(np.abs(along[:, 1]), 0.1, rtol=0.05)
    assert np.linalg.norm(across, axis=1).max() < 0.04
    np.testing.assert_allclose((along * across).sum(axis=1), 0.0, atol=1e-12)
    far = plane(np.column_stack([np.full(50, 0.2), np.linspace(0.2, 0.8, 50)]))
    wide = np.linalg.norm(field.half_axes(*far)[:, 1], axis=1)
    assert wide.min() > 2 * np.linalg.norm(across, axis=1).max()


def test_the_isotropic_kernel_is_round():
    """It answers to one photon the same whatever the way to it."""
    photons, point = half_lit(2000), [[0.48, 0.5, 0.0]]
    field = DiffusionField(photons, LOCAL, isotropic=True)
    axes = np.linalg.norm(field.half_axes(point, [[0.0, 0.0, 1.0]]), axis=2)
    np.testing.assert_allclose(axes[0, 0], axes[0, 1])
    distance = np.linalg.norm(photons.position - point, axis=1)
    near = np.flatnonzero(distance < 0.1)
    answers = field.densities(np.eye(len(photons))[:, near])(point, [[0.0, 0.0, 1.0]])[0]
    h = axes[0, 0]
    expected = 2 / (np.pi * h**2) * np.maximum(1 - (distance[near] / h) ** 2, 0)
    np.testing.assert_allclose(answers, expected, rtol=1e-9, atol=1e-9)


def test_kernels_are_no_narrower_than_the_least_eigenvalue_says():
    field = DiffusionField(half_lit(), replace(LOCAL, edge_threshold=1e-6, least_eigenvalue=0.04))
    points, normals = plane(np.random.default_rng(0).uniform(0.1, 0.4, (100, 2)))
    widths = np.linalg.norm(field.half_axes(points, normals)[:, 1], axis=1)
    np.testing.assert_allclose(widths, 0.2 * 0.1)
