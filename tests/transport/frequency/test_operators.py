"""Operators against light fields transformed ray by ray; radii against the bias they bound."""

from fractions import Fraction

import numpy as np
import pytest

from photonrelax.transport.frequency import operators
from photonrelax.transport.frequency.operators import (
    COSINE_LOBE,
    deposited,
    diffused,
    kernel_radius,
    occluded,
    root,
)

ONE = np.ones(1)
# Wave packets in (x, θ), of unit size: centre, axes, wave, weight.
PACKETS = [
    ([0.3, -0.2], [[1.0, 0.3], [0.3, 0.8]], [0.2, 0.1], 1.0),
    ([-0.4, 0.5], [[0.7, -0.2], [-0.2, 1.5]], [-0.1, 0.3], 0.6),
]
INCIDENCE = 0.7


def carried(spectrum, operator):
    """Spectra after an operator: K Σ Kᵀ."""
    return operator @ spectrum @ np.swapaxes(operator, -1, -2)


def light(x, theta):
    total = np.zeros(np.broadcast(x, theta).shape)
    for centre, axes, wave, weight in PACKETS:
        v = np.stack([x - centre[0], theta - centre[1]])
        square = np.einsum("i...,ij,j...->...", v, np.array(axes), v)
        phase = np.einsum("i,i...->...", wave, v)
        total += weight * np.exp(-0.5 * square) * np.cos(2 * np.pi * phase)
    return total


