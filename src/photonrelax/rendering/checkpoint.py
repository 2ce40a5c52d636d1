"""Checkpoint file, written atomically; resumed only by the run that wrote it."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from .._util.files import remove_leftovers
from .._util.npz import check_names, read_npz, scalar, write_npz


class Checkpoint:
    """Checkpoint file of a run.

    Parameters
    ----------
    path : path
        Of the file; partial files beside it, left by killed processes, are removed.
    identity : mapping
        Parameters that a run must share to be resumed from the file; values that JSON allows.
    """

    def __init__(self, path: str | os.PathLike[str], identity: Mapping[str, Any]) -> None:
        self.path = Path(path)
        self._identity = json.loads(json.dumps(identity))
        remove_leftovers(self.path)

    def save(self, arrays: Mapping[str, Any]) -> None:
        """Replace the file, which is complete on disk before it takes the place of the old one."""
        write_npz(self.path, {"identity": json.dumps(self._identity), **arrays}, sync=True)

    def load(self) -> dict[str, NDArray] | None:
        """The saved arrays, None if there is no file.

        Raises
        ------
        ValueError
            If the file is damaged, no checkpoint, or that of another run.
        OSError, MemoryError
            If it cannot be read, or does not fit in memory.
        """
        if not self.path.exists():
            return None
        try:
            identity = _identity(self.path)
            arrays = read_npz(self.path)
        except (ValueError, RecursionError) as error:
            raise unreadable(self.path, error) from None
        self._check(identity)
        return arrays

    def _check(self, identity: Mapping[str, Any]) -> None:
        for name, value in self._identity.items():
            if identity.get(name) != value:
                raise ValueError(
                    f"{self.path} holds another run: its {name} is {identity.get(name)}, "
                    f"not {value}; name another file, or resume it as it was begun"
                )


def check_checkpoint(path: Path) -> None:
    """Raise the errors of `Checkpoint.load` for a file that may be damaged, if there is one."""
    if path.exists():
        try:
            _identity(path)
            read_npz(path)
        except (ValueError, RecursionError) as error:
            raise unreadable(path, error) from None


def unreadable(path: Path, error: Exception) -> ValueError:
    """Error that names a file, from one of reading it."""
    return ValueError(
        f"{path} does not hold a run to be resumed: {error}; "
        "it is left as it is: move it away to start anew, or name another file"
    )


def _identity(path: Path) -> dict[str, Any]:
    """Identity of the run in a file."""
    arrays = read_npz(path, ["identity"])
    check_names(arrays, ["identity"])
    identity: dict[str, Any] = json.loads(scalar(arrays, "identity", "U"))
    if not isinstance(identity, dict):
        raise ValueError("its identity should be a JSON object, but is not")
    return identity
