"""The command line: what it parses, prints, writes and returns."""

import argparse
import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image as PILImage

import photonrelax as pr
from photonrelax import gallery
from photonrelax.cli import arguments, commands
from photonrelax.imaging.image import read_exr

PASSES = ["render", "ring", "-o", "a.exr", "--method", "progressive"]
HEAVY = ("scipy", "trimesh", "matplotlib", "OpenEXR", "tqdm")


def run(*arguments):
    return commands.main([str(argument) for argument in arguments])


@pytest.fixture
def small_map(tmp_path):
    rng = np.random.default_rng(3)
    position = np.column_stack([rng.uniform(0, 1, (500, 2)), np.zeros(500)])
    photons = pr.PhotonMap(
        position=position,
        normal=np.tile([0.0, 0.0, 1.0], (500, 1)),
        flux=np.full(500, 0.002),
        emitter_coords=position[:, :2],
        emitter_density=np.full(500, 500.0),
        n_emitted=500,
    )
    photons.save(tmp_path / "photons.npz")
    return photons


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from photonrelax.cli.commands import main\n"
        "try: main(['--help'])\n"
        f"finally: print([name for name in {HEAVY} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "render" in done.stdout
    assert done.stdout.splitlines()[-1] == "[]"


def test_list_names_every_scene(capsys):
    assert run("list") == 0
    lines = capsys.readouterr().out.splitlines()
    names = [*gallery.names(), *gallery.pattern_names()]
    assert [line.split()[0] for line in lines] == names


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ([], "required"),
        (["render", "teapot", "-o", "a.exr"], "toruses or a file named *.py"),
        (["render", "ring"], "-o/--output"),
        (["render", "ring", "-o", "a.exr", "--method", "magic"], "invalid choice: 'magic'"),
        (["render", "ring", "-o", "a.exr", "--photons", "many"], "a whole number, but is 'many'"),
        (["render", "ring", "-o", "a.exr", "--photons", "2.5"], "a whole number, but is '2.5'"),
        (["render", "ring", "-o", "a.exr", "--k", "0"], "at least 1, but is '0'"),
        (["render", "ring", "-o", "a.exr", "--seed", "-1"], "a whole number, but is '-1'"),
        (["render", "ring", "-o", "a.exr", "--iterations", "7"], "expected 2 arguments"),
        (["render", "ring", "-o", "a.exr", "--exposure", "1e9"], "between -100 and 100"),
        (["render", "ring", "-o", "a.exr", "--exposure", "nan"], "between -100 and 100"),
        (["render", "ring", "-o", "a.exr", "--photon-map", "p", "--photons", "9"], "leave out"),
        (["render", "ring", "-o", "a.exr", "--photon-map", "p", "--seed", "0"], "leave out"),
        (["render", "ring", "-o", "a.exr", "--arg", "size=2"], "--arg should be of radius, thick"),
        (["render", "ring", "-o", "a.exr", "--arg", "radius=()"], "values that ring takes"),
        ([*PASSES[:-2], "--passes", "3"], "need --method progressive"),
        ([*PASSES[:-2], "--minutes", "3"], "need --method progressive"),
        ([*PASSES, "--state", "s.npz"], "need --passes or --minutes"),
        ([*PASSES, "--interval", "9"], "need --passes or --minutes"),
        ([*PASSES, "--stochastic"], "need --passes or --minutes"),
        ([*PASSES, "--passes", "3", "--photon-map", "p"], "leave out --photon-map"),
        ([*PASSES, "--minutes", "0"], "a positive number, but is '0'"),
        ([*PASSES, "--minutes", "inf"], "a positive number, but is 'inf'"),
    ],
)
def test_wrong_usage_exits_2_and_says_why(arguments, complaint, capsys):
    with pytest.raises(SystemExit) as caught:
        run(*arguments)
    assert caught.value.code == 2
    assert complaint in capsys.readouterr().err


def test_built_in_scenes_take_arguments(capsys):
    arguments = ["sections=16", "surroundings=0.1,0.2,0.3"]
    assert run("plan", "ring", *(word for each in arguments for word in ("--arg", each))) == 0
    assert "emitters that a camera may see: 1" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "number"),
    [("7", 7), ("2e6", 2_000_000), ("1_000", 1000), (str(2**60 + 1), 2**60 + 1)],
)
def test_numbers_may_be_written_as_people_write_them(text, number):
    assert arguments.whole(text) == number


@pytest.mark.parametrize("text", ["inf", "nan", "1e999", "-3", "", "0x10"])
def test_what_is_no_whole_number_is_refused(text):
    with pytest.raises(argparse.ArgumentTypeError):
        arguments.whole(text)