def moments(field, size=(1.0, 1.0), n=512, reach=24.0):
    """Σ of a light field: the second moments of the amplitude of its FFT, (1, 2, 2).

    The field is sampled to `reach` times its sizes.
    """
    step = 2 * reach / n
    grid = (np.arange(n) - n // 2) * step
    sampled = field(*np.meshgrid(grid * size[0], grid * size[1], indexing="ij"))
    amplitude = np.abs(np.fft.fft2(sampled))
    # What remains of sampling is no part of the light.
    amplitude[amplitude < 1e-9 * amplitude.max()] = 0.0
    omega = np.meshgrid(*(np.fft.fftfreq(n, step * s) for s in size), indexing="ij")
    second = np.array([[(u * v * amplitude).sum() for u in omega] for v in omega])
    return second[np.newaxis] / amplitude.sum()


def assert_carries(operator, transformed, size=(1.0, 1.0), size_out=None, rtol=1e-4):
    """`transformed` is the light field of size `size` after the event."""
    before = moments(lambda x, theta: light(x / size[0], theta / size[1]), size)
    after = moments(transformed, size_out or size)
    scale = np.sqrt(np.einsum("nii->ni", after))
    limit = rtol * scale[:, :, None] * scale[:, None, :]
    assert (np.abs(carried(before, operator) - after) <= limit).all()
    # A test that anything passes would be none.
    assert not (np.abs(before - after) <= 10 * limit).all()


def test_propagation_shears_the_angles_frequencies():
    assert_carries(operators.propagate(0.8 * ONE), lambda x, theta: light(x - 0.8 * theta, theta))


def test_a_tilted_surface_stretches_space():
    assert_carries(operators.project(0.6 * ONE), lambda x, theta: light(0.6 * x, theta))


def test_a_turning_normal_shears_spaces_frequencies():
    bend = np.full((1, 1, 1), 0.5)
    assert_carries(operators.curvature(bend), lambda x, theta: light(x, theta - 0.5 * x))


def test_angles_scale():
    assert_carries(
        operators.scale_angles(np.full((1, 1), 1.4)), lambda x, theta: light(x, theta / 1.4)
    )


@pytest.mark.parametrize("radius", [1.0, -1.7])
def test_a_mirror_is_reflection_at_a_circle(radius):
    """Size 1e-3 makes the circle's own second order a thousandth."""

    def transformed(x, theta):
        return light(*(v / 1e-3 for v in before_mirror(x, theta, radius)))

    operator = operators.reflect(np.cos(INCIDENCE) * ONE, np.full((1, 1, 1), 1 / radius))
    assert_carries(operator, transformed, (1e-3, 1e-3), rtol=5e-3)


def test_a_plane_mirror_changes_nothing():
    operator = operators.reflect(np.cos(INCIDENCE) * ONE, np.zeros((1, 1, 1)))
    np.testing.assert_allclose(operator[0], np.eye(2), atol=1e-15)


@pytest.mark.parametrize("radius", [1.0, -1.7, 1e3])
@pytest.mark.parametrize("ratio", [1 / 1.5, 1.3])
def test_an_interface_is_snells_law_at_a_circle(radius, ratio):
    def transformed(x, theta):
        return light(*(v / 1e-3 for v in before_interface(x, theta, radius, ratio)))

    cosine_out = np.sqrt(1 - (ratio * np.sin(INCIDENCE)) ** 2)
    operator = operators.refract(
        np.cos(INCIDENCE) * ONE, cosine_out * ONE, ratio * ONE, np.full((1, 1, 1), 1 / radius)
    )
    assert_carries(operator, transformed, (1e-3, 1e-3), rtol=5e-3)


def before_mirror(x, theta, radius):
    """(x, θ), before it is reflected, of the ray that leaves a circle as (x, θ)."""
    i = INCIDENCE
    direction = rotated((np.sin(i), np.cos(i)), (np.cos(i), -np.sin(i)), theta)
    point, normal = on_circle(
        x * np.array((np.cos(i), -np.sin(i)))[:, None, None], direction, radius
    )
    incoming = direction - 2 * (direction * normal).sum(axis=0) * normal
    return across(point, incoming)


def before_interface(x, theta, radius, ratio):
    i = INCIDENCE
    j = np.arcsin(ratio * np.sin(i))
    direction = rotated((np.sin(j), -np.cos(j)), (np.cos(j), np.sin(j)), theta)
    point, normal = on_circle(
        x * np.array((np.cos(j), np.sin(j)))[:, None, None], direction, radius
    )
    up = (direction * normal).sum(axis=0)
    tangential = (direction - up * normal) / ratio
    incoming = tangential - np.sqrt(1 - (tangential**2).sum(axis=0)) * normal
    return across(point, incoming)


def rotated(ahead, aside, theta):
    ahead, aside = (np.array(v)[:, None, None] for v in (ahead, aside))
    return np.cos(theta) * ahead + np.sin(theta) * aside


def on_circle(start, direction, radius):
    """Intersections of lines and a circle through the origin, below it (above, if negative)."""
    offset = start - np.array([0.0, -radius])[:, None, None]
    b, c = (offset * direction).sum(axis=0), (offset**2).sum(axis=0) - radius**2
    # The root near zero, without cancellation.
    root = np.sqrt(b**2 - c)
    point = start - c / (b + np.sign(b) * root) * direction
    return point, (point - np.array([0.0, -radius])[:, None, None]) / radius


def across(point, incoming):
    """(x, θ) of rays relative to the one that arrives at the origin."""
    i = INCIDENCE
    ahead = np.array([np.sin(i), -np.cos(i)])[:, None, None]
    aside = np.array([np.cos(i), np.sin(i)])[:, None, None]
    along = (incoming * ahead).sum(axis=0)
    there = point - (point * ahead).sum(axis=0) / along * incoming
    return (there * aside).sum(axis=0), np.arctan2((incoming * aside).sum(axis=0), along)


GAUSSIAN = np.array([[[0.05, 0.02], [0.02, 0.06]]])


def gaussian_light(x, theta, covariance=GAUSSIAN[0]):
    """The light field of a spectrum: Q = 4π² Σ."""
    q = 4 * np.pi**2 * covariance
    return np.exp(-0.5 * (q[0, 0] * x**2 + 2 * q[0, 1] * x * theta + q[1, 1] * theta**2))


def test_a_spectrum_is_the_transform_of_its_light_field():
    np.testing.assert_allclose(moments(gaussian_light), GAUSSIAN, rtol=1e-6)


@pytest.mark.parametrize("angular", [False, True])
def test_occlusion_convolves_with_the_spectrum_of_a_window(angular):
    distance = 1.3
    width = distance / np.sqrt(2)

    def windowed(x, theta):
        return gaussian_light(x, theta) * np.exp(-0.5 * ((theta if angular else x) / width) ** 2)

    after = occluded(GAUSSIAN, distance * ONE, angular=angular)
    np.testing.assert_allclose(moments(windowed), after, rtol=1e-6)
    assert (after != GAUSSIAN).any()


def test_a_deposit_is_the_slice_without_angular_frequency():
    """Of light in a narrow range of angles the cosine is one, and its lobe hardly matters."""
    narrow = np.array([[0.05, 0.4], [0.4, 6.0]])
    x = np.linspace(-40, 40, 2001)
    theta = np.linspace(-1.5, 1.5, 3001)
    irradiance = gaussian_light(x[:, None], theta, narrow).sum(axis=1)
    amplitude = np.abs(np.fft.fft(irradiance))
    omega = np.fft.fftfreq(len(x), x[1] - x[0])
    measured = (omega**2 * amplitude).sum() / amplitude.sum()
    a, b, c = narrow[0, 0], narrow[1, 1], narrow[0, 1]
    assert a - c**2 / b == pytest.approx(measured, rel=1e-6)
    assert kept_of(narrow) == pytest.approx(measured, rel=0.02)


def test_the_cosine_blurs_the_slice():
    """Of light from all directions the lobe decides; it is cos θ that is integrated here."""
    wide = np.array([[0.05, 0.02], [0.02, 0.03]])
    x = np.linspace(-40, 40, 2001)
    theta = np.linspace(-np.pi / 2, np.pi / 2, 2001)
    irradiance = (gaussian_light(x[:, None], theta, wide) * np.cos(theta)).sum(axis=1)
    # By its width rather than its tails, where cos θ and its Gaussian differ.
    spread = (x**2 * irradiance).sum() / irradiance.sum()
    kept = kept_of(wide)
    assert kept == pytest.approx(1 / (4 * np.pi**2 * spread), rel=0.03)
    assert 0.9 * kept > 0.05 - 0.02**2 / 0.03


def kept_of(matrix):
    slices, _ = deposited(root(matrix[np.newaxis]))
    return slices[0, 0, 0] ** 2


def test_what_is_reflected_has_no_angular_frequency():
    np.testing.assert_array_equal(diffused(np.array([[0.4, 6.0, -0.3]])), [[0.4, 0.0, 0.0]])


def test_the_roughest_section_has_the_largest_slice_of_all():
    rng = np.random.default_rng(3)
    factor = rng.normal(size=(50, 4, 4))
    spectra = factor @ np.swapaxes(factor, 1, 2)
    kept, b, c = operators.roughest(factor).T
    lobe = spectra[:, 2:, 2:] + COSINE_LOBE * np.eye(2)
    mixed = spectra[:, :2, 2:]
    slices = spectra[:, :2, :2] - mixed @ np.linalg.inv(lobe) @ np.swapaxes(mixed, 1, 2)
    values, vectors = np.linalg.eigh(slices)
    np.testing.assert_allclose(kept, values[:, 1], rtol=1e-9)
    t = vectors[:, :, 1]
    a = np.einsum("ni,nij,nj->n", t, spectra[:, :2, :2], t)
    np.testing.assert_allclose(a - c**2 / (b + COSINE_LOBE), kept, rtol=1e-9)


@pytest.mark.parametrize("focal_length", [0.25, 0.03, 0.003, 0.001, 1e-4])
def test_slices_of_parallel_light_beyond_a_focus_are_exact(focal_length):
    """A window of 0.3 f, a mirror and 1 m of travel, in fractions instead of floating point."""
    rng = np.random.default_rng(1)
    focal, distance = focal_length * rng.uniform(0.9, 1.1, 40), rng.uniform(0.8, 1.2, 40)
    beam = np.zeros((40, 4, 4))
    beam[:, [2, 3], [2, 3]] = 1.0 / (4.0 * np.pi**2 * 1e-12)
    beam = occluded(beam, 0.3 * focal)
    mirror = operators.reflect(np.ones(40), np.eye(2) * (-0.5 / focal)[:, None, None])
    there = operators.propagate(distance, 2) @ mirror @ root(beam)
    exact = [beyond_a_mirror(*each) for each in zip(beam, focal, distance, strict=True)]
    np.testing.assert_allclose(operators.roughest(there)[:, 0], exact, rtol=1e-9)


def beyond_a_mirror(beam, focal, distance):
    a, b, lobe = Fraction(beam[0, 0]), Fraction(beam[2, 2]), Fraction(COSINE_LOBE)
    power, d = 1 / Fraction(focal), Fraction(distance)
    stretch = 1 - d * power
    mixed = d * a - power * stretch * b
    return float(a + power**2 * b - mixed**2 / (d**2 * a + stretch**2 * b + lobe))


def test_a_point_lights_smoothly_from_afar_and_a_parallel_beam_keeps_its_pattern():
    dot, lobe = 1e8, 0.5
    far = carried(np.diag([dot, lobe])[np.newaxis], operators.propagate(3.0 * ONE))
    assert slice_of(far) == pytest.approx(lobe / 3.0**2, rel=1e-6)
    pattern, parallel = 0.3, 1e8
    same = carried(np.diag([pattern, parallel])[np.newaxis], operators.propagate(3.0 * ONE))
    assert slice_of(same) == pytest.approx(pattern, rel=1e-6)


def test_a_concave_mirror_shrinks_a_pattern_towards_its_focus():
    beam = np.diag([0.3, 1e8])[np.newaxis]
    mirror = operators.reflect(ONE, np.full((1, 1, 1), -0.5))  # focal length 1
    for distance in (0.5, 0.9, 1.5, 3.0):
        there = carried(carried(beam, mirror), operators.propagate(distance * ONE))
        assert slice_of(there) == pytest.approx(0.3 / (1 - distance) ** 2, rel=1e-6)
    focus = carried(carried(beam, mirror), operators.propagate(ONE))
    assert slice_of(focus) == pytest.approx(1e8, rel=1e-6)


def slice_of(matrix):
    return matrix[0, 0, 0] - matrix[0, 0, 1] ** 2 / matrix[0, 1, 1]


def disc_mean(irradiance, centre, radius, n=400):
    """Mean over discs, by midpoints in r² and azimuth."""
    r = radius * np.sqrt((np.arange(n) + 0.5) / n)
    turn = 2 * np.pi * (np.arange(64) + 0.5) / 64
    x = centre[:, None, None] + r[:, None] * np.cos(turn)
    y = r[:, None] * np.sin(turn)
    return irradiance(x, y).mean(axis=(1, 2))


@pytest.mark.parametrize("frequency", [0.5, 3.0])
def test_radii_keep_the_bias_of_a_sine_below_five_percent(frequency):
    radius = kernel_radius(np.array([frequency**2]))[0]
    x = np.linspace(0, 1 / frequency, 41)

    def wave(x, y):
        return 1.0 + np.cos(2 * np.pi * frequency * x)

    bias = np.abs(disc_mean(wave, x, radius) - wave(x, 0.0))
    # The amplitude is one; half of the five percent are for variation across.
    assert 0.02 < bias.max() < 0.05

    def egg_box(x, y):
        return 1.0 + np.cos(2 * np.pi * frequency * x) * np.cos(2 * np.pi * frequency * y)

    bias = np.abs(disc_mean(egg_box, x, radius) - egg_box(x, 0.0))
    assert 0.04 < bias.max() <= 0.05


@pytest.mark.parametrize("flat", [True, False])
@pytest.mark.parametrize("width", [0.1, 2.0])
def test_radii_keep_the_bias_of_a_gaussian_below_five_percent(width, flat):
    radius = kernel_radius(np.array([1 / (4 * np.pi**2 * width**2)]))[0]
    x = np.linspace(-3 * width, 3 * width, 61)

    def bump(x, y):
        return np.exp(-(x**2 + (0.0 if flat else y**2)) / (2 * width**2))

    bias = np.abs(disc_mean(bump, x, radius) - bump(x, 0.0))
    assert (0.02 if flat else 0.04) < bias.max() <= 0.05


@pytest.mark.parametrize("distance", [0.01, 1.0])
def test_windows_keep_kernels_off_edges_and_away_from_folds(distance):
    """At a fold light at u lands at u²/2, stretched by u, with irradiance 1/u: relative bias."""
    stretch = distance
    beam = occluded(np.diag([0.0, 1e12])[np.newaxis], distance * ONE)
    radius = kernel_radius(np.array([slice_of(beam) / stretch**2]))[0]
    place = np.array([distance**2 / 2])
    bias = disc_mean(lambda x, y: 1 / np.sqrt(2 * x), place, radius) * distance - 1
    assert 0.04 < bias[0] <= 0.05
    assert kernel_radius(occluded(np.zeros((1, 2, 2)), distance * ONE)[:, 0, 0])[0] < distance


def test_light_without_frequencies_has_no_limit():
    assert kernel_radius(np.zeros(1))[0] == np.inf
    assert np.isnan(diffused(np.full((1, 3), np.nan))[0, 0])
