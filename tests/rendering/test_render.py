"""Rendering: layers in absolute units, made by stages whose times and counts are reported."""

import importlib
import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import photonrelax as pr
from photonrelax import gallery
from photonrelax.rendering import layers, view

# The module; `pr.render` is the function it holds.
render = importlib.import_module("photonrelax.rendering.render")


def small(name, pixels=24, **sizes):
    return gallery.scene(name, pixels=pixels, **sizes)


@pytest.fixture(scope="module")
def prism():
    return small("prism", subdivisions=5)


@pytest.fixture(scope="module")
def image(prism):
    return pr.render(prism, n_emitted=20_000)


def test_layers_are_those_promised(image):
    # Nothing in this scene is seen to emit, and light is of photons.
    others = {"emission", "envelope.error", "envelope.photons"}
    assert list(image.layers) == [name for name in layers.LAYERS if name not in others]
    for name, layer in image.layers.items():
        colour = name not in ("Z", "photons.constraint", "photons.bounces")
        assert layer.shape == ((24, 24, 3) if colour else (24, 24))


def test_radiance_is_all_light(image):
    total = image.layers["caustic"] + image.layers["direct"] + image.layers["indirect"]
    np.testing.assert_allclose(image.layers["radiance"], total, rtol=1e-12)
    assert image.layers["caustic"].max() > 0.0
    assert image.layers["indirect"].max() > 0.0


def test_photon_layers_are_means(image):
    constraint, bounces = image.layers["photons.constraint"], image.layers["photons.bounces"]
    lit = image.layers["caustic"].sum(axis=2) > 0.0
    assert (bounces[lit] >= 1.0 - 1e-9).all()
    assert (bounces[~lit] == 0.0).all()
    assert constraint.min() >= 0.0
    assert constraint.max() <= 1.0
    assert image.layers["photons.emitter"].min() >= 0.0
    assert image.layers["photons.emitter"].max() <= 1.0


@pytest.mark.parametrize("crop", [(3, 5, 20, 17), (11, 12, 12, 13), (0, 20, 24, 24)])
def test_a_crop_has_the_pixels_of_the_whole_image(prism, crop):
    how = {"n_emitted": 2000, "n_global": 2000, "final_gather": 2}
    whole, part = pr.render(prism, **how), pr.render(prism, crop=crop, **how)
    x0, y0, x1, y1 = crop
    assert part.layers.keys() == whole.layers.keys()
    for name, layer in part.layers.items():
        np.testing.assert_array_equal(layer, whole.layers[name][y0:y1, x0:x1], err_msg=name)
    assert json.loads(part.metadata["photonrelax.settings"])["crop"] == list(crop)


@pytest.mark.parametrize("crop", [(0, 0, 25, 24), (5, 0, 5, 24), (-1, 0, 3, 3), (0, 0, 2), 4.0])
def test_crops_that_are_not_of_the_image_are_refused(prism, crop):
    with pytest.raises(ValueError, match="crop should be"):
        pr.render(prism, crop=crop)


def floor_under(emitter, camera, objects=()):
    quad = trimesh.Trimesh([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], [[0, 1, 2], [0, 2, 3]])
    floor = pr.SceneObject(quad, pr.Diffuse((0.8, 0.4, 0.2)))
    return pr.Scene([floor, *objects], [emitter], camera)


@pytest.mark.parametrize("orthographic_height", [None, 0.2])
def test_radiance_of_a_floor_lit_directly_and_through_a_mirror(orthographic_height):
    """Albedo/π times E₀ cos θ, once from the light and once more from its mirror image."""
    mirror = trimesh.Trimesh(
        [[4, -4, 0.001], [4, 4, 0.001], [4, 4, 8], [4, -4, 8]], [[0, 1, 2], [0, 2, 3]]
    )
    camera = pr.Camera(
        (0, -1, 6),
        (0, 0, 0),
        width=4,
        height=4,
        vertical_fov=2.0,
        orthographic_height=orthographic_height,
    )
    scene = floor_under(
        pr.CollimatedEmitter((1, 0, -1), irradiance=(2, 3, 4)), camera,
        [pr.SceneObject(mirror, pr.Mirror())],
    )  # fmt: skip
    image = pr.render(scene, n_emitted=60_000, method="standard", supersampling=1)
    once = np.array([0.8, 0.4, 0.2]) / np.pi * np.array([2, 3, 4]) * np.sqrt(0.5)
    np.testing.assert_allclose(image.layers["direct"], np.broadcast_to(once, (4, 4, 3)), rtol=1e-9)
    np.testing.assert_allclose(image.layers["caustic"].mean(axis=(0, 1)), once, rtol=0.03)
    np.testing.assert_allclose(image.layers["albedo"][0, 0], [0.8, 0.4, 0.2])
    np.testing.assert_allclose(image.layers["N"][0, 0], [0, 0, 1], atol=1e-12)


