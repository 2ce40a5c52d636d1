"""Neighbours with one kind of vector instructions, chosen when a process starts."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from bench.speed.timing import Timing, keep_memory

PATHS = ("avx2", "portable")
_VARIABLE = "PHOTONRELAX_SIMD"
_ROOT = Path(__file__).parents[2]


def measured(path: str, n: int, n_threads: int, rounds: int) -> dict[str, Timing]:
    """Return times of all-neighbours searches, K = 50, of photonrelax on a path and of peers.

    Nothing where the process fails, as it does if the processor has not got the instructions; it
    says why on stderr.
    """
    arguments = [str(number) for number in (n, n_threads, rounds)]
    done = subprocess.run(
        [sys.executable, "-m", "bench", "simd", *arguments],
        env=os.environ | {_VARIABLE: path},
        cwd=_ROOT,
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    if done.returncode:
        print(f"{path} is left out: its process failed", file=sys.stderr)
        return {}
    times = json.loads(done.stdout.splitlines()[-1])
    return {name: Timing(**each) for name, each in times.items()}


def main(n: int, n_threads: int, rounds: int) -> None:
    """Measure in this process, whose environment chose the path, and print JSON."""
    from bench.speed.side_by_side import Workbench
    from photonrelax._ext.spatial import tree as kdtree

    wanted, used = os.environ[_VARIABLE], kdtree.instruction_set()
    if used != wanted:
        raise SystemExit(f"{_VARIABLE} should make searches use {wanted}, but they use {used}")
    keep_memory()
    bench = Workbench(n, n_threads, pixels=1)
    results = bench.measured(list(bench.searches(50)), rounds)
    print(json.dumps({name: {"wall": t.wall, "cpu": t.cpu} for name, t in results.items()}))
