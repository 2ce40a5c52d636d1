"""A final gather against radiosity, beside the estimate that it replaces, and at its extremes."""

from dataclasses import replace

import numpy as np
import pytest

import photonrelax as pr
from tests.analytic.radiosity import Cube
from tests.helpers.tracing_scenes import ball, coloured_walls

ALBEDOS = np.array([[0.8, 0.2, 0.2], [0.2, 0.8, 0.2], *4 * [[0.7, 0.7, 0.7]]])
LAMP, POWER = (0.2, -0.1, 0.5), (10.0, 10.0, 10.0)
FLOOR, SIDE, N_PIXELS = 4, 1.28, 64
BLOCK = 16
# From above, without perspective; rows run along -y.
CAMERA = pr.Camera(
    (0, 0, 0.9), (0, 0, -1), (0, 1, 0), width=N_PIXELS, height=N_PIXELS, orthographic_height=SIDE
)

SMALL = replace(CAMERA, width=24, height=24)


def block_means(layer):
    n = N_PIXELS // BLOCK
    return layer.reshape(n, BLOCK, n, BLOCK, 3).mean(axis=(1, 3))


@pytest.fixture(scope="module")
def exact():
    """Indirect radiance of the floor in blocks of pixels, extrapolated from two divisions."""
    at = (np.arange(N_PIXELS) + 0.5) * SIDE / N_PIXELS - SIDE / 2
    y, x = np.meshgrid(-at, at, indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -1.0)])
    coarse, fine = (Cube(2.0, ALBEDOS, POWER, LAMP, n).indirect(FLOOR, points) for n in (5, 10))
    radiance = (fine + (fine - coarse) / 3.0) * ALBEDOS[FLOOR] / np.pi
    return block_means(radiance.reshape(N_PIXELS, N_PIXELS, 3))


def rendered(objects=(), camera=CAMERA, **options):
    scene = pr.Scene([*coloured_walls(ALBEDOS), *objects], [pr.PointEmitter(LAMP, POWER)], camera)
    options = {"n_global": 20_000, "supersampling": 1, **options}
    return pr.render(scene, components=("indirect",), **options).layers["indirect"]


@pytest.mark.kernels_run_elsewhere
def test_noise_of_a_smooth_wall_is_at_most_a_quarter(exact):
    found, gathered = (rendered(final_gather=n, n_global=100_000) for n in (0, 16))
    noise, less = (np.sqrt(np.mean((block_means(each) - exact) ** 2)) for each in (found, gathered))
    assert less <= noise / 4.0
    np.testing.assert_allclose(block_means(gathered), exact, rtol=0.03)


@pytest.mark.kernels_run_elsewhere
def test_corners_and_glass_are_as_without_it():
    """Where much is near, and rays meet glass and a mirror: means of the whole image agree."""
    objects = [
        pr.SceneObject(ball(0.3, [0.3, 0.3, -0.6]), pr.Dielectric(), smooth=True),
        pr.SceneObject(ball(0.3, [-0.5, -0.5, -0.6]), pr.Mirror(), smooth=True),
    ]
    found, gathered = (
        rendered(objects, SMALL, final_gather=n, n_global=50_000).mean(axis=(0, 1)) for n in (0, 16)
    )
    np.testing.assert_allclose(gathered, found, rtol=0.03)


def test_it_does_not_depend_on_threads():
    one, two = (rendered(camera=SMALL, final_gather=4, n_threads=n) for n in (1, 2))
    np.testing.assert_array_equal(one, two)


def test_seeds_are_other_rays():
    one, other = (rendered(camera=SMALL, final_gather=1, seed=seed) for seed in (0, 1))
    assert (one != other).any()


@pytest.mark.parametrize("n", [-1, 10**9, 2.5])
def test_numbers_of_rays_that_make_no_sense_are_refused(n):
    with pytest.raises((TypeError, ValueError), match="final_gather"):
        rendered(final_gather=n)
