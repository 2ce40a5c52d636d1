"""Process of `versions`: times tasks, named on stdin, with the photonrelax it imports."""

from __future__ import annotations

import json
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np

import photonrelax as pr
from bench.speed.timing import Case, keep_memory, run_once
from bench.speed.workbench import Workbench

PHOTONS, HITS = "photons.npz", "hits.npz"


def main(folder: Path, n_threads: int, pixels: int) -> None:
    """Answer each line of stdin, the name of a task, by a line of JSON.

    It has the seconds by clock, or the error of a task that needs a module this build does not
    have. The first round of a task is checked.
    """
    keep_memory()
    bench = Workbench(pr.PhotonMap.load(folder / PHOTONS), n_threads, pixels)
    with np.load(folder / HITS) as columns:
        # Other builds may have fewer.
        known = [field.name for field in fields(pr.HitPoints) if field.name in columns]
        bench.hits = pr.HitPoints(**{name: columns[name] for name in known})
    cases: dict[str, Case] = {}
    for line in sys.stdin:
        task = line.rstrip("\n")
        first = task not in cases
        try:
            if first:
                cases[task] = bench.case(task)
            wall, cpu = run_once(cases[task], check=first)
            answer = {"wall": wall, "cpu": cpu}
        except ImportError as error:
            answer = {"error": str(error)}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
