import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax.photons.energy_ledger import PATH_OUTCOMES
from tests.analytic.slab import slab_transmittance
from tests.helpers.tracing_scenes import (
    DOWN,
    INSIDE,
    SCENES,
    TINT,
    ball,
    box,
    enclosure,
    floor,
    glass_ball,
    sheet,
    slab,
)

each_scene = pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES.keys())
each_kind = pytest.mark.parametrize("paths", ["caustic", "global", "all"])


@each_scene
@each_kind
@pytest.mark.parametrize("max_bounces", [3, 32])
def test_the_ledger_balances(scene, paths, max_bounces):
    photons = pr.trace_photons(scene, 20_000, paths=paths, max_bounces=max_bounces)
    ledger = photons.ledger
    assert ledger.imbalance < 1e-9
    assert (
        sum(ledger.ends[outcome].sum() for outcome in PATH_OUTCOMES) == photons.n_emitted == 20_000
    )
    assert ledger.emitted.shape == (len(scene.emitters), 3)


@each_scene
def test_stored_flux_of_a_caustic_is_the_flux_of_its_photons(scene):
    photons = pr.trace_photons(scene, 20_000)
    for e, stored in enumerate(photons.ledger.stored):
        mine = photons.emitter_id == e
        np.testing.assert_allclose(photons.flux[mine].sum(axis=0), stored, rtol=1e-12)
        assert mine.sum() == photons.ledger.ends["stored"][e]


@pytest.mark.parametrize("albedo", [0.0, 0.5, 0.9, (0.9, 0.5, 0.1)])
def test_furnace(albedo):
    """In a closed enclosure light arrives 1 + albedo + albedo² + ... times."""
    n = 20_000
    scene = pr.Scene([enclosure(albedo)], [INSIDE])
    photons = pr.trace_photons(scene, n, paths="all", max_bounces=500)
    ledger = photons.ledger
    expected = np.array(INSIDE.power) / (1.0 - np.broadcast_to(albedo, 3))
    # Arrivals per path scatter like their mean where the walls are grey.
    tolerance = 5.0 * np.max(expected / INSIDE.power) / np.sqrt(n)
    np.testing.assert_allclose(photons.flux.sum(axis=0), expected, rtol=tolerance)
    # Nothing can leave, so all that was emitted stays on the walls.
    assert ledger.escaped.sum() == ledger.cut.sum() == ledger.absorbed.sum() == 0.0
    np.testing.assert_allclose(ledger.stored[0], INSIDE.power, rtol=1e-12)


def test_furnace_does_not_mind_clear_glass_and_white_mirrors():
    objects = [
        enclosure(0.8),
        pr.SceneObject(ball(0.4, [0.5, 0.5, 0.5]), pr.Dielectric(), smooth=True),
        pr.SceneObject(ball(0.4, [-0.5, -0.5, -0.5]), pr.Mirror(), smooth=True),
    ]
    photons = pr.trace_photons(
        pr.Scene(objects, [pr.PointEmitter([0, 0, 0])]), 20_000, paths="all", max_bounces=500
    )
    np.testing.assert_allclose(photons.flux.sum(axis=0), 5.0, rtol=0.03)
    assert photons.ledger.escaped.sum() == photons.ledger.absorbed.sum() == 0.0
    # Interpolated normals let a few rays run around inside the glass for ever.
    assert photons.ledger.ends["cut"][0] < 10


