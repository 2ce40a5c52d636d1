"""Presets from the fronts of scenes: the quickest choices that reach an error on all of a class."""

from __future__ import annotations

import argparse
import json
from bisect import bisect
from collections.abc import Iterable
from dataclasses import replace
from datetime import date
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from photonrelax import __version__, gallery
from photonrelax.estimation.methods import METHODS
from photonrelax.evaluation.tradeoff import STATE, Point
from photonrelax.rendering.presets import PRESETS, SCENE_CLASSES, Choice, scene_class

# Relative L1 of the presets that are chosen by it.
ERRORS = {"draft": 0.1, "preview": 0.05, "final": 0.02}
# Settings of the papers, whose method is the first.
PAPER = ("parameterised", "standard", "mapped", "relaxation", "diffusion", "progressive")
_PHOTONS = 1_000_000
# Photons of presets; points of a power law, and how far beyond the most photons that were measured
# it is used.
_NUMBERS = (*(n * ten for ten in (10_000, 100_000) for n in (1, 2, 3, 5, 7)), 1_000_000)
_FITTED, _FARTHEST = 2, 3.5
_LEAST_SCENES = 2
# Errors over the least one that are as good, where none is as small as asked.
_AS_GOOD = 1.05


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folders", nargs="+", type=Path, help="of `photonrelax tradeoff`")
    parser.add_argument("--write", action="store_true", help="replace the presets of the package")


def run(options: argparse.Namespace) -> None:
    """Print the presets as JSON, or write them into the package."""
    text = json.dumps(presets(options.folders), indent=1) + "\n"
    if options.write:
        Path(str(files("photonrelax.rendering").joinpath("presets.json"))).write_text(text)
    else:
        print(text)


def presets(folders: Iterable[Path]) -> dict[str, Any]:
    """The file of presets, from folders of sweeps."""
    sweeps = dict(map(_sweep, folders))
    by_class: dict[str, list[str]] = {name: [] for name in SCENE_CLASSES}
    for scene in sweeps:
        by_class[scene_class(gallery.scene(scene))].append(scene)
    found, envelopes = {}, {}
    for name, scenes in by_class.items():
        # One scene is no class: classes of fewer than two have the presets of all scenes.
        measured = len(scenes) >= _LEAST_SCENES
        mine = scenes if measured else sweeps
        found[name] = _of_class([sweeps[each] for each in mine], measured)
        envelopes[name] = _of_envelopes([sweeps[each] for each in scenes or sweeps])
    return {
        "version": __version__,
        "date": date.today().isoformat(),
        "measured_on": by_class,
        "envelopes": envelopes,
        "presets": found,
    }


def _sweep(folder: Path) -> tuple[str, list[Point]]:
    data = json.loads((folder / STATE).read_text())
    return data["about"]["scene"], [Point.from_dict(each) for each in data["points"]]


def _of_envelopes(sweeps: list[list[Point]]) -> float | None:
    """Geometric mean of the seconds of the quickest envelopes; None if no scene has any."""
    found = [
        min(point.cpu_seconds for point in points if point.choice.method == "envelope")
        for points in sweeps
        if any(point.choice.method == "envelope" for point in points)
    ]
    return round(float(np.exp(np.log(found).mean())), 3) if found else None


def _of_class(sweeps: list[list[Point]], measured: bool) -> dict[str, Any]:
    """Rows of each preset by method, the best first; `measured` if on scenes of the class."""
    rows = [row | {"measured": measured} for row in _common(sweeps)]
    found: dict[str, Any] = {name: _preset(rows, error) for name, error in ERRORS.items()}
    # Errors that are asked for of harder scenes are those of more photons than a draft's.
    first = next(iter(found["final"]))
    found = {name: {first: each[first], **each} for name, each in found.items()}
    paper = {"n_emitted": _PHOTONS, "supersampling": 2, "stages": {}, "measured": False}
    return found | {PRESETS[-1]: dict.fromkeys(PAPER, paper)}


def _common(sweeps: list[list[Point]]) -> list[dict[str, Any]]:
    """Choices of settings measured on all scenes, with the mean of their errors and times."""
    rows = []
    by_scene = [_by_settings(points) for points in sweeps]
    for name in sorted(set.intersection(*map(set, by_scene))):
        curves = [scene[name] for scene in by_scene]
        choice = curves[0][0].choice
        # Whether envelopes suit a scene takes a pilot to tell.
        if not METHODS[choice.method].needs_photons or min(map(len, curves)) < _FITTED:
            continue
        most = _FARTHEST * min(curve[-1].choice.n_emitted for curve in curves)
        for n in (n for n in _NUMBERS if n <= most):
            rows.append(_row(replace(choice, n_emitted=n), [_at(n, each) for each in curves]))
    return rows


def _by_settings(points: list[Point]) -> dict[str, list[Point]]:
    """Points of the same settings, few photons to many."""
    found: dict[str, list[Point]] = {}
    for point in sorted(points, key=lambda each: each.choice.n_emitted):
        found.setdefault(point.choice.name, []).append(point)
    return found


def _of(point: Point) -> tuple[float, float]:
    return point.error, point.cpu_seconds


def _at(n: int, curve: list[Point]) -> tuple[float, float]:
    """Error and time of n photons, by the power laws of the points next to them."""
    last = bisect([point.choice.n_emitted for point in curve], n, 1, len(curve) - 1)
    near = curve[last - 1 : last + 1]
    numbers = np.log([point.choice.n_emitted for point in near])
    values = np.log([_of(point) for point in near])
    error, seconds = np.exp(np.polyval(np.polyfit(numbers, values, 1), np.log(n)[np.newaxis]))
    return float(error), float(seconds)


def _row(choice: Choice, measured: list[tuple[float, float]]) -> dict[str, Any]:
    """A choice with the geometric means of error and time over all scenes."""
    error, seconds = np.exp(np.log(measured).mean(axis=0))
    return {**choice.to_dict(), "error": round(error, 4), "seconds": round(seconds, 3)}


def _preset(rows: list[dict[str, Any]], error: float) -> dict[str, Any]:
    """The best row of each method, the best of all first."""
    best = []
    for method in dict.fromkeys(row["method"] for row in rows):
        mine = [row for row in rows if row["method"] == method]
        reach = [row for row in mine if row["error"] <= error]
        # What none reaches, the most exact come nearest to.
        least = min(row["error"] for row in mine)
        near = [row for row in mine if row["error"] <= _AS_GOOD * least]
        best.append(min(reach or near, key=lambda row: row["seconds"]))
    best.sort(key=lambda row: (max(row["error"] / error, 1.0), row["seconds"]))
    return {row["method"]: {k: v for k, v in row.items() if k != "method"} for row in best}
