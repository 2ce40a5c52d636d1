"""Table of a comparison, in the form of SJ13's Table I."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from ..._util.parallel import thread_count
from ...estimation.methods import METHODS
from ..comparison import Comparison, Entry, machine
from ..reference import Reference

# Rows of the times by stage; all other stages of methods detect features.
_ROW_OF_STAGE = {
    "cast": "photon cast",
    "spectra": "photon cast",
    "relax": "relaxation",
    "camera": "render",
    "gather": "render",
}
_FEATURES = "feature detection"
_EMPTY = "–"


class Row(NamedTuple):
    """Name, cells and index of the best cell of a row, None where none is better than others."""

    name: str
    cells: list[str]
    best: int | None = None


@dataclass(frozen=True)
class Table:
    """Text in rows and columns.

    Attributes
    ----------
    title : str
        Subject and parameters of the comparison.
    column_titles : list of str
        One a column of cells.
    rows : list of Row
        From the top down.
    notes : list of str
        Explanations of columns and rows.
    """

    title: str
    column_titles: list[str]
    rows: list[Row]
    notes: list[str]

    def text(self) -> str:
        """The table for a terminal, columns aligned."""
        lines = [["", *self.column_titles], *([row.name, *row.cells] for row in self.rows)]
        name_width, *widths = (max(map(len, column)) for column in zip(*lines, strict=True))
        aligned = [
            "  ".join([f"{name:{name_width}}", *map(str.rjust, cells, widths)]).rstrip()
            for name, *cells in lines
        ]
        return "\n".join([self.title, *aligned, *self.notes])

    def to_dict(self) -> dict[str, Any]:
        """The table by its attributes."""
        return vars(self) | {"rows": [row._asdict() for row in self.rows]}


def table(comparison: Comparison) -> Table:
    """Table of a comparison; a computed reference is its last column.

    That is what SJ13 calls progressive; methods that split the photon map into passes are marked.
    """
    entries = comparison.entries
    rows = [
        Row("photons emitted", [f"{entry.n_emitted:,}" for entry in entries]),
        Row("photons absorbed", [f"{entry.n_stored:,}" for entry in entries]),
        Row("photons per estimate", [_photons_per_estimate(entry) for entry in entries]),
        *_time_rows(entries),
        *(metric.row(entries) for metric in _METRICS),
        *_analytic_rows(entries),
    ]
    titles = column_titles(entries)
    return _with_reference(
        Table(_title(comparison), titles, rows, _notes(comparison)), comparison.reference
    )


def column_titles(entries: Sequence[Entry]) -> list[str]:
    """Names of entries; methods that split the photon map into passes are marked."""
    return [
        f"{entry.name}, split passes" if METHODS[entry.method].splits_passes else entry.name
        for entry in entries
    ]


def seconds_by_row(seconds: dict[str, float]) -> dict[str, float]:
    """Seconds of the stages of an entry, summed by the rows of the table."""
    rows = {"photon cast": 0.0, _FEATURES: 0.0, "relaxation": 0.0, "render": 0.0}
    for stage, value in seconds.items():
        rows[_ROW_OF_STAGE.get(stage, _FEATURES)] += value
    return rows


def _time_rows(entries: Sequence[Entry]) -> list[Row]:
    columns = [seconds_by_row(entry.seconds) for entry in entries]
    totals = [sum(column.values()) for column in columns]
    return [
        *(Row(name, [_seconds(column[name]) for column in columns]) for name in columns[0]),
        Row("total", [_seconds(total) for total in totals], _best(totals)),
    ]


def _seconds(value: float) -> str:
    return f"{value:.2f} s" if value else _EMPTY


@dataclass(frozen=True)
class _Metric:
    """An error metric, its format, and the cost of its values: the least is the best."""

    name: str
    attribute: str
    form: str
    cost: Callable[[float], float] = abs

    def row(self, entries: Sequence[Entry]) -> Row:
        return self.row_of([getattr(entry.errors, self.attribute) for entry in entries])

    def row_of(self, values: list[float]) -> Row:
        cells = [self.form.format(value) for value in values]
        return Row(self.name, cells, _best([self.cost(value) for value in values]))


_METRICS = (
    _Metric("relative L1", "relative_l1", "{:.2%}"),
    _Metric("relative L2", "relative_l2", "{:.2%}"),
    _Metric("SSIM", "ssim", "{:.4f}", lambda value: -value),
    _Metric("FLIP", "flip", "{:.4f}"),
    _Metric("energy bias", "energy_bias", "{:+.2%}"),
)
# Those of the pixels whose irradiance is analytic.
_ANALYTIC_METRICS = tuple(
    replace(metric, name=f"{metric.name}, analytic")
    for metric in _METRICS
    if metric.attribute in ("relative_l1", "relative_l2", "energy_bias")
)


def _analytic_rows(entries: Sequence[Entry]) -> list[Row]:
    if not all(entry.analytic_errors for entry in entries):
        return []
    return [
        metric.row_of([entry.analytic_errors[metric.attribute] for entry in entries])
        for metric in _ANALYTIC_METRICS
    ]


def _best(costs: list[float]) -> int | None:
    return costs.index(min(costs)) if len(costs) > 1 else None


def _with_reference(table: Table, reference: Reference) -> Table:
    """Table with the column of a computed reference."""
    cost = reference.cost
    if not cost:
        return table
    cells = {
        "photons emitted": f"{cost['emitted']:,}",
        "photons absorbed": f"{cost['stored']:,}",
        "total": _seconds(cost["seconds"] or 0.0),
    }
    if reference.analytic_errors:
        for metric in _ANALYTIC_METRICS:
            cells[metric.name] = metric.form.format(reference.analytic_errors[metric.attribute])
    rows = [row._replace(cells=[*row.cells, cells.get(row.name, _EMPTY)]) for row in table.rows]
    return replace(table, column_titles=[*table.column_titles, "reference"], rows=rows)


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
    threads = thread_count(comparison.request.n_threads)
    notes = [
        f"reference: {reference.description}",
        "L1, L2 and energy bias are of the caustic alone, SSIM and FLIP of the image on a display; "
        "photons and camera rays were traced for all methods and count in every total.",
        f"SSIM and FLIP see nothing beyond the range of the display: {reference.clipped:.1%} of "
        "the reference's pixels.",
        f"times are of {threads} threads; {machine()}.",
    ]
    if any(METHODS[entry.method].splits_passes for entry in comparison.entries):
        notes.append("split passes: of the same photon map, not of new photons in every pass.")
    if reference.analytic_errors:
        notes.append(
            f"analytic: over {reference.analytic_share:.0%} of the pixels, whose irradiance "
            "follows from geometry, without photons."
        )
    return notes
