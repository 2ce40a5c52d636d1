"""A sample sees the mean of a sky over its footprint, not the texel in its middle."""

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.scene.camera import pixel_rays
from photonrelax.scene.sky_map import SkyMap
from tests.helpers.tracing_scenes import ball, sheet

SIDE = 16
MIRROR = pr.SceneObject(sheet(50.0), pr.Mirror())


def stars(height):
    """A map that no pixel resolves: few texels are bright."""
    rng = np.random.default_rng(0)
    return np.repeat(rng.random((height, 2 * height, 1)) ** 8, 3, axis=2)


def camera(target, fov=60.0, **options):
    return pr.Camera(
        (0, 0, 3), target, (0, 1, 0.1), fov, **{"width": SIDE, "height": SIDE} | options
    )


def seen(sky, view, thing=MIRROR, **options):
    scene = pr.Scene([thing], [sky], view)
    return pr.render(scene, components=("emission",), **options).layers["emission"][..., 0]


def counted(sky, view, up):
    """Means of pixels over a grid of rays, each with the texel that it meets; up or mirrored."""
    n = 64
    _, direction, pixel = pixel_rays(view, range(SIDE), n)
    direction[:, 2] = np.abs(direction[:, 2]) if up else direction[:, 2]
    sums = np.bincount(pixel, sky.background(direction)[:, 0], minlength=SIDE**2)
    return sums.reshape(SIDE, SIDE) / n**2


@pytest.mark.parametrize("height", [5, 64, 1000])
@pytest.mark.parametrize(
    ("target", "mirrored"),
    [((1, 2, 5), False), ((0, 0, 9), False), ((3, 1, 0), True)],
    ids=["sky", "pole", "mirror"],
)
def test_a_pixel_is_the_mean_over_its_directions(height, target, mirrored):
    sky, view = pr.EnvironmentEmitter(stars(height)), camera(target, 40.0)
    exact = counted(sky, view, up=mirrored)
    error = np.abs(seen(sky, view) - exact).mean() / exact.mean()
    texel = np.abs(seen(sky, view, supersampling=1) - exact).mean() / exact.mean()
    assert error < 0.04
    assert texel < 0.08


def test_a_ball_of_glass_shows_fewer_stars_than_samples_make_of_them():
    """Against many more samples a pixel: their texels alone are off by several times as much."""
    glass = pr.SceneObject(ball(1.0, (0, 0, 0), 4), pr.Dielectric(1.5), smooth=True)
    sky, view = pr.EnvironmentEmitter(stars(400)), camera((0, 0, 0), 45.0)
    exact = seen(sky, view, glass, supersampling=12)
    error = np.abs(seen(sky, view, glass) - exact).mean() / exact.mean()
    assert error < 0.12


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (7, 13), (64, 128)])
def test_coarser_maps_have_the_same_light(shape):
    sky = SkyMap(np.random.default_rng(1).random((*shape, 3)))
    for times in range(sky._max_level + 1):
        np.testing.assert_allclose(sky._halved(times).flux_per_area, sky.flux_per_area, rtol=0.1)
    assert sky._halved(sky._max_level).radiance.shape == (1, 1, 3)


def test_a_constant_map_has_the_same_mean_everywhere():
    rng = np.random.default_rng(2)
    direction = rng.normal(size=(500, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    edges = rng.normal(size=(500, 2, 3)) * 10.0 ** rng.uniform(-6, 0.2, (500, 1, 1))
    sky = SkyMap(np.full((31, 47, 3), [1.0, 2.0, 3.0]))
    np.testing.assert_allclose(sky.means(direction, edges), np.tile([1.0, 2, 3], (500, 1)))
    assert sky.means(direction[:0], edges[:0]).shape == (0, 3)
