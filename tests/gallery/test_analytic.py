"""Analytic irradiance is that of references made in other ways."""

import numpy as np
import pytest

from photonrelax import gallery
from photonrelax.evaluation.subject import gallery_subject
from photonrelax.gallery.analytic import RingIrradiance, SphereIrradiance, analytic_irradiance
from tests.analytic.glass_sphere import GlassSphere
from tests.analytic.metal_ring import MetalRing


def floor_points(xy):
    points = np.column_stack([xy, np.zeros(len(xy))])
    return points, np.tile([0.0, 0.0, 1.0], (len(xy), 1))


def test_the_ring_is_that_of_a_search_over_the_wall():
    xy = np.random.default_rng(0).uniform(-1.0, 1.0, (400, 2))
    found, known = RingIrradiance()(*floor_points(xy))
    expected = MetalRing(
        height=0.4, elevation=np.radians(28.0), irradiance=1.6, reflectance=0.95
    ).irradiance_at(xy[known])
    assert 0.3 < known.mean() < 0.9
    assert (expected > 0.0).sum() > 10
    np.testing.assert_allclose(found[known], expected, rtol=2e-3, atol=1e-9)


def test_the_flux_on_the_ring_s_floor_is_that_of_paths_followed():
    edges = np.linspace(-0.9, 0.9, 61)
    means = MetalRing(
        height=0.4, elevation=np.radians(28.0), irradiance=1.6, reflectance=0.95
    ).pixel_irradiance(edges, 1_000_000)
    sides = (np.arange(240) + 0.5) / 240 * 1.8 - 0.9
    x, y = np.meshgrid(sides, sides, indexing="ij")
    found, known = RingIrradiance()(*floor_points(np.column_stack([x.ravel(), y.ravel()])))
    shape = (60, 4, 60, 4)
    inside = known.reshape(shape).all(axis=(1, 3))
    means_found = found.reshape(shape).mean(axis=(1, 3))
    assert means_found[inside].sum() == pytest.approx(means[inside].sum(), rel=2e-3)
    assert np.abs(means_found - means)[inside].sum() < 0.02 * means[inside].sum()


def test_the_sphere_is_that_of_a_search_over_impact_parameters():
    distance = np.random.default_rng(1).uniform(0.02, 3.0, 200)
    turn = np.linspace(0.0, 6.0, 200)
    xy = distance[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    found, known = SphereIrradiance()(*floor_points(xy))
    expected = GlassSphere(gap=0.2, irradiance=0.8).irradiance_at(
        distance[known], orders=range(-1, 12)
    )
    assert known.mean() > 0.5
    np.testing.assert_allclose(found[known], expected, rtol=5e-3)


def test_nothing_is_known_off_the_floor_and_of_other_scenes():
    points, normals = floor_points(np.tile([0.5, 0.2], (3, 1)))
    points[0, 2], normals[1] = 0.1, [1.0, 0.0, 0.0]
    for light in (RingIrradiance(), SphereIrradiance()):
        assert light(points, normals)[1].tolist() == [False, False, True]
    assert [name for name in gallery.names() if analytic_irradiance(name)] == ["ring", "sphere"]


@pytest.mark.parametrize("name", ["ring", "sphere"])
def test_pixels_are_known_if_all_that_they_see_is(name):
    subject = gallery_subject(name, 48, 48)
    view = subject.view(2, 8, n_threads=None, progress=None)
    known = subject.analytic_pixels(view)
    assert 0.05 < known.where.mean() < 0.9
    (band,) = view.bands
    _, each = subject.irradiance(band.hits.position, band.hits.normal)
    unknown = np.bincount(band.hits.pixel, ~each, minlength=48 * 48).reshape(48, 48)
    assert (unknown[known.where] == 0).all()
    assert known.caustic[known.where].sum() > 0.0