def test_furnace_irradiance_is_even_on_all_walls():
    scene = pr.Scene([enclosure(0.9)], [pr.PointEmitter([0, 0, 0])])
    photons = pr.trace_photons(scene, 50_000, paths="all", max_bounces=500)
    walls = [photons.flux[photons.normal @ n > 0.9, 0].sum() for n in [*np.eye(3), *-np.eye(3)]]
    np.testing.assert_allclose(walls, 10.0 / 6.0, rtol=0.03)


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("angle", [0.0, 50.0, 75.0])
@pytest.mark.parametrize(("ior", "absorption"), [(1.5, 0.0), (2.4, (0.0, 10.0, 40.0)), (1.0, 0.0)])
def test_light_through_a_slab_is_e0_times_t(angle, ior, absorption):
    cos, sin = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    emitter = pr.CollimatedEmitter([sin, 0, -cos], (1.0, 2.0, 3.0))
    scene = pr.Scene([floor(9.0), slab(absorption, ior)], [emitter])
    photons = pr.trace_photons(scene, 400_000)
    # Well inside the shadow of the slab, where nothing comes through its sides.
    x = photons.position[:, 0] - sin / cos
    inside = np.maximum(np.abs(x), np.abs(photons.position[:, 1])) < 1.6
    irradiance = photons.flux[inside].sum(axis=0) / 3.2**2
    passed = slab_transmittance(ior, np.radians(angle), absorption=absorption, thickness=0.02)
    expected = cos * np.array([1, 2, 3]) * passed
    np.testing.assert_allclose(irradiance, expected, rtol=0.005)


def test_absorption_leaves_luminance_equal_between_photons():
    scene = pr.Scene([floor(9.0), slab((0.0, 10.0, 40.0))], [DOWN])
    photons = pr.trace_photons(scene, 10_000)
    luminance = photons.flux @ [0.2126, 0.7152, 0.0722]
    np.testing.assert_allclose(luminance, luminance[0], rtol=1e-12)
    grey = pr.trace_photons(pr.Scene([floor(9.0), slab(10.0)], [DOWN]), 10_000)
    np.testing.assert_allclose(grey.flux, grey.flux[0, 0], rtol=1e-12)


def test_flat_mirror():
    # Light falls on a mirror at 45° and is thrown sideways onto a wall.
    corners = [[-1, -1, -1], [1, -1, 1], [1, 1, 1], [-1, 1, -1]]
    mesh = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    wall = box([0.1, 20, 20], [5.05, 0, 0])
    objects = [pr.SceneObject(mesh, pr.Mirror(TINT)), pr.SceneObject(wall, pr.Diffuse())]
    scene = pr.Scene(objects, [pr.CollimatedEmitter([-1, 0, 0])])
    with pytest.raises(ValueError, match=r"0 met a specular object first"):
        pr.trace_photons(scene, 1000)
    photons = pr.trace_photons(pr.Scene(objects, [pr.CollimatedEmitter([0, 0, 1])]), 100_000)
    # The mirror shows the light a square of 2 × 2.
    np.testing.assert_allclose(photons.flux.sum(axis=0), 4.0 * np.array(TINT), rtol=0.02)
    np.testing.assert_allclose(photons.position[:, 0], 5.0, atol=1e-12)
    np.testing.assert_allclose(photons.wi, np.tile([-1.0, 0, 0], (len(photons), 1)), atol=1e-12)
    np.testing.assert_array_equal(photons.normal, np.tile([-1.0, 0, 0], (len(photons), 1)))
    assert (photons.n_bounces == 1).all()
    assert (photons.object_id == 1).all()
    assert len(np.unique(photons.path_signature)) == 1
    # Up from the emitter plane to height z, then from x = z to the wall at 5.
    level = 5.0 - photons.path_length
    np.testing.assert_allclose(level, level[0], atol=1e-9)


def test_a_schlick_mirror_reflects_by_the_angle():
    """Light meets a mirror at 60°, where (1 - cos θ)⁵ is 1/32."""
    mirror = pr.SceneObject(sheet(1.0), pr.Mirror(TINT, schlick=True))
    wall = pr.SceneObject(box([0.1, 50, 50], [20.05, 0, 0]), pr.Diffuse())
    light = pr.CollimatedEmitter([np.sin(np.pi / 3), 0.0, -0.5])
    photons = pr.trace_photons(pr.Scene([mirror, wall], [light]), 100_000)
    area = np.ptp(mirror.mesh.vertices[:, 0]) * np.ptp(mirror.mesh.vertices[:, 1])
    reflectance = np.array(TINT) + (1.0 - np.array(TINT)) / 32.0
    np.testing.assert_allclose(photons.flux.sum(axis=0), 0.5 * area * reflectance, rtol=0.02)


