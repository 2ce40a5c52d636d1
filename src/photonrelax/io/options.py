"""Options of the loaders of scenes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .objects import ObjectMaker

LIGHT_UNITS = ("standard", "compat", "raw")


@dataclass(frozen=True)
class LoadOptions:
    """The arguments of a loader, all checked; `maker` makes its objects."""

    camera: str | None
    light_units: str
    strict: bool
    arguments: Mapping[str, Any]
    maker: ObjectMaker = field(default_factory=ObjectMaker)

    def refuse_arguments(self, path: Path) -> None:
        """Raise ValueError if there are arguments, which the file has no use for."""
        if self.arguments:
            raise ValueError(
                f"{path} takes no arguments, but is given {', '.join(sorted(self.arguments))}"
            )
