"""SJ13's Table I: the prism stage by stage, compared with the paper's figures."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from time import perf_counter, process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

import photonrelax as pr
from bench.markdown import markdown_table
from bench.speed import inputs, machine
from photonrelax.imaging.metrics import relative_l1
from photonrelax.rendering.presets import Choice

# Rows of the table by stage; every other stage of a method counts as feature detection.
_FEATURES = "structure (feature detect)"
_ROWS_OF = {"trace": "photon cast", "relax": "relaxation", "render": "render"}
# Spencer & Jones 2013, Table I, "Our method": seconds on 7 cores of a desktop of its time.
PAPER = {
    "photons emitted": 20_000_000,
    "photons stored": 863_000,
    "photon cast": 12.3,
    _FEATURES: 5.3,
    "relaxation": 28.4,
    "render": 4.3,
    "total": 50.3,
}


def _column(render: float, total: float, **others: float) -> dict[str, float]:
    """Return a column of the paper for the photons that four of its methods share."""
    found = {name: PAPER[name] for name in ("photons emitted", "photons stored", "photon cast")}
    rows = {"feature": _FEATURES, "relaxation": "relaxation"}
    named = {rows[name]: seconds for name, seconds in others.items()}
    return {**found, **named, "render": render, "total": total}


def _quick(n_iterations: tuple[int, int]) -> dict[str, dict[str, Any]]:
    return {"relax": {"n_iterations": n_iterations}, "gather": {"k": 8}}


_GATHER = pr.GatherSettings(k=15)
# ibid., §5: 500 photons and q = 0.02; eigenvalues over the largest, as in SSO08.
_DIFFUSION = pr.DiffusionSettings(k=500, edge_threshold=0.02, normalisation="maximum")
# The paper's settings, and those of the fronts of docs/measurements/tradeoff.md.
SETTINGS = {
    "7 + 7, k = 15": Choice("parameterised", 0, 2, {"gather": {"k": 15}}),
    "2 + 2, k = 8": Choice("parameterised", 0, 2, _quick((2, 2))),
    "2 + 2, k = 8, 1 sample": Choice("parameterised", 0, 1, _quick((2, 2))),
    "mapped, 3 + 3, k = 8, 1 sample": Choice("mapped", 0, 1, _quick((3, 3))),
}
_ERROR = "error of the caustic"
# ibid., all columns.
PAPER_OF = {
    "standard": _column(4.3, 14.8),
    "relaxation": _column(4.3, 48.2, feature=9.1, relaxation=27.3),
    "diffusion": _column(89.0, 104.0, feature=3.3),
    "parameterised": PAPER,
    "progressive": {"photons emitted": 4_600_000_000, "photons stored": 200_000_000}
    | {"total": 47 * 60 + 21.0},
}


def measured(
    n_emitted: int,
    n_threads: int | None = None,
    pixels: int = 600,
    method: str = "parameterised",
) -> dict[str, float]:
    """Return seconds and counts of an image with the paper's settings, by the table's rows.

    K = 15, 7 + 7 iterations, K_c = 50; 600 x 600 pixels of 2 x 2 samples.
    """
    choice = Choice(method, n_emitted, 2)
    return _columns_of(_image(choice, n_threads, pixels, gather=_GATHER, diffusion=_DIFFUSION))


def _image(
    choice: Choice, n_threads: int | None, pixels: int, seed: int = 0, **settings: Any
) -> pr.Image:
    """Image of the prism, with settings of a choice and others."""
    return pr.render(
        inputs.scene(pixels),
        method=choice.method,
        n_emitted=choice.n_emitted,
        components=("direct", "caustic"),
        supersampling=choice.supersampling,
        seed=seed,
        n_threads=n_threads,
        progress=_report,
        **(choice.settings.given | settings),
    )


def _columns_of(image: pr.Image) -> dict[str, float]:
    """Seconds and counts of an image by the table's rows."""
    stages: dict[str, Any] = image.stats["stages"]
    seconds: dict[str, float] = {}
    for name, stage in stages.items():
        row = _ROWS_OF.get(name, _FEATURES)
        seconds[row] = seconds.get(row, 0.0) + stage["seconds"]
    return {
        "photons emitted": stages["trace"]["emitted"],
        "photons stored": stages["trace"]["stored"],
        **seconds,
        "total": image.stats["seconds"],
    }


def progressive(
    n_passes: int, n_emitted: int, n_threads: int | None = None, pixels: int = 600
) -> dict[str, float]:
    """Return the counts and seconds of so many passes of fresh photons."""
    started = perf_counter()
    image = pr.render_progressive(
        inputs.scene(pixels),
        n_passes=n_passes,
        photons_per_pass=n_emitted,
        settings=pr.ProgressiveSettings(k=4),
        n_global=0,
        n_threads=n_threads,
        progress=_report,
    )
    return {
        "photons emitted": n_passes * n_emitted,
        "photons stored": image.stats["stages"]["passes"]["stored"],
        "total": perf_counter() - started,
    }


