"""Signals that end the command line, and its progress bars."""

import importlib
import json
import os
import signal
import subprocess
import sys
from contextlib import suppress
from types import SimpleNamespace

import numpy as np
import pytest
import tqdm

import photonrelax as pr
from photonrelax.cli import commands, progress_bar
from photonrelax.cli.interrupts import Interrupts

SIZE = ("--width", 12, "--height", 8, "--supersampling", 1)
SMALL = ("--photons", 3000, "--seed", 5, *SIZE)
STAGES = ("trace", "structure", "rest density", "relax", "render")


def run(*arguments):
    return commands.main([str(argument) for argument in arguments])


@pytest.fixture
def run_interrupted_at(monkeypatch, capsys):
    """Run and get signals whenever a stage reports progress: exit code and standard error."""
    # Not those of whoever runs the tests, which the command line would leave alone.
    defaults = {"SIGINT": signal.default_int_handler, "SIGTERM": signal.SIG_DFL,
                "SIGHUP": signal.SIG_DFL}  # fmt: skip
    before = [signal.signal(getattr(signal, name), to) for name, to in defaults.items()]

    def interrupted(stage, *arguments, name="SIGINT"):
        def report(bars, reported, done, total):
            if reported == stage:
                os.kill(os.getpid(), getattr(signal, name))

        with monkeypatch.context() as patch:
            patch.setattr(progress_bar.ProgressBars, "__call__", report)
            return run(*arguments), capsys.readouterr().err

    yield interrupted
    for name, handler in zip(defaults, before, strict=True):
        signal.signal(getattr(signal, name), handler)


@pytest.mark.parametrize("stage", STAGES)
def test_ctrl_c_leaves_no_file_and_returns_130(stage, run_interrupted_at, tmp_path):
    output = ("-o", tmp_path / "ring.exr", "--stats", tmp_path / "stats.json")
    done = run_interrupted_at(stage, "render", "ring", *output, *SMALL)
    assert done == (130, "photonrelax: interrupted\n")
    assert list(tmp_path.iterdir()) == []


ENDS = [("SIGTERM", 143, "terminated"), ("SIGHUP", 129, "hung up"), ("SIGINT", 130, "interrupted")]


@pytest.mark.parametrize(
    ("end", "options"),
    [*((end, ()) for end in ENDS), (ENDS[0], ("--stochastic",)), (ENDS[0], ("--interval", "1e-9"))],
)
def test_every_end_of_a_session_saves_the_passes_done(end, options, run_interrupted_at, tmp_path):
    name, code, message = end
    command = ("render", "ring", "--method", "progressive", "--passes", 3, *SMALL, *options)
    state, output = ("--state", tmp_path / "run.npz"), tmp_path / "ring.exr"
    done = run_interrupted_at("passes", *command, *state, "-o", output, name=name)
    assert done == (code, f"photonrelax: {message}\n")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ring.exr", "ring.png", "run.npz"]
    assert np.load(tmp_path / "run.npz")["n_passes"] == 1
    assert run(*command, *state, "-o", output, "--quiet") == 0
    assert run(*command, "-o", tmp_path / "straight.exr", "--quiet") == 0
    assert output.read_bytes() == (tmp_path / "straight.exr").read_bytes()


@pytest.mark.parametrize(("name", "code", "message"), ENDS)
def test_every_end_of_a_session_leaves_no_half_file(
    name, code, message, run_interrupted_at, tmp_path
):
    command = ("trace", "ring", "-o", tmp_path / "map.npz", "--photons", 3000)
    done = run_interrupted_at("trace", *command, name=name)
    assert done == (code, f"photonrelax: {message}\n")
    assert list(tmp_path.iterdir()) == []


