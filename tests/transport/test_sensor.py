"""Sensors store the photons that cross them; nothing else changes."""

import pickle
from itertools import pairwise

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax.photons.photon_map import NothingStoredError
from photonrelax.scene.digest import scene_digests
from photonrelax.transport.batch import TraceContext, TraceSettings, trace_batch
from photonrelax.transport.emission import plan_emission
from tests.analytic.lens import PlanoConvex
from tests.analytic.slab import slab_transmittance
from tests.helpers.stl import from_stl
from tests.helpers.tracing_scenes import DOWN, SCENES, ball, box, floor, sheet, slab

COLUMNS = (
    *("position", "normal", "wi", "flux", "emitter_coords", "emitter_density", "emitter_id"),
    *("path_signature", "n_bounces", "path_length", "object_id"),
)


def sensor(mesh):
    return pr.SceneObject(mesh, pr.Sensor())


def plane(z, size=4.0):
    return sensor(sheet(size, z))


def with_sensors(scene, *meshes):
    """The scene with sensors as its last objects."""
    return pr.Scene([*scene.objects, *map(sensor, meshes)], scene.emitters, scene.camera)


def window():
    return pr.SceneObject(box([8, 8, 0.5], [0, 0, 1]), pr.Dielectric(1.5))


def on(photons, object_id):
    return photons.subset(photons.object_id == object_id)


def assert_same_photons(some, others, columns=COLUMNS):
    for name in columns:
        np.testing.assert_array_equal(getattr(some, name), getattr(others, name), err_msg=name)


def power(photons):
    return photons.flux[:, 0].sum()


each_kind = pytest.mark.parametrize("paths", ["caustic", "global", "all"])
each_scene = pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES.keys())
# Within the boxes around the other objects.
MESHES = (sheet(1.0, 0.3), ball(0.3, [0.1, 0.1, 0.6], 2), sheet(0.7, 1.0))


@each_scene
@each_kind
def test_photons_elsewhere_are_as_without_sensors(scene, paths):
    given = {"paths": paths, "max_bounces": 32}
    photons = pr.trace_photons(with_sensors(scene, *MESHES), 5_000, **given)
    expected = pr.trace_photons(scene, 5_000, **given)
    assert photons.on_sensor.any()
    np.testing.assert_array_equal(photons.on_sensor, photons.object_id >= len(scene.objects))
    assert_same_photons(photons.subset(~photons.on_sensor), expected)
    assert photons.ledger.to_dict() == expected.ledger.to_dict()
    assert photons.ledger.imbalance < 1e-9


@each_scene
def test_the_ledger_counts_what_is_stored_on_other_objects(scene):
    photons = pr.trace_photons(with_sensors(scene, *MESHES), 20_000)
    stored = photons.flux[~photons.on_sensor].sum(axis=0)
    np.testing.assert_allclose(stored, photons.ledger.stored.sum(axis=0), rtol=1e-12)
    assert photons.on_sensor.any()


@pytest.mark.kernels_run_elsewhere
@each_scene
@each_kind
def test_threads_and_batches_change_no_bit(scene, paths):
    seen = with_sensors(scene, *MESHES)
    # Light that is trapped in glass crosses sensors thousands of times.
    given = {"paths": paths, "max_bounces": 32}
    expected = pr.trace_photons(seen, 10_000, **given, n_threads=1)
    for n_threads, batch_size in ((2, 1024), (1, 4096)):
        photons = pr.trace_photons(
            seen, 10_000, **given, n_threads=n_threads, batch_size=batch_size
        )
        assert_same_photons(photons, expected)


