"""Files of a trade-off: table, plot and page."""

from __future__ import annotations

import base64
import io
import json
from contextlib import ExitStack
from importlib.resources import files
from pathlib import Path
from typing import Any

from ..._util.files import make_folder, whole_file
from ..tradeoff import REFERENCE, STATE, Point, Tradeoff, front, seconds_for
from .table import Row, Table

PAGE, PLOT, TABLE = "index.html", "front.png", "front.md"
_DATA = "/* DATA */"
# Errors whose times are told.
ERRORS = (0.1, 0.05, 0.02, 0.01)
# Errors are told where the doubt of the reference is under this share of them.
_DOUBT_SHARE = 1.0 / 3.0
_COLUMNS = ["seconds", "CPU", "L1", "rms", "SSIM", "FLIP", "energy", "memory"]


def check_installed() -> None:
    """Raise ImportError unless matplotlib is installed."""
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise ImportError(
            "plots need matplotlib, which is not installed: pip install 'photonrelax[compare]'"
        ) from error


def prepare_folder(folder: Path) -> None:
    """Make the folder of a trade-off, before the work; see `make_folder`."""
    make_folder(folder, (PAGE, PLOT, TABLE, STATE, REFERENCE))


def table(found: Tradeoff) -> Table:
    """Table of the points of the front, a row each, quickest first."""
    width, height = found.about["size"]
    doubt = f"{found.doubt:.1%}" if found.doubt == found.doubt else "unknown"
    size, n = f"{width} x {height} pixels", len(found.points)
    return Table(
        f"{found.about['scene']}, {size}: the front of {n} points",
        _COLUMNS,
        [Row(_name(point), _cells(point)) for point in found.front],
        [
            f"reference: {found.reference}; its doubt, relative L1: {doubt}",
            "L1, rms and energy are of the caustic, SSIM and FLIP of the image; rms is relative L2",
            *_reached(found),
        ],
    )


def markdown(shown: Table) -> str:
    """A table as Markdown."""
    lines = [["", *shown.column_titles], ["---"] * (len(shown.column_titles) + 1)]
    lines += [[row.name, *row.cells] for row in shown.rows]
    rows = "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
    notes = "\n".join(f"- {note}" for note in shown.notes)
    return f"# {shown.title}\n\n{rows}\n\n{notes}\n"


def write(found: Tradeoff, folder: Path) -> Table:
    """Write table, plot and page into a folder that there is; return the table."""
    shown, plot = table(found), _plot(found)
    with ExitStack() as stack:
        stack.enter_context(whole_file(folder / PLOT)).write_bytes(plot)
        text = markdown(shown)
        stack.enter_context(whole_file(folder / TABLE)).write_text(text, encoding="utf-8")
        page = stack.enter_context(whole_file(folder / PAGE))
        page.write_text(_page(found, shown, plot), encoding="utf-8")
    return shown


def _reached(found: Tradeoff) -> list[str]:
    """Times in which errors are reached, a line a method, of errors above the doubt."""
    told = [error for error in ERRORS if not found.doubt > _DOUBT_SHARE * error]
    lines = []
    for method in dict.fromkeys(point.choice.method for point in found.points):
        times = [(error, seconds_for(found.of(method), error)) for error in told]
        reached = [f"{error:.0%} in {seconds:.2g} s" for error, seconds in times if seconds < 1e300]
        lines.append(f"{method}: {', '.join(reached) or 'no error told is reached'}")
    return lines


def _name(point: Point) -> str:
    n = point.choice.n_emitted
    return f"{point.choice.name}, {n:,} photons" if n else point.choice.name


def _cells(point: Point) -> list[str]:
    errors = point.errors
    known = point.peak_bytes == point.peak_bytes
    return [
        f"{point.total:.2f}",
        f"{point.cpu_seconds:.2f}",
        f"{errors.relative_l1:.2%}",
        f"{errors.relative_l2:.2%}",
        f"{errors.ssim:.4f}",
        f"{errors.flip:.4f}",
        f"{errors.energy_bias:+.2%}",
        f"{point.peak_bytes / 1e6:.0f} MB" if known else "",
    ]


def _plot(found: Tradeoff) -> bytes:
    """PNG of errors over seconds: all points, and the front of each method."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 5), layout="constrained")
    axes = figure.subplots()
    for method in dict.fromkeys(point.choice.method for point in found.points):
        points = found.of(method)
        (line,) = axes.plot(
            *zip(*((point.total, point.error) for point in front(points)), strict=True),
            marker="o",
            label=method,
        )
        axes.scatter(*_columns(points), s=8, alpha=0.4, color=line.get_color())
    if found.doubt == found.doubt:
        axes.axhline(found.doubt, color="gray", linestyle="--", label="doubt of the reference")
    axes.set(
        xscale="log", yscale="log", xlabel="s", ylabel="relative L1", title=found.about["scene"]
    )
    axes.grid(which="both", alpha=0.3)
    axes.legend(fontsize="small")
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=120)
    return file.getvalue()


def _columns(points: list[Point]) -> tuple[list[float], list[float]]:
    return [point.total for point in points], [point.error for point in points]


def _page(found: Tradeoff, shown: Table, plot: bytes) -> str:
    """Self-contained HTML page."""
    data: dict[str, Any] = {
        "about": found.about,
        "table": shown.to_dict(),
        "plot": f"data:image/png;base64,{base64.b64encode(plot).decode('ascii')}",
        "points": [point.to_dict() for point in found.points],
    }
    template = files(__package__).joinpath("tradeoff.html").read_text(encoding="utf-8")
    # Escaped: a script element must not contain its end tag.
    return template.replace(_DATA, json.dumps(data, allow_nan=False).replace("<", "\\u003c"))
