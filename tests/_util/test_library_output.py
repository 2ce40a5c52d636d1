"""Lines of libraries are held back, those of others are not."""

import os
import subprocess
import sys
import threading
import time

import pytest

from photonrelax._util import library_output
from photonrelax._util.library_output import held_back


def test_only_lines_that_begin_with_a_mark_are_held_back(capfd):
    with held_back("file: ", "Warning") as held:
        os.write(2, b"file: damaged\nanother: line\n\xff\n")
        print("Warning: damaged")
        print("a line that is printed")
        print("and one on standard error", file=sys.stderr)
    out, err = capfd.readouterr()
    assert out == "a line that is printed\n"
    assert set(err.splitlines()) == {"another: line", "\ufffd", "and one on standard error"}
    assert sorted(held.lines) == ["Warning: damaged", "file: damaged"]


def test_streams_come_back_after_an_error(capfd):
    before = sys.stdout
    with pytest.raises(OSError, match="read"), held_back("x"):
        raise OSError("read")
    assert sys.stdout is before
    os.write(2, b"after\n")
    assert capfd.readouterr().err == "after\n"


def test_threads_take_turns_and_lose_no_line(capfd):
    def work(name):
        for i in range(200):
            with held_back(f"{name}: ") as held:
                os.write(2, f"{name}: {i}\n".encode())
            assert held.lines == [f"{name}: {i}"]

    threads = [threading.Thread(target=work, args=(name,)) for name in "abcd"]
    for thread in threads:
        thread.start()
    written = 0
    while any(thread.is_alive() for thread in threads):
        os.write(2, f"main {written}\n".encode())
        written += 1
        time.sleep(1e-5)
    lines = capfd.readouterr().err.splitlines()
    assert sorted(lines) == sorted(f"main {i}" for i in range(written))


def test_a_closed_standard_error_is_no_error():
    code = (
        "import os; os.close(2)\n"
        "from photonrelax._util.library_output import held_back\n"
        "with held_back('x'): print('printed')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "printed\n"


def test_without_another_thread_nothing_is_held_back(capfd, monkeypatch):
    def full(thread):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", full)
    with held_back("x: "):
        os.write(2, b"x: damaged\n")
    assert capfd.readouterr().err == "x: damaged\n"


def test_a_process_that_goes_on_is_not_waited_for(capfd, monkeypatch):
    monkeypatch.setattr(library_output, "_LONGEST_WAIT", 0.01)
    with held_back("x: ") as held:
        child = subprocess.Popen(["sh", "-c", "read line; echo $line >&2"], stdin=subprocess.PIPE)
        os.write(2, b"x: damaged\n")
    assert capfd.readouterr().err == ""
    child.communicate(b"the child's\n")
    for thread in threading.enumerate():
        if thread.daemon:
            thread.join(60)
    assert held.lines == ["x: damaged"]
    assert capfd.readouterr().err == "the child's\n"


def test_forked_processes_find_the_streams_free():
    code = (
        "import os, threading\n"
        "from photonrelax._util.library_output import held_back\n"
        "inside, leave = threading.Event(), threading.Event()\n"
        "def hold():\n"
        "    with held_back('x'): inside.set(); leave.wait()\n"
        "thread = threading.Thread(target=hold); thread.start(); inside.wait()\n"
        "threading.Timer(0.1, leave.set).start()\n"
        "if not (child := os.fork()):\n"
        "    with held_back('x'): os.write(2, b'x held\\nof the child\\n')\n"
        "    os._exit(0)\n"
        "thread.join(); os.waitpid(child, 0)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "of the child\n")
