"""Ctrl-C on the command line, and its progress bars."""

import json
import signal
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import tqdm

import photonrelax as pr
from photonrelax.cli import commands, progress_bar
from photonrelax.cli.interrupts import Interrupts

SIZE = ("--width", 12, "--height", 8, "--supersampling", 1)
SMALL = ("--photons", 3000, "--seed", 5, *SIZE)
STAGES = ("trace", "structure", "relax", "render")


def run(*arguments):
    return commands.main([str(argument) for argument in arguments])


def run_interrupted_at(stage, *arguments):
    """Run in a process of its own that gets SIGINT when `stage` first reports progress."""
    code = (
        "import os, signal, sys\n"
        "from photonrelax.cli import commands, progress_bar\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "def report(bars, stage, done, total):\n"
        f"    if stage == {stage!r}: os.kill(os.getpid(), signal.SIGINT)\n"
        "progress_bar.ProgressBars.__call__ = report\n"
        f"sys.exit(commands.main({[str(argument) for argument in arguments]!r}))"
    )
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("stage", STAGES)
def test_ctrl_c_leaves_no_file_and_returns_130(stage, tmp_path):
    output = ("-o", tmp_path / "ring.exr", "--stats", tmp_path / "stats.json")
    done = run_interrupted_at(stage, "render", "ring", *output, *SMALL)
    assert (done.returncode, done.stderr) == (130, "photonrelax: interrupted\n")
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_leaves_the_passes_done_and_their_image(tmp_path):
    command = ("render", "ring", "--method", "progressive", "--passes", 3, *SMALL)
    state, output = ("--state", tmp_path / "run.npz"), tmp_path / "ring.exr"
    done = run_interrupted_at("passes", *command, *state, "-o", output)
    assert (done.returncode, done.stderr) == (130, "photonrelax: interrupted\n")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ring.exr", "ring.png", "run.npz"]
    assert run(*command, *state, "-o", output, "--quiet") == 0
    assert run(*command, "-o", tmp_path / "straight.exr", "--quiet") == 0
    assert output.read_bytes() == (tmp_path / "straight.exr").read_bytes()


def test_ctrl_c_leaves_an_older_image_as_it_was(tmp_path):
    output = tmp_path / "ring.exr"
    output.write_bytes(b"older")
    assert run_interrupted_at("render", "render", "ring", "-o", output, *SMALL).returncode == 130
    assert output.read_bytes() == b"older"


# Interrupts the first import of a module, and swallows the exception as some libraries do.
INTERRUPTED_IMPORT = """
import os, signal, sys
from photonrelax.cli.commands import main
class Interrupt:
    def find_spec(self, name, *_):
        if name == {module!r} and not hasattr(self, "sent"):
            self.sent = True
            try:
                os.kill(os.getpid(), signal.SIGINT)
            except BaseException:
                if not {swallowed!r}: raise
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Interrupt())
sys.exit(main({arguments!r}))
"""


@pytest.mark.parametrize("swallowed", [True, False])
@pytest.mark.parametrize("module", ["numpy", "trimesh", "embreex", "PIL"])
def test_ctrl_c_while_modules_load_is_not_lost(module, swallowed, tmp_path):
    arguments = [*map(str, ("render", "ring", "-o", tmp_path / "ring.exr", *SMALL))]
    code = INTERRUPTED_IMPORT.format(module=module, swallowed=swallowed, arguments=arguments)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (130, "photonrelax: interrupted\n")
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_while_the_last_file_is_written_leaves_none(tmp_path, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(json, "dumps", interrupted)
    monkeypatch.setattr(pr, "render", lambda *_, **__: pr.Image({"radiance": np.ones((2, 2, 3))}))
    files = ("-o", tmp_path / "ring.exr", "--stats", tmp_path / "stats.json")
    assert run("render", "ring", *files, "--quiet") == 130
    assert list(tmp_path.iterdir()) == []


def test_the_handler_of_the_caller_comes_back():
    before = signal.getsignal(signal.SIGINT)
    run("list")
    assert signal.getsignal(signal.SIGINT) is before


class ProgressBars:
    """Tell what bars show when; as if on a terminal."""

    def __init__(self, capsys):
        self.bars = progress_bar.ProgressBars(False, Interrupts())
        self.bars._disable = False
        self._capsys = capsys

    def shown(self, *report):
        self.bars(*report)
        return self._capsys.readouterr().err


def test_a_bar_closes_when_its_stage_is_done(capsys):
    bars = ProgressBars(capsys)
    assert not bars.shown("trace", 1, 4).endswith("\n")
    done = bars.shown("trace", 4, 4)
    assert "trace: 100%" in done
    assert done.endswith("\n")
    assert bars.shown("trace", 4, 4) == ""


def test_a_bar_closes_when_another_stage_starts(capsys):
    bars = ProgressBars(capsys)
    bars.shown("trace", 1, 4)
    before, after = bars.shown("relax", 0, 6).split("\n")
    assert "trace:  25%" in before
    assert "trace" not in after
    assert "relax:   0%" in after


def test_a_bar_counts_the_time_before_its_first_report(capsys, monkeypatch):
    times = iter([100.0, 107.0, 110.0])
    monkeypatch.setattr(progress_bar, "time", SimpleNamespace(time=lambda: next(times)))
    bars = ProgressBars(capsys)
    monkeypatch.setattr(tqdm.std, "time", lambda: 107.0)
    assert "[00:07<" in bars.shown("trace", 4, 4)
    monkeypatch.setattr(tqdm.std, "time", lambda: 110.0)
    assert "[00:03<" in bars.shown("relax", 6, 6)


def test_a_bar_left_over_closes_at_the_end(capsys):
    bars = ProgressBars(capsys)
    with bars.bars:
        bars.shown("relax", 3, 6)
    assert "relax:  50%" in capsys.readouterr().err
