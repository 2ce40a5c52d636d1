"""Every stage compared with another build of photonrelax, that of another interpreter.

``python -m bench versions --other PYTHON`` starts a process of each interpreter and times tasks
in turns: a busy machine slows both alike. Photons and hit points are the same for both, from a
file; tasks are those of the workbench, written with public names, so that the other build may be
of any layout. A task that one of them cannot do is left out, with the reason on stderr.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import fields
from pathlib import Path
from statistics import median

import numpy as np
from scipy.stats import quantile_test

from bench.markdown import markdown_table
from bench.speed import inputs, machine
from bench.speed.child import ROOT
from bench.speed.peers import UnavailableError
from bench.speed.timing import Timing
from bench.speed.version_worker import HITS, PHOTONS
from bench.speed.workbench import TASKS

Builds = tuple[subprocess.Popen[str], subprocess.Popen[str]]
STAGES = (
    "emission, rays that miss",
    "emission",
    "trace",
    "build",
    "neighbours 50",
    "constrained 6",
    "structure",
    "1 constrained",
    "1 collapsed",
    "gather",
    "render, parameterised",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--other", type=Path, required=True, help="Python with another build")
    parser.add_argument("--photons", type=float, default=863e3, help="default 863e3")
    parser.add_argument("--threads", type=int, default=1, help="default 1")
    parser.add_argument("--rounds", type=int, default=5, help="default 5")
    parser.add_argument("--clock", choices=("wall", "cpu"), default="wall")
    parser.add_argument("--pixels", type=int, default=600, help="default 600")
    parser.add_argument("--tasks", nargs="+", default=STAGES, choices=TASKS, metavar="TASK")


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    n, pixels = int(options.photons), options.pixels
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        save_inputs(Path(folder), n, pixels)
        arguments = [folder, str(options.threads), str(pixels)]
        # The other build is an installed one: PYTHONPATH would put this one before it.
        other_environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
        builds = (
            stack.enter_context(worker(Path(sys.executable), arguments, dict(os.environ))),
            stack.enter_context(worker(options.other, arguments, other_environment)),
        )
        timings = {task: compared(task, builds, options.rounds) for task in options.tasks}
    title = f"{n:,} photons, threads: {options.threads}, rounds: {options.rounds}"
    print(markdown(title, timings, options.clock))


def save_inputs(folder: Path, n: int, pixels: int) -> None:
    """Save photons and hit points, which both builds are given."""
    inputs.caustic(n).save(folder / PHOTONS)
    hits = inputs.hit_points(pixels)
    columns = {field.name: getattr(hits, field.name) for field in fields(hits)}
    # Older builds know no footprints.
    np.savez(folder / HITS, **{name: rows for name, rows in columns.items() if rows is not None})


@contextmanager
def worker(
    python: Path, arguments: list[str], environment: dict[str, str] | None
) -> Iterator[subprocess.Popen[str]]:
    """Start a worker with an interpreter; it ends with the block. None: the same environment."""
    process = subprocess.Popen(
        [python, "-m", "bench.speed.version_worker", *arguments],
        cwd=ROOT,
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    with process:
        try:
            yield process
        finally:
            process.stdin.close()


def compared(task: str, builds: Builds, rounds: int) -> tuple[Timing, Timing] | None:
    """Return the times of both builds; None if one of them cannot do the task."""
    print(f"... {task}", file=sys.stderr, flush=True)
    timings = Timing(), Timing()
    try:
        # The first round warms up and is checked.
        for build in builds:
            _once(build, task)
        for turn in range(rounds):
            for which in (0, 1) if turn % 2 else (1, 0):
                timings[which].add(*_once(builds[which], task))
    except UnavailableError as error:
        print(f"... left out: {error}", file=sys.stderr, flush=True)
        return None
    return timings


def _once(build: subprocess.Popen[str], task: str) -> tuple[float, float]:
    """Return wall seconds and CPU seconds of one round."""
    print(task, file=build.stdin, flush=True)
    line = build.stdout.readline()
    if not line:
        raise SystemExit(f"the process of {build.args[0]} ended during: {task}")
    answer = json.loads(line)
    if "error" in answer:
        raise UnavailableError(f"{build.args[0]}: {answer['error']}")
    return answer["wall"], answer["cpu"]


def markdown(
    title: str, timings: dict[str, tuple[Timing, Timing] | None], clock: str = "wall"
) -> str:
    """Return the table of times by task and build; tasks without any are left out."""
    rows = []
    for task, both in timings.items():
        if both is not None:
            this, other = (getattr(timing, clock) for timing in both)
            seconds = [f"{median(each):.4g} s" for each in (this, other)]
            ratios = [f"{typical(this) / typical(other):.3f}" for typical in (median, min)]
            rows.append([task, *seconds, *ratios, interval(this, other)])
    titles = [title, "this build", "the other", "this over the other", "by shortest rounds"]
    titles.append("95 % interval")
    note = f"Medians, {clock} time. {machine.description()}."
    return f"{markdown_table(titles, rows)}\n\n{note}\n"


def interval(this: list[float], other: list[float]) -> str:
    """95 % interval of the median ratio of rounds that followed each other; empty under six."""
    ratios = [mine / others for mine, others in zip(this, other, strict=True)]
    if len(ratios) < 6:
        return ""
    low, high = quantile_test(ratios, p=0.5).confidence_interval(0.95)
    return f"{low:.3f} to {high:.3f}"
