"""Area emitters that are mirrors or glass: what they emit counts once, and they reflect light."""

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.rendering.layers import band_layers
from photonrelax.rendering.view import View
from photonrelax.transport.direct_light import LightSamples, direct_irradiance
from photonrelax.transport.raycast import RayCaster
from tests.helpers.tracing_scenes import box, floor, sheet

CAMERA = pr.Camera((0, -4, 1), (0, 0, 1), width=16, height=16, vertical_fov=10.0)
BALL = pr.Sphere((0, 0, 1), 0.5)
RADIANCE = np.array([3.0, 2.0, 1.0])
SPECULAR = {
    "mirror": pr.Mirror(0.5),
    "glass": pr.Dielectric(1.5),
}


@pytest.fixture(params=SPECULAR)
def material(request):
    return SPECULAR[request.param]


def lamp(material, **options):
    return pr.AreaEmitter(BALL, radiance=RADIANCE, material=material, **options)


def emission(emitters, objects=()):
    aside = pr.SceneObject(box([0.1] * 3, [-3, 0, 1]), pr.Diffuse(0.0))
    scene = pr.Scene([aside, *objects], emitters, CAMERA)
    return band_layers(next(View(scene, max_depth=16).bands()))["emission"]


def test_a_lamp_is_seen_with_what_it_reflects_and_transmits(material):
    """In a furnace of radiance 2, glass has 2 more than it emits, half a mirror 1 more.

    In means over 16 x 16 pixels: some rays stay in the facets of glass for long.
    """
    more = 2.0 if material.has_inside else 1.0
    seen = emission([lamp(material), pr.EnvironmentEmitter(2.0)])
    np.testing.assert_allclose(seen.mean(axis=(0, 1)), RADIANCE + more, rtol=0.01)
    np.testing.assert_allclose(emission([lamp(material)])[8, 8], RADIANCE, rtol=1e-9)


def test_the_order_of_emitters_does_not_matter(material):
    lights = [pr.EnvironmentEmitter(2.0), lamp(material), pr.PointEmitter((0, 0, 9))]
    np.testing.assert_allclose(emission(lights), emission(lights[::-1]), rtol=1e-12)


def test_a_lamp_is_seen_once_in_another_mirror(material):
    """A mirror across the view turns it to the lamp, which is outside of the picture."""
    mirror = sheet(0.5)
    mirror.apply_transform([[1, 0, 0, 0], [0, 1, -1, 0], [0, 1, 1, 1], [0, 0, 0, 1]])
    above = pr.AreaEmitter(pr.Sphere((0, 0, 4), 1.0), radiance=RADIANCE, material=material)
    seen = emission([above], [pr.SceneObject(mirror, pr.Mirror(0.8))])
    np.testing.assert_allclose(seen[8, 8], 0.8 * RADIANCE, rtol=1e-6)


@pytest.mark.kernels_run_elsewhere
def test_direct_light_and_photons_are_those_of_a_black_lamp(material):
    """Where nothing sends light back to the lamp, its material does not matter."""
    at = np.array([[0.0, 0, 0], [1.5, 0, 0]]), np.tile([0.0, 0, 1], (2, 1))
    found = {}
    for which in (material, pr.Diffuse(0.0)):
        scene = pr.Scene([floor(albedo=0.0)], [lamp(which)])
        caster = RayCaster(scene.surfaces)
        light = direct_irradiance(scene, caster, *at, samples=LightSamples(2000))
        photons = pr.trace_photons(scene, 20_000, paths="all")
        on_floor = photons.flux[photons.object_id == 0].sum(axis=0)
        found[type(which)] = light, on_floor
    (light, flux), (expected, expected_flux) = found.values()
    np.testing.assert_array_equal(light, expected)
    np.testing.assert_allclose(flux, expected_flux, rtol=1e-9)


def test_a_lamp_makes_caustics_of_other_light_as_an_object_does(material):
    sun = pr.CollimatedEmitter((0.3, 0, -1), (1.0, 2.0, 4.0))
    item = pr.SceneObject(BALL.mesh(), material)
    alone = pr.trace_photons(pr.Scene([floor(), item], [sun]), 50_000)
    both = pr.trace_photons(pr.Scene([floor()], [sun, lamp(material)]), (50_000, 1000))
    of_sun = both.flux[both.emitter_id == 0].sum(axis=0)
    np.testing.assert_allclose(of_sun, alone.flux.sum(axis=0), rtol=0.01)


def test_a_lone_lamp_has_no_caustic_and_renders(material):
    scene = pr.Scene([floor()], [lamp(material)], CAMERA)
    planned = pr.plan(scene, n_emitted=20_000)
    assert not planned.models("caustic")
    image = pr.render(scene, n_emitted=20_000)
    assert image.layers["direct"].any() or image.layers["emission"].any()


def test_all_light_of_a_furnace_is_counted_once():
    """Between a white room and a mirror lamp in it, L = a E / π with E of the closed form.

    The lamp emits Φ, and absorbs half of what it meets.
    """
    reflectance, albedo, side = 0.5, 0.6, 4.0
    power = 10.0
    room = pr.SceneObject(box([side] * 3), pr.Diffuse(albedo))
    ball = pr.Sphere((0, 0, 0), 0.5)
    light = pr.AreaEmitter(ball, power=power, material=pr.Mirror(reflectance))
    scene = pr.Scene([room], [light])
    photons = pr.trace_photons(scene, 200_000, paths="all")
    incident = photons.flux[:, 0].sum()
    # Light that leaves the walls meets the ball in the ratio of areas, a convex body's mean.
    share = 4 * np.pi * 0.5**2 / (6 * side**2)
    # What the walls get: the lamp's, and what they scatter less what the ball absorbs.
    expected = power / (1.0 - albedo * (1.0 - share * (1.0 - reflectance)))
    assert incident == pytest.approx(expected, rel=0.01)


@pytest.mark.kernels_run_elsewhere
def test_spectra_relaxing_and_final_gathers_know_specular_lamps(material):
    sun = pr.CollimatedEmitter((0.3, 0, -1))
    scene = pr.Scene([floor()], [sun, lamp(material)], CAMERA)
    photons = pr.trace_photons(scene, 5000, frequency_share=0.5)
    moved = pr.relax(photons, pr.detect_structure(photons), scene=scene)
    assert np.isfinite(moved.position).all()
    image = pr.render(scene, n_emitted=5000, final_gather=4)
    assert np.isfinite(image.layers["radiance"]).all()
