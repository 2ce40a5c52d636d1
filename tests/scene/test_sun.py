"""A sun is one emitter, of the same radiance all over: its light, penumbrae and caustics."""

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax.scene.emission_region import DISK
from photonrelax.transport.direct_light import LightSamples, direct_irradiance
from photonrelax.transport.emission import emit, plan_emission
from photonrelax.transport.raycast import RayCaster
from tests.helpers.tracing_scenes import ball, floor, sheet

IRRADIANCE = np.array([1.0, 2.0, 3.0])
SLANTED = np.array([0.6, 0.0, -0.8])


def sun(angle, direction=(0, 0, -1)):
    return pr.CollimatedEmitter(direction, IRRADIANCE, angular_radius=angle)


def direct(scene, position, n, **samples):
    up = np.tile([0.0, 0, 1], (len(position), 1))
    light = LightSamples(n, **samples)
    return direct_irradiance(scene, RayCaster(scene.objects), position, up, samples=light)


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("angle", [1e-4, 0.266, 5.0, 60.0])
def test_a_plate_that_faces_the_sun_gets_its_irradiance(angle):
    plate = pr.SceneObject(sheet(5.0), pr.Diffuse(0.0))
    scene = pr.Scene([plate], [sun(angle)])
    photons = pr.trace_photons(scene, 600_000, paths="all")
    # The flux that crosses the sphere of the target, of which the plate is a great circle.
    around = np.pi * scene.bounding_sphere().radius ** 2 * 2 / (1 + np.cos(np.radians(angle)))
    np.testing.assert_allclose(photons.ledger.emitted[0], around * IRRADIANCE, rtol=1e-9)
    inside = (np.abs(photons.position[:, :2]) < 2.5).all(axis=1)
    np.testing.assert_allclose(photons.flux[inside].sum(axis=0) / 25.0, IRRADIANCE, rtol=3e-3)
    np.testing.assert_allclose(direct(scene, np.zeros((1, 3)), 4096)[0], IRRADIANCE, rtol=1e-3)


@pytest.mark.parametrize("sampler", ["halton", "random"])
def test_directions_are_uniform_over_the_sun(sampler):
    angle = np.radians(8.0)
    n = 20_000
    plan = plan_emission(pr.Scene([floor()], [sun(8.0, SLANTED)]), n, "all", sampler=sampler)
    rays = emit(plan, 0, range(n))
    drop = np.sort(1.0 - rays.direction @ SLANTED) / (1.0 - np.cos(angle))
    limit = 2e-3 if sampler == "halton" else 0.015
    np.testing.assert_allclose(drop, (np.arange(n) + 0.5) / n, atol=limit)
    across = rays.direction[:, 1], rays.direction @ np.cross(SLANTED, [0, 1, 0])
    for k in (1, 2):
        assert np.abs(np.exp(1j * k * np.arctan2(*across)).mean()) < 2 * limit
    # Directions and places across the light are independent.
    for coordinate in rays.emitter_coords.T:
        assert np.abs(np.corrcoef(coordinate, across)[0, 1:]).max() < 2 * limit


def test_a_sun_without_radius_is_parallel_light():
    scene = pr.Scene([floor(), pr.SceneObject(ball(0.5, (0, 0, 1)), pr.Mirror())], [sun(0.0)])
    plan = plan_emission(scene, 1000)
    assert [region.kind for region in plan.regions] == [DISK]
    photons = pr.trace_photons(scene, 1000)
    assert photons.well_spaced
    assert photons.extended_ids is None


def test_a_tiny_sun_agrees_with_parallel_light():
    photons = [pr.trace_photons(_ring(angle), 50_000) for angle in (0.0, 1e-4)]
    np.testing.assert_allclose(photons[1].position, photons[0].position, atol=2e-5)
    np.testing.assert_allclose(photons[1].emitter_density, photons[0].emitter_density, rtol=1e-9)
    points = photons[0].position[::50]
    up = np.tile([0.0, 0, 1], (len(points), 1))
    # Well spaced or not, the estimate of relaxed photons is the same; suns have no map.
    fields = [pr.irradiance_field(each, method="parameterised") for each in photons]
    E = [field(points, up)[:, 0] for field in fields]
    assert np.abs(E[1] - E[0]).sum() < 0.01 * E[0].sum()