def test_an_output_that_cannot_be_written_is_an_error_before_the_work(tmp_path, capsys):
    nowhere = tmp_path / "missing" / "ring.exr"
    assert run("render", "ring", "-o", nowhere) == 1
    error = capsys.readouterr().err
    assert (
        error
        == f"photonrelax: error: cannot write {nowhere}: there is no folder {nowhere.parent}\n"
    )
    assert run("render", "ring", "-o", tmp_path / "ring.jpg") == 1
    assert "should be named *.exr" in capsys.readouterr().err
    assert run("trace", "ring", "-o", tmp_path) == 1
    (tmp_path / "folder.npz").mkdir()
    assert run("trace", "ring", "-o", tmp_path / "folder.npz") == 1
    assert "it is a folder" in capsys.readouterr().err


@pytest.fixture
def no_work(monkeypatch):
    """Fail where the stages start."""

    def works(*_, **__):
        pytest.fail("the work was begun")

    for name in ("render", "render_progressive", "trace_photons", "relax", "detect_structure"):
        monkeypatch.setattr(pr, name, works)


@pytest.mark.parametrize(
    ("stats", "complaint"),
    [
        ("missing/stats.json", "there is no folder"),
        (".", "it is a folder"),
        ("a.exr", "--stats and the image should not be one file"),
        ("a.png", "--stats and the preview should not be one file"),
        ("link.json", "--stats and the image should not be one file"),
        ("photons.npz", "--photon-map and --stats should not be one file"),
    ],
)
def test_statistics_go_to_a_file_of_their_own(
    stats, complaint, small_map, no_work, *, tmp_path, capsys
):
    (tmp_path / "link.json").symlink_to(tmp_path / "a.exr")
    maps = ("--photon-map", tmp_path / "photons.npz")
    assert run("render", "ring", "-o", tmp_path / "a.exr", "--stats", tmp_path / stats, *maps) == 1
    assert complaint in capsys.readouterr().err


def test_a_preview_that_cannot_be_written_is_an_error_before_the_work(no_work, tmp_path, capsys):
    (tmp_path / "a.png").mkdir()
    assert run("render", "ring", "-o", tmp_path / "a.exr") == 1
    assert f"cannot write {tmp_path / 'a.png'}: it is a folder" in capsys.readouterr().err


@pytest.mark.skipif(not os.path.isdir("/proc"), reason="no folder that nobody can write to")
def test_a_folder_that_takes_no_files_is_an_error_before_the_work(small_map, no_work, tmp_path):
    assert run("render", "ring", "-o", "/proc/a.exr") == 1
    assert run("render", "ring", "-o", tmp_path / "a.exr", "--stats", "/proc/a.json") == 1
    assert run("trace", "ring", "-o", "/proc/a.npz") == 1
    assert run("relax", tmp_path / "photons.npz", "-o", "/proc/a.npz") == 1


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (TypeError("two\nlines"), "two lines"),
        (MemoryError(), "out of memory"),
        (OSError("disk full"), "disk full"),
    ],
)
def test_errors_are_printed_in_one_line(error, message, tmp_path, capsys, monkeypatch):
    def fails(*_, **__):
        raise error

    monkeypatch.setattr(pr, "trace_photons", fails)
    assert run("trace", "ring", "-o", tmp_path / "a.npz") == 1
    assert capsys.readouterr().err == f"photonrelax: error: {message}\n"


def test_relax_reads_a_map_and_writes_another(small_map, tmp_path, capsys):
    output = tmp_path / "relaxed.npz"
    arguments = ["relax", tmp_path / "photons.npz", "-o", output, "--iterations", 2, 1]
    assert run(*arguments, "--method", "parameterised", "--threads", 1) == 0
    assert f"wrote {output}" in capsys.readouterr().out
    relaxed = pr.PhotonMap.load(output)
    settings = pr.RelaxSettings(n_iterations=(2, 1))
    expected = pr.relax(small_map, pr.detect_structure(small_map), settings)
    np.testing.assert_array_equal(relaxed.position, expected.position)


@pytest.mark.parametrize(
    ("options", "settings"),
    [
        ((), pr.RelaxSettings((5, 5), step=2.0)),
        (("--iterations", 2, 1), pr.RelaxSettings((2, 1), step=2.0)),
    ],
)
def test_relax_towards_the_rest_density(options, settings, small_map, tmp_path, capsys):
    output = tmp_path / "relaxed.npz"
    assert run("relax", tmp_path / "photons.npz", "-o", output, *options) == 0
    assert "rest_density" in capsys.readouterr().out
    rest = pr.rest_density(small_map)
    expected = pr.relax(small_map, pr.detect_structure(small_map), settings, rest=rest)
    np.testing.assert_array_equal(pr.PhotonMap.load(output).position, expected.position)


