"""Table of what stands for things that a file holds and a scene cannot."""

from __future__ import annotations

import warnings
from pathlib import Path


class Substitutions:
    """Rows of what a scene has no counterpart for, each once, and what it has instead."""

    def __init__(self) -> None:
        self._rows: dict[tuple[str, str], str] = {}
        self._readings: set[tuple[str, str]] = set()

    def add(self, subject: str, held: str, used: str) -> None:
        """Add what a material, object or light holds, and what the scene has instead."""
        self._rows.setdefault((subject, held), used)

    def add_reading(self, subject: str, held: str, used: str) -> None:
        """Add what can be read in two ways, and how it is: no error, however strict."""
        self.add(subject, held, used)
        self._readings.add((subject, held))

    def report(self, path: Path, strict: bool) -> None:
        """Warn of the rows, if there are any.

        Raises
        ------
        ValueError
            With `strict`, if one is more than a reading.
        """
        lost = [key for key in self._rows if key not in self._readings]
        if strict and lost:
            held = "; ".join(f"{subject}: {what}" for subject, what in lost)
            raise ValueError(f"{path} should hold no more than a scene can, but holds {held}")
        if self._rows:
            title = "holds what a scene cannot" if lost else "can be read in two ways"
            warnings.warn(f"{path} {title}\n{self._table()}", stacklevel=2)

    def _table(self) -> str:
        rows = [("of", "in the file", "used instead")]
        rows += [(subject, held, used) for (subject, held), used in self._rows.items()]
        first, second = (max(len(row[i]) for row in rows) for i in range(2))
        return "\n".join(f"  {a:{first}}  {b:{second}}  {c}" for a, b, c in rows)
