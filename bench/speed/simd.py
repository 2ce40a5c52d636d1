"""All-neighbours searches with one instruction set, which is chosen when a process starts."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys

from bench.speed import child, inputs
from bench.speed.timing import Timing, keep_memory
from bench.speed.workbench import Workbench

PATHS = ("avx2", "portable")
_VARIABLE = "PHOTONRELAX_SIMD"


def measured(path: str, n: int, n_threads: int, rounds: int) -> dict[str, Timing]:
    """Return times of all-neighbours searches, K = 50, of photonrelax on a path and of peers.

    Empty if the process fails, as it does on a processor without the instructions; the reason is
    on stderr.
    """
    arguments = ["simd", str(n), str(n_threads), str(rounds)]
    try:
        times = child.result(arguments, {_VARIABLE: path})
    except subprocess.CalledProcessError:
        print(f"{path} is left out: its process failed", file=sys.stderr)
        return {}
    return {name: Timing(**each) for name, each in times.items()}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    for name in ("n", "n_threads", "rounds"):
        parser.add_argument(name, type=int)


def run(options: argparse.Namespace) -> None:
    """Measure in this process, whose environment chose the path, and print JSON."""
    from photonrelax._ext.spatial import tree

    wanted, used = os.environ[_VARIABLE], tree.instruction_set()
    if used != wanted:
        raise SystemExit(f"{_VARIABLE} should make searches use {wanted}, but they use {used}")
    keep_memory()
    bench = Workbench(inputs.caustic(options.n), options.n_threads, pixels=1)
    results = bench.measured(["neighbours 50"], options.rounds)
    print(json.dumps({name: {"wall": t.wall, "cpu": t.cpu} for name, t in results.items()}))
