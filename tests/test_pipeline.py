"""From emitter to irradiance: scenes whose answer is known, and what must not matter."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax import gallery
from tests.analytic.glass_sphere import GlassSphere
from tests.analytic.metal_ring import MetalRing
from tests.helpers.photon_maps import plane


def test_relaxed_sphere_profile():
    """Away from the focus, within 3 % of the quadrature of Snell and Fresnel."""
    edges = np.array([0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6])
    expected = GlassSphere(gap=0.2, irradiance=0.8).annulus_irradiance(edges, orders=range(-1, 8))
    rng = np.random.default_rng(0)
    inner, outer = edges[:-1, np.newaxis], edges[1:, np.newaxis]
    radius = np.sqrt(inner**2 + (outer**2 - inner**2) * rng.random((6, 4000)))
    angle = rng.uniform(0, 2 * np.pi, radius.shape)
    around = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    scene = gallery.scene("sphere", gap=0.2, irradiance=0.8, subdivisions=5)
    photons = pr.trace_photons(scene, 150_000)
    estimates = pr.irradiance_field(photons)(*plane(around.reshape(-1, 2)))[:, 0]
    np.testing.assert_allclose(estimates.reshape(6, -1).mean(axis=1), expected, rtol=0.03)


def test_relaxed_ring_equals_the_reflection_map():
    """Pixel means of the nephroid; relaxed photons come closer to it than the same unrelaxed."""
    sizes = {"height": 0.5, "gap": 1e-3, "irradiance": 2.5, "reflectance": 0.95}
    scene = gallery.scene("ring", elevation=28.0, **sizes)
    photons = pr.trace_photons(scene, 600_000)
    edges = np.linspace(-1, 1, 41)
    ring = MetalRing(elevation=np.radians(28.0), **sizes)
    expected = ring.pixel_irradiance(edges, 1_000_000)
    centres = 0.5 * (edges[1:] + edges[:-1])
    inside = np.hypot(*np.meshgrid(centres, centres, indexing="ij")) < 0.93
    fine = (np.arange(320) + 0.5) / 160 - 1
    points, normals = plane(np.stack(np.meshgrid(fine, fine, indexing="ij"), -1).reshape(-1, 2))
    error = {}
    for method in ("standard", "parameterised"):
        estimates = pr.irradiance_field(photons, method=method)(points, normals)[:, 0]
        pixels = estimates.reshape(40, 8, 40, 8).mean(axis=(1, 3))
        error[method] = relative_l1(pixels[inside], expected[inside])
    assert error["parameterised"] < 0.025
    assert error["parameterised"] < error["standard"]


def test_relaxed_prism_comes_closer_to_a_much_larger_run():
    """SJ13 Fig. 6: the same photons, relaxed or not, against ten times as many."""
    scene = gallery.scene("prism", subdivisions=6)
    few = pr.trace_photons(scene, 250_000, sampler="random")
    many = pr.trace_photons(scene, 2_500_000, seed=1)
    points, normals = plane(np.random.default_rng(0).uniform([0.8, 0.3], [1.8, 1.2], (20_000, 2)))
    expected = pr.estimate_irradiance(many, points, normals, pr.GatherSettings(k=50))
    standard, relaxed = (
        relative_l1(pr.irradiance_field(few, method=m)(points, normals), expected)
        for m in ("standard", "parameterised")
    )
    assert relaxed < 0.8 * standard


IDENTITY = np.eye(3)


def transformed(scene, *, rotation=IDENTITY, scale=1.0, shift=(0.0, 0.0, 0.0)):
    """The scene turned, then scaled, then moved; with irradiance as before."""

    def point(x):
        return scale * (np.asarray(x) @ rotation.T) + shift

    def mesh(old):
        return trimesh.Trimesh(
            point(old.vertices),
            old.faces,
            vertex_normals=old.vertex_normals @ rotation.T,
            process=False,
        )

    def emitter(old):
        if isinstance(old, pr.CollimatedEmitter):
            return replace(old, direction=rotation @ old.direction)
        return replace(old, position=point(old.position), power=old.power * scale**2)

    return pr.Scene(
        [replace(item, mesh=mesh(item.mesh)) for item in scene.objects],
        [emitter(old) for old in scene.emitters],
    )


def relative_l1(a, b):
    return np.abs(a - b).sum() / np.abs(b).sum()


SCENES = {
    "sphere": lambda: gallery.scene("sphere", subdivisions=5),
    "prism": lambda: gallery.scene("prism", subdivisions=5),
}


def irradiance(scene, points, normals, seed=0):
    photons = pr.trace_photons(scene, 30_000, seed=seed)
    return pr.irradiance_field(photons, scene=scene)(points, normals)[:, 0]


@pytest.fixture(scope="module", params=SCENES)
def known(request):
    """A scene, points on its floor and the irradiance there."""
    scene = SCENES[request.param]()
    centre = [1.2, 0.7] if request.param == "prism" else [0.0, 0.0]
    xy = np.random.default_rng(1).uniform(-0.8, 0.8, (20_000, 2)) + centre
    points, normals = plane(xy)
    return scene, points, normals, irradiance(scene, points, normals)


@pytest.mark.parametrize("scale", [1e-4, 1e4])
def test_the_unit_of_length_does_not_matter(known, scale):
    scene, points, normals, before = known
    after = irradiance(transformed(scene, scale=scale), points * scale, normals)
    assert relative_l1(after, before) < 1e-3


def test_where_the_scene_is_does_not_matter(known):
    scene, points, normals, before = known
    shift = 1e4 * scene.scale * np.array([1.0, -1.0, 1.0])
    after = irradiance(transformed(scene, shift=shift), points + shift, normals)
    assert relative_l1(after, before) < 1e-3


def test_turning_the_scene_changes_no_more_than_another_seed(known):
    scene, points, normals, before = known
    turned, reseeded = [], []
    # Among seeds, and among rotations, errors vary by some 5 % about the same mean.
    for seed, (angle, axis) in enumerate([(1.1, [1, 2, 3]), (1.5, [1, 1, 0]), (0.7, [3, 1, 2])], 1):
        rotation = trimesh.transformations.rotation_matrix(angle, axis)[:3, :3]
        scene_turned = transformed(scene, rotation=rotation)
        after = irradiance(scene_turned, points @ rotation.T, normals @ rotation.T)
        turned.append(relative_l1(after, before))
        reseeded.append(relative_l1(irradiance(scene, points, normals, seed=seed), before))
    assert np.mean(turned) < 1.1 * np.mean(reseeded)


def test_photons_stay_on_their_surfaces_and_keep_their_flux():
    scene = SCENES["prism"]()
    photons = pr.trace_photons(scene, 50_000)
    relaxed = pr.relax(photons, pr.detect_structure(photons), scene=scene)
    assert relaxed.flux.sum(axis=0).tobytes() == photons.flux.sum(axis=0).tobytes()
    on_floor = photons.object_id == 0
    assert on_floor.sum() > 10_000
    assert np.abs(relaxed.position[on_floor, 2]).max() < 1e-6 * scene.scale


def test_same_bytes_for_every_number_of_threads_and_batch_size():
    """From tracing to irradiance."""
    scene = SCENES["prism"]()
    points, normals = plane(np.random.default_rng(2).uniform(0.5, 1.5, (5000, 2)))
    results = set()
    for n_threads, batch_size in ((1, 65536), (2, 4096), (7, 20_000)):
        photons = pr.trace_photons(scene, 30_000, n_threads=n_threads, batch_size=batch_size)
        field = pr.irradiance_field(photons, scene=scene, n_threads=n_threads)
        results.add(field(points, normals).tobytes())
    assert len(results) == 1
