"""Errors of images are what their definitions say."""

import sys

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from photonrelax.imaging import metrics


@pytest.fixture
def pair():
    """A smooth image on a display, and the same with noise."""
    rng = np.random.default_rng(5)
    smooth = gaussian_filter(rng.random((40, 30, 3)), (4, 4, 0))
    reference = (smooth - smooth.min()) / np.ptp(smooth)
    return np.clip(reference + rng.normal(0, 0.1, reference.shape), 0, 1), reference


def test_relative_errors_are_sums_over_sums(pair):
    image, reference = pair
    difference = (image - reference).ravel()
    l1 = sum(map(abs, difference)) / reference.sum()
    l2 = np.sqrt((difference**2).mean() / (reference**2).mean())
    assert metrics.relative_l1(image, reference) == pytest.approx(l1)
    assert metrics.relative_l2(image, reference) == pytest.approx(l2)


@pytest.mark.parametrize("factor", [0.0, 0.75, 1.0, 3.0])
def test_a_brighter_image_errs_by_its_share(pair, factor):
    image = factor * pair[1]
    assert metrics.energy_bias(image, pair[1]) == pytest.approx(factor - 1.0)
    for error in (metrics.relative_l1, metrics.relative_l2):
        assert error(image, pair[1]) == pytest.approx(abs(factor - 1.0))


def test_moving_light_is_an_error_but_no_bias():
    reference = np.zeros((4, 4, 3))
    reference[1, 1] = 2.0
    image = np.roll(reference, 1, axis=0)
    assert metrics.energy_bias(image, reference) == 0.0
    assert metrics.relative_l1(image, reference) == pytest.approx(2.0)
    assert metrics.relative_l2(image, reference) == pytest.approx(np.sqrt(2.0))


def test_ssim_is_the_mean_of_wangs_index(pair):
    """Eq. 13 of Wang et al. 2004 by Gaussian moments, where the window is inside the image."""

    def local(values):
        return gaussian_filter(values, (1.5, 1.5, 0), truncate=3.5)

    x, y = pair
    mean_x, mean_y = local(x), local(y)
    var_x, var_y = local(x * x) - mean_x**2, local(y * y) - mean_y**2
    covariance = local(x * y) - mean_x * mean_y
    index = (2 * mean_x * mean_y + 0.01**2) * (2 * covariance + 0.03**2)
    index /= (mean_x**2 + mean_y**2 + 0.01**2) * (var_x + var_y + 0.03**2)
    assert metrics.ssim(x, y) == pytest.approx(index[5:-5, 5:-5].mean(), rel=1e-9)


def test_images_that_are_the_same_are_alike(pair):
    assert metrics.ssim(pair[1], pair[1]) == pytest.approx(1.0)
    assert (metrics.flip_map(pair[1], pair[1]) == 0.0).all()


def test_flip_is_largest_between_green_and_blue():
    """The two colours of a display that are farthest apart define FLIP's one."""
    green, blue = np.zeros((2, 20, 30, 3))
    green[..., 1] = blue[..., 2] = 1.0
    found = metrics.flip_map(green, blue)
    assert found.shape == (20, 30)
    np.testing.assert_allclose(found, 1.0, atol=2e-3)


def test_flip_is_seen_where_the_images_differ_and_near_it():
    reference = np.full((120, 120, 3), 0.5)
    image = reference.copy()
    image[50:70, 50:70] = 0.8
    found = metrics.flip_map(image, reference)
    # What flip-evaluator makes of sRGB values; taken for linear ones they would give 0.394.
    assert found[60, 60] == pytest.approx(0.6026, abs=1e-3)
    assert found[:30].max() < 1e-3
    np.testing.assert_allclose(found, metrics.flip_map(reference, image), atol=1e-5)


def test_more_noise_is_farther(pair):
    image, reference = pair
    nearer = 0.5 * (image + reference)
    assert metrics.flip_map(nearer, reference).mean() < metrics.flip_map(image, reference).mean()
    assert metrics.ssim(nearer, reference) > metrics.ssim(image, reference)


@pytest.mark.parametrize("error", [metrics.relative_l1, metrics.relative_l2, metrics.energy_bias])
def test_errors_relative_to_nothing_are_refused(error, pair):
    with pytest.raises(ValueError, match="reference should not be black"):
        error(pair[0], np.zeros_like(pair[0]))
    with pytest.raises(ValueError, match="image"):
        error(pair[0][:-1], pair[1])


@pytest.mark.parametrize("measure", [metrics.ssim, metrics.flip_map])
def test_what_no_display_shows_is_refused(measure, pair):
    with pytest.raises(ValueError, match=r"image should hold display values in \[0, 1\]"):
        measure(2.0 * pair[0], pair[1])


def test_ssim_needs_room_for_its_window():
    with pytest.raises(ValueError, match="at least 11 x 11 pixels"):
        metrics.ssim(np.ones((10, 30, 3)), np.ones((10, 30, 3)))


@pytest.mark.parametrize(
    ("module", "package"), [("skimage", "scikit-image"), ("flip_evaluator", "flip-evaluator")]
)
def test_a_missing_library_is_named_with_the_extra_that_installs_it(module, package, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(
        ImportError, match=rf"needs {package}: pip install 'photonrelax\[compare\]'"
    ):
        metrics.check_installed()
