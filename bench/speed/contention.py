"""Every stage on several threads compared with one thread, beside busy processes.

``python -m bench contention`` keeps as many processes busy as it uses threads and times tasks of
the workbench on one thread and on all in turns. On a machine without a core to spare threads gain
nothing; they must not lose either, as they do where they spin while they wait for one another.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from statistics import median

from bench.markdown import markdown_table
from bench.speed import machine
from bench.speed.timing import Timing
from bench.speed.versions import STAGES, Builds, compared, save_inputs, worker
from bench.speed.workbench import TASKS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--photons", type=float, default=2e5, help="default 2e5")
    parser.add_argument("--threads", type=int, default=2, help="default 2")
    parser.add_argument("--rounds", type=int, default=5, help="default 5")
    parser.add_argument("--pixels", type=int, default=300, help="default 300")
    parser.add_argument("--tasks", nargs="+", default=STAGES, choices=TASKS, metavar="TASK")


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    n, pixels = int(options.photons), options.pixels
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        save_inputs(Path(folder), n, pixels)
        several, one = (
            stack.enter_context(
                worker(Path(sys.executable), [folder, str(n_threads), str(pixels)], None)
            )
            for n_threads in (options.threads, 1)
        )
        workers: Builds = several, one
        idle = {task: compared(task, workers, options.rounds) for task in options.tasks}
        with busy_processes(options.threads):
            busy = {task: compared(task, workers, options.rounds) for task in options.tasks}
    print(markdown(f"{n:,} photons, threads: {options.threads}", idle, busy))


@contextmanager
def busy_processes(n: int) -> Iterator[None]:
    """Keep n processes busy."""
    running = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(n)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def markdown(
    title: str,
    idle: dict[str, tuple[Timing, Timing] | None],
    busy: dict[str, tuple[Timing, Timing] | None],
) -> str:
    """The table of times by task; tasks without any are left out."""
    rows = []
    for task, timings in idle.items():
        beside = busy[task]
        if timings is not None and beside is not None:
            (several, one), (busy_several, busy_one) = timings, beside
            seconds = [median(each.wall) for each in (one, several, busy_one, busy_several)]
            ratio = f"{seconds[3] / seconds[2]:.2f}"
            rows.append([task, *(f"{each:.4g} s" for each in seconds), ratio])
    titles = [title, "1 thread", "all", "1, beside busy processes", "all, beside", "ratio of these"]
    return f"{markdown_table(titles, rows)}\n\nMedians, wall time. {machine.description()}.\n"
