"""Environments by a latitude-longitude map, against closed forms and the constant environment."""

import pickle

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.rendering.layers import band_layers, with_radiance
from photonrelax.rendering.view import View
from photonrelax.scene.camera import pixel_rays
from photonrelax.scene.digest import scene_digest
from photonrelax.scene.sky_map import LUMINANCE
from photonrelax.transport.direct_light import LightSamples, direct_irradiance
from photonrelax.transport.emission import plan_emission
from photonrelax.transport.raycast import RayCaster
from tests.helpers.aimed_light import assert_aimed_light_is_that_of_all_paths
from tests.helpers.tracing_scenes import ball, box, floor, sheet

HEIGHT, WIDTH = 90, 180
COLOUR = np.array([1.0, 2.0, 3.0])


def texel_directions(height=HEIGHT, width=WIDTH):
    """Unit vectors (h, w, 3) to the middles of texels, as the map is defined."""
    polar = np.pi * (np.arange(height) + 0.5) / height
    azimuth = np.pi * (1.0 - 2.0 * (np.arange(width) + 0.5) / width)
    sine, cosine = np.sin(polar)[:, None], np.cos(polar)[:, None]
    return np.stack(
        np.broadcast_arrays(sine * np.cos(azimuth), sine * np.sin(azimuth), cosine), axis=-1
    )


TOWARDS = texel_directions()


def sky_of(values):
    """An environment of the radiance values (h, w) or (h, w, 3)."""
    values = np.asarray(values, dtype=float)
    return pr.EnvironmentEmitter(values if values.ndim == 3 else values[..., None] * COLOUR)


def direct_on_plate(sky, normal=(0.0, 0.0, 1.0), n=4096):
    """Irradiance (3,) at a point of a small plate of a normal."""
    scene = pr.Scene([pr.SceneObject(sheet(0.01), pr.Diffuse())], [sky])
    at = np.array([[0.0, 0.0, 1.0]]), np.array([normal])
    return direct_irradiance(scene, RayCaster(scene.surfaces), *at, samples=LightSamples(n))[0]


def photons_on_plate(sky, n=100_000, **options):
    """Irradiance (3,) that photons bring to the upper side of a plate, and all photons."""
    plate = pr.Scene([pr.SceneObject(sheet(1.0), pr.Diffuse(0.0))], [sky])
    photons = pr.trace_photons(plate, n, paths="all", **options)
    return photons.flux[photons.normal[:, 2] > 0.0].sum(axis=0) / 4.0, photons


def test_a_sky_by_the_cosine_lights_a_plate_with_two_thirds_pi():
    """The integral of cos² over the upper hemisphere; texels are fine enough for 0.1 %."""
    sky = sky_of(np.maximum(TOWARDS[..., 2], 0.0))
    np.testing.assert_allclose(direct_on_plate(sky), 2 * np.pi / 3 * COLOUR, rtol=3e-3)
    found, _ = photons_on_plate(sky)
    np.testing.assert_allclose(found, 2 * np.pi / 3 * COLOUR, rtol=5e-3)


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("towards", [(1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0), (0, 0, -1)])
def test_a_disk_in_the_sky_is_where_its_texels_say(towards):
    """Of radius 20°, a plate that faces it gets π sin² of that; one that faces away nothing."""
    disk = TOWARDS @ np.array(towards, dtype=float) > np.cos(np.radians(20.0))
    expected = np.pi * np.sin(np.radians(20.0)) ** 2 * COLOUR
    found = direct_on_plate(sky_of(disk), normal=np.array(towards, dtype=float))
    np.testing.assert_allclose(found, expected, rtol=0.02)
    away = direct_on_plate(sky_of(disk), normal=-np.array(towards, dtype=float))
    np.testing.assert_allclose(away, 0.0)


def test_rows_begin_at_the_zenith_and_columns_at_minus_x():
    values = np.zeros((4, 8, 3))
    values[0] = 1.0
    values[1, 0] = 2.0
    values[2, 2] = 3.0
    rays = np.array([[0, 0, 1.0], [-1, 0.05, 0.2], [-1, -0.05, 0.2], [0.05, 1, -0.1]])
    seen = pr.EnvironmentEmitter(values).background(rays / np.linalg.norm(rays, axis=1)[:, None])
    np.testing.assert_array_equal(seen[:, 0], [1.0, 2.0, 0.0, 3.0])


def two_colours():
    """Red light from +x, blue from -x."""
    values = np.zeros((HEIGHT, WIDTH, 3))
    values[TOWARDS[..., 0] > 0.0] = [4.0, 1.0, 0.0]
    values[TOWARDS[..., 0] <= 0.0] = [0.0, 1.0, 2.0]
    return pr.EnvironmentEmitter(values)


