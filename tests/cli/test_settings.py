"""Settings on the command line: any of any stage, and none that nothing reads."""

import argparse
import json
from dataclasses import replace

import numpy as np
import pytest

import photonrelax as pr
from photonrelax import gallery
from photonrelax.cli import commands, settings
from photonrelax.estimation.methods import (
    METHODS,
    PHOTON_METHODS,
    SETTINGS_CLASSES,
    MethodInput,
    Settings,
    prepare,
)
from photonrelax.imaging.image import read_exr
from photonrelax.rendering.view import resized

VIEW = ("--width", 12, "--height", 12, "--supersampling", 1)
SMALL = ("--photons", 3000, "--quiet", *VIEW)


def run(*arguments):
    return commands.main([str(argument) for argument in arguments])


def settings_of(path):
    return json.loads(read_exr(path).metadata["photonrelax.settings"])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("diffusion.k=200", ("diffusion", "k", 200)),
        ("diffusion.k=none", ("diffusion", "k", None)),
        ("diffusion.k = 2e2", ("diffusion", "k", 200)),
        ("progressive.alpha=0.6", ("progressive", "alpha", 0.6)),
        ("progressive.radius=global", ("progressive", "radius", "global")),
        ("progressive.radius=0.5", ("progressive", "radius", 0.5)),
        ("gather.gather_radius=inf", ("gather", "gather_radius", np.inf)),
        ("gather.refinement=none", ("gather", "refinement", "none")),
        ("relax.n_iterations=3,3", ("relax", "n_iterations", (3, 3))),
    ],
)
def test_values_are_of_the_kind_of_their_setting(text, expected):
    found = settings.assignment(text)
    assert found == expected
    assert type(found[2]) is type(expected[2])


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("diffusion", "STAGE.FIELD=VALUE"),
        ("k=3", "STAGE.FIELD=VALUE"),
        ("magic.k=3", "the stage should be one of structure, gradient"),
        ("diffusion.q=3", "the setting of diffusion should be one of k, bandwidth"),
        ("diffusion.k=2.5", "diffusion.k should be a whole number, but is '2.5'"),
        ("diffusion.bandwidth=wide", "diffusion.bandwidth should be a number, but is 'wide'"),
        ("relax.n_iterations=3", "relax.n_iterations should be 2 numbers with commas between"),
        ("gather.k=none", "gather.k should be a whole number"),
    ],
)
def test_text_that_is_no_setting_is_refused_with_the_reason(text, complaint, capsys):
    with pytest.raises(argparse.ArgumentTypeError, match=complaint):
        settings.assignment(text)
    with pytest.raises(SystemExit):
        run("render", "ring", "-o", "a.exr", "--set", text)
    assert complaint in capsys.readouterr().err


@pytest.mark.parametrize("method", PHOTON_METHODS)
def test_every_method_says_what_it_reads(method):
    """Settings that are not read are not among those reported as used."""
    photons = pr.trace_photons(gallery.scene("ring"), 2000, frequency_share=0.02)
    used = prepare(method, MethodInput(photons, Settings(), None, None, None)).used
    assert set(used) == set(METHODS[method].stages) <= set(SETTINGS_CLASSES)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("--method", "diffusion", "--k", 5), "--k sets gather.k, which diffusion does not read"),
        (("--method", "standard", "--iterations", 3, 3), "--iterations sets relax.n_iterations"),
        (("--method", "progressive", "--refinement", "none"), "--refinement sets gather"),
        (("--set", "diffusion.k=5"), "--set diffusion.k sets diffusion.k, which mapped"),
        (("--set", "gather.k=5", "--k", 5), "gather.k is given twice"),
        (("--photon-map", "p.npz", "--sampler", "halton"), "leave out --photons, --seed and"),
        (
            ("--method", "progressive", "--passes", 1, "--set", "progressive.n_passes=3"),
            "set --passes instead",
        ),
        (
            ("--method", "progressive", "--passes", 1, "--sampler", "random"),
            "passes are of Halton photons",
        ),
    ],
)
def test_what_no_chosen_method_reads_is_wrong_usage(arguments, complaint, tmp_path, capsys):
    with pytest.raises(SystemExit) as caught:
        run("render", "ring", "-o", tmp_path / "a.exr", *arguments)
    assert caught.value.code == 2
    assert complaint in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_settings_reach_the_stages_of_render(tmp_path):
    path = tmp_path / "a.exr"
    arguments = ("--set", "structure.k=40", "--set", "relax.step=0.5", "--k", 20)
    assert run("render", "ring", "-o", path, *arguments, *SMALL) == 0
    used = settings_of(path)
    assert (used["structure"]["k"], used["relax"]["step"], used["gather"]["k"]) == (40, 0.5, 20)
    assert used["relax"]["n_iterations"] == [5, 5]


def test_k_gives_the_initial_radius_of_progressive_renders(tmp_path):
    for name, more in (("split", ()), ("fresh", ("--passes", 1))):
        path = tmp_path / f"{name}.exr"
        arguments = ("render", "ring", "-o", path, "--method", "progressive", "--k", 6)
        assert run(*arguments, *more, *SMALL) == 0
    assert settings_of(tmp_path / "split.exr")["progressive"]["k"] == 6
    assert settings_of(tmp_path / "fresh.exr")["k"] == 6


def test_one_side_alone_keeps_the_proportions():
    scene = gallery.scene("ring")
    scene = replace(scene, camera=replace(scene.camera, width=400, height=300))
    for given, expected in (
        ((200, None), (200, 150)),
        ((None, 30), (40, 30)),
        ((50, 60), (50, 60)),
        ((None, None), (400, 300)),
    ):
        camera = resized(scene, *given).camera
        assert (camera.width, camera.height) == expected


def test_render_takes_random_photons(tmp_path):
    path = tmp_path / "a.exr"
    arguments = ("--method", "standard", "--sampler", "random")
    assert run("render", "ring", "-o", path, *arguments, *SMALL) == 0
    image = read_exr(path)
    assert image.metadata["photonrelax.sampler"] == "random"
    photons = pr.trace_photons(gallery.scene("ring"), 3000, sampler="random")
    assert image.metadata["photonrelax.photons_stored"] == str(len(photons))


def test_settings_reach_the_methods_of_compare(tmp_path, capsys):
    arguments = ("compare", "shapes", "-o", tmp_path / "out", "--photons", 3000, *VIEW)
    methods = ("--methods", "standard", "diffusion")
    choices = ("--refinement", "bias-compensation", "--k", 30, "--set", "diffusion.k=200")
    assert run(*arguments, *methods, *choices) == 0
    entries = json.loads((tmp_path / "out" / "comparison.json").read_text())["methods"]
    assert entries["standard"]["settings"]["gather"]["refinement"] == "bias-compensation"
    assert entries["standard"]["settings"]["gather"]["k"] == 30
    assert entries["diffusion"]["settings"]["diffusion"]["k"] == 200
    with pytest.raises(SystemExit):
        run(*arguments, *methods, "--iterations", 3, 3)
    assert "standard, diffusion do not read" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("methods", "expected"),
    [
        (("parameterised",), pr.RelaxSettings(k=12)),
        (("mapped", "standard"), pr.RelaxSettings((5, 5), k=12, step=2.0)),
        (("mapped", "parameterised"), pr.RelaxSettings(k=12)),
    ],
)
def test_fields_that_are_not_set_are_those_of_the_method(methods, expected):
    options = argparse.Namespace(set=[("relax", "k", 12)], k=None, refinement=None, iterations=None)
    assert settings.settings_from_options(options, methods).of("relax") == expected
