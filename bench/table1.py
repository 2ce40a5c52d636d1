"""SJ13's Table I: the prism stage by stage, beside the paper's figures."""

from __future__ import annotations

import sys
from typing import Any

import photonrelax as pr

from . import inputs, machine

# Spencer & Jones 2013, Table I, "Our method": seconds on 7 cores of a desktop of its time.
PAPER = {
    "photons emitted": 20_000_000,
    "photons stored": 863_000,
    "photon cast": 12.3,
    "structure (feature detect)": 5.3,
    "relaxation": 28.4,
    "render": 4.3,
    "total": 50.3,
}
_STAGES = {
    "photon cast": "trace",
    "structure (feature detect)": "structure",
    "relaxation": "relax",
    "render": "render",
}
_GATHER = pr.GatherSettings(k=15)


def measured(n_emitted: int, n_threads: int | None = None, pixels: int = 600) -> dict[str, float]:
    """Return seconds and counts of a picture with the paper's settings, by the table's rows.

    K = 15, 7 + 7 iterations, K_c = 50; 600 x 600 pixels of 2 x 2 samples.
    """
    scene = inputs.scene(pixels)
    image = pr.render(
        scene,
        n_emitted=n_emitted,
        gather=_GATHER,
        supersampling=2,
        n_threads=n_threads,
        progress=_tell,
    )
    stages: dict[str, Any] = image.stats["stages"]
    return {
        "photons emitted": stages["trace"]["emitted"],
        "photons stored": stages["trace"]["stored"],
        **{row: stages[name]["seconds"] for row, name in _STAGES.items()},
        "total": image.stats["seconds"],
    }


def _tell(stage: str, done: int, total: int) -> None:
    if done == total:
        print(f"... {stage}: {total:,} done", file=sys.stderr, flush=True)


def markdown(n_emitted: int, n_stored: int, n_threads: int | None = None) -> str:
    """Return the table: with so many photons emitted, and with about so many stored."""
    pixels = 600 if n_emitted > 1_000_000 else 60
    columns = [
        measured(n_emitted, n_threads, pixels),
        measured(int(n_stored / inputs.STORED), n_threads, pixels),
    ]
    threads = n_threads or machine.machine()["cores"]
    lines = [
        f"| prism | SJ13, Table I | {n_emitted:,} emitted | about {n_stored:,} stored |",
        "| --- | --- | --- | --- |",
        *(_line(row, [PAPER, *columns]) for row in PAPER),
    ]
    note = (
        "SJ13: 7 cores of a desktop of 2012. Photons are aimed at the prism, so more of those "
        f"emitted are stored. Threads: {threads}. {machine.description()}."
    )
    return "\n".join([*lines, "", note, ""])


def _line(row: str, columns: list[dict[str, float]]) -> str:
    form = "{:,}" if row.startswith("photons") else "{:.3g} s"
    return f"| {row} | {' | '.join(form.format(column[row]) for column in columns)} |"
