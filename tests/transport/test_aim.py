"""Aim at casters that lie apart: all light of each, and no photons for the space between."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import photonrelax as pr
from photonrelax.photons.photon_map import NothingStoredError
from photonrelax.scene.casters import MAX_GROUPS, group_spheres
from photonrelax.transport.emission import emit, plan_emission
from tests.helpers.tracing_scenes import floor

N = 40_000
DOWN = pr.CollimatedEmitter([0, 0, -1], (1.0, 2.0, 3.0))


def ball(x, y=0.0, z=1.0, radius=0.5, subdivisions=3):
    mesh = trimesh.creation.icosphere(subdivisions, radius)
    mesh.apply_translation([x, y, z])
    return mesh


def objects(meshes, material):
    return [pr.SceneObject(mesh, material) for mesh in meshes]


def scene(*meshes, material=None, emitters=(DOWN,), side=400.0):
    return pr.Scene([floor(side), *objects(meshes, material or pr.Dielectric(1.5))], emitters)


def lamp(x, y, z, kind=pr.PointEmitter):
    return kind([x, y, z]) if kind is pr.PointEmitter else kind([x, y, z], [0, 0, -1])


APART = {
    "parallel light": DOWN,
    "slanted parallel light": pr.CollimatedEmitter([1, 0.2, -2]),
    "point above one": lamp(0.0, 0.0, 4.0),
    "point between": lamp(50.0, 1.0, 30.0),
    "lambertian": lamp(20.0, 0.0, 9.0, pr.LambertianEmitter),
}


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("name", APART)
@pytest.mark.parametrize("material", [pr.Dielectric(1.5), pr.Mirror()], ids=["glass", "mirror"])
def test_two_balls_far_apart_bring_what_each_brings_alone(name, material):
    emitter = APART[name]
    both = pr.trace_photons(
        scene(ball(0), ball(100), material=material, emitters=[emitter]), N
    ).flux.sum(axis=0)
    # Alone, the other is a black body that stands in the light as before.
    alone = 0.0
    for caster, other in ((ball(0), ball(100)), (ball(100), ball(0))):
        black = pr.SceneObject(other, pr.Diffuse(0.0))
        lit = pr.Scene([floor(400.0), pr.SceneObject(caster, material), black], [emitter])
        alone = alone + pr.trace_photons(lit, N).flux.sum(axis=0)
    np.testing.assert_allclose(both, alone, rtol=0.01)


@pytest.mark.parametrize("name", APART)
@pytest.mark.parametrize("x", [1.03, 3.0, 100.0, 1e4])
def test_no_light_is_sent_between_casters(name, x):
    """Two balls are sent the light that each is sent by itself, wherever they are."""
    emitter = APART[name]
    sent = [
        plan_emission(scene(*meshes, emitters=[emitter]), N).flux
        for meshes in ([ball(0), ball(x)], [ball(0)], [ball(x)])
    ]
    # Less where one stands before the other.
    assert (sent[0] <= (sent[1] + sent[2]) * (1.0 + 1e-3)).all()
    if name == "parallel light":
        np.testing.assert_allclose(sent[0], sent[1] + sent[2], rtol=1e-3)


KINDS = {
    "one mesh of two balls": lambda: [trimesh.util.concatenate([ball(0), ball(100)])],
    "separate triangles": lambda: [separate(trimesh.util.concatenate([ball(0), ball(100)]))],
    "plate and ball": lambda: [trimesh.creation.box((0.5, 0.5, 0.1)), ball(70, 20, 3)],
    "nine balls on a grid": lambda: [ball(30 * i, 30 * j) for i in range(3) for j in range(3)],
}


def separate(mesh):
    """The triangles of a mesh without common vertices, as of an STL file."""
    vertices = np.asarray(mesh.triangles).reshape(-1, 3).astype(np.float32)
    return trimesh.Trimesh(vertices, np.arange(len(vertices)).reshape(-1, 3), process=False)


@pytest.mark.parametrize("kind", KINDS)
def test_groups_are_parts_that_lie_apart(kind):
    meshes = KINDS[kind]()
    spheres = group_spheres(meshes, MAX_GROUPS)
    assert len(spheres) == (9 if kind == "nine balls on a grid" else 2)
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    distance = [np.linalg.norm(vertices - centre, axis=1) / radius for centre, radius in spheres]
    assert (np.min(distance, axis=0) <= 1.0 + 1e-6).all()
    assert [sphere.radius for sphere in spheres] == sorted(
        (s.radius for s in spheres), reverse=True
    )


@pytest.mark.parametrize(
    "meshes",
    [
        [ball(0)],
        [ball(0), trimesh.creation.icosphere(3, 0.2).apply_translation([0, 0, 1])],
        [
            trimesh.creation.box((9, 9, 0.1)),
            trimesh.creation.box((8, 8, 0.1)).apply_translation([0, 0, 1]),
        ],
        [separate(ball(0))],
        [ball(0), ball(0)],
    ],
    ids=["one", "one in another", "panes", "separate triangles", "the same twice"],
)
def test_close_parts_are_aimed_at_together(meshes):
    assert len(group_spheres(meshes, MAX_GROUPS)) == 1


def test_thousands_of_parts_have_few_groups():
    grid = [ball(3 * i, 3 * j, subdivisions=0) for i in range(40) for j in range(40)]
    far = [ball(1e4, 0.0, subdivisions=0)]
    spheres = group_spheres([trimesh.util.concatenate(grid + far)], MAX_GROUPS)
    assert 2 <= len(spheres) <= MAX_GROUPS
    assert min(abs(sphere.centre[0] - 1e4) for sphere in spheres) < 1e-6


def union_of_two_disks(radius, distance):
    """Area of two equal disks less that of their lens."""
    half = distance / (2 * radius)
    lens = 2 * radius**2 * (np.arccos(half) - half * np.sqrt(1 - half**2))
    return 2 * np.pi * radius**2 - lens


@pytest.mark.parametrize("sampler", ["halton", "random"])
def test_outlines_that_overlap_count_once(sampler):
    """Balls one above the other, a little aside, in a row whose ends are far apart."""
    meshes = [ball(0, z=1), ball(0.6, z=4), ball(100)]
    plan = plan_emission(scene(*meshes), N, sampler=sampler)
    assert len(plan.regions) == 3
    # A sphere reaches the vertices of its ball only.
    expected = union_of_two_disks(0.5, 0.6) + np.pi * 0.25
    assert plan.flux[0, 0] == pytest.approx(expected, rel=2e-3 if sampler == "halton" else 0.02)
    assert plan.counts.sum() == N
    rays = [emit(plan, region, range(n)) for region, n in enumerate(plan.counts.tolist())]
    measure = sum(np.sum(1.0 / each.emitter_density) for each in rays)
    assert measure == pytest.approx(plan.flux[0, 0], rel=1e-12)
    # Coordinates of all regions are those of one plane.
    coords = np.concatenate([each.emitter_coords for each in rays])
    origin = np.concatenate([each.origin for each in rays])
    np.testing.assert_allclose(
        np.linalg.norm(np.diff(coords, axis=0), axis=1),
        np.linalg.norm(np.diff(origin, axis=0), axis=1),
        atol=1e-9,
    )


def test_flux_of_overlapping_regions_has_no_bias_for_few_photons():
    """Passes of few photons add up to the light of many."""
    lit = scene(ball(0, z=1), ball(0.6, z=4), ball(100))
    plans = [plan_emission(lit, 48, seed=seed, sampler="random") for seed in range(1500)]
    assert {len(plan.regions) for plan in plans} == {3}
    flux = np.array([plan.flux[0, 0] for plan in plans])
    expected = union_of_two_disks(0.5, 0.6) + np.pi * 0.25
    assert abs(flux.mean() - expected) < 4.0 * flux.std() / np.sqrt(len(flux))


def test_photons_of_overlapping_regions_are_as_even_as_those_of_one():
    """The density in the lens of two outlines is that outside of it."""
    plan = plan_emission(scene(ball(0, z=1), ball(0.6, z=4), ball(100)), N)
    rays = [emit(plan, region, range(n)) for region, n in enumerate(plan.counts.tolist())]
    xy = np.concatenate([each.origin[:, :2] for each in rays])
    in_first, in_second = (np.hypot(xy[:, 0] - x, xy[:, 1]) < 0.499 for x in (0.0, 0.6))
    half = 0.3 / 0.499
    lens = 2 * 0.499**2 * (np.arccos(half) - half * np.sqrt(1 - half**2))
    per_area = N / plan.flux[0, 0]
    assert np.count_nonzero(in_first & in_second) == pytest.approx(lens * per_area, rel=0.02)
    assert np.count_nonzero(in_first) == pytest.approx(np.pi * 0.499**2 * per_area, rel=0.01)
    assert np.count_nonzero(in_second) == pytest.approx(np.pi * 0.499**2 * per_area, rel=0.01)


def test_each_region_keeps_the_order_of_halton_points():
    """Any prefix of a region's photons is as evenly spread as Halton points are."""
    plan = plan_emission(scene(ball(0), ball(100)), N)
    for region, n in enumerate(plan.counts.tolist()):
        xy = emit(plan, region, range(n)).origin[:, :2]
        xy = xy - [[0.0, 0.0], [100.0, 0.0]][int(xy[0, 0] > 50)]
        for prefix in (500, n):
            inside = np.hypot(*xy[:prefix].T) < 0.25
            # Independent points would deviate by 0.4 / sqrt(prefix).
            assert abs(inside.mean() - 0.25) < 0.1 / np.sqrt(prefix)


