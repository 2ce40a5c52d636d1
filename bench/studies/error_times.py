"""Errors of irradiance maps over the time they take, at points and over footprints."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

from numpy.typing import NDArray

import photonrelax as pr
from bench.arguments import numbers
from bench.markdown import markdown_table
from bench.studies.pixel_means import Errors, FloorMap, Study, reference, texel_means
from photonrelax import gallery
from photonrelax.transport.raycast import RayCaster

WAYS: dict[str, Callable[[FloorMap, pr.Field], NDArray]] = {
    "2 x 2 points": FloorMap.points,
    "footprints": FloorMap.means,
}


class Result(NamedTuple):
    """Errors of a map in one of the ways, and the seconds that it took with its photons."""

    scene: str
    way: str
    photons: int
    seconds: float
    errors: Errors


@dataclass(frozen=True)
class Request:
    """Scenes, numbers of photons emitted, and passes of references."""

    scenes: tuple[str, ...] = ("ring", "sphere", "ripples")
    photons: tuple[int, ...] = (100_000, 300_000, 1_000_000, 3_000_000)
    reference_passes: int = 20


def results(request: Request) -> list[Result]:
    """All results."""
    study = Study(reference_passes=request.reference_passes)
    found = []
    for name in request.scenes:
        scene = gallery.scene(name)
        caster = RayCaster(scene.objects)
        floor = FloorMap.of(pr.trace_photons(scene, 100_000, caster=caster), study.texels)
        exact = texel_means(reference(study, scene, caster, floor).mean(axis=0))
        for n in request.photons:
            field, prepared = timed(_field, scene, n, caster)
            for way, evaluate in WAYS.items():
                image, seconds = timed(evaluate, floor, field)
                errors = Errors.of(image, exact)
                found.append(Result(name, way, n, prepared + seconds, errors))
    return found


def timed(make: Callable[..., Any], *arguments: object) -> tuple[Any, float]:
    """Result of a call, and the seconds that it took."""
    started = perf_counter()
    made = make(*arguments)
    return made, perf_counter() - started


def _field(scene: pr.Scene, n: int, caster: RayCaster) -> pr.Field:
    photons = pr.trace_photons(scene, n, caster=caster)
    return pr.irradiance_field(photons, method="parameterised", scene=scene)


def save_plot(found: list[Result], path: Path) -> None:
    """Plot both errors over seconds, a panel for each scene."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import FormatStrFormatter, NullFormatter

    scenes = list(dict.fromkeys(result.scene for result in found))
    figure = Figure(figsize=(4.2 * len(scenes), 3.8), layout="constrained")
    for axes, scene in zip(figure.subplots(1, len(scenes), squeeze=False)[0], scenes, strict=True):
        for way, colour in zip(WAYS, ("tab:orange", "tab:blue"), strict=True):
            line = [r for r in found if (r.scene, r.way) == (scene, way)]
            seconds = [r.seconds for r in line]
            axes.plot(seconds, [r.errors.rms for r in line], "o-", c=colour, label=f"rms, {way}")
            axes.plot(seconds, [r.errors.l1 for r in line], "s--", c=colour, label=f"L1, {way}")
        axes.set(xscale="log", yscale="log", xlabel="s", ylabel="relative error", title=scene)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(FormatStrFormatter("%g"))
            axis.set_minor_formatter(NullFormatter())
        axes.grid(which="both", alpha=0.3)
        axes.legend(fontsize="small")
    figure.savefig(path, dpi=90)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the scenes, the numbers of photons, the size of references, and a file for a plot."""
    default = Request()
    parser.add_argument("--scenes", default=",".join(default.scenes))
    parser.add_argument("--photons", type=numbers, default=list(default.photons))
    parser.add_argument("--reference-passes", type=int, default=default.reference_passes)
    parser.add_argument("--plot", type=Path, help="an image of the errors over time")


def run(options: argparse.Namespace) -> None:
    """Print the table, and write the plot if it is asked for."""
    request = Request(
        tuple(options.scenes.split(",")), tuple(options.photons), options.reference_passes
    )
    found = results(request)
    print(markdown(found))
    if options.plot is not None:
        save_plot(found, options.plot)


def markdown(found: list[Result]) -> str:
    """Table of results."""
    titles = ["scene", "emitted", "map", "seconds", "rms", "L1"]
    rows = (
        [r.scene, f"{r.photons:,}", r.way, f"{r.seconds:.2f}", f"{e.rms:.3f}", f"{e.l1:.3f}"]
        for r in found
        for e in [r.errors]
    )
    return f"{markdown_table(titles, rows)}\n"