def _report(stage: str, done: int, total: int) -> None:
    if done == total:
        print(f"... {stage}: {total:,} done", file=sys.stderr, flush=True)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--emitted", type=float, default=20e6, help="default 20e6")
    parser.add_argument("--stored", type=float, default=863e3, help="of the second column")
    parser.add_argument("--methods", action="store_true", help="all five columns of the paper")
    parser.add_argument("--settings", action="store_true", help="the paper's and quicker ones")
    parser.add_argument("--counts", type=int, default=4, help="of --settings, default 4")
    parser.add_argument("--passes", type=int, default=50, help="of progressive, default 50")
    parser.add_argument("--threads", type=int, help="default all")
    parser.add_argument("--quick", action="store_true", help="few photons: does it run?")


def run(options: argparse.Namespace) -> None:
    """Print photonrelax's column next to the paper's, or all columns."""
    stored, emitted = (2e4, 2e5) if options.quick else (options.stored, options.emitted)
    if options.settings:
        print(by_settings(int(stored), options.counts, options.threads))
    elif options.methods:
        print(every_method(int(stored), options.passes, options.threads))
    else:
        print(markdown(int(emitted), int(stored), options.threads))


def markdown(n_emitted: int, n_stored: int, n_threads: int | None = None) -> str:
    """Return the table: with so many photons emitted, and with about so many stored."""
    pixels = 600 if n_emitted > 1_000_000 else 60
    columns = {
        "SJ13, Table I": PAPER,
        f"{n_emitted:,} emitted": measured(n_emitted, n_threads, pixels),
        f"about {n_stored:,} stored": measured(int(n_stored / inputs.STORED), n_threads, pixels),
    }
    table = markdown_table(
        ["prism", *columns],
        ([row, *(_cell(row, column) for column in columns.values())] for row in PAPER),
    )
    return (
        f"{table}\n\nSJ13: 7 cores of a desktop of 2012. Photons are aimed at the prism, so more "
        f"of those emitted are stored. {_threads_and_machine(n_threads)}\n"
    )


def every_method(n_stored: int, n_passes: int, n_threads: int | None = None) -> str:
    """Return all columns of the table, each with the paper's in brackets.

    Four methods with about so many photons stored; progressive photon mapping is a run of so many
    passes, each of as many photons emitted.
    """
    pixels, n_emitted = 600 if n_stored > 100_000 else 60, int(n_stored / inputs.STORED)
    # Not timed: imports and first allocations.
    measured(10_000, n_threads, pixels, "standard")
    columns = {
        method: measured(n_emitted, n_threads, pixels, method)
        for method in PAPER_OF
        if method != "progressive"
    }
    columns["progressive"] = progressive(n_passes, n_emitted, n_threads, pixels)
    rows = (
        [row, *(f"{_cell(row, columns[m])} ({_cell(row, PAPER_OF[m])})" for m in columns)]
        for row in PAPER
    )
    table = markdown_table(["prism, in brackets SJ13", *columns], rows)
    return f"{table}\n\n{_threads_and_machine(n_threads)}\n"


def by_settings(n_stored: int, n_counts: int, n_threads: int | None = None) -> str:
    """Return a column for each of `SETTINGS`, with the errors of the caustic.

    Against the mean of so many images of as many other photons, counted, whose noise is half of the
    difference of its halves.
    """
    pixels, n_emitted = 600 if n_stored > 100_000 else 60, int(n_stored / inputs.STORED)
    expected, noise = _counts(n_emitted, n_counts, n_threads, pixels)
    columns = {}
    for name, choice in SETTINGS.items():
        started = process_time()
        image = _image(replace(choice, n_emitted=n_emitted), n_threads, pixels)
        columns[name] = _columns_of(image) | {"of the processors": process_time() - started}
        columns[name][_ERROR] = relative_l1(image.layers["caustic"], expected)
    rows = [*PAPER, "of the processors", _ERROR]
    table = markdown_table(
        ["prism", *columns], ([row, *(_cell(row, columns[m]) for m in columns)] for row in rows)
    )
    return (
        f"{table}\n\nErrors are relative L1, with the noise of the {n_counts} x {n_emitted:,} "
        f"photons counted, {noise:.2%}. {_threads_and_machine(n_threads)}\n"
    )


def _counts(
    n_emitted: int, n_counts: int, n_threads: int | None, pixels: int
) -> tuple[NDArray[np.float64], float]:
    """Mean caustic of images of counted photons, an even number, and its noise."""
    choice = Choice("standard", n_emitted, 2, {"gather": {"k": 4}})
    images = [
        np.asarray(_image(choice, n_threads, pixels, 1000 + seed).layers["caustic"])
        for seed in range(n_counts)
    ]
    halves = [np.mean(images[first::2], axis=0) for first in range(2)]
    return np.mean(halves, axis=0), 0.5 * relative_l1(halves[0], halves[1])


def _threads_and_machine(n_threads: int | None) -> str:
    return f"Threads: {n_threads or machine.machine()['cores']}. {machine.description()}."


def _cell(row: str, column: dict[str, float]) -> str:
    if row not in column:
        return "–"
    if row == _ERROR:
        return f"{column[row]:.2%}"
    if row.startswith("photons"):
        return f"{column[row]:,}"
    return f"{column[row]:,.0f} s" if column[row] >= 100.0 else f"{column[row]:.3g} s"
