"""Content of a scene's file, and of files that it names."""

from __future__ import annotations

import os
from pathlib import Path

from .._util.files import open_file


def read_whole(path: Path) -> bytes:
    """Content of a regular file; raises the errors of `open_file`."""
    with open_file(path) as file:
        try:
            return file.read()
        except OSError as error:
            raise type(error)(f"cannot read {path}: {error.strerror}") from None


def read_beside(scene: Path, name: str, where: str) -> bytes:
    """Content of a file in the folder of a scene's file, or below.

    Raises
    ------
    ValueError
        If the name leads out of the folder, also by symbolic links.
    OSError
        If there is no such file or it cannot be read.
    """
    try:
        return read_whole(path_beside(scene, name, where))
    except OSError as error:
        raise type(error)(f"{where} should name a file: {error}") from None


def path_beside(scene: Path, name: str, where: str) -> Path:
    """Path of a file in the folder of a scene's file, or below, links followed.

    Raises
    ------
    ValueError
        If the name leads out of the folder.
    """
    folder = Path(os.path.realpath(scene)).parent
    try:
        target = Path(os.path.realpath(folder / name))
    except ValueError:
        raise ValueError(f"{where} should name a file, but is {name!r}") from None
    if "://" in name or not target.is_relative_to(folder):
        raise ValueError(f"{where} should name a file in {folder} or below, but is {name!r}")
    return target
