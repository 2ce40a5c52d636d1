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
    command = f"exec {sys.executable} -m photonrelax {' '.join(RENDER)} -o a.exr {closed}"
    assert subprocess.run(["sh", "-c", command], cwd=tmp_path, timeout=60).returncode == 0
    assert (tmp_path / "a.exr").exists()


# --- names ----------------------------------------------------------------------------------------

NAMES = {"text": "ä日本🔆a\nb", "no text": "\udcff"}
ENCODINGS = {
    "ascii": {"PYTHONIOENCODING": "ascii"},
    "strict": {"PYTHONIOENCODING": "ascii:strict", "LANG": "C"},
    "C": {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    "latin-1": {"PYTHONIOENCODING": "latin-1:surrogateescape"},
    "utf-8": {"PYTHONIOENCODING": "utf-8:strict"},
}


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("name", NAMES)
def test_names_that_cannot_be_printed_are_no_error(name, encoding, tmp_path):
    image, environment = tmp_path / f"{NAMES[name]}.exr", ENCODINGS[encoding]
    done = process(*RENDER, "-o", image, env=environment)
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"wrote" in done.stdout
    assert sorted(tmp_path.iterdir()) == sorted([image, image.with_suffix(".png")])
    assert read_exr(image).layers["radiance"].shape == (8, 12, 3)
    image.write_bytes(b"v/1\x01")
    done = process("info", image, env=environment)
    assert done.returncode == 1
    assert done.stderr.startswith(b"photonrelax: error: ")
    assert done.stderr.count(b"\n") == 1


@pytest.mark.parametrize("name", NAMES)
def test_names_of_all_other_files_are_no_error(name, tmp_path):
    folder = tmp_path / NAMES[name]
    folder.mkdir()
    environment = ENCODINGS["strict"]
    photons, state, stats = (folder / f"{NAMES[name]}.{end}" for end in ("npz", "state", "json"))
    passes = ("render", "ring", "--method", "progressive", "--passes", "1", *SIZE)
    output = ("-o", folder / "a.exr")
    for command in (
        ("trace", "ring", "-o", photons, "--photons", "2000"),
        ("relax", photons, "-o", photons),
        ("info", photons),
        (*passes, *output, "--state", state, "--stats", stats),
        ("compare", "ring", "-o", folder / "out", "--reference", folder / "a.exr", *SIZE[:4],
         "--height", "12"),
    ):  # fmt: skip
        if command[0] == "compare":
            large = (*passes[:-4], "--height", "12", *passes[-2:], *output)
            assert process(*large, env=environment).returncode == 0
        done = process(*command, env=environment)
        assert (done.returncode, b"Error" in done.stderr) == (0, False), done.stderr


@pytest.mark.parametrize("text", NAMES.values())
def test_images_hold_any_text(text, tmp_path):
    image = pr.Image({"radiance": np.ones((2, 3, 3)), f"{text}x": np.ones((2, 3))}, {"a": text})
    image.write_exr(tmp_path / "a.exr")
    found = read_exr(tmp_path / "a.exr")
    assert found.metadata["a"] == text.encode("utf-8", "backslashreplace").decode()
    assert len(found.layers) == 2
    panel = (np.zeros((4, 4, 3), np.uint8), text, text)
    contact_sheet([[panel]], text).save(io.BytesIO(), "PNG")
