"""The table of a comparison, in the form of SJ13's Table I."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from ..._util.parallel import thread_count
from ...estimation.methods import METHODS
from ..comparison import Comparison, Entry, machine

# Stages by the rows of the table; every other stage of a method's own finds features.
_ROWS_OF = {
    "cast": "photon cast",
    "spectra": "photon cast",
    "relax": "relaxation",
    "camera": "render",
    "gather": "render",
}
_FEATURES = "feature detection"
_NOTHING = "–"


@dataclass(frozen=True)
class Table:
    """Text in rows and columns.

    Attributes
    ----------
    title : str
        What is compared.
    head : list of str
        Names of the columns.
    rows : list of (str, list of str, int or None)
        Name of a row, its cells, and which of them is the best, if that has a meaning.
    notes : list of str
        What has to be known to read it.
    """

    title: str
    head: list[str]
    rows: list[tuple[str, list[str], int | None]]
    notes: list[str]

    def text(self) -> str:
        """Return the table for a terminal."""
        lines = [["", *self.head], *([name, *cells] for name, cells, _ in self.rows)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        body = [
            "  ".join([f"{name:{widths[0]}}", *(f"{c:>{w}}" for c, w in zip(cells, widths[1:]))])  # noqa: B905
            for name, *cells in lines
        ]
        return "\n".join([self.title, *(line.rstrip() for line in body), *self.notes])

    def to_dict(self) -> dict[str, Any]:
        """Return the table by its attributes."""
        rows = [{"name": name, "cells": cells, "best": best} for name, cells, best in self.rows]
        return {"title": self.title, "head": self.head, "rows": rows, "notes": self.notes}


def table(comparison: Comparison) -> Table:
    """Return the table of a comparison; where the reference was computed, it is the last column.

    That run is what SJ13 calls progressive; a method that photons of one map were dealt to passes
    for is marked so.
    """
    entries = comparison.entries
    rows = [
        ("photons emitted", [f"{entry.n_emitted:,}" for entry in entries], None),
        ("photons absorbed", [f"{entry.n_stored:,}" for entry in entries], None),
        ("photons per estimate", [_photons_per_estimate(entry) for entry in entries], None),
        *_times(entries),
        *(_measured(entries, *row) for row in _ERRORS),
        *_known(entries),
    ]
    made = Table(_title(comparison), heads(entries), rows, _notes(comparison))
    return _with_reference(made, comparison)


def heads(entries: tuple[Entry, ...]) -> list[str]:
    """Return what entries are called; marked are those whose photons were dealt to passes."""
    return [f"{e.name}, dealt" if METHODS[e.method].splits_passes else e.name for e in entries]


def _with_reference(shown: Table, comparison: Comparison) -> Table:
    reference = comparison.reference
    cost = reference.cost
    if not cost:
        return shown
    cells_of = {
        "photons emitted": f"{cost['emitted']:,}",
        "photons absorbed": f"{cost['stored']:,}",
        "total": _seconds(cost["seconds"] or 0.0),
    }
    for name, attribute, form, _ in _KNOWN:
        if reference.analytic_errors:
            cells_of[name] = form.format(reference.analytic_errors[attribute])
    rows = [
        (name, [*cells, cells_of.get(name, _NOTHING)], best) for name, cells, best in shown.rows
    ]
    return replace(shown, head=[*shown.head, "reference"], rows=rows)


def by_row(seconds: dict[str, float]) -> dict[str, float]:
    """Return the seconds of an entry's stages by the rows of the table."""
    rows = {"photon cast": 0.0, _FEATURES: 0.0, "relaxation": 0.0, "render": 0.0}
    for stage, value in seconds.items():
        rows[_ROWS_OF.get(stage, _FEATURES)] += value
    return rows


def _times(entries: tuple[Entry, ...]) -> list[tuple[str, list[str], int | None]]:
    columns = [by_row(entry.seconds) for entry in entries]
    rows: list[tuple[str, list[str], int | None]] = [
        (name, [_seconds(column[name]) for column in columns], None) for name in columns[0]
    ]
    totals = [sum(column.values()) for column in columns]
    return [*rows, ("total", [_seconds(total) for total in totals], _best(totals, abs))]


def _seconds(value: float) -> str:
    return f"{value:.2f} s" if value else _NOTHING


_ERRORS: list[tuple[str, str, str, Callable[[float], float]]] = [
    ("relative L1", "relative_l1", "{:.2%}", abs),
    ("relative L2", "relative_l2", "{:.2%}", abs),
    ("SSIM", "ssim", "{:.4f}", lambda value: -value),
    ("FLIP", "flip", "{:.4f}", abs),
    ("energy bias", "energy_bias", "{:+.2%}", abs),
]


def _measured(
    entries: tuple[Entry, ...], name: str, attribute: str, form: str, badness: Callable
) -> tuple[str, list[str], int | None]:
    values = [getattr(entry.errors, attribute) for entry in entries]
    return name, [form.format(value) for value in values], _best(values, badness)


# The same errors where light is known without photons.
_KNOWN = [
    (f"{name}, known light", attribute, form, badness)
    for name, attribute, form, badness in _ERRORS
    if attribute in ("relative_l1", "relative_l2", "energy_bias")
]


def _known(entries: tuple[Entry, ...]) -> list[tuple[str, list[str], int | None]]:
    rows = []
    for name, attribute, form, badness in _KNOWN:
        values = [entry.analytic_errors[attribute] for entry in entries if entry.analytic_errors]
        if values:
            rows.append((name, [form.format(value) for value in values], _best(values, badness)))
    return rows


def _best(values: list[float], badness: Callable[[float], float]) -> int | None:
    return min(range(len(values)), key=lambda i: badness(values[i])) if len(values) > 1 else None


def _photons_per_estimate(entry: Entry) -> str:
    method = METHODS[entry.method]
    k = None if method.splits_passes else entry.settings[method.stages[-1]].get("k")
    return str(k) if k else "varies"


def _title(comparison: Comparison) -> str:
    request = comparison.request
    width, height = request.subject.size
    return (
        f"{request.subject.name}: {request.n_emitted:,} photons emitted ({request.sampler}, seed "
        f"{request.seed}), {width} x {height} pixels of {request.supersampling**2} samples"
    )


def _notes(comparison: Comparison) -> list[str]:
    reference = comparison.reference
    notes = [
        f"reference: {reference.description}",
        "L1, L2 and energy bias are of the caustic alone, SSIM and FLIP of the picture as shown; "
        "photons and camera rays were traced for all methods and count in every total.",
        f"SSIM and FLIP see nothing of what a display cuts off: {reference.clipped:.1%} of the "
        "reference's pixels.",
    ]
    threads = thread_count(comparison.request.n_threads)
    notes.append(f"times are of {threads} threads; {machine()}.")
    if any(METHODS[entry.method].splits_passes for entry in comparison.entries):
        notes.append("dealt: the photons of the same map, not fresh ones in every pass.")
    if reference.analytic_errors:
        notes.append(
            f"known light: {reference.analytic_share:.0%} of the pixels, whose irradiance follows "
            "from geometry, without photons."
        )
    return notes
