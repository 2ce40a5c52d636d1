"""Standard output and error: what cannot be printed is escaped, what cannot be written is told."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TextIO

from .._util.files import WriteError


@contextmanager
def escaping_streams() -> Iterator[None]:
    r"""Context in which characters that a stream's encoding lacks are printed as ``\udcff``."""
    streams = [each for each in (sys.stdout, sys.stderr) if isinstance(each, io.TextIOWrapper)]
    before = [stream.errors for stream in streams]
    for stream in streams:
        stream.reconfigure(errors="backslashreplace")
    try:
        yield
    finally:
        for stream, errors in zip(streams, before, strict=True):
            # What is left may not be writable.
            with suppress(OSError):
                stream.reconfigure(errors=errors)


def write_lines(*lines: str, to_stderr: bool = False) -> None:
    """Print lines.

    Raises
    ------
    WriteError
        If they cannot be written.
    """
    stream = sys.stderr if to_stderr else sys.stdout
    if stream is None:
        # It was closed before the program began; `print` would take another.
        return
    try:
        print("\n".join(lines), file=stream, flush=True)
    except OSError as error:
        _discard(stream)
        name = "standard error" if to_stderr else "standard output"
        raise WriteError(name, error.strerror or str(error)) from None


def complain(message: str) -> None:
    """Print one line on standard error, if there still is one."""
    with suppress(OSError):
        write_lines(f"photonrelax: {_one_line(message)}", to_stderr=True)


def _one_line(text: str) -> str:
    """Text in one line, control characters in names of files escaped."""
    flat = " ".join(text.splitlines())
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in flat)


def _discard(stream: TextIO) -> None:
    """Let what a stream has not written yet go nowhere: Python would try again at its exit."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
        stream.flush()
