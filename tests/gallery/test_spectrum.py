"""The rainbow of a prism, by Snell's law for each photon's wavelength."""

import numpy as np
import pytest

import photonrelax as pr
from photonrelax import gallery
from photonrelax.gallery.spectrum import DENSE_FLINT, least_deviation
from photonrelax.scene.dispersion import D_LINE

SLOPE = 0.05


@pytest.fixture(scope="module")
def scene():
    return gallery.scene("spectrum", slope=SLOPE)


@pytest.fixture(scope="module")
def rainbow(scene):
    """Photons on the wall that were refracted twice."""
    photons = pr.trace_photons(scene, (100_000, 0))
    wall = [item.name for item in scene.objects].index("wall")
    return photons.subset((photons.object_id == wall) & (photons.n_bounces == 2))


def refracted(direction, normal, ratio):
    """Directions (n, 3) beyond a plane, by Snell's law with n₁/n₂ (n,)."""
    cosine = -direction @ normal
    beyond = np.sqrt(1.0 - ratio**2 * (1.0 - cosine**2))
    return ratio[:, np.newaxis] * direction + (ratio * cosine - beyond)[:, np.newaxis] * normal


def on_plane(position, direction, normal, offset):
    """Where lines (n, 3) meet a plane."""
    way = (offset - position @ normal) / (direction @ normal)
    return position + way[:, np.newaxis] * direction


def test_light_leads_back_from_the_wall_to_the_sun(scene, rainbow):
    """Back through both faces, by the index of each photon's wavelength."""
    mesh, sun = scene.objects[-1].mesh, scene.emitters[0].direction
    normals = np.unique(mesh.face_normals.round(9), axis=0)
    upright = normals[np.abs(normals[:, 2]) < 0.5]
    offsets = (mesh.vertices @ upright.T).max(axis=0)
    # Light enters from -y, and leaves by the face that looks along x most.
    last, first = upright[:, 0].argmax(), upright[:, 1].argmin()
    index = DENSE_FLINT.index(rainbow.wavelength)
    leaving = on_plane(rainbow.position, rainbow.wi, upright[last], offsets[last])
    inside = refracted(rainbow.wi, upright[last], 1.0 / index)
    entering = on_plane(leaving, inside, upright[first], offsets[first])
    outside = refracted(inside, -upright[first], index)
    np.testing.assert_allclose(outside, np.broadcast_to(-sun, outside.shape), atol=1e-6)
    # Through the slit, 3 mm wide, and so within the prism.
    slit = on_plane(entering, outside, np.array([1.0, 0.0, 0.0]), -0.35)
    assert np.ptp(slit[:, 1]) == pytest.approx(0.003, rel=0.05)
    assert np.ptp(rainbow.wavelength) > 300.0


def test_light_of_the_d_line_is_turned_least(scene, rainbow):
    """By 2 asin(n sin 30°) - 60°, across the prism; other light by more for its index."""
    sun = scene.emitters[0].direction
    turned = np.arctan2(-rainbow.wi[:, 1], -rainbow.wi[:, 0]) - np.arctan2(sun[1], sun[0])
    least = [least_deviation(n, SLOPE) for n in DENSE_FLINT.index(rainbow.wavelength)]
    assert (turned > np.array(least) - 1e-9).all()
    near = np.abs(rainbow.wavelength - D_LINE) < 2.0
    np.testing.assert_allclose(turned[near], np.array(least)[near], atol=1e-5)


def test_red_is_turned_least_and_violet_most(rainbow):
    order = np.argsort(rainbow.wavelength)
    x = rainbow.position[order, 0]
    # Bands of wavelengths, each wider than the slit's image.
    means = [band.mean() for band in np.array_split(x, 20)]
    assert (np.diff(means) > 0.0).all()
    assert means[-1] - means[0] > 0.1
