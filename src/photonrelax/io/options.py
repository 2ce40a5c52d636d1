"""Options of the loaders of scenes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

LIGHT_UNITS = ("standard", "compat", "raw")


@dataclass(frozen=True)
class LoadOptions:
    """The arguments of `load_scene`, all checked; `arguments` is a copy."""

    camera: str | None
    light_units: str
    strict: bool
    arguments: Mapping[str, Any]

    def refuse_arguments(self, path: Path) -> None:
        """Raise ValueError if there are arguments, which the file has no use for."""
        if self.arguments:
            raise ValueError(
                f"{path} takes no arguments, but is given {', '.join(sorted(self.arguments))}"
            )