SIZE = ("--width", 12, "--height", 8, "--supersampling", 1)
SMALL = ("--photons", 3000, "--seed", 5, *SIZE)


def test_render_writes_the_image_its_preview_and_its_statistics(tmp_path, capsys):
    output, stats = tmp_path / "ring.exr", tmp_path / "stats.json"
    options = ("--k", 20, "--iterations", 2, 1, "--threads", 2, "--stats", stats)
    assert run("render", "ring", "-o", output, *SMALL, *options) == 0
    out = capsys.readouterr().out
    assert [line.split()[0] for line in out.splitlines()] == [
        "modelled:",
        *STAGES,
        "total",
        "wrote",
    ]
    assert "emitted 3,000" in out

    scene = gallery.scene("ring")
    scene = replace(scene, camera=replace(scene.camera, width=12, height=8))
    expected = pr.render(
        scene,
        n_emitted=3000,
        seed=5,
        supersampling=1,
        gather=pr.GatherSettings(k=20),
        relax=pr.RelaxSettings(n_iterations=(2, 1), step=2.0),
    )
    image = read_exr(output)
    np.testing.assert_array_equal(
        image.layers["radiance"], expected.layers["radiance"].astype(np.float32)
    )
    with PILImage.open(tmp_path / "ring.png") as preview:
        assert preview.size == (12, 8)
    assert list(json.loads(stats.read_text())["stages"]) == list(STAGES)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ring.exr", "ring.png", stats.name]


STAGES = ("trace", "structure", "rest_density", "relax", "render")


def test_render_goes_on_with_passes_where_it_stopped(tmp_path, capsys):
    command = ("render", "ring", "--method", "progressive", *SMALL, "--k", 20)
    state = ("--state", tmp_path / "run.npz")
    straight, stopped = tmp_path / "straight.exr", tmp_path / "stopped.exr"
    assert run(*command, "--passes", 3, "-o", straight) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["modelled:", "passes", "total", "wrote"]
    for passes in (2, 3):
        assert run(*command, "--passes", passes, *state, "-o", stopped, "--quiet") == 0
    assert stopped.read_bytes() == straight.read_bytes()
    assert stopped.with_suffix(".png").read_bytes() == straight.with_suffix(".png").read_bytes()

    scene = gallery.scene("ring")
    scene = replace(scene, camera=replace(scene.camera, width=12, height=8))
    expected = pr.render_progressive(
        scene,
        n_passes=3,
        photons_per_pass=3000,
        seed=5,
        supersampling=1,
        settings=pr.ProgressiveSettings(k=20),
    )
    radiance = expected.layers["radiance"].astype(np.float32)
    np.testing.assert_array_equal(read_exr(straight).layers["radiance"], radiance)
    assert run(*command, "--passes", 2, *state, "-o", stopped) == 1
    assert "n_passes should be at least the 3" in capsys.readouterr().err


def test_passes_for_a_time_move_about_in_their_pixels(tmp_path, capsys):
    command = (*PASSES[:3], tmp_path / "a.exr", *PASSES[4:], *SMALL, "--stochastic")
    stats = tmp_path / "stats.json"
    assert run(*command, "--minutes", "0.001", "--interval", "0.01", "--stats", stats) == 0
    assert json.loads(stats.read_text())["stages"]["passes"]["passes"] >= 1
    assert "stochastic" in read_exr(tmp_path / "a.exr").metadata["photonrelax.settings"]


def test_the_state_of_a_run_is_a_file_of_its_own(no_work, tmp_path, capsys):
    output = tmp_path / "a.exr"
    command = ("render", "ring", "-o", output, "--method", "progressive", "--passes", 1)
    assert run(*command, "--state", output) == 1
    assert "--state and the image should not be one file" in capsys.readouterr().err


def test_refinement_reaches_the_estimates(tmp_path, capsys):
    command = ("render", "ring", "-o", tmp_path / "a.exr", "--refinement", "bias-compensation")
    assert run(*command, "--k", 30, "--method", "standard", "--quiet", *SMALL) == 0
    settings = json.loads(read_exr(tmp_path / "a.exr").metadata["photonrelax.settings"])
    assert settings["gather"]["refinement"] == "bias-compensation"
    assert run(*command, "--k", 10, "--quiet", *SMALL) == 1
    assert "k should be more than k_min, 15, with a refinement" in capsys.readouterr().err


