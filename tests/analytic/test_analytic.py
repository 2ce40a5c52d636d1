"""The oracles themselves: limits, sums and special cases known without them."""

import numpy as np
import pytest

from tests.analytic.glass_sphere import GlassSphere
from tests.analytic.interface import fresnel_reflectance, refraction_angle
from tests.analytic.metal_ring import MetalRing
from tests.analytic.slab import slab_reflectance, slab_transmittance

ANGLES = np.radians([0.0, 20.0, 56.0, 80.0, 89.0])
DOWNWARD_ORDERS = range(-1, 12)


def test_fresnel_at_normal_incidence_is_the_textbook_value():
    assert fresnel_reflectance(0.0, 1.5) == pytest.approx(0.04)


def test_fresnel_is_the_same_from_both_sides():
    inside = refraction_angle(ANGLES, 1.5)
    np.testing.assert_allclose(
        fresnel_reflectance(ANGLES, 1.5), fresnel_reflectance(inside, 1 / 1.5), rtol=1e-12
    )


def test_at_brewster_angle_only_the_perpendicular_half_reflects():
    brewster = np.arctan(1.5)
    perpendicular = np.sin(brewster - refraction_angle(brewster, 1.5)) ** 2
    assert fresnel_reflectance(brewster, 1.5) == pytest.approx(perpendicular / 2)


@pytest.mark.parametrize("angle", ANGLES)
def test_clear_slab_loses_nothing(angle):
    assert slab_transmittance(1.5, angle) + slab_reflectance(1.5, angle) == pytest.approx(1)


def test_slab_at_normal_incidence_is_2n_over_n_squared_plus_1():
    assert slab_transmittance(1.5) == pytest.approx(2 * 1.5 / (1.5**2 + 1))


def test_slab_equals_its_reflections_added_one_by_one():
    reflectance = fresnel_reflectance(0.7, 1.5)
    path = 0.2 / np.cos(refraction_angle(0.7, 1.5))
    passes = [reflectance ** (2 * m) * np.exp(-3.0 * path * (2 * m + 1)) for m in range(30)]
    expected = (1 - reflectance) ** 2 * sum(passes)
    assert slab_transmittance(1.5, 0.7, absorption=3.0, thickness=0.2) == pytest.approx(expected)


def test_slab_of_nothing_is_invisible():
    assert slab_transmittance(1.0, 1.0) == pytest.approx(1)


def test_sphere_of_nothing_leaves_the_light_alone():
    sphere = GlassSphere(ior=1.0, irradiance=2.0)
    edges = np.linspace(0, 1, 11)
    np.testing.assert_allclose(sphere.annulus_irradiance(edges), 2.0, rtol=1e-4)
    np.testing.assert_allclose(sphere.irradiance_at(np.array([0.3, 0.8])), 2.0, rtol=1e-4)


def test_sphere_sends_on_what_it_intercepts():
    impact = np.linspace(0, 0.999, 50)
    weights = sum(GlassSphere().landing(impact, order)[1] for order in range(-1, 400))
    np.testing.assert_allclose(weights, 1.0, rtol=1e-9)


@pytest.mark.parametrize("reflections", [0, 1, 2, 3])
def test_sphere_landing_equals_vector_ray_tracing(reflections):
    sphere = GlassSphere(radius=2.0, gap=0.7, ior=1.6)
    impacts = np.linspace(0.1, 1.9, 7)
    expected = [trace_through_sphere(impact, sphere, reflections) for impact in impacts]
    np.testing.assert_allclose(sphere.landing(impacts, reflections)[0], expected, atol=1e-10)


def test_light_off_the_outside_lands_beyond_45_degrees_only():
    position, _ = GlassSphere().landing(np.array([0.70, 0.72]), -1)
    assert np.isnan(position[0])
    assert position[1] > 10


def test_sphere_focuses_paraxial_rays_at_the_ball_lens_focal_length():
    # Effective focal length nR / (2(n-1)) from the centre: 1.5 for n = 1.5.
    position, _ = GlassSphere(gap=0.5).landing(np.array([1e-4]))
    assert abs(position[0]) < 1e-9