def test_each_channel_comes_from_its_side():
    """A plate upright gets π of what it faces, a flat one half of each."""
    found = direct_on_plate(two_colours(), (1.0, 0.0, 0.0))
    # The plate itself hides nothing from its edge.
    np.testing.assert_allclose(found, np.pi * np.array([4.0, 1.0, 0.0]), rtol=5e-3)
    expected = np.pi * np.array([2.0, 1.0, 1.0])
    np.testing.assert_allclose(direct_on_plate(two_colours()), expected, rtol=5e-3)
    found, photons = photons_on_plate(two_colours())
    np.testing.assert_allclose(found, expected, rtol=0.01)
    from_right = photons.wi[:, 0] > 0.0
    assert not photons.flux[from_right, 2].any()
    assert not photons.flux[~from_right, 0].any()


@pytest.mark.parametrize("sampler", ["halton", "random"])
def test_photons_carry_the_same_luminance_and_the_ledger_their_colours(sampler):
    sky = two_colours()
    mirror = pr.SceneObject(ball(0.5, (0, 0, 1)), pr.Mirror((0.9, 0.5, 0.3)))
    scene = pr.Scene([floor(albedo=(0.8, 0.2, 0.5)), mirror], [sky])
    photons = pr.trace_photons(scene, 20_000, paths="all", sampler=sampler)
    np.testing.assert_allclose(photons.flux @ LUMINANCE, (photons.flux @ LUMINANCE)[0], rtol=1e-9)
    ledger = photons.ledger
    out = ledger.stored + ledger.absorbed + ledger.escaped + ledger.cut + ledger.discarded
    np.testing.assert_allclose(out, ledger.emitted, rtol=1e-9)
    whole = np.pi * scene.bounding_sphere().radius ** 2 * sky._sky.flux_per_area
    np.testing.assert_allclose(ledger.emitted[0] @ LUMINANCE, whole @ LUMINANCE, rtol=1e-12)
    np.testing.assert_allclose(ledger.emitted[0], whole, rtol=0.02)


def test_a_plan_knows_the_colours_of_its_photons_also_where_regions_overlap():
    balls = [pr.SceneObject(ball(0.2, (x, 0, 1)), pr.Mirror()) for x in (-2.0, 0.0, 2.0)]
    scene = pr.Scene([floor(albedo=0.0), *balls], [two_colours()])
    plan = plan_emission(scene, 5000)
    assert len(plan.regions) == 3
    photons = pr.trace_photons(scene, 5000)
    np.testing.assert_array_equal(photons.ledger.emitted, plan.flux)
    ledger = photons.ledger
    out = ledger.stored + ledger.absorbed + ledger.escaped + ledger.cut + ledger.discarded
    np.testing.assert_allclose(out, ledger.emitted, rtol=1e-9)


def test_caustics_of_a_map_are_those_of_all_its_light():
    mirror = pr.SceneObject(ball(0.5, (0, 0, 1)), pr.Mirror(0.5))
    scene = pr.Scene([floor(albedo=0.0), mirror], [sky_of(1.0 + TOWARDS[..., 0])])
    assert_aimed_light_is_that_of_all_paths(scene)


def furnace(material):
    """A ball in front of a map: the layers of its image."""
    camera = pr.Camera((0, -4, 0), (0, 0, 0), width=32, height=32, vertical_fov=40.0)
    item = pr.SceneObject(ball(1.0, (0, 0, 0), 5), material, smooth=True)
    scene = pr.Scene([item], [sky_of(np.ones((HEIGHT, WIDTH)))], camera)
    bands = View(scene, max_depth=16).bands()
    return with_radiance(band_layers(next(bands), {"caustic": np.zeros((32, 32, 3))}))


