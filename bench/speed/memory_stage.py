"""Memory of one stage, measured in the process that runs it (Linux only)."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import fields
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

import photonrelax as pr
from bench.speed import inputs

_STATUS, _RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")
_MAP = "photons.npz"
# Fields that structure, relaxation and gathering do not read in a map of one emitter.
_NOT_NEEDED = ("wi", "emitter_id", "path_signature", "n_bounces", "path_length", "object_id")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("name")
    parser.add_argument("n", type=int)
    parser.add_argument("folder", type=Path)


def run(options: argparse.Namespace) -> None:
    """Run one stage in this process and print its bytes as JSON."""
    print(json.dumps(_stage(options.name, options.n, options.folder)))


def _stage(name: str, n: int, folder: Path) -> dict[str, Any]:
    if name == "trace":
        return _traced(n, folder)
    photons = pr.PhotonMap.load(folder / _MAP)
    if name == "whole":
        return _whole(photons)
    if name == "bare":
        return _whole(photons.replace(**dict.fromkeys(_NOT_NEEDED)))
    return _measured(_prepared(name, photons))[1]


def _traced(n: int, folder: Path) -> dict[str, float]:
    inputs.scene()
    # Once, so that imports and the ray caster's libraries are not counted.
    pr.trace_photons(inputs.scene(), 10_000)
    photons, found = _measured(lambda: pr.trace_photons(inputs.scene(), int(n / inputs.STORED)))
    photons.subset(slice(0, n)).save(folder / _MAP)
    arrays = (getattr(photons, field.name) for field in fields(photons))
    found["map"] = sum(array.nbytes for array in arrays if isinstance(array, np.ndarray))
    return found


def _prepared(name: str, photons: pr.PhotonMap) -> Callable[[], Any]:
    if name == "tree":
        return lambda: pr.KDTree(photons.position)
    if name == "structure":
        return lambda: pr.detect_structure(photons)
    if name == "rest density":
        return lambda: pr.rest_density(photons)
    if name.startswith("relax"):
        structure, settings = pr.detect_structure(photons), pr.RelaxSettings((1, 1))
        rest = pr.rest_density(photons) if "rest" in name else None
        scene = inputs.scene() if "scene" in name else None
        return lambda: pr.relax(photons, structure, settings, rest=rest, scene=scene)
    return partial(_gathered, photons)


def _gathered(photons: pr.PhotonMap) -> pr.Field:
    """Gather at some points; return the field, which is kept for others."""
    hits = inputs.hit_points(100)
    field = pr.irradiance_field(photons, method="standard")
    field(hits.position, hits.normal)
    return field


def _whole(photons: pr.PhotonMap) -> dict[str, dict[str, float]]:
    hits = inputs.hit_points(600)
    structure, found = _measured(lambda: pr.detect_structure(photons))
    relaxed, moving = _measured(partial(pr.relax, photons, structure))
    del structure
    _, gathering = _measured(lambda: pr.estimate_irradiance(relaxed, hits.position, hits.normal))
    return {"structure": found, "relaxation": moving, "gathering": gathering}


def _measured(work: Callable[[], Any]) -> tuple[Any, dict[str, float]]:
    """Return a result and bytes: its own, the peak above the start, the peak of the process."""
    try:
        _RESET.write_text("5")
    except OSError as error:
        raise SystemExit(f"memory is measured through {_RESET}, which failed: {error}") from None
    before, started = resident("VmRSS"), perf_counter()
    result = work()
    seconds, peak, after = perf_counter() - started, resident("VmHWM"), resident("VmRSS")
    return result, {
        "kept": after - before,
        "peak": peak - before,
        "total": peak,
        "seconds": seconds,
    }


def resident(name: str) -> int:
    """Bytes of this process, of a line of its status in Linux's proc file system."""
    for line in _STATUS.read_text().splitlines():
        if line.startswith(name):
            return int(line.split()[1]) * 1024
    raise SystemExit(f"{_STATUS} should name {name}")
