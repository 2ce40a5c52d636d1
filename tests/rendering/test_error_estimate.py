"""Estimates of error: from fewer photons, and of each component of light."""

import numpy as np
import pytest

from photonrelax.imaging.image import Image
from photonrelax.rendering.error_estimate import (
    Earlier,
    Falls,
    estimate_error,
    estimated,
    photon_falls,
)

SHAPE = (256, 128, 3)
TRUTH = 1.0 + np.random.default_rng(5).random(SHAPE)
PATTERN = np.random.default_rng(6).standard_normal(SHAPE)
OTHER_PATTERN = np.random.default_rng(7).standard_normal(SHAPE)
N = 500
WIDER, SAME = Falls(2.0, 2.0, 1.0), Falls(1.0, 1.0, 0.0)


def values_of(seed, *, noise=1.0, bias=1.0, pattern=PATTERN):
    """Truth with independent noise, and a bias that is always the same."""
    drawn = np.random.default_rng(seed).standard_normal(SHAPE)
    return TRUTH + (noise * drawn + bias * pattern) / np.sqrt(N)


def three(noise, bias, falls=WIDER, first_seed=1):
    """Two images of a quarter of the photons, and one of all, whose noise and bias are given."""
    more = {"noise": noise * falls.variance**0.5, "bias": bias * falls.bias}
    # Their biases differ by as much as the falls say.
    alike = (falls.bias**2 + 1.0 - falls.difference**2) / (2.0 * falls.bias)
    pattern = alike * PATTERN + (1.0 - min(alike, 1.0) ** 2) ** 0.5 * OTHER_PATTERN
    seeds = range(first_seed, first_seed + 2)
    quarters = [values_of(seed, **more, pattern=pattern) for seed in seeds]
    return [*quarters, values_of(first_seed + 2, noise=noise, bias=bias)]


def error_of_mean(images, weight):
    mean = weight * images[2] + (1.0 - weight) * 0.5 * (images[0] + images[1])
    return np.abs(mean - TRUTH).sum() / TRUTH.sum()


@pytest.mark.parametrize(("noise", "bias"), [(1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (0.2, 1.0)])
@pytest.mark.parametrize("falls", [WIDER, photon_falls(0.3), photon_falls(0.6)])
def test_the_estimate_is_the_error_of_the_mean(noise, bias, falls):
    images = three(noise, bias, falls)
    found = estimate_error(*images, falls)
    # Where there is none, noise of a percent in squares is told as a bias of a third of the noise.
    rel = 0.1 if bias else 0.2
    assert found.total == pytest.approx(error_of_mean(images, found.weight), rel=rel)
    assert found.total == pytest.approx(np.hypot(found.noise, found.bias))


def test_no_other_mean_is_better():
    images = three(1.0, 0.7)
    weight = estimate_error(*images, WIDER).weight
    others = [error_of_mean(images, weight + step) for step in (-0.2, 0.2)]
    assert error_of_mean(images, weight) < min(others)


def test_noise_alone_weighs_all_photons_alike_and_bias_alone_takes_the_most():
    assert estimate_error(*three(1.0, 0.0), WIDER).weight == pytest.approx(0.5, abs=0.1)
    bias = [values_of(1, noise=0.0, bias=each) for each in (2.0, 2.0, 1.0)]
    assert estimate_error(*bias).weight == 1.0


def test_shadow_rays_that_are_as_many_in_all_images_count_alike():
    images = three(1.0, 0.0, SAME)
    found = estimate_error(*images, SAME)
    assert found.weight == pytest.approx(1.0 / 3.0)
    assert found.total == pytest.approx(error_of_mean(images, found.weight), rel=0.05)


def test_black_images_have_no_error():
    assert estimate_error(*np.zeros((3, *SHAPE))).total == 0.0


@pytest.mark.parametrize("is_apart", [True, False])
def test_errors_of_components_add_up_to_that_of_radiance(is_apart):
    caustic, indirect = three(1.0, 0.5, photon_falls(0.3)), three(2.0, 0.0, first_seed=4)
    left = (np.arange(SHAPE[1]) < SHAPE[1] // 2)[:, np.newaxis]
    places = (left, ~left) if is_apart else (True, True)
    images = []
    for one, other in zip(caustic, indirect, strict=True):
        one, other = places[0] * one, places[1] * other
        layers = {"radiance": one + other, "caustic": one, "indirect": other}
        images.append(Image(layers))
    found, parts, image = estimated(*images, "radiance")
    truth = places[0] * TRUTH + places[1] * TRUTH
    error = np.abs(image.layers["radiance"] - truth).sum() / truth.sum()
    assert found.total == pytest.approx(error, rel=0.15)
    assert set(parts) == {"caustic", "indirect"}
    total = image.layers["caustic"] + image.layers["indirect"]
    np.testing.assert_allclose(image.layers["radiance"], total)


def test_biases_of_caustics_fall_as_fast_as_their_differences_did():
    images = [Image({"radiance": v, "caustic": v}) for v in three(0.5, 1.0, photon_falls(0.5))]
    first, parts, _ = estimated(*images, "radiance")
    difference = parts["caustic"].difference

    def bias(exponent, ratio=8.0):
        before = Earlier(ratio, {"caustic": difference * ratio**exponent})
        return estimated(*images, "radiance", before)[0].bias

    assert bias(0.6) < bias(0.4) < bias(0.25) <= first.bias
    assert bias(0.4, ratio=5.0) == pytest.approx(bias(0.4))
    # What is so near tells less.
    assert bias(0.4) < bias(0.4, ratio=1.5) < first.bias
    assert bias(-1.0) == first.bias
    nothing = estimated(*images, "radiance", Earlier(8.0, {}))[0]
    assert nothing == first