OVERLAPPING = [ball(0, z=1), ball(0.6, z=4), ball(3.0, z=2), ball(100)]


@pytest.mark.kernels_run_elsewhere
@pytest.mark.parametrize("emitter", [DOWN, lamp(1.0, 0.0, 9.0)], ids=["parallel", "point"])
def test_threads_and_batches_do_not_change_the_map(emitter):
    lit = scene(*OVERLAPPING, emitters=[emitter])
    expected = pr.trace_photons(lit, 4000, seed=5, frequency_share=0.01)
    for n_threads, batch_size in ((1, 512), (7, 1500)):
        photons = pr.trace_photons(
            lit, 4000, seed=5, frequency_share=0.01, n_threads=n_threads, batch_size=batch_size
        )
        for name in ("position", "flux", "emitter_coords", "emitter_density", "spectrum"):
            np.testing.assert_array_equal(getattr(photons, name), getattr(expected, name))
        for name in ("emitted", "stored", "escaped"):
            np.testing.assert_array_equal(
                getattr(photons.ledger, name), getattr(expected.ledger, name)
            )
    assert np.isfinite(expected.spectrum).any()


@pytest.mark.parametrize("emitter", [DOWN, lamp(1.0, 0.0, 9.0)], ids=["parallel", "point"])
def test_the_ledger_closes(emitter):
    ledger = pr.trace_photons(scene(*OVERLAPPING, emitters=[emitter]), N).ledger
    lost = ledger.absorbed + ledger.escaped + ledger.cut + ledger.discarded
    np.testing.assert_allclose(ledger.stored + lost, ledger.emitted, rtol=1e-9)


