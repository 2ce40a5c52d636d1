"""A spot has glTF's falloff, and its cone the flux that it is given."""

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.transport.direct_light import direct_irradiance
from photonrelax.transport.emission import emit, plan_emission
from photonrelax.transport.raycast import RayCaster
from tests.helpers.tracing_scenes import ball, floor

POWER = np.array([1.0, 2.0, 3.0])
INNER, OUTER = 12.0, 30.0
CONE = pr.SpotEmitter((0, 0, 2), (0, 0, -1), POWER, INNER, OUTER)


def falloff(angle):
    """That of KHR_lights_punctual, as its text has it."""
    inner, outer = np.cos(np.radians([INNER, OUTER]))
    return np.clip((np.cos(angle) - outer) / (inner - outer), 0.0, 1.0) ** 2


def on_axis():
    """Intensity over power: one over the integral of the falloff, by quadrature."""
    angle = (np.arange(200_000) + 0.5) / 200_000 * np.pi / 2
    return 1.0 / np.sum(2 * np.pi * np.sin(angle) * falloff(angle) * np.pi / 2 / 200_000)


def irradiance(x):
    """Closed form on the floor, 2 m below the spot, at a distance from its axis."""
    angle = np.arctan(x / 2.0)
    return np.multiply.outer(on_axis() * falloff(angle) * np.cos(angle) ** 3 / 4.0, POWER)


def test_direct_light_of_a_spot_is_its_intensity_over_the_squared_distance():
    scene = pr.Scene([floor()], [CONE])
    x = np.linspace(0.0, 2.0, 50)
    position, up = np.outer(x, [0.6, 0.8, 0.0]), np.tile([0.0, 0, 1], (50, 1))
    direct = direct_irradiance(scene, RayCaster(scene.objects), position, up)
    np.testing.assert_allclose(direct, irradiance(x), rtol=1e-8, atol=0)
    assert (direct[x > 2 * np.tan(np.radians(OUTER))] == 0.0).all()


def test_the_flux_of_the_cone_is_the_power():
    photons = pr.trace_photons(pr.Scene([floor()], [CONE]), 10_000, paths="all")
    np.testing.assert_allclose(photons.ledger.emitted[0], POWER, rtol=1e-12)
    np.testing.assert_allclose(photons.flux[photons.n_bounces == 0][0], POWER / 10_000)


@pytest.mark.parametrize("inner", [0.0, INNER, 29.9])
def test_photons_bring_the_irradiance_of_direct_light(inner):
    """Flux within circles on the floor, of 200,000 evenly spaced photons: to 0.3 %."""
    spot = pr.SpotEmitter((0, 0, 2), (0, 0, -1), 1.0, inner, OUTER)
    scene = pr.Scene([floor(albedo=0.0)], [spot])
    photons = pr.trace_photons(scene, 200_000, paths="all")
    r = (np.arange(2000) + 0.5) / 2000 * 1.2
    position, up = np.outer(r, [1.0, 0, 0]), np.tile([0.0, 0, 1], (2000, 1))
    direct = direct_irradiance(scene, RayCaster(scene.objects), position, up)[:, 0]
    within = np.cumsum(direct * 2 * np.pi * r * 1.2 / 2000)
    distance = np.linalg.norm(photons.position[:, :2], axis=1)
    for i in range(199, 2000, 200):
        flux = photons.flux[distance < r[i] + 0.3e-3, 0].sum()
        assert flux == pytest.approx(within[i], rel=3e-3)
    np.testing.assert_allclose(within[-1], 1.0, rtol=1e-5)


def test_density_follows_the_intensity():
    photons = pr.trace_photons(pr.Scene([floor(albedo=0.0)], [CONE]), 10_000, paths="all")
    angle = np.arccos(-photons.emitter_coords[:, 2])
    inside = angle < np.radians(29)
    expected = 10_000 * on_axis() * falloff(angle)
    np.testing.assert_allclose(photons.emitter_density[inside], expected[inside], rtol=1e-6)
    assert (photons.emitter_density > 0.0).all()


def two_mirrors(gap):
    balls = [ball(0.1, (x, 0, 1)) for x in (-gap / 2, gap / 2)]
    return [floor(), *(pr.SceneObject(each, pr.Mirror()) for each in balls)]


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("gap", [0.25, 0.9, 1.3])
@pytest.mark.parametrize("sampler", ["halton", "random"])
def test_photons_aimed_at_casters_meet_them_as_those_of_the_whole_cone(gap, sampler):
    """Flux of caustics on the floor, against the specular light among all of it."""
    scene = pr.Scene(two_mirrors(gap), [CONE])
    aimed = pr.trace_photons(scene, 100_000, sampler=sampler)
    whole = pr.trace_photons(scene, 400_000, paths="all", sampler="random")
    caustic = whole.subset(np.isin(whole.path_signature, aimed.path_signature))
    noise = np.hypot(*(1 / np.sqrt(len(each)) for each in (aimed, caustic)))
    ratio = aimed.flux[:, 0].sum() / caustic.flux[:, 0].sum()
    assert ratio == pytest.approx(1.0, abs=5 * noise)
    assert len(aimed) / 100_000 > 4 * len(caustic) / 400_000
    assert aimed.ledger.emitted[0, 0] < 0.3 * POWER[0]


def test_a_spot_that_turns_away_from_the_caster_sends_nothing():
    away = pr.SpotEmitter((0, 0, 2), (0, 0, 1), outer_angle=90.0)
    with pytest.raises(ValueError, match="no power or face away"):
        pr.trace_photons(pr.Scene(two_mirrors(0.5), [away]), 1000)


@pytest.mark.parametrize("outer", [1e-4, 1.0, 90.0])
def test_cones_of_all_widths_have_their_power(outer):
    spot = pr.SpotEmitter((0, 0, 2), (0, 0, -1), 1.0, outer_angle=outer)
    plan = plan_emission(pr.Scene([floor()], [spot]), 5000, "all")
    rays = emit(plan, 0, range(5000))
    np.testing.assert_allclose(plan.flux[0], 1.0, rtol=1e-12)
    widest = np.linalg.norm(rays.direction[:, :2], axis=1).max()
    assert widest == pytest.approx(np.sin(np.radians(outer)), rel=0.1)
    assert widest <= np.sin(np.radians(outer)) * (1 + 1e-12)


@pytest.mark.parametrize("angles", [(30.0, 30.0), (-1.0, 30.0), (40.0, 30.0), (0.0, 91.0)])
def test_angles_out_of_order_are_refused(angles):
    with pytest.raises(ValueError, match=r"0 <= inner < outer <= 90, but are"):
        pr.SpotEmitter((0, 0, 2), (0, 0, -1), 1.0, *angles)


def test_photons_of_a_spot_can_carry_spectra():
    photons = pr.trace_photons(pr.Scene(two_mirrors(0.5), [CONE]), 500, frequency_share=1.0)
    assert np.isfinite(photons.spectrum).any(axis=1).mean() > 0.9
