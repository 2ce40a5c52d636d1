"""Bytes a photon in each stage, from the peak of a process of its own (Linux only)."""

from __future__ import annotations

import argparse
import tempfile
from typing import Any

from bench.arguments import numbers
from bench.markdown import markdown_table
from bench.speed import child, machine

STAGES = (
    *("trace", "tree", "structure", "rest density"),
    *("relax", "relax to rest", "relax on the scene", "gather"),
)
# Every array in pages of its own, returned when freed, so that the count is of memory in use.
_ENVIRONMENT = {"MALLOC_MMAP_THRESHOLD_": "65536", "MALLOC_TRIM_THRESHOLD_": "65536"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--photons", type=numbers, default=[1_000_000, 4_000_000])
    parser.add_argument("--whole", type=float, help="so many photons through all stages, say 20e6")


def run(options: argparse.Namespace) -> None:
    """Print the tables."""
    print(markdown(options.photons))
    if options.whole:
        print(whole(int(options.whole)))


def markdown(counts: list[int]) -> str:
    """Return the table: growth per photon between the least and the greatest count."""
    few, many = min(counts), max(counts)
    measured = {n: _stages(n) for n in (few, many)}

    def growth(name: str, quantity: str) -> str:
        grown = measured[many][name][quantity] - measured[few][name][quantity]
        return f"{grown / (many - few):.0f}"

    table = markdown_table(
        ["stage", "bytes a photon, result", "at its peak, input not counted"],
        [[name, growth(name, "kept"), growth(name, "peak")] for name in STAGES],
    )
    held = measured[many]["trace"]["map"] / many
    return (
        f"{table}\n\nA photon of a traced map takes {held:.0f} bytes. From {few:,} to {many:,} "
        f"photons; {machine.description()}.\n"
    )


def whole(n: int) -> str:
    """Return time and peak of structure, relaxation and gathering in one process."""
    with tempfile.TemporaryDirectory() as folder:
        _measured_apart("trace", n, folder)
        found = {name: _measured_apart(name, n, folder) for name in ("whole", "bare")}
    titles = [
        f"{n:,} photons, all in one process",
        "all fields, peak",
        "those needed, peak",
        "time",
    ]
    rows = [
        [
            name,
            *(f"{found[kind][name]['total'] / 1e9:.2f} GB" for kind in ("whole", "bare")),
            f"{each['seconds']:.0f} s",
        ]
        for name, each in found["whole"].items()
    ]
    return markdown_table(titles, rows) + "\n"


def _stages(n: int) -> dict[str, dict[str, float]]:
    with tempfile.TemporaryDirectory() as folder:
        return {name: _measured_apart(name, n, folder) for name in STAGES}


def _measured_apart(name: str, n: int, folder: str) -> dict[str, Any]:
    return child.result(["stage", name, str(n), folder], _ENVIRONMENT)