def test_sphere_profile_agrees_with_annulus_means_away_from_folds():
    sphere = GlassSphere(gap=0.2)
    at = np.array([0.1, 0.2, 0.6])
    annuli = np.ravel([[r - 0.004, r + 0.004] for r in at])
    means = sphere.annulus_irradiance(annuli, orders=DOWNWARD_ORDERS)[::2]
    np.testing.assert_allclose(sphere.irradiance_at(at, orders=DOWNWARD_ORDERS), means, rtol=2e-3)


def test_ring_conserves_flux():
    ring = MetalRing(elevation=np.radians(40), irradiance=3.0)
    _, flux = ring.deposits()
    assert flux.sum() == pytest.approx(ring.lit_flux(), rel=1e-4)


def test_ring_lights_the_floor_evenly_across_its_axis():
    edges = np.linspace(-1, 1, 41)
    image = MetalRing(elevation=np.radians(40)).pixel_irradiance(edges)
    np.testing.assert_allclose(image[:, ::-1].sum(0), image.sum(0), rtol=2e-3)


@pytest.fixture(scope="module")
def high_ring():
    ring = MetalRing(height=1.2, elevation=np.radians(30), irradiance=2.0)
    return ring, *ring.deposits(4_000_000)


@pytest.mark.parametrize("run", [0.3, 0.75, 1.0, 1.5])
def test_ring_on_its_axis_equals_the_mirror_equation(run, high_ring):
    # Light that ran s from the wall at azimuth a has E₀ sin e / |1 - 2s / (R cos a)|. A point on
    # the axis sees a = 0 and, beyond the cusp at R/2, also the azimuths ±a with cos a = R / 2x.
    ring, landed, flux = high_ring
    x = ring.radius - run
    expected = 1 / abs(1 - 2 * run)
    if x > 0.5:
        expected += 2 / abs(1 - (2 * x) ** 2)
    near = (np.abs(landed - [x, 0.0]) < 0.01).all(axis=1)
    assert flux[near].sum() / 0.02**2 == pytest.approx(2.0 * 0.5 * expected, rel=0.02)


def test_ring_at_points_agrees_with_pixel_means_away_from_folds():
    ring = MetalRing(height=0.4, elevation=np.radians(28), irradiance=1.6, reflectance=0.95)
    landed, flux = ring.deposits(2_000_000)
    points = np.array([[0.85, 0.0], [0.85, 0.3], [0.75, 0.3], [0.7, -0.1], [0.2, 0.0], [0.6, 0.2]])
    x, y = np.ascontiguousarray(landed.T)
    near = [(np.abs(x - at[0]) < 0.01) & (np.abs(y - at[1]) < 0.01) for at in points]
    means = np.array([flux[each].sum() for each in near]) / 0.02**2
    assert (means == 0.0).sum() == 2
    np.testing.assert_allclose(ring.irradiance_at(points), means, rtol=0.015)


def test_dark_ring_reflects_by_its_reflectance():
    bright, dim = (MetalRing(height=0.3, reflectance=r).deposits()[1].sum() for r in (1.0, 0.25))
    assert dim == pytest.approx(0.25 * bright, rel=1e-2)


def trace_through_sphere(impact: float, sphere: GlassSphere, reflections: int = 0) -> float:
    """Landing points, as of `landing`, by rotation of 2-D vectors; NaN if upward."""
    centre_height = sphere.radius + sphere.gap
    point = np.array([impact, np.sqrt(sphere.radius**2 - impact**2)])
    heading = refracted(np.array([0.0, -1.0]), point / sphere.radius, 1 / sphere.ior)
    for step in range(reflections + 1):
        point = point - 2 * (point @ heading) * heading
        outward = point / sphere.radius
        if step < reflections:
            heading = heading - 2 * (heading @ outward) * outward
    heading = refracted(heading, -outward, sphere.ior)
    if heading[1] >= 0:
        return np.nan
    return float(point[0] - (centre_height + point[1]) / heading[1] * heading[0])


def refracted(heading, normal, index_ratio):
    """Refract a unit vector at a surface whose normal faces it."""
    cosine = -heading @ normal
    sine_squared = index_ratio**2 * (1 - cosine**2)
    return index_ratio * heading + (index_ratio * cosine - np.sqrt(1 - sine_squared)) * normal
