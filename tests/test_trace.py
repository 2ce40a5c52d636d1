from dataclasses import dataclass

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax.photonmap import FATES

DOWN = pr.CollimatedEmitter([0, 0, -1])


def box(extents, centre=(0.0, 0.0, 0.0)):
    mesh = trimesh.creation.box(extents)
    mesh.apply_translation(centre)
    return mesh


def sheet(size, z=0.0):
    corners = [[-size, -size, z], [size, -size, z], [size, size, z], [-size, size, z]]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def ball(radius, centre, subdivisions=3):
    mesh = trimesh.creation.icosphere(subdivisions, radius)
    mesh.apply_translation(centre)
    return mesh


def floor(size=4.0, albedo=0.8):
    return pr.SceneObject(sheet(size), pr.Diffuse(albedo))


def slab(absorption=0.0, ior=1.5):
    return pr.SceneObject(box([4, 4, 0.02], [0, 0, 1]), pr.Dielectric(ior, absorption=absorption))


def glass_ball(smooth=True, **glass):
    return pr.SceneObject(ball(0.5, [0, 0, 1]), pr.Dielectric(**glass), smooth=smooth)


def mirror_ball(reflectance=1.0):
    # Coarse and smooth: interpolated normals often point away from the rays.
    return pr.SceneObject(ball(0.5, [1, 0, 1], 1), pr.Mirror(reflectance), smooth=True)


def enclosure(albedo):
    return pr.SceneObject(box([2, 2, 2]), pr.Diffuse(albedo))


INSIDE = pr.PointEmitter([0.1, 0.2, 0.3], (1.0, 2.0, 3.0))
LAMBERT = pr.LambertianEmitter([0, 1, 3], [0, -0.3, -1], (3.0, 2.0, 0.0))
TINT = (0.9, 0.5, 0.1)

SCENES = {
    "glass ball": pr.Scene([floor(), glass_ball()], [DOWN]),
    "tinted glass, mirror, three emitters": pr.Scene(
        [floor(albedo=TINT), glass_ball(absorption=(0.1, 1.0, 3.0)), mirror_ball(TINT)],
        [DOWN, pr.PointEmitter([0, 0, 3], (5.0, 1.0, 0.0)), LAMBERT],
    ),
    "emitter in glass": pr.Scene(
        [floor(), glass_ball(absorption=TINT)], [pr.PointEmitter([0.1, 0.1, 0.9])]
    ),
    "glass and mirror in an enclosure": pr.Scene(
        [
            enclosure(TINT),
            pr.SceneObject(ball(0.3, [0.4, 0.4, 0.4]), pr.Dielectric(absorption=1.0)),
            pr.SceneObject(ball(0.3, [-0.4, -0.4, -0.4]), pr.Mirror(TINT)),
        ],
        [pr.PointEmitter([0, 0, 0], (1.0, 2.0, 3.0))],
    ),
}
each_scene = pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES.keys())
each_kind = pytest.mark.parametrize("paths", ["caustic", "global", "all"])


@each_scene
@each_kind
@pytest.mark.parametrize("max_bounces", [3, 32])
def test_the_ledger_balances(scene, paths, max_bounces):
    photons = pr.trace_photons(scene, 20_000, paths=paths, max_bounces=max_bounces)
    ledger = photons.ledger
    assert ledger.imbalance < 1e-9
    assert sum(ledger.ends[fate].sum() for fate in FATES) == photons.n_emitted == 20_000
    assert ledger.emitted.shape == (len(scene.emitters), 3)


@each_scene
def test_stored_flux_of_a_caustic_is_the_flux_of_its_photons(scene):
    photons = pr.trace_photons(scene, 20_000)
    for e, stored in enumerate(photons.ledger.stored):
        mine = photons.emitter_id == e
        np.testing.assert_allclose(photons.flux[mine].sum(axis=0), stored, rtol=1e-12)
        assert mine.sum() == photons.ledger.ends["stored"][e]


@each_scene
@each_kind
def test_threads_and_batches_change_no_bit(scene, paths):
    one = pr.trace_photons(scene, 10_000, paths=paths, n_threads=1)
    for n_threads, batch_size in ((2, 1), (7, 3000), (1, 5000), (2, 10**6)):
        other = pr.trace_photons(
            scene, 10_000, paths=paths, n_threads=n_threads, batch_size=batch_size
        )
        assert_same_bytes(one, other)


def assert_same_bytes(one, other):
    for name in PER_PHOTON:
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes(), name
    assert one.ledger.to_dict() == other.ledger.to_dict()


