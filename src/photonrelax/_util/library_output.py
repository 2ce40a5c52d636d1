"""Lines that libraries print by themselves, held back."""

from __future__ import annotations

import io
import os
import sys
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


# In seconds, for processes started meanwhile: what they write comes when they have ended.
_LONGEST_WAIT = 1.0


class HeldBack:
    """Lines that were held back: `lines` has those of the library once the context has ended."""

    def __init__(self, marks: tuple[str, ...]) -> None:
        self.lines: list[str] = []
        self._marks = marks

    def keeps(self, line: str) -> bool:
        """Whether a line is the library's; it is kept then."""
        own = line.startswith(self._marks)
        if own:
            self.lines.append(line.rstrip("\n"))
        return own


@contextmanager
def held_back(*marks: str) -> Iterator[HeldBack]:
    """Hold back lines on standard output and error that begin with one of the marks.

    Whatever else is printed meanwhile, by other threads, comes when the context ends. C code is
    heard on standard error alone.
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
        lines = printed.getvalue().splitlines(keepends=True)
        others = "".join(line for line in lines if not held.keeps(line))
        if others and sys.stdout is not None:
            sys.stdout.write(others)


@contextmanager
def _file_stderr(held: HeldBack) -> Iterator[None]:
    # A pipe, as it ends only when no write into it is under way: a file could have been read, and
    # be gone, before a line that another thread was writing is in it.
    with ExitStack() as opened:
        try:
            stderr = os.dup(_STDERR)
            opened.callback(os.close, stderr)
            read_end, write_end = os.pipe()
            opened.callback(os.close, write_end)
            reader = _start_reader(read_end, held)
        except (OSError, RuntimeError):
            # It is closed, or there are too many files or threads: nothing is held back.
            yield
            return
        try:
            os.dup2(write_end, _STDERR)
            yield
        finally:
            os.dup2(stderr, _STDERR)
            opened.close()
            reader.join(_LONGEST_WAIT)


def _start_reader(read_end: int, held: HeldBack) -> threading.Thread:
    with ExitStack() as opened:
        source = opened.enter_context(open(read_end, "rb"))
        target = opened.enter_context(open(os.dup(_STDERR), "wb"))
        reader = threading.Thread(target=_pass_on, args=(source, target, held), daemon=True)
        reader.start()
        # The thread closes them.
        opened.pop_all()
    return reader


def _pass_on(source: IO[bytes], target: IO[bytes], held: HeldBack) -> None:
    """Write what is not held back to `target` when nobody writes into `source` any more."""
    with source, target:
        target.writelines(
            [line for line in source if not held.keeps(line.decode(errors="surrogateescape"))]
        )
