import tracemalloc

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.transport import batch
from photonrelax.transport.emission import emit, plan_emission
from tests.helpers.tracing_scenes import (
    DOWN,
    SCENES,
    ball,
    box,
    floor,
    glass_ball,
    leaning,
    sheet,
    slab,
)

each_scene = pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES.keys())
each_kind = pytest.mark.parametrize("paths", ["caustic", "global", "all"])


@each_scene
@each_kind
def test_threads_and_batches_change_no_bit(scene, paths):
    # Light may be trapped in glass of flat facets.
    given = {"paths": paths, "max_bounces": 64}
    one = pr.trace_photons(scene, 10_000, **given, n_threads=1)
    for n_threads, batch_size in ((2, 1), (7, 3000), (1, 5000), (2, 10**6)):
        other = pr.trace_photons(scene, 10_000, **given, n_threads=n_threads, batch_size=batch_size)
        assert_same_bytes(one, other)


@each_scene
@each_kind
def test_nor_does_the_order_of_rays(scene, paths, monkeypatch):
    """Rays of scenes with many faces follow a curve over the emitter."""
    in_order = pr.trace_photons(scene, 10_000, paths=paths, batch_size=3000)
    monkeypatch.setattr(batch, "_MANY_FACES", 0)
    assert_same_bytes(in_order, pr.trace_photons(scene, 10_000, paths=paths, batch_size=3000))


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
    # Where light is not aimed by what a probe of as many paths tells.
    scene = SCENES["glass and mirror in an enclosure" if paths == "global" else "glass ball"]
    few = pr.trace_photons(scene, 3_000, paths=paths, sampler=sampler)
    many = pr.trace_photons(scene, 6_000, paths=paths, sampler=sampler)
    many = many.subset(slice(len(few)))
    for name in PER_PHOTON:
        scale = {"flux": 2.0, "emitter_density": 0.5}.get(name, 1)
        np.testing.assert_array_equal(getattr(few, name), getattr(many, name) * scale)


def test_a_map_grows_when_a_later_emitter_stores_more_than_the_first():
    blocked = pr.CollimatedEmitter([0, 0, 1])
    scene = pr.Scene(SCENES["glass ball"].objects, [blocked, DOWN, blocked, DOWN])
    whole = pr.trace_photons(scene, 20_000, batch_size=20_000)
    grown = pr.trace_photons(scene, 20_000, batch_size=1024)
    assert set(whole.emitter_id) == {1, 3}
    assert_same_bytes(whole, grown)


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("n_threads", [1, 2])
@pytest.mark.parametrize(
    ("name", "paths"), [("glass ball", "caustic"), ("glass and mirror in an enclosure", "all")]
)
def test_memory_is_that_of_the_stored_photons_and_a_few_batches(name, paths, n_threads):
    options = {"paths": paths, "n_threads": n_threads, "batch_size": 1024}
    pr.trace_photons(SCENES[name], 1000, **options)  # what is made only once stays out of it
    tracemalloc.start()
    photons = pr.trace_photons(SCENES[name], 150_000, **options)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    stored = sum(getattr(photons, column).nbytes for column in PER_PHOTON)
    batch = 1024 * (400 + 200 * len(photons) / 150_000)
    assert stored > 10 * batch
    assert peak < 1.06 * stored + (2 * n_threads + 2) * batch


def test_seeds_differ_and_repeat():
    scene = SCENES["glass ball"]
    first, again = (pr.trace_photons(scene, 2_000, seed=5) for _ in range(2))
    assert_same_bytes(first, again)
    other = pr.trace_photons(scene, 2_000, seed=6)
    assert not np.isin(other.position[:, 0], first.position[:, 0]).any()


def test_identical_emitters_do_not_throw_the_same_dice():
    n = 4000
    scene = pr.Scene([floor(9.0), slab(np.log(2) / 0.02)], [DOWN, DOWN])
    photons, plan = pr.trace_photons(scene, 2 * n), plan_emission(scene, 2 * n)
    survived = []
    for e in (0, 1):
        emitted = emit(plan, e, range(n)).emitter_coords @ [1, 1j]
        stored = photons.emitter_coords[photons.emitter_id == e] @ [1, 1j]
        survived.append(np.isin(emitted, stored))
        assert survived[e].sum() == len(stored)
    assert abs(np.corrcoef(survived)[0, 1]) < 5 / np.sqrt(n)


@pytest.mark.parametrize("angle", [0.3, 0.7, 1.2])
def test_a_leaning_normal_is_used_unless_it_leads_through_the_mirror(angle):
    """The normal leans away from the light by 0.5, which turns the reflection by twice that."""
    wall = pr.SceneObject(box([0.1, 20, 20], [9, 0, 0]), pr.Diffuse())
    light = pr.CollimatedEmitter([np.cos(angle), 0, -np.sin(angle)])
    scene = pr.Scene([wall, floor(9.0), leaning(pr.Mirror(), 0.5)], [light])
    photons = pr.trace_photons(scene, 1000)
    turned = angle - 2 * 0.5
    rising = turned if turned > 0 else angle
    expected = np.tile([-np.cos(rising), 0, -np.sin(rising)], (len(photons), 1))
    np.testing.assert_allclose(photons.wi, expected, atol=1e-12)


