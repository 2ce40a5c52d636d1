"""Relaxing photons on disk by blocks compared with one piece in memory: CPU time and memory.

``python -m bench blocks`` traces into a folder of parts, and relaxes these in turns by each size of
blocks and in one piece, each time in a process of its own.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

import photonrelax as pr
from bench.arguments import numbers
from bench.markdown import markdown_table
from bench.speed import child, machine

_PARTS = 8


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--scene", default="ripples", help="of the gallery; default ripples")
    parser.add_argument("--method", default="mapped", help="mapped, by default, or parameterised")
    parser.add_argument("--photons", type=float, default=2e6, help="emitted; default 2e6")
    parser.add_argument("--block", type=numbers, default=[300_000, 1_000_000])
    parser.add_argument("--rounds", type=int, default=3, help="default 3")
    parser.add_argument(
        "--folder", type=Path, help="that is there, for the parts and blocks; a temporary one"
    )


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory(dir=options.folder, prefix="blocks-") as folder:
        parts = pr.trace_parts(
            pr.gallery.scene(options.scene),
            int(options.photons),
            Path(folder) / "parts",
            chunk=-(-int(options.photons) // _PARTS),
        )
        print(_markdown(options, folder, len(parts)))


def _markdown(options: argparse.Namespace, folder: str, n_photons: int) -> str:
    # Of no size: one piece.
    found: dict[int, list[dict[str, Any]]] = {size: [] for size in (0, *options.block)}
    for _ in range(options.rounds):
        for size, runs in found.items():
            given = ["block-run", options.scene, options.method, folder, str(size)]
            runs.append(child.result(given, {}))
    rows = [_row(size, runs, found[0]) for size, runs in found.items()]
    titles = ["photons of a block", "blocks", "CPU time, s", "over one piece", "peak, GB"]
    return (
        f"{markdown_table([*titles, 'largest difference'], rows)}\n\n`{options.scene}`, "
        f"`{options.method}`, {n_photons:,} photons; differences over the extent of the map. "
        f"Medians of {options.rounds} in turns. {machine.description()}.\n"
    )


def _row(size: int, runs: list[dict[str, Any]], whole: list[dict[str, Any]]) -> list[str]:
    cpu, peak = (median(each[name] for each in runs) for name in ("cpu", "peak"))
    ratio = median(one["cpu"] / each["cpu"] for one, each in zip(runs, whole, strict=True))
    cells = [f"{cpu:.1f}", f"{ratio:.2f}", f"{peak / 1e9:.2f}"]
    if not size:
        return ["one piece", "1", *cells, ""]
    difference = max(each["difference"] for each in runs)
    return [f"{size:,}", str(runs[0]["n_blocks"]), *cells, f"{difference:.0e}"]