def _ring(angle):
    ring = pr.gallery.scene("ring")
    emitter = ring.emitters[0]
    light = pr.CollimatedEmitter(emitter.direction, emitter.irradiance, angular_radius=angle)
    return pr.Scene(ring.objects, [light], ring.camera)


@pytest.mark.kernels_run_elsewhere
def test_the_ring_under_a_sun_of_a_degree():
    """Relative L1 over cells of the floor within the ring, against ten times as many photons."""
    cells, half = 48, 1.05

    def histogram(photons):
        flux, _, _ = np.histogram2d(
            *photons.position[:, 1::-1].T,
            bins=cells,
            range=[[-half, half]] * 2,
            weights=photons.flux[:, 0],
        )
        return flux / (2 * half / cells) ** 2

    expected = histogram(pr.trace_photons(_ring(1.0), 2_000_000, seed=1))
    field = pr.irradiance_field(pr.trace_photons(_ring(1.0), 200_000))
    origin, u, v = (-half, -half, 0), (2 * half, 0, 0), (0, 2 * half, 0)
    E = pr.irradiance_map(field, origin, u, v, (cells, cells))[..., 0]
    assert np.abs(E - expected).sum() < 0.15 * expected.sum()


def test_photons_of_a_sun_are_not_well_spaced_and_have_no_map(tmp_path):
    photons = pr.trace_photons(_ring(1.0), 5000)
    assert not photons.well_spaced
    assert photons.emitter_coords.shape == (len(photons), 2)
    assert photons.extended_ids.tolist() == [0]
    photons.save(tmp_path / "sun.npz")
    assert pr.PhotonMap.load(tmp_path / "sun.npz").extended_ids.tolist() == [0]
    rest = pr.rest_density(photons)
    assert not rest.has_map.any()
    assert (rest.slope == 0.0).all()
    assert np.isinf(rest.limit).all()


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("angle", [2.0, 12.0])
@pytest.mark.parametrize("gap", [0.25, 1.0])
def test_casters_that_lie_apart_are_aimed_at_by_themselves(angle, gap):
    """Two balls, one above the other or beside it; regions count once where rays meet both."""
    balls = [ball(0.1, (x, 0, z)) for x, z in ((0, 0.2), (gap, 1.2), (-2.0, 1.0))]
    mirrors = [pr.SceneObject(each, pr.Mirror()) for each in balls]
    scene = pr.Scene([floor(), *mirrors], [sun(angle)])
    assert len(plan_emission(scene, 100_000).regions) == 3
    aimed = pr.trace_photons(scene, 100_000, sampler="random")
    whole = pr.trace_photons(scene, 800_000, paths="all", sampler="random", seed=1)
    caustic = whole.subset(np.isin(whole.path_signature, aimed.path_signature))
    noise = np.hypot(*(1 / np.sqrt(len(each)) for each in (aimed, caustic)))
    assert aimed.flux[:, 0].sum() / caustic.flux[:, 0].sum() == pytest.approx(1, abs=5 * noise)
    middle = [each.subset(each.position[:, 0] > gap / 2) for each in (aimed, caustic)]
    noise = np.hypot(*(1 / np.sqrt(len(each)) for each in middle))
    ratio = middle[0].flux[:, 0].sum() / middle[1].flux[:, 0].sum()
    assert ratio == pytest.approx(1, abs=5 * noise)


def lit_share(x, height, angle):
    """Share of a sun at the zenith that is seen past an edge, from a distance before it.

    The projected sun is a disk of radius sin of the angle; the edge cuts it along the ellipse of a
    great circle.
    """
    y = ((np.arange(20_000) + 0.5) / 10_000 - 1.0) * np.sin(angle)
    rim = np.sqrt(np.sin(angle) ** 2 - y**2)
    cut = -np.multiply.outer(np.sin(np.arctan(x / height)), np.sqrt(1.0 - y**2))
    return (rim - np.clip(cut, -rim, rim)).sum(axis=-1) / rim.sum() / 2.0


