"""Lightmaps: means over the texels of UV charts."""

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax.estimation import lightmap as module
from tests.helpers.photon_maps import flat_map, unit_square

RNG = np.random.default_rng(2)


@pytest.fixture(scope="module")
def field():
    position = unit_square(50_000, "random")
    photons = flat_map(position, 1)
    return pr.irradiance_field(
        photons.replace(flux=2.0 * (1.0 - position[:, [0, 1, 0]]) / len(position)),
        method="standard",
    )


def square(low=0.0, high=1.0, chart=((0.0, 0.0), (1.0, 1.0)), cells=1):
    """A square in z = 0 that faces up, in a rectangle of its chart."""
    grid = np.linspace(0.0, 1.0, cells + 1)
    x, y = (axis.ravel() for axis in np.meshgrid(grid, grid))
    corner = np.arange(len(x)).reshape(cells + 1, cells + 1)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    share = np.column_stack([x, y])
    vertices = np.column_stack([low + (high - low) * share, np.zeros(len(x))])
    uv = np.add(chart[0], share * np.subtract(*chart[::-1]))
    visual = trimesh.visual.TextureVisuals(uv=uv)
    return trimesh.Trimesh(vertices, faces, visual=visual, process=False)


def test_pieces_of_triangles_in_a_square_have_the_area_and_the_centre_of_points_in_both():
    triangles = RNG.uniform(-1.0, 2.0, (60, 3, 2))
    area, centre = module._overlap(triangles)
    grid = (np.arange(400) + 0.5) / 400
    points = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    for triangle, own, middle in zip(triangles, area, centre, strict=True):
        step = np.roll(triangle, -1, axis=0) - triangle
        offset = points[:, np.newaxis] - triangle
        side = step[:, 0] * offset[..., 1] - step[:, 1] * offset[..., 0]
        inside = (side > 0).all(axis=1) | (side < 0).all(axis=1)
        assert own == pytest.approx(inside.mean(), abs=3e-3)
        if own > 0.05:
            np.testing.assert_allclose(middle, points[inside].mean(axis=0), atol=0.01)


@pytest.mark.parametrize("cells", [1, 8, 3, 40])
def test_the_lightmap_of_a_square_is_its_irradiance_map(field, cells):
    """Row 0 is at V = 1; texels hold whole faces, faces whole texels, or parts of each other."""
    image, coverage = pr.lightmap(field, square(0.2, 0.8, cells=cells), (8, 8))
    expected = pr.irradiance_map(
        field, (0.2, 0.8, 0), (0.6, 0, 0), (0, -0.6, 0), (8, 8), normal=(0, 0, 1)
    )
    np.testing.assert_allclose(coverage, 1.0, rtol=1e-9)
    np.testing.assert_allclose(image, expected, rtol=1e-6)


def test_charts_cover_parts_of_texels(field):
    mesh = square(0.2, 0.8, chart=((0.25, 0.5), (0.875, 1.0)))
    image, coverage = pr.lightmap(field, mesh, (4, 4))
    expected = np.zeros((4, 4))
    expected[:2, 1:] = [1.0, 1.0, 0.5]
    np.testing.assert_allclose(coverage, expected, atol=1e-12)
    np.testing.assert_array_equal(np.isnan(image[..., 0]), expected == 0.0)
    assert np.isfinite(image[expected > 0.0]).all()


def test_padding_repeats_the_nearest_texel_of_the_chart(field):
    mesh = square(0.2, 0.8, chart=((0.25, 0.25), (0.5, 0.5)))
    bare, _ = pr.lightmap(field, mesh, (16, 16))
    padded, coverage = pr.lightmap(field, mesh, (16, 16), padding=2)
    assert coverage.sum() == pytest.approx(16)
    chart = slice(8, 12), slice(4, 8)
    np.testing.assert_array_equal(padded[chart], bare[chart])
    assert np.isfinite(padded[..., 0]).sum() == 16 + 2 * 4 * 4 + 4
    np.testing.assert_array_equal(padded[6, 4:8], bare[8, 4:8])
    np.testing.assert_array_equal(padded[7, 3], bare[8, 4])


def test_the_side_that_faces_wind_towards_counts(field):
    mesh = square(0.2, 0.8)
    mesh.invert()
    image, _ = pr.lightmap(field, mesh, (4, 4))
    np.testing.assert_array_equal(image, 0.0)


def test_flux_on_a_curved_surface_is_in_its_map():
    """Half a cylinder under light from the side: E is the cosine, its flux the shadow's area."""
    n = 400_000
    angle, height = RNG.uniform(-1.2, 1.2, n), RNG.uniform(0.0, 1.0, n)
    normal = np.column_stack([np.sin(angle), np.zeros(n), np.cos(angle)])
    position = normal + np.outer(height, [0, 1, 0])
    flux = np.repeat(np.cos(angle)[:, np.newaxis], 3, axis=1) * 2.4 / n
    field = pr.irradiance_field(pr.PhotonMap(position, normal, flux), method="standard")

    steps = np.linspace(-1.0, 1.0, 65)
    ring = np.column_stack([np.sin(steps), np.zeros(65), np.cos(steps)])
    vertices = np.concatenate([np.add(ring, [0, y, 0]) for y in (0.2, 0.8)])
    uv = np.column_stack([np.tile((steps + 1) / 2, 2), np.repeat([0.0, 1.0], 65)])
    i = np.arange(64)
    faces = np.concatenate(
        [np.column_stack([i, i + 1, i + 66]), np.column_stack([i, i + 66, i + 65])]
    )
    visual = trimesh.visual.TextureVisuals(uv=uv)
    mesh = trimesh.Trimesh(vertices, faces, visual=visual, process=False)
    if (mesh.face_normals[:, 2] < 0).any():
        mesh.invert()
    image, coverage = pr.lightmap(field, mesh, (16, 4))
    middle = (np.arange(16) + 0.5) / 8 - 1.0
    np.testing.assert_allclose(coverage, 1.0)
    np.testing.assert_allclose(image[..., 0].mean(axis=0), np.cos(middle), rtol=0.02)


def overlapping():
    both = [square(0.2, 0.8), square(0.2, 0.8)]
    return trimesh.util.concatenate(both)


def test_charts_that_overlap_are_averaged(field):
    image, coverage = pr.lightmap(field, overlapping(), (4, 4))
    one, _ = pr.lightmap(field, square(0.2, 0.8), (4, 4))
    np.testing.assert_array_equal(coverage, 1.0)
    np.testing.assert_allclose(image, one, rtol=1e-9)


def test_errors_say_what_is_wrong_with_the_chart(field):
    with pytest.raises(ValueError, match="should have texture coordinates"):
        pr.lightmap(field, trimesh.creation.box(), (4, 4))
    with pytest.raises(ValueError, match=r"should lie in \[0, 1\].*from 0 to 2"):
        pr.lightmap(field, square(chart=((0, 0), (2, 1))), (4, 4))
    with pytest.raises(ValueError, match="faces with an area on its UV chart"):
        pr.lightmap(field, square(chart=((0.5, 0), (0.5, 1))), (4, 4))
    with pytest.raises(ValueError, match="padding"):
        pr.lightmap(field, square(), (4, 4), padding=-1)
    with pytest.raises(ValueError, match="two numbers of texels"):
        pr.lightmap(field, square(), (4, 4, 3))