PER_PHOTON = [
    "position",
    "normal",
    "wi",
    "flux",
    "emitter_coords",
    "emitter_density",
    "emitter_id",
    "path_signature",
    "n_bounces",
    "path_length",
    "object_id",
]


@pytest.mark.parametrize("sampler", ["halton", "random"])
@each_kind
def test_photon_i_does_not_know_how_many_others_there_are(sampler, paths):
    scene = SCENES["glass ball"]
    few = pr.trace_photons(scene, 3_000, paths=paths, sampler=sampler)
    many = pr.trace_photons(scene, 6_000, paths=paths, sampler=sampler)
    many = many.subset(slice(len(few)))
    for name in PER_PHOTON:
        scale = {"flux": 2.0, "emitter_density": 0.5}.get(name, 1)
        np.testing.assert_array_equal(getattr(few, name), getattr(many, name) * scale)


def test_seeds_differ_and_repeat():
    scene = SCENES["glass ball"]
    first, again = (pr.trace_photons(scene, 2_000, seed=5) for _ in range(2))
    assert_same_bytes(first, again)
    other = pr.trace_photons(scene, 2_000, seed=6)
    assert not np.isin(other.position[:, 0], first.position[:, 0]).any()


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


def test_all_deposits_are_direct_or_caustic_or_global():
    scene = SCENES["glass and mirror in an enclosure"]
    everything = pr.trace_photons(scene, 5_000, paths="all")
    indirect = pr.trace_photons(scene, 5_000, paths="global")
    # Both follow the same paths; "global" leaves out what arrives first.
    shared = np.isin(everything.path_length, indirect.path_length)
    np.testing.assert_array_equal(everything.position[shared], indirect.position)
    first = everything.subset(~shared)
    direct = first.subset(first.n_bounces == 0)
    np.testing.assert_allclose(
        np.linalg.norm(direct.position, axis=1), direct.path_length, rtol=1e-9
    )
    assert len(first) == len(np.unique(first.emitter_coords, axis=0))


def slab_transmittance(cos_i, ior, absorption=0.0, thickness=0.02):
    """All internal reflections of a slab, summed: (1 - R)² t / (1 - R² t²)."""
    cos_t = np.sqrt(1.0 - (1.0 - cos_i**2) / ior**2)
    s = ((cos_i - ior * cos_t) / (cos_i + ior * cos_t)) ** 2
    p = ((ior * cos_i - cos_t) / (ior * cos_i + cos_t)) ** 2
    r, t = 0.5 * (s + p), np.exp(-np.multiply(absorption, thickness / cos_t))
    return (1.0 - r) ** 2 * t / (1.0 - r**2 * t**2)


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
    expected = cos * np.array([1, 2, 3]) * slab_transmittance(cos, ior, absorption)
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
    sun = pr.trace_photons(pr.Scene([floor(), glass_ball()], [DOWN]), 100_000)
    for distance in (1e4, 1e7):
        power = 4.0 * np.pi * distance**2
        for lamp in (
            pr.PointEmitter([0, 0, distance], power),
            pr.LambertianEmitter([0, 0, distance], [0, 0, -1], 0.25 * power),
        ):
            photons = pr.trace_photons(pr.Scene([floor(), glass_ball()], [lamp]), 100_000)
            assert photons.flux.sum() == pytest.approx(sun.flux.sum(), rel=0.01)
            spread = photons.position.std(axis=0) / sun.position[:, :].std(axis=0).max()
            np.testing.assert_allclose(
                spread, sun.position.std(axis=0) / sun.position.std(axis=0).max(), atol=0.03
            )


@dataclass
class Moved:
    scale: float
    shift: float

    def __call__(self, mesh):
        mesh.apply_scale(self.scale)
        mesh.apply_translation(np.multiply(self.shift * self.scale, [1.0, -2.0, 0.5]))
        return mesh