def behind_an_edge(angle):
    """A floor under a sheet that ends at x = 0, 1 m above it."""
    corners = [[-9, -9, 1], [0, -9, 1], [0, 9, 1], [-9, 9, 1]]
    roof = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    return pr.Scene([floor(20.0), pr.SceneObject(roof, pr.Diffuse(0.0))], [sun(angle)])


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("angle", [0.266, 1.0, 20.0])
def test_the_penumbra_behind_an_edge_is_the_closed_form(angle):
    x = np.linspace(-1.3, 1.3, 31) * np.tan(np.radians(angle))
    position = np.column_stack([x, 0.1 * x, 0.0 * x])
    E = direct(behind_an_edge(angle), position, 8192)
    share = lit_share(x, 1.0, np.radians(angle))
    np.testing.assert_allclose(E / IRRADIANCE, np.tile(share, (3, 1)).T, atol=3e-3)


def test_samples_of_a_pixel_are_one_even_sequence_of_its_seed():
    scene, pixel = behind_an_edge(1.0), np.repeat(np.arange(500), 4)
    position = np.tile([0.002, 0.0, 0.0], (2000, 1))
    E = direct(scene, position, 20, pixel=pixel)[:, 0]
    together = direct(scene, position[:500], 80, pixel=np.arange(500))[:, 0]
    np.testing.assert_allclose(E.reshape(500, 4).mean(axis=1), together, rtol=1e-12)
    np.testing.assert_array_equal(direct(scene, position, 20, pixel=pixel)[:, 0], E)
    assert (direct(scene, position, 20, pixel=pixel, seed=1)[:, 0] != E).any()
    # The default is 80 a pixel.
    assert together.std() < 0.02


def above_the_edge(angle):
    camera = pr.Camera((0, 0, 0.5), (0, 0, 0), (0, 1, 0), width=48, height=48, vertical_fov=5.0)
    scene = behind_an_edge(angle)
    glass = pr.SceneObject(ball(0.1, (5, 5, 1)), pr.Dielectric())
    return pr.Scene([*scene.objects, glass], scene.emitters, camera)


def test_noise_of_an_image_is_below_two_per_cent_of_a_pixel():
    image = pr.render(above_the_edge(1.0), method="standard", n_emitted=2000)
    pixel = 2 * 0.5 * np.tan(np.radians(2.5)) / 48
    edges = (np.arange(48) - 23.5) * pixel
    expected = lit_share(edges, 1.0, np.radians(1.0)) * 0.8 / np.pi
    error = image.layers["direct"][..., 0] - expected
    assert np.sqrt(np.mean(error**2)) < 0.02 * 0.8 / np.pi
    assert "light_samples" in image.metadata["photonrelax.settings"]
    finer = pr.render(above_the_edge(1.0), method="standard", n_emitted=2000, light_samples=200)
    error_of_finer = finer.layers["direct"][..., 0] - expected
    assert np.mean(error_of_finer**2) < 0.25 * np.mean(error**2)


def test_lights_without_extent_are_not_sampled():
    one, other = (
        pr.render(above_the_edge(0.0), method="standard", n_emitted=2000, light_samples=n)
        for n in (None, 9)
    )
    np.testing.assert_array_equal(one.layers["direct"], other.layers["direct"])
    assert "light_samples" not in one.metadata["photonrelax.settings"]


@pytest.mark.parametrize("angle", [-0.1, 90.0, np.nan])
def test_angles_that_no_sun_has_are_refused(angle):
    with pytest.raises(ValueError, match="angular_radius should be"):
        sun(angle)


def test_photons_of_a_sun_can_carry_spectra():
    photons = pr.trace_photons(_ring(1.0), 500, frequency_share=1.0)
    assert np.isfinite(photons.spectrum).all(axis=1).mean() > 0.9