def test_exposure_brightens_the_preview_alone(tmp_path):
    for name, stops in (("dark", -2), ("bright", 0)):
        arguments = ("render", "ring", "-o", tmp_path / f"{name}.exr", "--exposure", stops)
        assert run(*arguments, "--method", "standard", "--quiet", *SMALL) == 0
    dark, bright = (read_exr(tmp_path / f"{name}.exr") for name in ("dark", "bright"))
    np.testing.assert_array_equal(dark.layers["radiance"], bright.layers["radiance"])
    with PILImage.open(tmp_path / "dark.png") as a, PILImage.open(tmp_path / "bright.png") as b:
        assert np.mean(a) < np.mean(b)


def test_trace_writes_the_photons_of_a_scene(tmp_path, capsys):
    output = tmp_path / "photons.npz"
    assert run("trace", "ring", "-o", output, "--photons", "2e3", "--sampler", "random") == 0
    photons = pr.PhotonMap.load(output)
    expected = pr.trace_photons(gallery.scene("ring"), 2000, sampler="random")
    np.testing.assert_array_equal(photons.position, expected.position)
    assert f"emitted 2,000, stored {len(expected):,}" in capsys.readouterr().out


def test_relax_keeps_photons_on_the_surfaces_of_their_scene(tmp_path):
    bounds = gallery.scene("ring").objects[0].mesh.bounds
    rng = np.random.default_rng(4)
    # A strip along the border of the floor, over which repulsion pushes photons.
    position = bounds[1] - rng.uniform(0, 1, (500, 3)) * [0.1, 1.0, 0.0]
    photons = pr.PhotonMap(
        position, np.tile([0.0, 0.0, 1.0], (500, 1)), np.ones(500), object_id=np.zeros(500, int)
    )
    photons.save(tmp_path / "photons.npz")
    arguments = ("relax", tmp_path / "photons.npz", "--quiet", "-o")
    assert run(*arguments, tmp_path / "free.npz") == 0
    assert run(*arguments, tmp_path / "kept.npz", "--scene", "ring") == 0
    free, kept = (pr.PhotonMap.load(tmp_path / f"{name}.npz") for name in ("free", "kept"))
    assert (free.position > bounds[1] + 1e-3).any()
    assert (kept.position <= bounds[1] + 1e-6).all()
    assert (kept.position != photons.position).any()


@pytest.mark.parametrize("method", ["standard", "parameterised"])
def test_render_takes_photons_traced_before(method, tmp_path, capsys):
    traced = tmp_path / "photons.npz"
    assert run("trace", "ring", "-o", traced, "--photons", 3000, "--seed", 5, "--quiet") == 0
    command = ("render", "ring", "--method", method, *SIZE)
    assert run(*command, "--photon-map", traced, "-o", tmp_path / "apart.exr") == 0
    assert "trace" not in capsys.readouterr().out
    emission = ("--photons", 3000, "--seed", 5)
    assert run(*command, *emission, "-o", tmp_path / "at_once.exr") == 0
    apart, at_once = (read_exr(tmp_path / f"{name}.exr") for name in ("apart", "at_once"))
    for name, layer in at_once.layers.items():
        np.testing.assert_array_equal(apart.layers[name], layer, err_msg=name)


def test_stages_run_apart_make_the_same_caustic(tmp_path):
    traced, relaxed = tmp_path / "photons.npz", tmp_path / "relaxed.npz"
    assert run("trace", "ring", "-o", traced, "--photons", 3000, "--seed", 5, "--quiet") == 0
    assert run("relax", traced, "-o", relaxed, "--scene", "ring", "--quiet") == 0
    maps = ("--photon-map", relaxed, "--method", "standard")
    assert run("render", "ring", "-o", tmp_path / "apart.exr", *maps, *SIZE, "--quiet") == 0
    assert run("render", "ring", "-o", tmp_path / "at_once.exr", *SMALL, "--quiet") == 0
    apart, at_once = (read_exr(tmp_path / f"{name}.exr") for name in ("apart", "at_once"))
    np.testing.assert_array_equal(apart.layers["caustic"], at_once.layers["caustic"])


def test_failures_in_the_pipeline_are_one_line(tmp_path, capsys):
    output = tmp_path / "ring.exr"
    assert run("render", "ring", "-o", output, "--photons", 1, "--quiet") == 1
    error = capsys.readouterr().err
    assert error.startswith("photonrelax: error: ")
    assert error.count("\n") == 1
    assert not output.exists()


def test_quiet_prints_nothing(small_map, tmp_path, capsys):
    assert run("relax", tmp_path / "photons.npz", "-o", tmp_path / "r.npz", "--quiet") == 0
    assert capsys.readouterr() == ("", "")