@pytest.mark.parametrize("material", [pr.Diffuse(1.0), pr.Mirror(), pr.Dielectric(1.5)])
def test_nothing_is_seen_in_a_furnace_of_equal_texels(material):
    layers = furnace(material)
    tiles = layers["radiance"].reshape(2, 16, 2, 16, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(tiles / COLOUR, 1.0, rtol=0.01)
    np.testing.assert_allclose(layers["emission"][0, 0], COLOUR, rtol=1e-12)


def test_a_map_of_equal_texels_is_the_constant_environment():
    flat = sky_of(np.ones((4, 8)))
    constant = pr.EnvironmentEmitter(COLOUR)
    np.testing.assert_allclose(direct_on_plate(flat), direct_on_plate(constant), rtol=3e-3)
    (ours, photons), (theirs, expected) = (photons_on_plate(each) for each in (flat, constant))
    np.testing.assert_allclose(ours, theirs, rtol=5e-3)
    np.testing.assert_allclose(photons.ledger.emitted, expected.ledger.emitted, rtol=1e-9)
    np.testing.assert_allclose(photons.flux.std(axis=0), 0.0, atol=1e-15)


@pytest.mark.parametrize(
    ("material", "expected"),
    [(pr.Mirror(0.5), [0.5, 0.0, 0.0]), (pr.Dielectric(1.0), [0.0, 0.0, 1.0])],
)
def test_a_mirror_shows_what_is_behind_the_camera_and_glass_what_is_beyond(material, expected):
    values = np.where(TOWARDS[..., 1:2] < 0.0, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    camera = pr.Camera((0, -4, 0), (0, 0, 0), width=8, height=8, vertical_fov=5.0)
    item = pr.SceneObject(box([2, 1, 2]), material)
    scene = pr.Scene([item], [pr.EnvironmentEmitter(values)], camera)
    seen = band_layers(next(View(scene).bands()))["emission"]
    np.testing.assert_allclose(seen, np.tile(expected, (8, 8, 1)), atol=1e-9)


def test_what_is_seen_is_the_texel_of_the_ray():
    camera = pr.Camera((0, 0, 2), (0, 1, 2), width=64, height=32, vertical_fov=60.0)
    values = np.random.default_rng(1).uniform(size=(HEIGHT, WIDTH, 3))
    sky = pr.EnvironmentEmitter(values)
    _, direction, _ = pixel_rays(camera, range(32), 1)
    nearest = np.einsum("hwc,nc->nhw", TOWARDS, direction[::97])
    expected = values.reshape(-1, 3)[nearest.reshape(len(nearest), -1).argmax(axis=1)]
    # The nearest middle is that of the texel but beside its edges.
    same = (sky.background(np.ascontiguousarray(direction[::97])) == expected).all(axis=1)
    assert same.mean() > 0.8


def test_the_default_samples_have_less_noise_than_two_per_cent():
    sky = sky_of(np.where(TOWARDS[..., 2] > 0.0, 1.0, 0.2) + 2000.0 * (TOWARDS[..., 0] > 0.9998))
    camera = pr.Camera((0, 0, 5), (0, 0, 0), up=(0, 1, 0), width=32, height=32)
    scene = pr.Scene([floor(50.0, 0.5)], [sky], camera)
    direct = band_layers(next(View(scene).bands()))["direct"]
    assert (direct.std(axis=(0, 1)) / direct.mean(axis=(0, 1))).max() < 0.02


def test_a_scene_renders_with_a_map_and_its_photons_are_recognised():
    camera = pr.Camera((0, -4, 3), (0, 0, 0), width=16, height=16)
    glass = pr.SceneObject(ball(0.5, (0, 0, 1)), pr.Dielectric(1.5), smooth=True)
    scene = pr.Scene([floor(), glass], [two_colours()], camera)
    photons = pr.trace_photons(scene, 5000)
    image = pr.render(scene, photons=photons)
    assert np.isfinite(image.layers["radiance"]).all()
    other = pr.Scene(scene.objects, [pr.EnvironmentEmitter(COLOUR)], camera)
    with pytest.raises(ValueError, match="of the scene rendered"):
        pr.render(other, photons=photons)


def test_a_black_map_is_no_light():
    black = pr.EnvironmentEmitter(np.zeros((2, 4, 3)))
    np.testing.assert_array_equal(direct_on_plate(black, n=16), 0.0)
    with pytest.raises(ValueError, match="no power"):
        photons_on_plate(black, 100)


def test_a_map_is_read_from_exr(tmp_path):
    values = np.random.default_rng(2).uniform(size=(4, 8, 3)).astype(np.float32)
    pr.Image({"radiance": values}).write_exr(tmp_path / "sky.exr")
    sky = pr.EnvironmentEmitter.from_exr(tmp_path / "sky.exr")
    np.testing.assert_array_equal(sky.radiance, values)
    pr.Image({"Z": values[..., 0]}).write_exr(tmp_path / "depth.exr")
    with pytest.raises(ValueError, match=r"depth.exr should have channels R, G and B.*'Z'"):
        pr.EnvironmentEmitter.from_exr(tmp_path / "depth.exr")


def test_a_radiance_file_is_to_be_converted(tmp_path, monkeypatch):
    header = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 1\n"
    (tmp_path / "sky.hdr").write_bytes(header + b"\x80\x80\x80\x81")
    with pytest.raises(ValueError, match=r"sky.hdr .* is a Radiance .*oiiotool sky.hdr -o sky.exr"):
        pr.EnvironmentEmitter.from_exr(tmp_path / "sky.hdr")
    monkeypatch.chdir(tmp_path)
    sky = {"type": "envmap", "filename": "sky.hdr"}
    with pytest.raises(ValueError, match="is a Radiance"):
        pr.load_scene({"type": "scene", "ball": {"type": "sphere"}, "sky": sky})


def test_digests_tell_maps_apart_and_scenes_travel_between_processes():
    ones, others = np.ones((2, 4, 3)), np.ones((2, 4, 3))
    others[1, 2] = 2.0
    scenes = [pr.Scene([floor()], [pr.EnvironmentEmitter(each)]) for each in (ones, others)]
    assert scene_digest(scenes[0]) != scene_digest(scenes[1])
    expected = direct_on_plate(scenes[1].emitters[0], n=16)
    copied = pickle.loads(pickle.dumps(scenes[1].emitters[0]))
    np.testing.assert_array_equal(direct_on_plate(copied, n=16), expected)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.ones((4, 8, 4)), "shape"),
        (np.ones((0, 8, 3)), "texels"),
        (-np.ones((4, 8, 3)), "negative"),
        (np.full((4, 8, 3), np.inf), "finite"),
    ],
)
def test_what_is_no_map_is_refused(values, message):
    with pytest.raises(ValueError, match=f"radiance.*{message}"):
        pr.EnvironmentEmitter(values)
