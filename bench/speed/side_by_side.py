"""photonrelax side by side with its peers: the tables of the measurements, JSON and a plot."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path

from bench.arguments import numbers
from bench.speed import inputs, machine, peers, plot, simd, stages
from bench.speed.report import Report, Results
from bench.speed.timing import Timing, interleave, keep_memory
from bench.speed.workbench import EMITTED, STAGES, TASKS, Workbench, degenerate_cases

_N_DEGENERATE = 200_000
# What is measured for every number of photons.
_SWEPT = ("neighbours 50", "constrained 6", *STAGES)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--photons", type=float, help="of the tables, default 863e3")
    parser.add_argument("--sweep", type=numbers, help="of the plot, default 1e5,863e3,4e6")
    parser.add_argument("--threads", type=numbers, default=[1, 2], help="default 1,2")
    parser.add_argument("--rounds", type=int, default=5, help="default 5")
    parser.add_argument("--clock", choices=("wall", "cpu"), default="wall")
    parser.add_argument("--quick", action="store_true", help="few photons: does it run?")
    parser.add_argument("--out", type=Path, default=Path("build/bench"), help="folder for results")


def run(options: argparse.Namespace) -> None:
    """Measure, print the tables, save them with the plot and all times."""
    n = int(options.photons or (2e4 if options.quick else 863e3))
    sweep = options.sweep or ([5_000, n] if options.quick else [100_000, n, 4_000_000])
    rounds = 1 if options.quick else options.rounds
    for line in peers.missing().values():
        print(line, file=sys.stderr)
    keep_memory()
    report = Report(n, rounds, machine.description(), clock=options.clock)
    options.out.mkdir(parents=True, exist_ok=True)
    for title in fill(report, sweep, options.threads, pixels=60 if options.quick else 600):
        _save(report, options.out)
        print(f"... {title}", file=sys.stderr, flush=True)
    _save(report, options.out)
    print(report.markdown())
    try:
        plot.save(report.sweep, options.out / "time.svg")
    except ImportError:
        print("no plot: pip install '.[bench]'", file=sys.stderr)
    print(f"saved in {options.out}: tables.md, results.json, time.svg", file=sys.stderr)


def _save(report: Report, folder: Path) -> None:
    (folder / "results.json").write_text(json.dumps(report.to_dict(), indent=1))
    (folder / "tables.md").write_text(report.markdown())


def fill(report: Report, sweep: list[int], threads: list[int], pixels: int) -> Iterator[str]:
    """Measure everything for a report; yield the title of each part before it is measured."""
    n, rounds = report.n, report.rounds
    for n_threads in threads:
        yield f"{n:,} photons, threads: {n_threads}"
        bench = Workbench(inputs.caustic(n), n_threads, pixels)
        report.by_threads[n_threads] = bench.measured(TASKS, rounds)
    yield "tracing, shading apart"
    report.tracing = tracing_parts(n, rounds)
    yield "degenerate photons"
    report.degenerate = degenerate(n, rounds)
    for path in simd.PATHS:
        yield f"SIMD: {path}"
        report.simd[path] = simd.measured(path, n, 1, rounds)
    for count in sweep:
        if count == n and 1 in threads:
            report.sweep[n] = report.by_threads[1]
            continue
        yield f"{count:,} photons, threads: 1"
        bench = Workbench(inputs.caustic(count), 1, pixels)
        report.sweep[count] = bench.measured(_SWEPT, min(rounds, 3))


def tracing_parts(n: int, rounds: int) -> Results:
    """Return times of embree, shading and emission in tracing, on one thread."""
    total: Results = {}
    for _ in range(rounds):
        for name, part in stages.tracing_parts(int(EMITTED * n)).items():
            total.setdefault(name, Timing()).add(part.wall[0], part.cpu[0])
    return total


def degenerate(n: int, rounds: int) -> Results:
    """Return times of degenerate photons, on one thread, by "kind: name of the case"."""
    cases = {
        f"{kind}: {name}": case
        for kind in inputs.DEGENERATE
        for name, case in degenerate_cases(inputs.degenerate(kind, min(n, _N_DEGENERATE))).items()
    }
    return interleave(cases, rounds)
