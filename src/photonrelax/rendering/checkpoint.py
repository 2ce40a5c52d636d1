"""A long run kept in a file: whole or as it was, and taken up by the same run alone."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._util.files import NOT_READABLE, remove_leftovers, whole_file
from .._util.npz import read_npz


class Checkpoint:
    """The file of a run.

    Parameters
    ----------
    path : path
        Of the file; what runs that were killed left half written beside it is removed.
    identity : mapping
        What must be the same for a run to be resumed, as JSON knows it.
    """

    def __init__(self, path: str | os.PathLike[str], identity: Mapping[str, Any]) -> None:
        self.path = Path(path)
        self._identity = json.loads(json.dumps(identity))
        remove_leftovers(self.path)

    def save(self, arrays: Mapping[str, Any]) -> None:
        """Write the file anew, whole and onto the disk before it takes the place of the old one."""
        with whole_file(self.path) as partial, partial.open("wb") as file:
            np.savez(file, identity=json.dumps(self._identity), **arrays)
            file.flush()
            os.fsync(file.fileno())

    def load(self) -> dict[str, NDArray] | None:
        """Return what was saved, None if there is no file.

        Raises
        ------
        ValueError
            If the file is none of `save`, or of another run.
        """
        if not self.path.exists():
            return None
        try:
            arrays = read_npz(self.path)
            identity = json.loads(str(arrays.pop("identity")))
        except (*NOT_READABLE, KeyError) as error:
            raise ValueError(f"{self.path} does not hold a run to be resumed: {error}") from None
        self._check(identity)
        return arrays

    def _check(self, identity: Mapping[str, Any]) -> None:
        for name, value in self._identity.items():
            if identity.get(name) != value:
                raise ValueError(
                    f"{self.path} holds another run: its {name} is {identity.get(name)}, "
                    f"not {value}"
                )
