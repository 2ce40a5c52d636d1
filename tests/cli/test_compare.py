"""`photonrelax compare`: all in one command, errors before the work, nothing lost on Ctrl-C."""

import errno
import json
import os

import numpy as np
import pytest

from photonrelax.cli import commands
from photonrelax.evaluation import comparison, reference, subject
from photonrelax.evaluation.report import folder
from photonrelax.imaging.image import Image, read_exr

SIZE = 32
N = 10_000
VIEW = ("--width", SIZE, "--height", SIZE, "--supersampling", 1)
ARGUMENTS = ("--photons", N, *VIEW)
FEW = ("--reference-photons", N, "--reference-passes")
PAIR = ("standard", "parameterised")


def run_cli(*arguments):
    return commands.main([str(argument) for argument in arguments])


@pytest.fixture
def no_photons(monkeypatch):
    """Fail where photons are traced."""
    monkeypatch.setattr(subject, "trace_photons", None)


@pytest.fixture
def no_reference(monkeypatch):
    """Fail where a reference is computed."""
    monkeypatch.setattr(reference, "_computed", None)


def test_compare_does_it_all_in_one_command(tmp_path, capsys):
    output = tmp_path / "ring"
    arguments = ("compare", "ring", "-o", output, "--methods", *PAIR, *ARGUMENTS)
    assert run_cli(*arguments, *FEW, 2) == 0
    out = capsys.readouterr().out
    assert out.endswith(f"wrote {output / 'index.html'}\n")
    assert "SSIM" in out
    assert "two runs of 1 passes of 10,000 photons" in out
    assert "analytic: over " in out
    first = json.loads((output / "comparison.json").read_text())
    assert first["n_threads"] >= 1
    assert first["machine"] in (output / "index.html").read_text()
    assert run_cli(*arguments, "--reference", output / "reference.exr", "--quiet") == 0
    assert capsys.readouterr().out == ""
    again = json.loads((output / "comparison.json").read_text())
    for method in PAIR:
        assert again["methods"][method]["errors"] == first["methods"][method]["errors"]
    assert again["reference"].startswith("reference.exr: ")


def test_compare_shapes_needs_no_reference(tmp_path, capsys):
    output = tmp_path / "shapes"
    arguments = ("compare", "shapes", "-o", output, "--photons", 4000, *VIEW)
    assert run_cli(*arguments, "--methods", "standard", "isotropic-diffusion") == 0
    assert "reference: exact irradiance at the same points" in capsys.readouterr().out
    assert not (output / "reference.exr").exists()
    assert read_exr(output / "standard.exr").layers["caustic"].max() > 0.2
    np.testing.assert_array_equal(read_exr(output / "standard.exr").layers["direct"], 0.0)


def test_a_folder_that_cannot_be_is_an_error_before_the_work(tmp_path, capsys, no_photons):
    (tmp_path / "file").write_text("")
    assert run_cli("compare", "ring", "-o", tmp_path / "file") == 1
    assert "it is not a folder" in capsys.readouterr().err
    assert run_cli("compare", "ring", "-o", tmp_path / "a" / "b") == 1
    assert "there is no folder" in capsys.readouterr().err
    (tmp_path / "e" / "standard-flip.png").mkdir(parents=True)
    assert run_cli("compare", "ring", "-o", tmp_path / "e") == 1
    assert "it is a folder" in capsys.readouterr().err


def test_a_folder_that_may_not_be_made_is_named(tmp_path, capsys, monkeypatch):
    def refused(self, exist_ok):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(type(tmp_path), "mkdir", refused)
    assert run_cli("compare", "ring", "-o", tmp_path / "new", *ARGUMENTS) == 1
    expected = f"photonrelax: error: cannot make the folder {tmp_path / 'new'}: Permission denied\n"
    assert capsys.readouterr().err == expected


def test_a_foreign_reference_is_an_error_before_the_work(tmp_path, capsys, no_photons):
    (tmp_path / "reference.exr").write_text("mine")
    assert run_cli("compare", "ring", "-o", tmp_path) == 1
    assert "move it away" in capsys.readouterr().err
    assert (tmp_path / "reference.exr").read_text() == "mine"


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("ring", "--reference", "none.exr"), "there is no file"),
        (("ring", "--width", 8), "at least 11 x 11 pixels"),
        (("ring", "--seed", 2**64), "seed should be below"),
        (("shapes", "--methods", "frequency"), "carry no spectra"),
    ],
)
def test_what_cannot_be_leaves_no_folder(arguments, complaint, tmp_path, capsys, no_photons):
    assert run_cli("compare", *arguments, "-o", tmp_path / "new") == 1
    assert complaint in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("name", ["standard.exr", "relaxation.exr"])
def test_a_reference_that_the_comparison_replaces_or_removes_is_an_error(
    name, tmp_path, capsys, no_photons
):
    mine = tmp_path / name
    Image({"radiance": np.ones((SIZE, SIZE, 3))}).write_exr(mine)
    before = mine.read_bytes()
    compare = ("compare", "ring", "-o", tmp_path, "--methods", "standard", *ARGUMENTS)
    assert run_cli(*compare, "--reference", mine) == 1
    assert f"the image {name} and --reference should not be one file" in capsys.readouterr().err
    assert mine.read_bytes() == before


def test_photons_that_are_none_are_an_error_before_a_reference(tmp_path, capsys, no_reference):
    """The reference takes minutes."""
    assert run_cli("compare", "ring", "--photons", 1, *VIEW, "-o", tmp_path, "--quiet") == 1
    assert "no photons were stored" in capsys.readouterr().err


def test_a_method_that_fails_does_so_before_a_reference(
    tmp_path, capsys, monkeypatch, no_reference
):
    prepare = comparison.prepare

    def failing(method, task):
        if method == "diffusion":
            raise ValueError("photons are too few")
        return prepare(method, task)

    monkeypatch.setattr(comparison, "prepare", failing)
    arguments = ("compare", "ring", "--methods", "standard", "diffusion", *ARGUMENTS)
    assert run_cli(*arguments, "-o", tmp_path, "--quiet") == 1
    assert "photons are too few" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("shapes", "--reference-passes", 5), "--reference-passes is of a reference that is comp"),
        (("shapes", "--reference-photons", 5), "the irradiance of shapes is exact: leave it"),
        (("ring", "--reference", "none.exr", "--reference-passes", 50), "--reference gives one"),
        (("ring", "--reference", "none.exr", "--reference-photons", 3), "--reference gives one"),
    ],
)
def test_options_of_a_reference_that_is_not_computed_are_wrong_usage(
    arguments, complaint, tmp_path, capsys, no_photons
):
    with pytest.raises(SystemExit) as caught:
        run_cli("compare", *arguments, "-o", tmp_path / "new")
    assert caught.value.code == 2
    assert complaint in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_leaves_the_reference_alone(tmp_path, monkeypatch, capsys):
    """It took longest, and the next run resumes it."""

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(folder, "table", interrupted)
    output = tmp_path / "ring"
    arguments = ("compare", "ring", "-o", output, "--methods", *PAIR, *ARGUMENTS)
    assert run_cli(*arguments, *FEW, 1, "--quiet") == 130
    assert [path.name for path in output.iterdir()] == ["reference.exr"]
    assert capsys.readouterr().err == "photonrelax: interrupted\n"
