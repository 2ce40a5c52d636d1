"""Errors and times that renders promise, beside true ones."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

import photonrelax as pr
from bench.arguments import numbers
from bench.markdown import markdown_table
from photonrelax import gallery
from photonrelax.imaging.metrics import relative_l1
from photonrelax.rendering.view import resized

# A true error is to be at most, and at least, so many times the estimate.
_MOST, _LEAST = 1.25, 0.5
_COUNTS = 4


@dataclass(frozen=True)
class Study:
    """Scenes, methods, errors asked for, times asked for, s, and seeds.

    Attributes
    ----------
    counted : tuple of str
        Scenes whose envelopes take too long: photons are counted.
    reference_error : float
        Misplaced light of envelopes that are references.
    reference_photons : int
        Photons counted, four times.
    """

    scenes: tuple[str, ...] = ("ring", "sphere", "ripples", "prism", "pool")
    methods: tuple[str, ...] = ("",)
    errors: tuple[float, ...] = (0.1, 0.03)
    seconds: tuple[float, ...] = ()
    seeds: int = 20
    pixels: int = 200
    counted: tuple[str, ...] = ("prism",)
    reference_error: float = 0.004
    reference_photons: int = 2_000_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    default = Study()
    parser.add_argument("--scenes", default=",".join(default.scenes))
    parser.add_argument("--methods", default="", help="with commas; none: chosen")
    parser.add_argument("--errors", default="0.1,0.03")
    parser.add_argument("--seconds", type=numbers, default=[])
    parser.add_argument("--seeds", type=int, default=default.seeds)


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    study = Study(
        scenes=tuple(options.scenes.split(",")),
        methods=tuple(options.methods.split(",")),
        errors=tuple(float(text) for text in options.errors.split(",") if text),
        seconds=tuple(options.seconds),
        seeds=options.seeds,
    )
    print(markdown(study))


def markdown(study: Study) -> str:
    """Table of the study, a row each scene, method and goal."""
    titles = ["scene", "method", "asked", "runs", "estimate", "true / estimate, median, 5…95 %"]
    titles += [f"≤ {_MOST:g}", f"≥ {_LEAST:g}", "met", "seconds, median, worst"]
    return (
        f"{markdown_table(titles, rows(study))}\n\nRelative L1 of radiance over {study.pixels} x "
        f"{study.pixels} pixels, without indirect light.\n"
    )


def rows(study: Study) -> Iterator[list[str]]:
    """Yield the rows of the table."""
    goals = [{"error": error} for error in study.errors]
    goals += [{"seconds": float(seconds)} for seconds in study.seconds]
    for name in study.scenes:
        scene = resized(gallery.scene(name), study.pixels, None)
        expected = reference(scene, study)
        for method in study.methods:
            for goal in goals:
                cells = _row(scene, expected, method, goal, study)
                yield [name, method or "chosen", _text(goal), *cells]


def reference(scene: pr.Scene, study: Study) -> NDArray:
    """Radiance of an envelope, or of photons that are counted."""
    light = ("emission", "direct", "caustic")
    if scene.name not in study.counted:
        settings = pr.EnvelopeSettings(error=study.reference_error)
        image = pr.render(scene, method="envelope", envelope=settings, components=light)
        return np.asarray(image.layers["radiance"])
    images = [
        pr.render(
            scene,
            method="standard",
            n_emitted=study.reference_photons,
            seed=1000 + seed,
            gather=pr.GatherSettings(k=4),
            components=light,
        )
        for seed in range(_COUNTS)
    ]
    return np.mean([image.layers["radiance"] for image in images], axis=0)


def _row(
    scene: pr.Scene, expected: NDArray, method: str, goal: dict[str, float], study: Study
) -> list[str]:
    """Cells of the runs of all seeds."""
    runs = [_run(scene, expected, method, goal, seed) for seed in range(study.seeds)]
    estimate, true, met, seconds = np.array(runs).T
    ratio = true / estimate
    low, middle, high = np.percentile(ratio, [5, 50, 95])
    return [
        f"{len(runs)}",
        f"{np.median(estimate):.4f}",
        f"{middle:.2f}, {low:.2f}…{high:.2f}",
        f"{(ratio <= _MOST).mean():.0%}",
        f"{(ratio >= _LEAST).mean():.0%}",
        f"{met.mean():.0%}",
        f"{np.median(seconds):.1f}, {seconds.max():.1f}",
    ]


def _run(
    scene: pr.Scene, expected: NDArray, method: str, goal: dict[str, float], seed: int
) -> tuple[float, float, bool, float]:
    """Estimate, true error, whether the goal was met, and seconds."""
    started = perf_counter()
    image = pr.render(
        scene,
        method=method or None,
        seed=seed,
        components=("emission", "direct", "caustic"),
        **goal,
    )
    seconds = perf_counter() - started
    told = image.stats["error"]
    true = relative_l1(image.layers["radiance"], expected)
    return told["estimate"], true, told["is_met"], seconds


def _text(goal: dict[str, float]) -> str:
    return f"{goal['error']:g}" if "error" in goal else f"{goal['seconds']:g} s"