def test_photons_cross_a_plane_on_their_way_to_the_floor():
    """Below a window light goes straight down."""
    scene = pr.Scene([floor(), slab(), plane(0.25)], [DOWN])
    photons = pr.trace_photons(scene, 20_000)
    crossing, arriving = on(photons, 2), on(photons, 0)
    same = [name for name in COLUMNS if name not in ("position", "path_length", "object_id")]
    assert_same_photons(crossing, arriving, same)
    above = arriving.position + np.array([0, 0, 0.25])
    np.testing.assert_allclose(crossing.position, above, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(crossing.path_length, arriving.path_length - 0.25, rtol=1e-12)
    assert power(crossing) == power(arriving)
    assert power(crossing) == pytest.approx(slab_transmittance(1.5) * 16.0, rel=0.01)


def test_a_sensor_stores_what_a_floor_in_its_place_would():
    glass = SCENES["glass ball"].objects[1]
    seen = pr.Scene([floor(), glass, plane(0.1)], [DOWN])
    floored = pr.Scene([floor(), glass, pr.SceneObject(sheet(4.0, 0.1), pr.Diffuse())], [DOWN])
    photons, expected = (on(pr.trace_photons(each, 20_000), 2) for each in (seen, floored))
    for name in COLUMNS:
        some, others = getattr(photons, name), getattr(expected, name)
        np.testing.assert_allclose(some, others, rtol=1e-12, atol=1e-12, err_msg=name)


def test_photons_are_stored_on_both_sides_and_face_the_light():
    scene = pr.Scene([pr.SceneObject(sheet(1.0), pr.Mirror()), plane(0.5, 1.0)], [DOWN])
    photons = pr.trace_photons(scene, 5000, paths="all")
    down, up = (photons.subset(photons.n_bounces == n) for n in (0, 1))
    assert power(down) == power(up) == pytest.approx(4.0, rel=0.01)
    np.testing.assert_array_equal(down.normal, down.wi)
    np.testing.assert_array_equal(up.normal, up.wi)
    np.testing.assert_array_equal(up.wi[:, 2], -1.0)
    only_up = pr.trace_photons(scene, 5000)
    assert (only_up.n_bounces == 1).all()


def test_a_path_crosses_a_closed_sensor_twice():
    scene = pr.Scene([floor(), sensor(ball(0.5, [0, 0, 1]))], [DOWN])
    photons = pr.trace_photons(scene, 50_000, paths="all", max_bounces=1)
    before = photons.subset(photons.on_sensor & (photons.wi[:, 2] == 1.0))
    into = (before.normal[:, 2] > 0.0) & (before.position[:, 2] > 1.0)
    assert 2 * np.count_nonzero(into) == len(before)
    assert power(before) == pytest.approx(2 * np.pi * 0.5**2, rel=0.02)


def test_sensors_in_one_plane_store_the_same():
    scene = pr.Scene([floor(), slab(), plane(0.5), plane(0.5), plane(0.5 + 1e-7)], [DOWN])
    photons = pr.trace_photons(scene, 5000)
    first = on(photons, 2)
    assert len(first) == len(on(photons, 0))
    for other in (3, 4):
        assert_same_photons(
            first, on(photons, other), ("emitter_coords", "flux", "path_signature", "normal")
        )


@pytest.mark.parametrize("shift", [-1e-9, 0.0, 1e-9])
def test_in_the_plane_of_a_surface_arriving_light_counts(shift):
    """The lower face of the window, and the floor; what these send back counts no more."""
    scene = pr.Scene([floor(), window(), plane(shift, 3.9), plane(0.75 + shift, 3.9)], [DOWN])
    photons = pr.trace_photons(scene, 20_000, max_bounces=2)
    inside = (np.abs(photons.position[:, :2]) < 3.9).all(axis=1)
    arriving, on_floor, on_face = (
        photons.subset(inside & (photons.object_id == i)) for i in (0, 2, 3)
    )
    assert_same_photons(on_floor, arriving, ("emitter_coords", "flux"))
    assert (on_face.n_bounces == 1).all()
    assert (on_face.normal[:, 2] > 0.0).all()
    assert power(on_face) == pytest.approx(0.96 * 7.8**2, rel=0.01)


def test_a_sensor_in_glass_stores_what_goes_to_and_fro():
    scene = pr.Scene([floor(), window(), plane(1.0)], [DOWN])
    photons = on(pr.trace_photons(scene, 100_000), 2)
    # Reflected at the lower face, then at the upper one.
    for n_bounces, share in ((1, 0.96), (2, 0.96 * 0.04), (3, 0.96 * 0.04**2)):
        mine = photons.subset(photons.n_bounces == n_bounces)
        error = 4 * np.sqrt(share / 50_000)
        assert power(mine) / 64.0 == pytest.approx(share, abs=error)


def pool(*depths, absorption):
    """Water with sensors at some depths, the floor ten metres down, and its upper face at 0."""
    water = pr.Dielectric(1.0, absorption=absorption)
    bottom = pr.SceneObject(sheet(1.0, -10.0), pr.Diffuse())
    body = pr.SceneObject(box([4, 4, 12], [0, 0, -6]), water)
    return pr.Scene([bottom, body, *(plane(-depth, 0.9) for depth in depths)], [DOWN])


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("sampler", ["halton", "random"])
def test_flux_in_absorbing_water_follows_beer_lambert(sampler):
    n, absorption, depths = 200_000, 0.2, (0.5, 1.0, 2.0, 4.0, 8.0)
    scene = pool(*depths, absorption=absorption)
    photons = pr.trace_photons(scene, n, sampler=sampler)
    each = 1.8**2 / photons.flux[0, 0]
    survivors = []
    for number, depth in enumerate(depths, 2):
        mine = on(photons, number)
        expected = each * np.exp(-absorption * depth)
        assert abs(len(mine) - expected) < 4 * np.sqrt(expected)
        survivors.append({tuple(coords) for coords in mine.emitter_coords})
    # What is absorbed stays absorbed.
    for above, below in pairwise(survivors):
        assert below < above
    # Of those that get to one depth the share that gets to the next is that of the way between.
    for number, (above, below) in enumerate(pairwise(survivors)):
        expected = np.exp(-absorption * (depths[number + 1] - depths[number])) * len(above)
        assert abs(len(below) - expected) < 4 * np.sqrt(expected)


def test_coloured_water_colours_photons_by_the_way_to_the_sensor():
    absorption, depths = (0.1, 0.3, 0.9), (0.5, 2.0)
    photons = pr.trace_photons(pool(*depths, absorption=absorption), 100_000)
    for number, depth in enumerate(depths, 2):
        mine = on(photons, number)
        total = 1.8**2 * np.exp(-depth * np.array(absorption))
        np.testing.assert_allclose(mine.flux.sum(axis=0), total, rtol=0.02)
        assert np.ptp(mine.flux @ [0.2126, 0.7152, 0.0722]) < 1e-15


def test_furnace():
    """Light that a sphere has scattered comes from everywhere alike."""
    albedo, n = 0.7, 100_000
    walls = pr.SceneObject(ball(1.0, [0, 0, 0], 5), pr.Diffuse(albedo))
    lamp = pr.PointEmitter([0, 0, 0], 1.0)
    probe = sensor(sheet(0.4, 0.2))
    photons = pr.trace_photons(pr.Scene([walls, probe], [lamp]), n, paths="global", max_bounces=200)
    arriving = 1.0 / (4 * np.pi * (1 - albedo))
    for side in (1.0, -1.0):
        mine = photons.subset(photons.on_sensor & (photons.normal[:, 2] == side))
        assert power(mine) / 0.8**2 == pytest.approx(albedo * arriving, rel=0.02)


def test_a_sensor_may_be_the_only_receiver():
    glass = SCENES["glass ball"].objects[1]
    photons = pr.trace_photons(pr.Scene([glass, plane(0.0)], [DOWN]), 20_000)
    expected = pr.trace_photons(pr.Scene([glass, floor()], [DOWN]), 20_000)
    # Paths go on, and none ends as stored.
    assert photons.ledger.stored.sum() == 0.0
    assert len(photons) >= len(expected)
    assert power(photons) == pytest.approx(power(expected), rel=1e-12)


def test_sensors_may_be_all_there_is():
    scene = pr.Scene([plane(0.0, 1.0), sensor(ball(0.5, [0, 0, 1]))], [DOWN])
    photons = pr.trace_photons(scene, 50_000, paths="all")
    assert power(on(photons, 0)) == pytest.approx(4.0, rel=0.01)
    assert power(on(photons, 1)) == pytest.approx(2 * np.pi / 4, rel=0.02)


def test_direct_light_is_stored_on_sensors_beyond_the_other_objects():
    scene = pr.Scene([floor(1.0), plane(3.0, 5.0)], [DOWN, pr.PointEmitter([0, 0, 9.0], 50.0)])
    photons = pr.trace_photons(scene, 100_000, paths="all")
    down = on(photons, 1)
    sun, lamp = (
        power(down.subset((down.emitter_id == i) & (down.n_bounces == 0) & (down.wi[:, 2] > 0.0)))
        for i in (0, 1)
    )
    assert sun == pytest.approx(100.0, rel=0.01)
    # A lamp six metres above a square of ten.
    corner = 25.0 / (6.0 * np.sqrt(6.0**2 + 50.0))
    assert lamp == pytest.approx(50.0 * 4 * np.arctan(corner) / (4 * np.pi), rel=0.01)


@pytest.mark.parametrize("paths", ["caustic", "global"])
def test_sensors_are_not_aimed_at(paths):
    scene = SCENES["glass ball"]
    far = with_sensors(scene, sheet(50.0, -20.0))
    plans = [plan_emission(each, 1000, paths) for each in (scene, far)]
    np.testing.assert_array_equal(plans[0].flux, plans[1].flux)
    np.testing.assert_array_equal(plans[0].regions[0].origin, plans[1].regions[0].origin)


def test_sensors_have_neither_inside_nor_warnings(recwarn):
    sheets = [sensor(sheet(1.0)), sensor(box([1, 1, 1e-9]))]
    pr.trace_photons(pr.Scene([*sheets, floor()], [DOWN]), 1000, paths="all")
    assert not recwarn.list
    assert not pr.Sensor.has_inside
    assert not pr.Sensor.is_specular


def test_light_that_misses_all_receivers_is_told_of():
    glass = SCENES["glass ball"].objects[1]
    aside = sensor(box([0.1, 0.1, 0.1], [0, 0, 50.0]))
    with pytest.raises(NothingStoredError, match="a Diffuse object or a Sensor where it falls"):
        pr.trace_photons(pr.Scene([glass, aside], [DOWN]), 1000)


def test_no_photons_are_stored_on_sensors_unless_asked_for():
    scene = SCENES["glass ball"]
    photons = pr.trace_photons(with_sensors(scene, *MESHES), 5000, sensors=False)
    assert_same_photons(photons, pr.trace_photons(scene, 5000))
    assert photons.sensor_ids is None
    only = pr.Scene([scene.objects[1], plane(0.0)], [DOWN])
    with pytest.raises(ValueError, match="should have a Diffuse object to store photons on, but"):
        pr.trace_photons(only, 5000, sensors=False)


def test_spectra_are_those_of_photons_on_other_objects():
    scene = SCENES["glass ball"]
    photons = pr.trace_photons(with_sensors(scene, *MESHES), 5000, frequency_share=0.1)
    expected = pr.trace_photons(scene, 5000, frequency_share=0.1)
    assert np.isnan(photons.spectrum[photons.on_sensor]).all()
    np.testing.assert_array_equal(photons.spectrum[~photons.on_sensor], expected.spectrum)


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("method", ["standard", "parameterised", "frequency"])
def test_images_are_the_same_with_sensors(method):
    """From above, through glass and beside it; some sensors shade the floor from the camera."""
    camera = pr.Camera((0.3, -4.0, 2.5), (0, 0, 0.5), width=48, height=32)
    scene = SCENES["tinted glass, mirror, three emitters"]
    scene = pr.Scene(scene.objects, scene.emitters, camera)
    seen = with_sensors(scene, *MESHES, sheet(30.0, 2.0), sheet(3.0, 1e-3))
    images = [pr.render(each, n_emitted=5000, method=method) for each in (scene, seen)]
    given = pr.trace_photons(seen, 5000, frequency_share=0.02)
    if method != "frequency":
        images.append(pr.render(seen, photons=given, method=method))
    assert images[0].layers["direct"].any()
    assert images[0].layers["caustic"].any()
    for image in images[1:]:
        for name, layer in images[0].layers.items():
            np.testing.assert_array_equal(image.layers[name], layer, err_msg=name)


@pytest.mark.kernels_run_elsewhere
def test_progressive_images_are_the_same_with_sensors():
    camera = pr.Camera((0.3, -4.0, 2.5), (0, 0, 0.5), width=24, height=16)
    scene = pr.Scene(SCENES["glass ball"].objects, [DOWN], camera)
    one, other = (
        pr.render_progressive(each, n_passes=2, photons_per_pass=1000)
        for each in (scene, with_sensors(scene, *MESHES))
    )
    for name, layer in one.layers.items():
        np.testing.assert_array_equal(other.layers[name], layer, err_msg=name)


@pytest.mark.kernels_run_elsewhere
def test_photons_relax_on_their_sensor_alone():
    """A flat sensor close above the floor, and a curved one through both."""
    dome = trimesh.creation.icosphere(4, 1.5)
    dome.apply_translation([0, 0, -0.7])
    glass = SCENES["glass ball"].objects[1]
    scene = pr.Scene([floor(), glass, plane(1e-3), sensor(dome)], [DOWN])
    photons = pr.trace_photons(scene, 20_000)
    structure = pr.detect_structure(photons)
    relaxed = pr.relax(photons, structure, scene=scene)
    for rows in (~photons.on_sensor, photons.object_id == 2, photons.object_id == 3):
        alone = photons.subset(rows)
        expected = pr.relax(alone, pr.detect_structure(alone), scene=scene)
        mine = relaxed.subset(rows)
        assert (mine.position != alone.position).any(axis=1).mean() > 0.5
        np.testing.assert_array_equal(mine.position, expected.position)
        np.testing.assert_array_equal(mine.normal, expected.normal)
    assert np.ptp(on(relaxed, 2).position[:, 2]) == 0.0
    distance = np.linalg.norm(on(relaxed, 3).position - [0, 0, -0.7], axis=1)
    assert distance.min() > 1.49
    assert distance.max() <= 1.5 + 1e-12
    without = pr.trace_photons(pr.Scene(scene.objects[:2], [DOWN]), 20_000)
    expected = pr.relax(without, pr.detect_structure(without), scene=scene)
    np.testing.assert_array_equal(relaxed.subset(~photons.on_sensor).position, expected.position)


@pytest.mark.kernels_run_elsewhere
def test_many_emitters_relax_on_their_sensor_alone():
    """Some lamps have a tree of their own, some share one, and some are pooled."""
    rng = np.random.default_rng(0)
    lamps = [pr.PointEmitter([x, y, 4.0], 1.0) for x, y in rng.uniform(-3, 3, (40, 2))]
    glass = SCENES["glass ball"].objects[1]
    scene = pr.Scene([floor(), glass, plane(1e-3)], lamps)
    photons = pr.trace_photons(scene, 20_000)
    relaxed = pr.relax(photons, pr.detect_structure(photons))
    for rows in (photons.on_sensor, ~photons.on_sensor):
        alone = photons.subset(rows)
        expected = pr.relax(alone, pr.detect_structure(alone))
        np.testing.assert_array_equal(relaxed.subset(rows).position, expected.position)


def test_the_field_of_a_sensor_is_that_of_its_photons():
    scene = pr.Scene([floor(), slab(), plane(0.01)], [DOWN])
    photons = pr.trace_photons(scene, 50_000)
    points = np.random.default_rng(1).uniform(-1.5, 1.5, (5000, 3))
    up = np.tile([0, 0, 1.0], (5000, 1))
    points[:, 2] = 0.01
    irradiance = pr.irradiance_field(on(photons, 2), method="standard")(points, up)
    assert irradiance.mean() == pytest.approx(slab_transmittance(1.5), rel=0.01)


def test_maps_keep_their_sensors(tmp_path):
    photons = pr.trace_photons(
        pr.Scene([plane(0.5), floor(), plane(0.2)], [DOWN]), 100, paths="all"
    )
    np.testing.assert_array_equal(photons.sensor_ids, [0, 2])
    photons.save(tmp_path / "photons.npz")
    loaded = pr.PhotonMap.load(tmp_path / "photons.npz")
    np.testing.assert_array_equal(loaded.sensor_ids, [0, 2])
    np.testing.assert_array_equal(loaded.on_sensor, photons.on_sensor)
    np.testing.assert_array_equal(loaded.subset(loaded.on_sensor).object_id % 2, 0)
    without = pr.PhotonMap(photons.position, photons.normal, photons.flux)
    assert not without.on_sensor.any()


def test_scenes_with_other_sensors_have_other_digests():
    digests = {
        scene_digests(with_sensors(SCENES["glass ball"], *meshes))["digest of the objects"]
        for meshes in ((), MESHES[:1], MESHES[1:])
    }
    assert len(digests) == 3


def test_batches_can_be_traced_elsewhere():
    """A context that is pickled has the same sensors."""
    scene = with_sensors(SCENES["glass ball"], *MESHES)
    plan = plan_emission(scene, 2000)
    context = TraceContext(scene, plan, TraceSettings("caustic", 32, 0.0), 2048)
    copy = pickle.loads(pickle.dumps(context))
    job = ((0, range(2000)),)
    here, there = (trace_batch(each, job).deposits for each in (context, copy))
    np.testing.assert_array_equal(here, there)
    assert np.isin(here["object_id"], scene.sensors).any()


@pytest.mark.kernels_run_elsewhere
def test_shares_of_the_light_around_the_focus_of_a_lens():
    """A plano-convex lens from an STL file, and planes across its caustic."""
    lens, depths = PlanoConvex(), (190.0, 193.7, 195.0, 196.5, 198.0)
    glass = pr.SceneObject(from_stl(lens.mesh()), pr.Dielectric(lens.ior), smooth=True)
    planes = [plane(-depth, 30.0) for depth in depths]
    photons = pr.trace_photons(pr.Scene([glass, *planes], [DOWN]), 500_000)
    radius = np.hypot(*photons.position[:, :2].T)
    for number, depth in enumerate(depths, 1):
        for within in (1.0, 0.05):
            mine = photons.subset((photons.object_id == number) & (radius < within))
            assert power(mine) == pytest.approx(lens.flux_within(within, depth), rel=0.02)
