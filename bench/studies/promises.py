"""Errors and times that renders promise, beside true ones."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

import photonrelax as pr
from bench.arguments import numbers
from bench.markdown import markdown_table
from photonrelax import gallery
from photonrelax.imaging.metrics import relative_l1
from photonrelax.rendering.plan import COMPONENTS
from photonrelax.rendering.view import resized

# A true error is to be at most, and at least, so many times the estimate.
_MOST, _LEAST = 1.25, 0.5
_COUNTS = 4
_DIRECT = ("emission", "direct", "caustic")


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
        Photons counted, four times, and photons of indirect light.
    has_indirect : bool
        Indirect light is not left out.
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
    has_indirect: bool = False

    @property
    def light(self) -> tuple[str, ...]:
        """Components that are rendered."""
        return COMPONENTS if self.has_indirect else _DIRECT


def add_arguments(parser: argparse.ArgumentParser) -> None:
    default = Study()
    parser.add_argument("--scenes", default=",".join(default.scenes))
    parser.add_argument("--methods", default="", help="with commas; none: chosen")
    parser.add_argument("--errors", default="0.1,0.03")
    parser.add_argument("--seconds", type=numbers, default=[])
    parser.add_argument("--seeds", type=int, default=default.seeds)
    parser.add_argument("--indirect", action="store_true", help="with indirect light")
    parser.add_argument("--reference-error", type=float, default=default.reference_error)
    parser.add_argument("--reference-photons", type=numbers, default=[default.reference_photons])


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    study = Study(
        scenes=tuple(options.scenes.split(",")),
        methods=tuple(options.methods.split(",")),
        errors=tuple(float(text) for text in options.errors.split(",") if text),
        seconds=tuple(options.seconds),
        seeds=options.seeds,
        has_indirect=options.indirect,
        reference_error=options.reference_error,
        reference_photons=options.reference_photons[0],
    )
    print(markdown(study))


def markdown(study: Study) -> str:
    """Table of the study, a row each scene, method and goal."""
    titles = ["scene", "method", "asked", "runs", "estimate", "true / estimate, median, 5…95 %"]
    titles += [f"≤ {_MOST:g}", f"≥ {_LEAST:g}", "met", "seconds, median, worst"]
    return (
        f"{markdown_table(titles, rows(study))}\n\nRelative L1 of radiance over {study.pixels} x "
        f"{study.pixels} pixels, {'with' if study.has_indirect else 'without'} indirect light.\n"
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
                asked = goal | {"method": method or None, "components": study.light}
                yield [name, *_row(scene, expected, _text(goal), asked, study.seeds)]


def reference(scene: pr.Scene, study: Study) -> NDArray:
    """Radiance of an envelope, or of photons that are counted, and of other light."""
    others = tuple(name for name in study.light if name != "caustic")
    if scene.name not in study.counted:
        settings = pr.EnvelopeSettings(error=study.reference_error)
        image = pr.render(scene, method="envelope", envelope=settings, components=("caustic",))
        caustic = image.layers["radiance"]
    else:
        caustic = _mean(scene, study, method="standard", gather=pr.GatherSettings(k=4))
    n_global = study.reference_photons if study.has_indirect else 0
    rest = _mean(scene, study, components=others, n_global=n_global)
    return np.asarray(caustic) + rest


def _mean(scene: pr.Scene, study: Study, **settings: Any) -> NDArray:
    """Mean radiance of images of other photons, of caustics unless settings tell others."""
    images = [
        pr.render(
            scene,
            n_emitted=study.reference_photons,
            seed=1000 + seed,
            **({"components": ("caustic",)} | settings),
        )
        for seed in range(_COUNTS)
    ]
    mean: NDArray = np.mean([image.layers["radiance"] for image in images], axis=0)
    return mean


def _row(
    scene: pr.Scene, expected: NDArray, text: str, asked: dict[str, Any], seeds: int
) -> list[str]:
    """Cells of the runs of all seeds."""
    runs = [_run(scene, expected, asked, seed) for seed in range(seeds)]
    methods = dict.fromkeys(method for method, *_ in runs)
    estimate, true, met, seconds = np.array([figures for _, *figures in runs]).T
    ratio = true / estimate
    low, middle, high = np.percentile(ratio, [5, 50, 95])
    return [
        ", ".join(methods) if asked["method"] else f"chosen: {', '.join(methods)}",
        text,
        f"{len(runs)}",
        f"{np.median(estimate):.4f}",
        f"{middle:.2f}, {low:.2f}…{high:.2f}",
        f"{(ratio <= _MOST).mean():.0%}",
        f"{(ratio >= _LEAST).mean():.0%}",
        f"{met.mean():.0%}",
        f"{np.median(seconds):.1f}, {seconds.max():.1f}",
    ]


def _run(
    scene: pr.Scene, expected: NDArray, asked: dict[str, Any], seed: int
) -> tuple[str, float, float, bool, float]:
    """Method, estimate, true error, whether the goal was met, and seconds."""
    started = perf_counter()
    image = pr.render(scene, seed=seed, **asked)
    seconds = perf_counter() - started
    told = image.stats["error"]
    true = relative_l1(image.layers["radiance"], expected)
    method = image.metadata["photonrelax.method"]
    return method, told["estimate"], true, told["is_met"], seconds


def _text(goal: dict[str, float]) -> str:
    return f"{goal['error']:g}" if "error" in goal else f"{goal['seconds']:g} s"