@pytest.mark.filterwarnings("ignore:.*should be closed:UserWarning")
def test_glass_refracts_about_the_face_where_the_leaning_normal_would_reflect_into_it():
    """At 0.7 only the reflection goes wrong: light and camera both use the face for the two."""
    light = pr.CollimatedEmitter([np.cos(0.7), 0, -np.sin(0.7)])
    scene = pr.Scene([floor(9.0), leaning(pr.Dielectric(1.5), 0.5)], [light])
    photons = pr.trace_photons(scene, 1000)
    sine = np.cos(0.7) / 1.5
    expected = np.tile([-sine, 0, np.sqrt(1 - sine**2)], (len(photons), 1))
    np.testing.assert_allclose(photons.wi, expected, atol=1e-12)


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


def test_diffuse_surfaces_scatter_with_cosine_density():
    """In a room of walls at ±1 photons come from the wall that their direction leads back to."""
    room = pr.SceneObject(box([2, 2, 2]), pr.Diffuse(0.8))
    photons = pr.trace_photons(
        pr.Scene([room], [pr.PointEmitter([0.1, 0.2, 0.3])]), 10_000, paths="global"
    )
    distance = (np.sign(photons.wi) - photons.position) / photons.wi
    wall = distance.argmin(axis=1)
    axes = (wall[:, None] + [0, 1, 2]) % 3
    cosine, x, y = np.abs(np.take_along_axis(photons.wi, axes, axis=1)).T
    expected = (np.arange(len(photons)) + 0.5) / len(photons)
    # Kolmogorov's bound for a probability of one in 10,000.
    limit = 2.23 / np.sqrt(len(photons))
    for number in (cosine**2, 2 / np.pi * np.arctan2(y, x)):
        assert np.abs(np.sort(number) - expected).max() < limit


def placed(mesh, scale, shift):
    mesh.apply_translation(shift)
    return mesh.apply_scale(scale)


@pytest.mark.parametrize(("scale", "shift"), [(1e-4, 0.0), (1e4, 0.0), (1.0, 1e4), (1e-4, 1e4)])
def test_scaling_and_moving_a_scene_moves_its_photons(scale, shift):
    shift = shift * np.array([1.0, -2.0, 0.5])

    def photons_of(scale, shift):
        sheet_of_paper = placed(sheet(4.0), scale, shift)
        marble = placed(ball(0.5, [0, 0, 1]), scale, shift)
        objects = [
            pr.SceneObject(sheet_of_paper, pr.Diffuse()),
            pr.SceneObject(marble, pr.Dielectric(), smooth=True),
        ]
        return pr.trace_photons(pr.Scene(objects, [DOWN]), 20_000)

    here, there = photons_of(1.0, np.zeros(3)), photons_of(scale, shift)
    assert there.flux.sum() / scale**2 == pytest.approx(here.flux.sum(), rel=1e-3)
    # A ray that meets an edge may take the other face; nearly all photons land where they did.
    rows = {tuple(row): i for i, row in enumerate(np.round(here.emitter_coords, 6))}
    found = [rows.get(tuple(row)) for row in np.round(there.emitter_coords / scale, 6)]
    pairs = np.array([(i, j) for j, i in enumerate(found) if i is not None])
    assert len(pairs) > 0.98 * len(here)
    gap = here.position[pairs[:, 0]] + shift - there.position[pairs[:, 1]] / scale
    assert np.mean(np.abs(gap).max(axis=1) < 1e-6) > 0.99


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


def test_an_emitter_without_power_does_not_widen_the_coordinates():
    dark = pr.PointEmitter([0, 0, 3], 0.0)
    scene = SCENES["glass ball"]
    photons = pr.trace_photons(pr.Scene(scene.objects, [dark, DOWN]), 100)
    assert photons.emitter_coords.shape[1] == 2
    assert (photons.emitter_id == 1).all()


def test_only_halton_caustics_are_well_spaced():
    scene = SCENES["glass ball"]
    assert pr.trace_photons(scene, 1000).well_spaced
    assert not pr.trace_photons(scene, 1000, sampler="random").well_spaced
    assert not pr.trace_photons(scene, 1000, paths="all").well_spaced


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
        ({"max_bounces": 2**31}, "max_bounces should be at most 10000, but is 2147483648"),
        ({"batch_size": 0}, "batch_size should be at least 1"),
        ({"n_threads": 0}, "n_threads should be at least 1"),
        ({"n_emitted": 0}, "n_emitted should be at least 1"),
    ],
)
def test_errors_name_the_argument(change, message):
    with pytest.raises(ValueError, match=message):
        pr.trace_photons(**{"scene": SCENES["glass ball"], "n_emitted": 10} | change)
