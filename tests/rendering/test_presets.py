"""Presets: data that are whole, and choices that give way to what is given."""

import json

import pytest

import photonrelax as pr
from photonrelax import gallery
from photonrelax.cli import main
from photonrelax.estimation.methods import DEFAULT_METHOD
from photonrelax.rendering.presets import (
    PRESETS,
    SCENE_CLASSES,
    Choice,
    choose,
    preset,
    preset_data,
    scene_class,
    work_of,
)

ROWS = [
    pytest.param(Choice(method, row["n_emitted"], row["supersampling"], row["stages"]))
    for of_class in preset_data()["presets"].values()
    for rows in of_class.values()
    for method, row in rows.items()
]


def test_all_classes_have_all_presets_with_version_and_date():
    data = preset_data()
    assert tuple(data["presets"]) == SCENE_CLASSES == tuple(data["measured_on"])
    assert all(tuple(of_class) == PRESETS for of_class in data["presets"].values())
    assert data["version"]
    assert data["date"] > "2026"


def test_rows_that_no_two_scenes_of_the_class_were_measured_for_say_so():
    data = preset_data()
    for name, of_class in data["presets"].items():
        for each, rows in of_class.items():
            measured = len(data["measured_on"][name]) >= 2 and each != "paper"
            assert {row["measured"] for row in rows.values()} == {measured}
            assert not measured or all("error" in row for row in rows.values())


@pytest.mark.parametrize("choice", ROWS)
def test_rows_are_settings_of_their_methods(choice):
    assert choice.settings.given.keys() == choice.stages.keys()
    assert json.loads(json.dumps(choice.to_dict())) == choice.to_dict()


@pytest.mark.parametrize(
    ("scene", "name"), [("ring", "sharp"), ("prism", "sharp"), ("box", "extended")]
)
def test_classes_of_scenes(scene, name):
    assert scene_class(gallery.scene(scene)) == name


def test_the_papers_settings_are_the_defaults(ring):
    assert preset("paper", ring) == Choice("parameterised", 1_000_000)


def test_presets_get_more_exact(ring):
    errors = [preset_data()["presets"]["sharp"][name]["mapped"]["error"] for name in PRESETS[:3]]
    assert errors == sorted(errors, reverse=True)


def test_work_is_that_of_the_class(ring):
    work, row = work_of(ring), preset_data()["presets"]["sharp"]["final"]["mapped"]
    assert work.photon == row["seconds"] / row["n_emitted"]
    assert work.envelope == preset_data()["envelopes"]["sharp"]


def test_nothing_asked_for_is_the_default(ring):
    assert choose(ring, None) == Choice(DEFAULT_METHOD, 1_000_000)
    assert choose(ring, "standard") == Choice("standard", 1_000_000)


def test_an_error_chooses_a_preset(ring):
    assert choose(ring, None, error=0.1) == preset("draft", ring)
    assert choose(ring, "mapped", error=0.001) == preset("final", ring, "mapped")
    assert choose(ring, "frequency", error=0.1) == Choice("frequency", 1_000_000)


def test_what_is_given_replaces_what_a_preset_says(ring):
    image = pr.render(
        ring, preset="draft", method="mapped", n_emitted=3000, gather=pr.GatherSettings(k=20)
    )
    used = json.loads(image.metadata["photonrelax.settings"])
    assert used["gather"]["k"] == 20
    assert used["relax"]["n_iterations"] == [
        *preset("draft", ring, "mapped").settings.of("relax").n_iterations
    ]
    assert image.metadata["photonrelax.photons_emitted"] == "3000"


def test_methods_without_a_preset_are_named(ring):
    with pytest.raises(ValueError, match=r"presets are of the methods .*method is 'frequency'"):
        pr.render(ring, preset="draft", method="frequency")


def test_presets_on_the_command_line(tmp_path):
    path = tmp_path / "ring.exr"
    command = ["render", "ring", "-o", str(path), "--width", "16", "--quiet"]
    assert main([*command, "--preset", "draft", "--method", "standard"]) == 0
    assert path.exists()