def test_total_reflection_in_a_prism():
    """Light enters one leg of a right-angled prism, turns at the hypotenuse, leaves the other."""
    corners = [[0, 0, 0], [1, 0, 0], [0, 0, 1], [0, 1, 0], [1, 1, 0], [0, 1, 1]]
    faces = [[0, 1, 2], [3, 5, 4], [0, 3, 4], [0, 4, 1], [1, 4, 5], [1, 5, 2], [0, 2, 5], [0, 5, 3]]
    prism = trimesh.Trimesh(corners, faces, process=False)
    assert prism.is_watertight
    assert prism.volume == pytest.approx(0.5)
    objects = [
        pr.SceneObject(prism, pr.Dielectric(1.5)),
        pr.SceneObject(sheet(4.0, z=-1.0), pr.Diffuse()),
    ]
    photons = pr.trace_photons(pr.Scene(objects, [pr.CollimatedEmitter([1, 0, 0])]), 200_000)
    # Straight in and out through 4 % each; what is reflected inside comes back to the first leg.
    turned = photons.subset(photons.n_bounces == 3)
    assert turned.flux[:, 0].sum() == pytest.approx(0.96**2, rel=0.01)
    np.testing.assert_allclose(turned.wi, np.tile([0.0, 0, 1.0], (len(turned), 1)), atol=1e-12)
    assert len(np.unique(turned.path_signature)) == 1


def test_distant_points_light_like_the_sun():
    sun = pr.trace_photons(pr.Scene([floor(), glass_ball()], [DOWN]), 40_000)
    for distance in (1e4, 1e7):
        power = 4.0 * np.pi * distance**2
        for lamp in (
            pr.PointEmitter([0, 0, distance], power),
            pr.LambertianEmitter([0, 0, distance], [0, 0, -1], 0.25 * power),
        ):
            photons = pr.trace_photons(pr.Scene([floor(), glass_ball()], [lamp]), 40_000)
            assert photons.flux.sum() == pytest.approx(sun.flux.sum(), rel=0.01)
            np.testing.assert_allclose(
                photons.position.std(axis=0), sun.position.std(axis=0), rtol=0.05, atol=1e-12
            )


def wall(centre, normal):
    """A square of side 2 and a Lambertian emitter on it, off its edges and diagonal."""
    u = np.cross(normal, [1.0, 0, 0])
    u /= np.linalg.norm(u)
    v = np.cross(normal, u)
    corners = [centre + a * u + b * v for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    mesh = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    lamp = pr.LambertianEmitter(centre + 0.3 * u + 0.2 * v, normal)
    return pr.SceneObject(mesh, pr.Diffuse(0.0)), lamp


def test_a_lamp_on_a_wall_sheds_its_light_into_the_room():
    room = pr.SceneObject(box([8, 8, 8]), pr.Diffuse(0.0))
    normals = np.random.default_rng(3).normal(size=(20, 3))
    normals = np.concatenate([np.eye(3)[1:], -np.eye(3)[1:], normals])
    for normal in normals / np.linalg.norm(normals, axis=1, keepdims=True):
        plate, lamp = wall(1.3 - 2.3 * normal, normal)
        photons = pr.trace_photons(pr.Scene([room, plate], [lamp]), 2000, paths="all", n_threads=1)
        # All but rays along the wall itself.
        assert np.count_nonzero(photons.object_id == 1) <= 1
        travelled = np.linalg.norm(photons.position - lamp.position, axis=1)
        np.testing.assert_allclose(photons.path_length, travelled, rtol=1e-9, atol=1e-9)


def test_max_bounces_cuts_paths():
    scene = pr.Scene([floor(9.0), slab()], [DOWN])
    photons = pr.trace_photons(scene, 50_000, max_bounces=2)
    assert photons.n_bounces.max() == 2
    ledger = photons.ledger
    # Cut: reflected at the lower face, then once more.
    reached = ledger.emitted - ledger.discarded
    assert ledger.cut.sum() / reached.sum() == pytest.approx(0.96 * 0.04, rel=0.1)
    with pytest.raises(ValueError, match=r"cut after max_bounces=1"):
        pr.trace_photons(scene, 1000, max_bounces=1)
