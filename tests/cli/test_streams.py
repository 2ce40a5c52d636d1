"""Standard output and error: statistics, names that they cannot print, and closed ones."""

import io
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import photonrelax as pr
from photonrelax.cli import commands
from photonrelax.evaluation.report.contact_sheet import contact_sheet
from photonrelax.imaging.image import read_exr

SIZE = ("--photons", "2000", "--width", "12", "--height", "8", "--supersampling", "1")
RENDER = ("render", "ring", "--method", "standard", *SIZE)


def process(*arguments, **options):
    command = [sys.executable, "-m", "photonrelax", *map(os.fspath, arguments)]
    environment = os.environ | options.pop("env", {})
    return subprocess.run(command, capture_output=True, timeout=60, env=environment, **options)


# --- statistics -----------------------------------------------------------------------------------


@pytest.mark.parametrize("quiet", [(), ("--quiet",)])
def test_statistics_alone_go_to_standard_output(quiet, tmp_path, capsys):
    command = (*RENDER, "-o", str(tmp_path / "a.exr"), "--stats", "-", *quiet)
    assert commands.main(command) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["stages"]["trace"]["emitted"] == 2000
    assert ("wrote" in err) == (quiet == ())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.exr", "a.png"]


def test_statistics_of_passes_go_to_standard_output(tmp_path, capsys):
    passes = ("render", "ring", "--method", "progressive", "--passes", "2", *SIZE)
    assert commands.main((*passes, "-o", str(tmp_path / "a.exr"), "--stats", "-")) == 0
    assert json.loads(capsys.readouterr().out)["stages"]["passes"]["passes"] == 2


def test_a_file_may_have_the_name_of_standard_output(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert commands.main((*RENDER, "-o", "a.exr", "--stats", "./-")) == 0
    assert json.loads(Path("-").read_text())["seconds"] > 0
    assert "wrote a.exr" in capsys.readouterr().out


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no device that is always full")
@pytest.mark.parametrize(
    "command", [("list",), (*RENDER, "-o", "a.exr", "--stats", "-", "--quiet")]
)
def test_an_output_that_takes_nothing_is_one_line(command, tmp_path):
    with open("/dev/full", "wb") as full:
        done = subprocess.run(
            [sys.executable, "-m", "photonrelax", *command],
            stdout=full,
            stderr=subprocess.PIPE,
            cwd=tmp_path,
            timeout=60,
        )
    assert done.returncode == 1
    message = b"photonrelax: error: cannot write standard output: No space left on device\n"
    assert done.stderr == message


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", ">&- 2>&-"])
def test_closed_streams_are_no_error(closed, tmp_path):
    commands.main(("trace", "ring", "-o", str(tmp_path / "a.npz"), "--photons", "2000", "--quiet"))
    command = f"exec {sys.executable} -m photonrelax relax a.npz -o b.npz {closed}"
    assert subprocess.run(["sh", "-c", command], cwd=tmp_path, timeout=60).returncode == 0
    assert len(pr.PhotonMap.load(tmp_path / "b.npz")) > 0


# --- names ----------------------------------------------------------------------------------------

NAMES = {"text": "ä日本🔆a\nb", "no text": "\udcff"}
ENCODINGS = {"ascii": "strict", "latin-1": "surrogateescape", "utf-8": "strict"}


@pytest.fixture
def streams(monkeypatch):
    """Standard streams of an encoding, as `PYTHONIOENCODING` makes them: a function of it."""

    def replaced(encoding):
        out, err = io.BytesIO(), io.BytesIO()
        for name, stream, errors in (
            ("stdout", out, ENCODINGS[encoding]),
            ("stderr", err, "backslashreplace"),
        ):
            monkeypatch.setattr(sys, name, io.TextIOWrapper(stream, encoding, errors))
        return out, err

    return replaced


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("name", NAMES)
def test_names_that_cannot_be_printed_are_no_error(name, encoding, streams, tmp_path):
    def run(*arguments):
        out, err = streams(encoding)
        code = commands.main([*map(str, arguments)])
        return code, out.getvalue(), err.getvalue()

    check_names(run, tmp_path, name)


@pytest.mark.parametrize("name", NAMES)
def test_nor_are_they_where_names_of_files_are_ascii(name, tmp_path):
    def run(*arguments):
        environment = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
        done = process(*arguments, env=environment)
        return done.returncode, done.stdout, done.stderr

    check_names(run, tmp_path, name)


def check_names(run, folder, name):
    image = folder / f"{NAMES[name]}.exr"
    code, out, err = run(*RENDER, "-o", image)
    assert (code, err) == (0, b"")
    assert b"wrote" in out
    assert sorted(folder.iterdir()) == sorted([image, image.with_suffix(".png")])
    assert read_exr(image).layers["radiance"].shape == (8, 12, 3)
    image.write_bytes(b"v/1\x01")
    code, _, err = run("info", image)
    assert code == 1
    assert err.startswith(b"photonrelax: error: ")
    assert err.count(b"\n") == 1


@pytest.mark.parametrize("name", NAMES)
def test_names_of_all_other_files_are_no_error(name, streams, tmp_path):
    folder = tmp_path / NAMES[name]
    folder.mkdir()
    photons, state, stats = (folder / f"{NAMES[name]}.{end}" for end in ("npz", "state", "json"))
    passes = ("render", "ring", "--method", "progressive", "--passes", "1", *SIZE)
    output = ("-o", folder / "a.exr")
    for command in (
        ("trace", "ring", "-o", photons, "--photons", "2000"),
        ("relax", photons, "-o", photons),
        ("info", photons),
        (*passes, *output, "--state", state, "--stats", stats),
        (*passes[:-4], "--height", "12", *passes[-2:], *output),
        ("compare", "ring", "-o", folder / "out", "--reference", folder / "a.exr", *SIZE[:4],
         "--height", "12"),
    ):  # fmt: skip
        _, err = streams("ascii")
        code = commands.main([*map(str, command)])
        assert (code, b"Error" in err.getvalue()) == (0, False), err.getvalue()


@pytest.mark.parametrize("text", NAMES.values())
def test_images_hold_any_text(text, tmp_path):
    image = pr.Image({"radiance": np.ones((2, 3, 3)), f"{text}x": np.ones((2, 3))}, {"a": text})
    image.write_exr(tmp_path / "a.exr")
    found = read_exr(tmp_path / "a.exr")
    assert found.metadata["a"] == text.encode("utf-8", "backslashreplace").decode()
    assert len(found.layers) == 2
    panel = (np.zeros((4, 4, 3), np.uint8), text, text)
    contact_sheet([[panel]], text).save(io.BytesIO(), "PNG")