@pytest.mark.parametrize(("scale", "shift"), [(1e-4, 0.0), (1e4, 0.0), (1.0, 1e4), (1e-4, 1e4)])
def test_scaling_and_moving_a_scene_moves_its_photons(scale, shift):
    def photons_of(moved):
        objects = [
            pr.SceneObject(moved(sheet(4.0)), pr.Diffuse()),
            pr.SceneObject(moved(ball(0.5, [0, 0, 1])), pr.Dielectric(), smooth=True),
        ]
        return pr.trace_photons(pr.Scene(objects, [DOWN]), 20_000)

    here, there = photons_of(Moved(1.0, 0.0)), photons_of(Moved(scale, shift))
    assert there.flux.sum() / scale**2 == pytest.approx(here.flux.sum(), rel=1e-3)
    back = there.position / scale - np.multiply(shift, [1.0, -2.0, 0.5])
    # A ray on an edge may take the other face; nearly all others land where they did.
    same = min(len(here), len(there))
    if len(here) == len(there):
        assert np.mean(np.abs(here.position - back).max(axis=1) < 1e-6) > 0.99
    assert same > 0.999 * max(len(here), len(there))


@each_scene
def test_photons_face_the_light(scene):
    photons = pr.trace_photons(scene, 5_000)
    assert (np.einsum("ij,ij->i", photons.normal, photons.wi) > 0.0).all()
    assert (photons.n_bounces >= 1).all()
    assert set(photons.object_id) == {0}


def test_mixed_emitters_pad_their_coordinates():
    photons = pr.trace_photons(SCENES["tinted glass, mirror, three emitters"], 5_000)
    assert photons.emitter_coords.shape[1] == 3
    parallel = photons.emitter_id == 0
    assert not photons.emitter_coords[parallel, 2].any()
    np.testing.assert_allclose(
        np.linalg.norm(photons.emitter_coords[~parallel], axis=1), 1.0, rtol=1e-14
    )
    assert (np.diff(photons.emitter_id) >= 0).all()
    assert pr.trace_photons(SCENES["glass ball"], 100).emitter_coords.shape[1] == 2


def test_only_halton_caustics_are_well_spaced():
    scene = SCENES["glass ball"]
    assert pr.trace_photons(scene, 1000).well_spaced
    assert not pr.trace_photons(scene, 1000, sampler="random").well_spaced
    assert not pr.trace_photons(scene, 1000, paths="all").well_spaced


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


def test_progress_counts_up_to_the_end():
    calls = []
    pr.trace_photons(
        SCENES["glass ball"],
        10_000,
        n_threads=2,
        batch_size=2048,
        progress=lambda *call: calls.append(call),
    )
    assert calls == [("trace", done, 10_000) for done in (2048, 4096, 6144, 8192, 10_000)]


def test_an_interrupt_ends_tracing():
    def interrupt(*_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pr.trace_photons(
            SCENES["glass ball"], 50_000, n_threads=2, batch_size=1024, progress=interrupt
        )


MIRROR_UP = pr.SceneObject(sheet(1.0, z=2.0), pr.Mirror())


@pytest.mark.parametrize(
    ("objects", "emitter", "message"),
    [
        ([floor()], DOWN, "none of the 1 objects is a Mirror or Dielectric"),
        ([slab()], DOWN, "should have a Diffuse object"),
        ([floor(), MIRROR_UP], DOWN, r"of 500 paths, [1-9]\d+ met .*, [1-9]\d+ escaped"),
        (
            [floor(), pr.SceneObject(box([1, 1, 1], [0, 0, 2]), pr.Mirror(0.0))],
            DOWN,
            r", [1-9]\d+ were absorbed",
        ),
        (
            [pr.SceneObject(sheet(9.0, z=3.0), pr.Diffuse()), glass_ball()],
            DOWN,
            "0 met a specular object first, .* 500 ended on diffuse objects",
        ),
        (
            [floor(), glass_ball()],
            pr.LambertianEmitter([0, 0, 3], [0, 0, 1]),
            "emitters should shine on the specular objects",
        ),
    ],
    ids=["no specular", "no diffuse", "all escape", "all absorbed", "in shadow", "faces away"],
)
def test_errors_say_why_nothing_is_stored(objects, emitter, message):
    with pytest.raises(ValueError, match=message):
        pr.trace_photons(pr.Scene(objects, [emitter]), 500)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sampler": "sobol"}, "sampler should be one of halton, random"),
        ({"paths": "direct"}, "paths should be one of"),
        ({"seed": -1}, "seed should be at least 0"),
        ({"max_bounces": 0}, "max_bounces should be at least 1"),
        ({"batch_size": 0}, "batch_size should be at least 1"),
        ({"n_threads": 0}, "n_threads should be at least 1"),
        ({"n_emitted": 0}, "n_emitted should be at least 1"),
    ],
)
def test_errors_name_the_argument(change, message):
    with pytest.raises(ValueError, match=message):
        pr.trace_photons(**{"scene": SCENES["glass ball"], "n_emitted": 10} | change)