def test_signals_that_come_while_the_run_is_saved_do_not_break_that_off(tmp_path):
    """Sent by the save itself, several times."""
    code = (
        "import os, signal, sys\n"
        "from photonrelax.cli import commands\n"
        "from photonrelax.rendering import checkpoint, progressive_render\n"
        "write, advance = checkpoint.write_npz, progressive_render._Run.advance\n"
        "def send(): [os.kill(os.getpid(), n) for n in (signal.SIGTERM, signal.SIGHUP) * 3]\n"
        "def saved(*args, **kwargs):\n    send()\n    write(*args, **kwargs)\n    send()\n"
        "def advanced(run):\n    advance(run)\n    send()\n"
        "checkpoint.write_npz, progressive_render._Run.advance = saved, advanced\n"
        "sys.exit(commands.main(sys.argv[1:]))"
    )
    command = ("render", "ring", "--method", "progressive", "--passes", 3, *SMALL, "--quiet")
    files = ("--state", tmp_path / "run.npz", "-o", tmp_path / "ring.exr")
    arguments = [str(argument) for argument in (*command, *files)]
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stderr) == (143, "photonrelax: terminated\n")
    assert np.load(tmp_path / "run.npz")["n_passes"] == 1
    assert (tmp_path / "ring.exr").exists()


def test_handlers_of_the_caller_stay():
    caller = lambda *_: None  # noqa: E731
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN), signal.signal(signal.SIGTERM, caller)
    try:
        with Interrupts():
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
            assert signal.getsignal(signal.SIGTERM) is caller
    finally:
        signal.signal(signal.SIGHUP, before[0])
        signal.signal(signal.SIGTERM, before[1])


def test_ctrl_c_leaves_an_older_image_as_it_was(run_interrupted_at, tmp_path):
    output = tmp_path / "ring.exr"
    output.write_bytes(b"older")
    assert run_interrupted_at("render", "render", "ring", "-o", output, *SMALL)[0] == 130
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


@pytest.mark.parametrize(
    ("module", "swallowed"),
    [("numpy", True), ("trimesh", True), ("embreex", True), ("embreex", False), ("PIL", True)],
)
def test_ctrl_c_while_modules_load_is_not_lost(module, swallowed, tmp_path):
    arguments = [*map(str, ("render", "ring", "-o", tmp_path / "ring.exr", *SMALL))]
    code = INTERRUPTED_IMPORT.format(module=module, swallowed=swallowed, arguments=arguments)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (130, "photonrelax: interrupted\n")
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def swallowed():
    """A signal whose exception was swallowed."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    with Interrupts() as interrupts:
        with suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        yield interrupts
    signal.signal(signal.SIGINT, before)


def test_an_interrupt_that_was_swallowed_comes_with_the_next_import(swallowed):
    with pytest.raises(KeyboardInterrupt):
        importlib.import_module("no_such_module")


def test_modules_load_while_an_exception_is_handled(swallowed):
    try:
        raise KeyboardInterrupt
    except KeyboardInterrupt:
        with pytest.raises(ModuleNotFoundError):
            importlib.import_module("no_such_module")


def test_ctrl_c_while_the_last_file_is_written_leaves_none(tmp_path, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(json, "dumps", interrupted)
    monkeypatch.setattr(pr, "render", lambda *_, **__: pr.Image({"radiance": np.ones((2, 2, 3))}))
    files = ("-o", tmp_path / "ring.exr", "--stats", tmp_path / "stats.json")
    assert run("render", "ring", *files, "--quiet") == 130
    assert list(tmp_path.iterdir()) == []


def test_the_handler_of_the_caller_comes_back():
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = [signal.getsignal(number) for number in numbers]
    run("list")
    assert [signal.getsignal(number) for number in numbers] == before


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


def test_bars_start_no_thread(capsys, monkeypatch):
    monkeypatch.setattr(tqdm.tqdm, "monitor", None)
    ProgressBars(capsys).shown("trace", 1, 4)
    assert tqdm.tqdm.monitor is None


def test_a_bar_left_over_closes_at_the_end(capsys):
    bars = ProgressBars(capsys)
    with bars.bars:
        bars.shown("relax", 3, 6)
    assert "relax:  50%" in capsys.readouterr().err
