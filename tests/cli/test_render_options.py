"""Options of `photonrelax render` that are arguments of `render` and `render_progressive`."""

import json

import numpy as np
import pytest

import photonrelax as pr
from photonrelax import gallery
from photonrelax.cli import commands
from photonrelax.imaging.image import read_exr
from photonrelax.rendering.view import resized
from tests.helpers.tracing_scenes import box

SMALL = ("--width", "12", "--height", "12", "--photons", "2000", "--quiet")


@pytest.fixture
def lit_by_a_panel(monkeypatch):
    """The ring with a wall behind it, under an area light."""
    ring = gallery.scene("ring")
    wall = pr.SceneObject(box([4, 0.1, 4], [0, 3, 0]), pr.Diffuse())
    panel = pr.AreaEmitter(pr.Disk((0, -1, 4), (0, 0, -1), 0.5), power=10.0)
    scene = pr.Scene([*ring.objects, wall], [panel], ring.camera)
    monkeypatch.setattr(gallery, "scene", lambda name, **_: scene)
    return scene


def rendered(folder, *options):
    """Layers and settings of an image by the command line."""
    output = folder / "out.exr"
    assert commands.main(["render", "ring", "-o", str(output), *SMALL, *options]) == 0
    image = read_exr(output)
    return image.layers, json.loads(image.metadata["photonrelax.settings"])


OPTIONS = ("--light-samples", "3", "--max-depth", "5", "--indirect-k", "60")


def test_they_are_those_of_render(lit_by_a_panel, tmp_path):
    layers, settings = rendered(tmp_path, *OPTIONS)
    assert (settings["light_samples"], settings["max_depth"]) == (3, 5)
    assert settings["indirect"]["k"] == 60
    expected = pr.render(
        resized(lit_by_a_panel, 12, 12),
        n_emitted=2000,
        light_samples=3,
        max_depth=5,
        indirect=pr.GatherSettings(k=60),
    )
    for name, layer in expected.layers.items():
        np.testing.assert_array_equal(layers[name], layer.astype(np.float32), err_msg=name)


def test_they_are_those_of_passes(lit_by_a_panel, tmp_path):
    passes = ("--method", "progressive", "--passes", "1", "--global", "1500")
    layers, settings = rendered(tmp_path, *passes, *OPTIONS)
    assert (settings["light_samples"], settings["max_depth"]) == (3, 5)
    assert (settings["n_global"], settings["indirect"]["k"]) == (1500, 60)
    assert layers["indirect"].any()
    none, settings = rendered(tmp_path, *passes[:-1], "0")
    assert "indirect" not in none
    assert "n_global" not in settings


def test_a_crop_has_the_pixels_of_the_whole_image(tmp_path):
    whole, _ = rendered(tmp_path)
    layers, settings = rendered(tmp_path, "--crop", "2", "3", "9", "5")
    assert settings["crop"] == [2, 3, 9, 5]
    for name, layer in whole.items():
        np.testing.assert_array_equal(layers[name], layer[3:5, 2:9], err_msg=name)


def test_passes_are_of_whole_images(tmp_path, capsys):
    with pytest.raises(SystemExit):
        rendered(
            *(tmp_path, "--method", "progressive", "--passes", "1"), *("--crop", "0", "0", "4", "4")
        )
    assert "leave out --crop" in capsys.readouterr().err


@pytest.mark.parametrize("options", [("--components", "direct"), ("--final-gather", "4")])
def test_passes_are_of_all_light(tmp_path, options, capsys):
    with pytest.raises(SystemExit):
        rendered(tmp_path, "--method", "progressive", "--passes", "1", *options)
    assert "passes are of all light" in capsys.readouterr().err


def test_numbers_that_make_no_sense_are_refused(tmp_path, capsys):
    with pytest.raises(SystemExit):
        rendered(tmp_path, "--light-samples", "0")
    assert "--light-samples: should be at least 1" in capsys.readouterr().err
