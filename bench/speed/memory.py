"""Bytes a photon takes in each stage, from the peak of a process of its own (Linux only)."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import fields
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

import photonrelax as pr
from bench.speed import inputs, machine

STAGES = ("trace", "tree", "structure", "relax", "relax on the scene", "gather")
_ROOT = Path(__file__).parents[2]
_STATUS, _RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")
# Every array in pages of its own, given back when freed: what is counted is what is in use.
_ENVIRONMENT = {"MALLOC_MMAP_THRESHOLD_": "65536", "MALLOC_TRIM_THRESHOLD_": "65536"}
_MAP = "photons.npz"
# What structure, relaxation and gathering do not look at in a map of one emitter.
_NOT_NEEDED = ("wi", "emitter_id", "path_signature", "n_bounces", "path_length", "object_id")


def markdown(counts: list[int]) -> str:
    """Return the table: growth per photon between the least and the greatest count."""
    few, many = min(counts), max(counts)
    lines = [
        "| stage | bytes a photon, result | at its peak, input not counted |",
        "| --- | --- | --- |",
    ]
    measured = {n: _stages(n) for n in (few, many)}
    for name in STAGES:
        growth = [
            (measured[many][name][what] - measured[few][name][what]) / (many - few)
            for what in ("kept", "peak")
        ]
        lines.append(f"| {name} | {growth[0]:.0f} | {growth[1]:.0f} |")
    held = measured[many]["trace"]["map"] / many
    note = (
        f"A photon of a traced map takes {held:.0f} bytes. From {few:,} to {many:,} photons; "
        f"{machine.description()}."
    )
    return "\n".join([*lines, "", note, ""])


def whole(n: int) -> str:
    """Return time and peak of structure, relaxation and gathering in one process."""
    with tempfile.TemporaryDirectory() as folder:
        _run("trace", n, folder)
        found = {name: _run(name, n, folder) for name in ("whole", "bare")}
    lines = [
        f"| {n:,} photons, all in one process | all fields, peak | those needed, peak | time |",
        "| --- | --- | --- | --- |",
    ]
    for name, each in found["whole"].items():
        peaks = [found[map_][name]["total"] / 1e9 for map_ in ("whole", "bare")]
        lines.append(
            f"| {name} | {peaks[0]:.2f} GB | {peaks[1]:.2f} GB | {each['seconds']:.0f} s |"
        )
    return "\n".join([*lines, ""])


def _stages(n: int) -> dict[str, dict[str, float]]:
    with tempfile.TemporaryDirectory() as folder:
        return {name: _run(name, n, folder) for name in STAGES}


def _run(name: str, n: int, folder: str) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-m", "bench", "stage", name, str(n), folder],
        cwd=_ROOT,
        env=os.environ | _ENVIRONMENT,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return json.loads(done.stdout.splitlines()[-1])


def stage(name: str, n: int, folder: Path) -> None:
    """Run one stage in this process and print what it took as JSON."""
    if name == "trace":
        print(json.dumps(_traced(n, folder)))
        return
    photons = pr.PhotonMap.load(folder / _MAP)
    if name in ("whole", "bare"):
        if name == "bare":
            photons = photons.replace(**dict.fromkeys(_NOT_NEEDED))
        print(json.dumps(_whole(photons)))
        return
    print(json.dumps(_measured(_prepared(name, photons))[1]))


def _traced(n: int, folder: Path) -> dict[str, float]:
    inputs.scene()
    # The first trace pays for what is loaded once.
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
    if name.startswith("relax"):
        structure = pr.detect_structure(photons)
        scene = inputs.scene() if "scene" in name else None
        return lambda: pr.relax(photons, structure, pr.RelaxSettings((1, 1)), scene=scene)
    return partial(_gathered, photons)


def _gathered(photons: pr.PhotonMap) -> pr.Field:
    """Gather at some points; return what is kept for others."""
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
    before, started = _resident("VmRSS"), perf_counter()
    result = work()
    seconds, peak, after = perf_counter() - started, _resident("VmHWM"), _resident("VmRSS")
    return result, {
        "kept": after - before,
        "peak": peak - before,
        "total": peak,
        "seconds": seconds,
    }


def _resident(name: str) -> int:
    for line in _STATUS.read_text().splitlines():
        if line.startswith(name):
            return int(line.split()[1]) * 1024
    raise SystemExit(f"{_STATUS} should name {name}")