def test_bands_and_images_that_see_nothing_are_black(prism):
    up = replace(prism.camera, target=prism.camera.origin + np.array([0.1, 0, 1]))
    image = pr.render(replace(prism, camera=up), n_emitted=5000)
    assert (image.layers["radiance"] == 0.0).all()
    horizon = replace(prism.camera, target=prism.camera.origin + np.array([-1, 0, 0]))
    image = pr.render(replace(prism, camera=horizon), n_emitted=5000)
    assert np.isinf(image.layers["Z"][0]).all()
    assert np.isfinite(image.layers["Z"][-1]).any()


def test_photon_layers_are_means_weighted_with_flux():
    """Two photons on the floor, of one and of three bounces and watts: the mean is 2.5."""
    camera = pr.Camera((0, 0, 5), (0, 0, 0), up=(0, 1, 0), width=1, height=1, vertical_fov=0.1)
    scene = floor_under(pr.CollimatedEmitter((0, 0, -1)), camera)
    photons = pr.PhotonMap(
        [[0.1, 0, 0], [-0.1, 0, 0]],
        [[0, 0, 1], [0, 0, 1]],
        [1.0, 3.0],
        n_bounces=[1, 3],
        emitter_coords=[[0.0, 5.0], [2.0, 5.0]],
        emitter_density=[1.0, 1.0],
    )
    gather = pr.GatherSettings(gather_radius=1.0)
    image = pr.render(scene, photons=photons, gather=gather)
    assert image.layers["photons.bounces"][0, 0] == pytest.approx(2.5, rel=1e-3)
    # Red is the first coordinate over its range, green the second, which does not vary.
    np.testing.assert_allclose(
        image.layers["photons.emitter"][0, 0], [0.75, 0.0, 1 - 0.375], rtol=1e-3
    )
    assert image.layers["Z"][0, 0] == pytest.approx(5.0, rel=1e-6)


def test_the_constraint_layer_shows_what_was_found(prism):
    photons = pr.trace_photons(prism, 20_000)
    found = pr.detect_structure(photons).constraint
    layer = pr.render(prism, photons=photons).layers["photons.constraint"]
    lit = layer > 0.0
    assert lit.mean() > 0.5
    assert layer[lit].mean() == pytest.approx(found.mean(), abs=0.2)


def test_bands_do_not_show(prism, image, monkeypatch):
    """An image made row by row is the same layers."""
    monkeypatch.setattr(view, "_RAYS_PER_BAND", 1)
    again = pr.render(prism, n_emitted=20_000)
    for name, layer in image.layers.items():
        assert again.layers[name].tobytes() == layer.tobytes()


def test_same_bytes_for_every_number_of_threads(prism, image):
    for n_threads in (1, 7):
        again = pr.render(prism, n_emitted=20_000, n_threads=n_threads)
        for name, layer in image.layers.items():
            assert again.layers[name].tobytes() == layer.tobytes()


def test_stages_report_seconds_and_counts(image):
    stages = image.stats["stages"]
    assert list(stages) == [
        "trace",
        "structure",
        "rest_density",
        "relax",
        "trace indirect",
        "indirect",
        "render",
    ]
    assert all(stage["seconds"] > 0.0 for stage in stages.values())
    assert stages["trace"]["emitted"] == 20_000
    assert stages["trace"]["stored"] == stages["relax"]["photons"] > 0
    assert stages["render"]["hit_points"] >= 24 * 24


def test_metadata_say_how_the_image_was_made(image):
    about = image.metadata
    settings = json.loads(about["photonrelax.settings"])
    assert settings["relax"]["n_iterations"] == [5, 5]
    assert settings["gather"]["gather_radius"] > 0.0
    ledger = json.loads(about["photonrelax.ledger"])
    assert ledger["emitted"][0][0] > 0.0
    assert about["photonrelax.method"] == "mapped"
    assert about["photonrelax.photons_emitted"] == "20000"
    assert (about["photonrelax.seed"], about["photonrelax.sampler"]) == ("0", "halton")
    assert about["photonrelax.version"] == pr.__version__


def test_metadata_hold_the_seed_of_photons_traced_before(prism):
    photons = pr.trace_photons(prism, 5000, seed=7, sampler="random")
    gather = pr.GatherSettings(gather_radius=np.float32(np.inf))
    image = pr.render(prism, photons=photons, supersampling=np.int64(1), gather=gather)
    assert image.metadata["photonrelax.seed"] == "7"
    assert image.metadata["photonrelax.sampler"] == "random"
    assert json.loads(image.metadata["photonrelax.settings"])["gather"]["gather_radius"] is None


def test_photons_traced_before_are_used(prism, image):
    photons = pr.trace_photons(prism, 20_000)
    again = pr.render(prism, photons=photons)
    assert again.layers["radiance"].tobytes() == image.layers["radiance"].tobytes()
    assert "trace" not in again.stats["stages"]


