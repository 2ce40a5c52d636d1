"""Lamps with a size: their light against closed forms, and what they look like."""

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax.scene.digest import scene_digest
from photonrelax.transport.direct_light import LightSamples, direct_irradiance
from photonrelax.transport.emission import plan_emission
from photonrelax.transport.raycast import RayCaster
from tests.helpers.aimed_light import assert_aimed_light_is_that_of_all_paths
from tests.helpers.tracing_scenes import ball, floor, sheet

RADIANCE = np.array([1.0, 2.0, 3.0])
PANEL = pr.Rectangle((0, 0, 2), (0.5, 0, 0), (0, -0.3, 0))


def direct(scene, position, normal=(0.0, 0, 1), n=16384):
    """Irradiance (m, 3) at points, from n samples at some copies of each, which share a pixel."""
    copies = min(n, 256)
    position = np.repeat(np.asarray(position, dtype=float), copies, axis=0)
    normals = np.tile(np.asarray(normal, dtype=float), (len(position), 1))
    pixel = np.arange(len(position), dtype=np.int64) // copies
    samples = LightSamples(n // copies, pixel=pixel)
    caster = RayCaster(scene.surfaces)
    found = direct_irradiance(scene, caster, position, normals, samples=samples)
    return found.reshape(-1, copies, 3).mean(axis=1)


def under_a_corner(a, b, height):
    """Irradiance over radiance below a corner of an a × b rectangle that faces down."""
    x, y = a / height, b / height
    u, v = np.sqrt(1 + x * x), np.sqrt(1 + y * y)
    return 0.5 * (x / u * np.arctan(y / u) + y / v * np.arctan(x / v))


def under_the_panel(x, y):
    """Sum of signed corners, for points below PANEL, 2 m above them."""
    total = 0.0
    for a in (0.5 - x, 0.5 + x):
        for b in (0.3 - y, 0.3 + y):
            total += np.sign(a * b) * under_a_corner(abs(a), abs(b), 2.0)
    return total


def test_a_rectangle_lights_a_plate_by_its_form_factor():
    scene = pr.Scene([floor()], [pr.AreaEmitter(PANEL, radiance=RADIANCE)])
    position = np.array([[0.0, 0, 0], [0.2, 0.1, 0], [1.0, -0.7, 0], [3.0, 2.0, 0]])
    expected = [under_the_panel(x, y) for x, y, _ in position]
    E = direct(scene, position) / RADIANCE
    np.testing.assert_allclose(E, np.tile(expected, (3, 1)).T, rtol=3e-3)


@pytest.mark.parametrize("radius", [0.2, 1.0])
def test_a_sphere_lights_a_plate_like_a_point_of_its_outline(radius):
    """E = π L (R/d)² cos θ where all of the sphere is above the plate's horizon."""
    lamp = pr.AreaEmitter(pr.Sphere((0, 0, 2), radius), radiance=RADIANCE)
    scene = pr.Scene([floor()], [lamp])
    position = np.array([[0.0, 0, 0], [0.4, 0.3, 0], [0.0, -1.5, 0]])
    squared = np.square(position - [0, 0, 2]).sum(axis=1)
    expected = np.pi * radius**2 / squared * 2.0 / np.sqrt(squared)
    E = direct(scene, position) / RADIANCE
    np.testing.assert_allclose(E, np.tile(expected, (3, 1)).T, rtol=3e-3)


def test_a_disk_lights_the_point_below_its_middle():
    """E = π L R² / (R² + h²)."""
    lamp = pr.AreaEmitter(pr.Disk((0, 0, 2), (0, 0, -1), 0.7), radiance=1.0)
    E = direct(pr.Scene([floor()], [lamp]), np.zeros((1, 3)))[0, 0]
    assert pytest.approx(np.pi * 0.49 / 4.49, rel=3e-3) == E


def test_any_mesh_emits_on_the_side_of_its_normals():
    panel = sheet(0.5, z=2.0)  # faces up
    above, below = np.array([[0.0, 0, 3]]), np.array([[0.0, 0, 1]])
    for two_sided in (False, True):
        scene = pr.Scene([floor()], [pr.AreaEmitter(panel, radiance=1.0, two_sided=two_sided)])
        up = 4 * under_a_corner(0.5, 0.5, 1.0)
        assert direct(scene, above, (0, 0, -1))[0, 0] == pytest.approx(up, rel=3e-3)
        expected = up if two_sided else 0.0
        assert direct(scene, below)[0, 0] == pytest.approx(expected, rel=3e-3)


@pytest.mark.parametrize("two_sided", [False, True])
@pytest.mark.parametrize("shape", [PANEL, pr.Sphere((0, 0, 2), 0.3)], ids=["panel", "sphere"])
def test_power_is_what_leaves_the_surface(shape, two_sided):
    lamp = pr.AreaEmitter(shape, power=RADIANCE, two_sided=two_sided)
    scene = pr.Scene([floor(40.0, 0.0)], [lamp])
    photons = pr.trace_photons(scene, 100_000, paths="all")
    np.testing.assert_allclose(photons.ledger.emitted[0], RADIANCE, rtol=5e-3)
    np.testing.assert_allclose(photons.flux, np.tile(photons.flux[0], (len(photons), 1)))
    area = 0.6 if shape is PANEL else 4 * np.pi * 0.09
    sides = 2 if two_sided else 1
    np.testing.assert_allclose(lamp.emitted_radiance, RADIANCE / (np.pi * sides * area), rtol=1e-9)


def test_photons_bring_the_irradiance_of_direct_light():
    scene = pr.Scene([floor(8.0, 0.0)], [pr.AreaEmitter(PANEL, radiance=1.0)])
    photons = pr.trace_photons(scene, 200_000, paths="all")
    edges = np.linspace(-1.5, 1.5, 4)
    flux, _, _ = np.histogram2d(
        *photons.position[:, :2].T, bins=(edges, edges), weights=photons.flux[:, 0]
    )
    middle = (np.arange(60) + 0.5) / 20 - 1.5
    exact = np.array([[under_the_panel(x, y) for y in middle] for x in middle])
    expected = exact.reshape(3, 20, 3, 20).mean(axis=(1, 3))
    np.testing.assert_allclose(flux, expected, rtol=0.02)
    assert photons.emitter_density.min() > 0.0


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("shape", [PANEL, pr.Sphere((0, 0, 2), 0.3)], ids=["panel", "sphere"])
@pytest.mark.parametrize("gap", [0.5, 3.0])
def test_photons_aimed_at_casters_are_those_of_the_whole_surface(shape, gap):
    balls = [ball(0.15, (x, 0.1, 1)) for x in (-gap / 2, gap / 2)]
    mirrors = [pr.SceneObject(each, pr.Mirror()) for each in balls]
    scene = pr.Scene([floor(albedo=0.0), *mirrors], [pr.AreaEmitter(shape, power=1.0)])
    aimed, caustic = assert_aimed_light_is_that_of_all_paths(scene)
    assert len(aimed) / 50_000 > 3 * len(caustic) / 400_000


def test_a_lamp_that_faces_away_from_the_casters_sends_nothing():
    away = pr.AreaEmitter(pr.Disk((0, 0, 2), (0, 0, 1), 0.5), power=1.0)
    scene = pr.Scene([floor(), pr.SceneObject(ball(0.3, (0, 0, 1)), pr.Mirror())], [away])
    with pytest.raises(ValueError, match="no power or face away"):
        plan_emission(scene, 1000)
    lamps = [away, pr.PointEmitter((0, 0, 3))]
    assert plan_emission(pr.Scene(scene.objects, lamps), 1000).counts.tolist() == [0, 1000]


def test_a_lamp_occludes_and_stores_photons_under_an_id_of_its_own():
    lamp = pr.AreaEmitter(PANEL, power=1.0, material=pr.Diffuse(0.5))
    lights = [pr.PointEmitter((0, 0, 4)), lamp]
    mirror = pr.SceneObject(ball(0.3, (0, 0, 1)), pr.Mirror())
    scene = pr.Scene([floor(), mirror], lights)
    assert direct(pr.Scene([floor(), mirror], lights[:1]), [[0.6, 0, 0]])[0, 0] > 0.0
    shadowed = pr.Scene([floor()], [lights[0], pr.AreaEmitter(PANEL, radiance=0.0)])
    assert direct(shadowed, [[0.6, 0, 0]], n=1)[0, 0] == 0.0
    photons = pr.trace_photons(scene, 20_000)
    assert set(np.unique(photons.object_id)) == {0, 2 + 1}
    on_lamp = photons.position[photons.object_id == 3]
    np.testing.assert_allclose(on_lamp[:, 2], 2.0, atol=1e-9)
    relaxed = pr.relax(photons, pr.detect_structure(photons), scene=scene)
    np.testing.assert_allclose(relaxed.position[photons.object_id == 3, 2], 2.0, atol=1e-9)
    other = photons.replace(object_id=np.full(len(photons), 2))
    structure = pr.detect_structure(other)
    with pytest.raises(ValueError, match="object_id should be of the scene's 2 objects"):
        pr.relax(other, structure, scene=scene)


def room(lamp):
    """A lamp, 2 m up, above a mirror on the floor; seen from between them."""
    mirror = pr.SceneObject(sheet(1.0, z=0.1), pr.Mirror((0.5, 0.5, 0.5)))
    return [pr.SceneObject(sheet(4.0), pr.Diffuse(0.8)), mirror], [lamp]


def pictured(lamp, target, **size):
    camera = pr.Camera((0, 0, 1), target, (0, 1, 0), width=16, height=16, vertical_fov=10.0, **size)
    return pr.render(pr.Scene(*room(lamp), camera), method="standard", n_emitted=2000)


def test_cameras_see_lamps_directly_and_in_mirrors():
    lamp = pr.AreaEmitter(PANEL, radiance=RADIANCE)
    above, below = (pictured(lamp, (0, 0, z)) for z in (2, 0))
    np.testing.assert_allclose(above.layers["emission"], np.tile(RADIANCE, (16, 16, 1)))
    np.testing.assert_allclose(below.layers["emission"], np.tile(0.5 * RADIANCE, (16, 16, 1)))
    for image in (above, below):
        parts = [image.layers[name] for name in ("emission", "direct", "caustic")]
        np.testing.assert_allclose(image.layers["radiance"], sum(parts))


def test_the_back_of_a_lamp_is_dark_unless_it_is_two_sided():
    back = pr.Rectangle((0, 0, 2), (0.5, 0, 0), (0, 0.3, 0))
    for two_sided in (False, True):
        lamp = pr.AreaEmitter(back, radiance=RADIANCE, two_sided=two_sided)
        objects, _ = room(lamp)
        camera = pr.Camera((0, 0, 1), (0, 0, 2), (0, 1, 0), width=8, height=8, vertical_fov=10.0)
        scene = pr.Scene(objects, [lamp, pr.PointEmitter((1, 0, 1))], camera)
        image = pr.render(scene, method="standard", n_emitted=2000)
        expected = two_sided * RADIANCE
        np.testing.assert_allclose(image.layers["emission"], np.tile(expected, (8, 8, 1)))


def test_noise_of_a_lamps_shadow_is_below_two_per_cent_of_a_pixel():
    """The default's RMS difference from many samples, over the light without the shadow."""
    edge = sheet(1.0, z=1.0)
    edge.apply_translation((1.0, 0, 0))
    glass = pr.SceneObject(ball(0.1, (5, 5, 1)), pr.Dielectric())
    camera = pr.Camera((0, 0, 0.5), (0, 0, 0), (0, 1, 0), width=24, height=24, vertical_fov=60.0)
    lamp = pr.AreaEmitter(PANEL, power=10.0)
    objects = [floor(), pr.SceneObject(edge, pr.Diffuse(0.0)), glass]
    images = [
        pr.render(
            pr.Scene(objects, [lamp], camera),
            method="standard",
            n_emitted=2_000,
            n_global=0,
            light_samples=n,
        ).layers["direct"]
        for n in (None, 1000)
    ]
    unshadowed = images[1].max()
    assert 0.0 < images[1].min() < 0.5 * unshadowed
    assert np.sqrt(np.mean((images[0] - images[1]) ** 2)) < 0.02 * unshadowed


def test_scenes_without_surfaces_that_emit_have_no_layer_of_emission():
    image = pr.render(pr.gallery.scene("ring", pixels=8, sections=64), n_emitted=2000)
    assert "emission" not in image.layers


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "one of radiance and power should be given"),
        ({"radiance": 1.0, "power": 1.0}, "one of radiance and power should be given"),
        ({"power": -1.0}, "power should"),
        ({"power": 1.0, "material": pr.Sensor()}, "material should not be a Sensor"),
        ({"power": 1.0, "material": pr.Dielectric()}, "closed and shine on its outside.*4 open"),
    ],
)
def test_errors_say_what_would_do(given, message):
    with pytest.raises(ValueError, match=message):
        pr.AreaEmitter(PANEL, **given)
    with pytest.raises(TypeError, match=r"mesh should be a trimesh\.Trimesh, but is str"):
        pr.AreaEmitter("panel", power=1.0)


def test_digests_tell_shapes_apart():
    def digest(shape):
        return scene_digest(pr.Scene([floor()], [pr.AreaEmitter(shape, power=1.0)]))

    one, other = trimesh.creation.box((1, 1, 1)), trimesh.creation.box((1, 1, 2))
    assert digest(one) == digest(one.copy()) != digest(other)
    assert digest(pr.Sphere((0, 0, 1), 1.0)) != digest(pr.Sphere((0, 0, 1), 2.0))


def test_photons_of_a_lamp_can_carry_spectra():
    mirror = pr.SceneObject(ball(0.3, (0, 0, 1)), pr.Mirror())
    scene = pr.Scene([floor(), mirror], [pr.AreaEmitter(PANEL, power=1.0)])
    photons = pr.trace_photons(scene, 500, frequency_share=1.0)
    assert np.isfinite(photons.spectrum).any(axis=1).mean() > 0.9
