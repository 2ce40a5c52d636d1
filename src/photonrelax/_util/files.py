"""Atomic writing of files, and locks."""

from __future__ import annotations

import fcntl
import glob
import json
import os
import stat
import uuid
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from hashlib import blake2b
from pathlib import Path
from typing import Any, BinaryIO


class WriteError(OSError):
    """A file that cannot be written, and the reason."""

    def __init__(self, path: Path | str, reason: str) -> None:
        super().__init__(f"cannot write {path}: {reason}")
        self.path, self.reason = path, reason


@contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path beside `path`, which is renamed to `path` unless an error is raised.

    A symbolic link stays one: the file it points to is written. A file that is replaced keeps its
    mode.

    Raises
    ------
    FileNotFoundError
        If the folder of `path` does not exist.
    OSError
        If `path` is a folder or a device.
    WriteError
        If writing fails.
    """
    path = Path(path)
    target = _target(path)
    partial = _partial(target)
    try:
        yield partial
        if target.exists():
            partial.chmod(stat.S_IMODE(target.stat().st_mode))
        partial.replace(target)
    except WriteError as error:
        raise WriteError(path, error.reason) if error.path == partial else error from None
    except OSError as error:
        if error.errno is None or error.filename not in (None, str(partial), partial):
            raise
        raise WriteError(path, error.strerror or str(error)) from None
    finally:
        partial.unlink(missing_ok=True)


def open_file(path: str | os.PathLike[str]) -> BinaryIO:
    """Open a regular file for reading.

    Raises
    ------
    OSError
        If there is none or it cannot be read; the message names it.
    """
    path = Path(path)
    try:
        if path.exists() and not path.is_file():
            kind = "a folder" if path.is_dir() else "a device or pipe"
            raise OSError(None, f"it is {kind}, not a regular file")
        return path.open("rb")
    except FileNotFoundError as error:
        raise FileNotFoundError(f"there is no file {path}: {error.strerror}") from None
    except OSError as error:
        raise type(error)(f"cannot read {path}: {error.strerror}") from None


def first_bytes(path: str | os.PathLike[str], n: int) -> bytes:
    """The first bytes of a file, at most `n`; raises the errors of `open_file`."""
    with open_file(path) as file:
        try:
            return file.read(n)
        except OSError as error:
            raise type(error)(f"cannot read {path}: {error.strerror}") from None


@contextmanager
def file_lock(path: str | os.PathLike[str]) -> Iterator[None]:
    """Hold the lock of `path`, which need not exist.

    A file beside it is locked; the system releases the lock when the process ends.

    Raises
    ------
    BlockingIOError
        If another process holds it.
    """
    path = Path(path)
    lock = path.with_name(f"{_partial_prefix(path)}.lock")
    held = _acquire(lock)
    if held is None:
        raise BlockingIOError(f"{path} is in use by another run")
    try:
        yield
    finally:
        lock.unlink(missing_ok=True)
        os.close(held)


def _acquire(lock: Path) -> int | None:
    """Return the open file that was locked, None if another process holds it."""
    while True:
        held = os.open(lock, os.O_RDWR | os.O_CREAT)
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # The process that held it may have removed the file in between.
            if os.path.samestat(os.fstat(held), os.stat(lock)):
                return held
        except BlockingIOError:
            os.close(held)
            return None
        except FileNotFoundError:
            pass
        os.close(held)


def remove_leftovers(path: Path) -> None:
    """Remove temporary files of `whole_file` left by processes that were killed."""
    path = Path(os.path.realpath(path))
    pattern = f"{glob.escape(_partial_prefix(path))}.{'[0-9a-f]' * 32}.part"
    for partial in path.parent.glob(pattern):
        partial.unlink(missing_ok=True)


def check_writable(path: str | os.PathLike[str]) -> None:
    """Raise the errors of `whole_file`, by creating and removing a file beside `path`.

    Raises
    ------
    OSError
        If the folder does not exist or cannot be written to, or `path` is not a regular file.
    """
    path = Path(path)
    probe = _partial(_target(path))
    try:
        probe.touch()
    except OSError as error:
        raise OSError(
            f"cannot write {path}: no file can be made in {_folder(path)} ({error.strerror})"
        ) from None
    finally:
        probe.unlink(missing_ok=True)


def make_folder(folder: Path, names: Iterable[str]) -> None:
    """Make a folder unless there is one, and check that files of some names can be written there.

    Raises
    ------
    OSError
        If it cannot be created or written to.
    """
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(f"cannot write into {folder}: it is not a folder")
    if not folder.exists() and not folder.parent.is_dir():
        raise FileNotFoundError(f"cannot write {folder}: there is no folder {folder.parent}")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise type(error)(f"cannot make the folder {folder}: {error.strerror}") from None
    for name in names:
        check_writable(folder / name)


def output_path(path: Path, suffix: str | None = None) -> Path:
    """Return a path, checked to be writable before the work whose result it is for.

    Temporary files left by processes that were killed are removed.

    Raises
    ------
    ValueError
        If it does not end in `suffix`.
    OSError
        As `check_writable`.
    """
    if suffix is not None and path.suffix.lower() != suffix:
        raise ValueError(f"the output should be named *{suffix}, but is {path}")
    check_writable(path)
    remove_leftovers(path)
    return path


def check_distinct(paths: Mapping[str, Path | None]) -> None:
    """Raise ValueError if two names stand for one file."""
    names: dict[str, str] = {}
    for name, path in paths.items():
        if path is not None:
            other = names.setdefault(os.path.realpath(path), name)
            if other != name:
                raise ValueError(f"{name} and {other} should not be one file, but both are {path}")


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write indented JSON."""
    path.write_text(json_text(content) + "\n", encoding="utf-8")


def json_text(content: Mapping[str, Any]) -> str:
    """Indented JSON."""
    return json.dumps(content, indent=2)


def _target(path: Path) -> Path:
    """Path with symbolic links followed; OSError unless a regular file may be, or is, there."""
    target, folder = Path(os.path.realpath(path)), _folder(path)
    try:
        if not folder.is_dir():
            raise FileNotFoundError(None, f"there is no folder {folder}")
        mode = _mode(target)
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(None, "it is a folder")
        if stat.S_ISLNK(mode):
            raise OSError(None, "its symbolic links lead back to themselves")
        if not stat.S_ISREG(mode):
            raise OSError(None, "it is a device, not a regular file")
    except OSError as error:
        raise type(error)(f"cannot write {path}: {error.strerror}") from None
    return target


def _folder(path: Path) -> Path:
    """Folder of the file that a path stands for."""
    return Path(os.path.realpath(path)).parent if os.path.islink(path) else path.parent


def _mode(path: Path) -> int:
    """Mode of a file, that of a regular one if there is none."""
    try:
        return path.lstat().st_mode
    except FileNotFoundError:
        return stat.S_IFREG


def _partial(path: Path) -> Path:
    return path.with_name(f"{_partial_prefix(path)}.{uuid.uuid4().hex}.part")


def _partial_prefix(path: Path) -> str:
    """Return the prefix of the names of `path`'s temporary files, and of no others."""
    # The whole name could become longer than file systems allow.
    digest = blake2b(os.fsencode(path.name), digest_size=8).hexdigest()
    return f".{path.name[:40]}.{digest}"