def under_glass(*emitters, size=2.0):
    pane = trimesh.creation.box([size, size, 0.1]).apply_translation([0, 0, 1])
    camera = pr.Camera((0, -3, 6), (0, 0, 0), up=(0, 1, 0), width=4, height=4)
    scene = floor_under(emitters[0], camera, [pr.SceneObject(pane, pr.Dielectric())])
    return replace(scene, emitters=emitters)


SUN = pr.CollimatedEmitter((0, 0, -1))
# Over the circle around the pane, m² times 1 W/m².
AIMED = np.pi * (1.0 + 1.0 + 0.05**2)
YELLOWER = pr.CollimatedEmitter((0, 0, -1), irradiance=(1, 1, 0.9))


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (under_glass(YELLOWER), rf"whose emitter 0 sends out .*, but it sent out \[{AIMED:.4f}"),
        (under_glass(SUN, size=2.1), "whose emitter 0 sends out"),
        (under_glass(pr.PointEmitter((0, 0, 3))), "whose emitter 0 sends out"),
        (small("ring"), "whose emitter 0 sends out"),
        (under_glass(SUN, YELLOWER), "which has 2 emitters, but are of one with 1"),
        (
            floor_under(SUN, small("ring").camera),
            "in which they cannot have been traced: .* none of the 1 objects is a Mirror",
        ),
    ],
)
def test_photons_whose_ledger_is_of_another_scene_are_refused(other, message):
    photons = pr.trace_photons(under_glass(SUN), 1000)
    with pytest.raises(ValueError, match=f"photons should be of the scene rendered, {message}"):
        pr.render(other, photons=photons)
    unchecked = pr.render(other, photons=photons.replace(ledger=None), method="standard")
    assert unchecked.layers["radiance"].shape[2] == 3


def test_photons_of_a_scene_of_another_digest_are_refused_though_their_flux_is_right():
    scene = under_glass(SUN)
    photons = pr.trace_photons(scene, 1000)
    denser = replace(scene.objects[1], material=pr.Dielectric(1.7))
    other = replace(scene, objects=[scene.objects[0], denser])
    with pytest.raises(ValueError, match="the same flux, but differs in objects or emitters"):
        pr.render(other, photons=photons)


def test_photons_of_the_scene_with_another_camera_and_name_are_taken():
    scene = under_glass(SUN)
    photons = pr.trace_photons(scene, 1000)
    nearer = pr.Camera((0, -1, 2), (0, 0, 0), up=(0, 1, 0), width=4, height=4)
    image = pr.render(replace(scene, camera=nearer, name="near"), photons=photons)
    assert image.layers["caustic"].any()


@pytest.mark.parametrize("paths", ["caustic", "all"])
def test_without_a_digest_those_with_another_albedo_or_mesh_as_good_are_taken(paths):
    photons = pr.trace_photons(gallery.scene("sphere", subdivisions=4), 3000, paths=paths)
    photons = photons.replace(scene_digest=None)
    scene = small("sphere", subdivisions=3)
    floor = replace(scene.objects[0], material=pr.Diffuse(0.1))
    scene = replace(scene, objects=[floor, *scene.objects[1:]])
    image = pr.render(scene, photons=photons.subset(slice(0, None, 2)), method="standard")
    assert image.layers["caustic"].any()


def test_an_empty_map_is_rendered_black(prism):
    empty = pr.trace_photons(prism, 5000).subset(slice(0, 0))
    image = pr.render(prism, photons=empty)
    assert (image.layers["caustic"] == 0.0).all()


def test_maps_from_elsewhere_lack_layers_but_render(prism):
    photons = pr.trace_photons(prism, 5000)
    bare = pr.PhotonMap(photons.position, photons.normal, photons.flux)
    image = pr.render(prism, photons=bare, method="standard")
    assert not any(name.startswith("photons.") for name in image.layers)


def test_progress_names_every_stage(prism):
    seen = {}
    pr.render(prism, n_emitted=5000, progress=lambda *step: seen.update({step[0]: step[1:]}))
    assert list(seen) == ["trace", "structure", "rest density", "relax", "render"]
    assert all(done == total for done, total in seen.values())


def test_bad_input_is_refused(prism):
    with pytest.raises(ValueError, match="should have a camera"):
        pr.render(replace(prism, camera=None))
    with pytest.raises(ValueError, match="method should be one of"):
        pr.render(prism, method="magic")


@pytest.mark.parametrize(
    ("argument", "error", "message"),
    [
        ({"supersampling": 0}, ValueError, "supersampling should be at least 1"),
        ({"max_depth": 1.5}, TypeError, "max_depth should be an integer"),
        ({"gather": {"k": 10}}, TypeError, "gather should be GatherSettings"),
        ({"relax": 3}, TypeError, "relax should be RelaxSettings"),
        ({"gatherr": None}, TypeError, "render has no argument gatherr; settings are structure, "),
    ],
)
def test_bad_arguments_are_refused_before_any_work(prism, argument, error, message):
    stages = []
    with pytest.raises(error, match=message):
        pr.render(prism, n_emitted=1000, progress=lambda *step: stages.append(step), **argument)
    assert not stages
