"""The photon pattern `two-sets`: two shapes that overlap, and their exact irradiance."""

import numpy as np
import pytest

from photonrelax import gallery


@pytest.fixture(scope="module", params=["random", "halton"])
def sets(request):
    return gallery.pattern("two-sets", sampler=request.param, irradiance=2.0)


def test_irradiance_adds_up_where_the_sets_overlap(sets):
    inside, left, right, outside = (0.55, 0.45), (0.2, 0.6), (0.8, 0.3), (0.02, 0.02)
    points = np.column_stack([[inside, left, right, outside], np.zeros(4)])
    np.testing.assert_allclose(sets.irradiance(points)[:, 1], [2.0, 1.28, 0.72, 0.0])


def test_photons_of_the_sets_are_apart_in_emitter_coordinates(sets):
    photons = sets.photons
    second = photons.emitter_coords[:, 0] > 1.5
    shift = photons.emitter_coords - photons.position[:, :2]
    np.testing.assert_allclose(shift[second], np.tile([2.0, 0.0], (second.sum(), 1)), atol=1e-12)
    np.testing.assert_allclose(shift[~second], 0.0, atol=1e-12)
    flux = np.array([photons.flux[some, 0].sum() for some in (~second, second)])
    np.testing.assert_allclose(
        flux, [1.28 * np.pi * 0.09, 0.72 * (0.54 * 0.44 + 0.0072)], rtol=0.02
    )


def test_density_is_that_of_the_photons(sets):
    photons = sets.photons
    square = np.abs(photons.position[:, :2] - [0.2, 0.6]).max(axis=1) < 0.06
    assert square.sum() / 0.12**2 == pytest.approx(photons.emitter_density[square].mean(), rel=0.05)


def test_pixel_means_are_means_of_the_irradiance(sets):
    image = sets.image(lambda points, normals: sets.irradiance(points), 20, 20, 40)
    np.testing.assert_allclose(sets.pixel_means(20, 20), image, atol=0.02)
