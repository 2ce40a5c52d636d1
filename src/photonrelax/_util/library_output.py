"""Lines that libraries print by themselves, held back."""

from __future__ import annotations

import io
import os
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout
from typing import IO

_STDERR = 2
# The streams are those of the whole process.
_lock = threading.RLock()
# A child that is forked meanwhile would find it held for ever, and its standard error held back.
os.register_at_fork(
    before=_lock.acquire, after_in_parent=_lock.release, after_in_child=_lock.release
)


class HeldBack:
    """Lines that were held back: `lines` has those of the library once the context has ended."""

    def __init__(self, marks: tuple[str, ...]) -> None:
        self.lines: list[str] = []
        self._marks = marks

    def others(self, text: str) -> str:
        """Text without the lines of the library, which are kept."""
        lines = text.splitlines(keepends=True)
        own = [line for line in lines if line.startswith(self._marks)]
        self.lines += [line.rstrip("\n") for line in own]
        return "".join(line for line in lines if line not in own)


@contextmanager
def held_back(*marks: str) -> Iterator[HeldBack]:
    """Hold back lines on standard output and error that begin with one of the marks.

    Whatever else is printed meanwhile, by other threads, comes when the context ends. C code is
    heard on standard error alone. Processes started meanwhile would write into what is held back.
    """
    held = HeldBack(marks)
    with _lock, _python_stdout(held), _file_stderr(held):
        yield held


@contextmanager
def _python_stdout(held: HeldBack) -> Iterator[None]:
    printed = io.StringIO()
    try:
        with redirect_stdout(printed):
            yield
    finally:
        others = held.others(printed.getvalue())
        if others and sys.stdout is not None:
            sys.stdout.write(others)


@contextmanager
def _file_stderr(held: HeldBack) -> Iterator[None]:
    with ExitStack() as opened:
        try:
            stderr = os.dup(_STDERR)
            opened.callback(os.close, stderr)
            printed = opened.enter_context(tempfile.TemporaryFile())
        except OSError:
            # It is closed, or no file can be made: nothing is held back.
            yield
            return
        try:
            os.dup2(printed.fileno(), _STDERR)
            yield
        finally:
            os.dup2(stderr, _STDERR)
            _write_others(printed, held)


def _write_others(printed: IO[bytes], held: HeldBack) -> None:
    printed.seek(0)
    others = held.others(printed.read().decode(errors="surrogateescape"))
    if others:
        os.write(_STDERR, others.encode(errors="surrogateescape"))