def test_few_photons_are_aimed_at_all_together():
    plan = plan_emission(scene(ball(0), ball(100)), 20)
    assert len(plan.regions) == 1
    assert plan.counts.tolist() == [20]


def test_rendering_takes_photons_of_overlapping_regions():
    lit = scene(*OVERLAPPING)
    camera = pr.Camera([0, -9, 6], [0, 0, 0], width=8, height=6)
    lit = pr.Scene(lit.objects, lit.emitters, camera)
    photons = pr.trace_photons(lit, N)
    assert np.isfinite(pr.render(lit, photons=photons).layers["caustic"]).all()


@dataclass(frozen=True, eq=False)
class Turned(pr.CollimatedEmitter):
    """Parallel light whose coordinates are turned about its direction, by the target."""

    angle: float = 0.0

    def emission_region(self, target, scene, emitter_offset):
        region = super().emission_region(target, scene, emitter_offset)
        turn = Rotation.from_rotvec(self.angle * target.radius * region.frame[2])
        return replace(region, frame=turn.apply(region.frame))


@dataclass(frozen=True, eq=False)
class Mixed(pr.CollimatedEmitter):
    """Parallel light on large targets, and that of a point on small ones."""

    def emission_region(self, target, scene, emitter_offset):
        source = pr.PointEmitter([0, 0, 20.0]) if target.radius < 1.0 else super()
        return source.emission_region(target, scene, emitter_offset)


@pytest.mark.parametrize("emitter", [Turned([0, 0, -1], angle=0.1), Mixed([0, 0, -1])])
def test_emitters_without_a_chart_of_their_own_are_refused(emitter):
    with pytest.raises(ValueError, match=f"those of {type(emitter).__name__} differ by target"):
        plan_emission(scene(ball(0), ball(100), emitters=[emitter]), N)


# Most of what is sent to it passes through it and falls on the floor.
RING = trimesh.creation.torus(5.0, 1e-5, major_sections=64, minor_sections=6)
RING.apply_translation([0, 0, 1])


def closed_box(material):
    return pr.SceneObject(trimesh.creation.box((9, 9, 9)), material)


@pytest.mark.parametrize(
    ("lit", "options", "remedy"),
    [
        (
            pr.Scene(
                [floor(20.0), *objects([ball(0)], pr.Mirror()), closed_box(pr.Diffuse(0.5))],
                [lamp(0, 0, 30.0)],
            ),
            {},
            "Diffuse objects stand between the emitters and the specular ones",
        ),
        (
            scene(ball(0, z=-900.0), side=5.0, emitters=[pr.CollimatedEmitter([1, 0, 0])]),
            {},
            "leaves the scene: place a Diffuse object",
        ),
        (
            scene(ball(0), material=pr.Dielectric(1.5, absorption=1e9)),
            {"n_emitted": 1},
            "raise the reflectance of the materials or lower their absorption",
        ),
        (
            pr.Scene([closed_box(pr.Mirror()), floor(0.01)], [lamp(0, 0, 3.0)]),
            {"max_bounces": 1},
            "Most were cut: raise max_bounces",
        ),
        (
            scene(ball(0), side=0.1),
            {"paths": "global", "n_emitted": 10},
            "leaves the scene",
        ),
        (scene(RING, material=pr.Mirror()), {}, "light misses the specular objects"),
        (
            pr.Scene(
                [
                    floor(20.0),
                    *objects([trimesh.creation.box((4, 4, 4))], pr.Dielectric(1.3, absorption=1e3)),
                    *objects([ball(0, z=-1.0)], pr.Mirror()),
                ],
                [lamp(0, 0, 1.0)],
            ),
            {},
            "raise the reflectance of the materials or lower their absorption",
        ),
    ],
    ids=[
        *("blocked", "nothing below", "black glass", "cut", "floor too small"),
        *("thin ring over a floor", "lamp in black glass"),
    ],
)
def test_nothing_stored_names_cause_and_remedy(lit, options, remedy):
    with pytest.raises(NothingStoredError, match=remedy):
        pr.trace_photons(lit, **{"n_emitted": 50} | options)
