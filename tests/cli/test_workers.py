"""Commands with workers: what they write, how they end."""

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from photonrelax.cli import commands, workers
from photonrelax.imaging.image import read_exr
from tests.helpers.executors import shared_pool

VIEW = ("--width", 12, "--height", 12, "--supersampling", 1)
OPTIONAL = ("distributed", "dask", "loky", "mpi4py")


def run(*arguments):
    return commands.main([str(argument) for argument in arguments])


def layers(path):
    return {name: layer.tobytes() for name, layer in read_exr(path).layers.items()}


MOVING = """
import photonrelax as pr
def scene(time):
    return pr.gallery.scene("ring", pixels=12, sections=32)
"""


@contextmanager
def already_started(n):
    yield shared_pool()


def test_an_image_is_that_without_workers(tmp_path):
    image = ("render", "ring", "--photons", 2000, "--quiet", *VIEW)
    assert run(*image, "-o", tmp_path / "one.exr") == 0
    assert run(*image, "-o", tmp_path / "two.exr", "--workers", 1) == 0
    assert layers(tmp_path / "one.exr") == layers(tmp_path / "two.exr")


def test_frames_are_those_without_workers(tmp_path, monkeypatch):
    monkeypatch.setattr(workers, "_processes", already_started)
    (tmp_path / "moving.py").write_text(MOVING)
    frames = ("animate", tmp_path / "moving.py", "--frames", 2, "--photons", 2000, "--quiet")
    assert run(*frames, "-o", tmp_path / "one.%02d.exr") == 0
    assert run(*frames, "-o", tmp_path / "two.%02d.exr", "--workers", 2) == 0
    assert layers(tmp_path / "one.01.exr") == layers(tmp_path / "two.01.exr")


def test_a_scheduler_that_does_not_answer_is_one_line(tmp_path, capsys, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(workers, "_ANSWER", "0.1s")
    output = tmp_path / "a.npz"
    assert run("trace", "ring", "-o", output, "--scheduler", "tcp://127.0.0.1:1", "--quiet") == 1
    error = capsys.readouterr().err
    assert error.startswith("photonrelax: error: no Dask scheduler answers at tcp://127.0.0.1:1")
    assert error.count("\n") == 1


def test_a_traceback_is_printed_if_it_is_asked_for(tmp_path, capsys):
    bad = ("trace", tmp_path / "none.py", "-o", tmp_path / "a.npz")
    assert run(*bad) == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert run(*bad, "--traceback") == 1
    assert "Traceback (most recent call last)" in capsys.readouterr().err


def test_workers_and_a_scheduler_exclude_each_other(tmp_path, capsys):
    with pytest.raises(SystemExit):
        run("trace", "ring", "-o", tmp_path / "a", "--workers", 2, "--scheduler", "tcp://a:1")
    assert "not allowed with argument" in capsys.readouterr().err


def test_ctrl_c_ends_workers_and_leaves_no_file(tmp_path):
    """It goes to the whole group of processes, as in a terminal."""
    arguments = ["trace", "ring", "-o", str(tmp_path / "a.npz"), "--photons", "50000000"]
    arguments += ["--workers", "1"]
    # A shell's background job, which tests may be run in, ignores Ctrl-C.
    code = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        f"from photonrelax.cli import main; raise SystemExit(main({arguments}))"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code], stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    end = time.monotonic() + 60.0
    # The tracker of resources, and the worker.
    while len(children.read_text().split()) < 2:
        assert time.monotonic() < end
        time.sleep(0.02)
    time.sleep(1.0)
    os.killpg(process.pid, signal.SIGINT)
    # All processes that have it have closed standard error, so they have ended.
    error = process.communicate(timeout=30)[1]
    assert process.returncode == 130
    assert error.splitlines()[-1] == "photonrelax: interrupted"
    assert os.listdir(tmp_path) == []


LAST = """
import os, signal, time
from photonrelax._util import workers
class Last:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.01)
workers.hear_endings()
with workers._until_ended():
    Last()
    time.sleep(60.0)
"""


def test_an_ending_that_a_destructor_hears_is_not_lost():
    """Python drops what is raised in it."""
    done = subprocess.run([sys.executable, "-c", LAST], capture_output=True, text=True, timeout=30)
    assert "Exception ignored in: <function Last.__del__" in done.stderr
    assert done.stderr.splitlines()[-1] == "KeyboardInterrupt"


def test_optional_packages_are_not_imported_without_use():
    code = (
        "import sys, photonrelax as pr\n"
        "from concurrent.futures import ThreadPoolExecutor\n"
        "scene = pr.gallery.scene('ring')\n"
        "pr.trace_photons(scene, 1000, executor=ThreadPoolExecutor(1))\n"
        f"print([name for name in {OPTIONAL} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() == "[]", done.stderr
