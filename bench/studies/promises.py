"""Errors and times that renders promise, beside true ones and the best of single choices."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import photonrelax as pr
from bench.arguments import numbers
from bench.markdown import markdown_table
from bench.studies.whole_renders import Whole, WholeRenders, best, chosen, single_choices
from photonrelax import gallery
from photonrelax.imaging.metrics import relative_l1
from photonrelax.rendering.error_target import PhotonTrials
from photonrelax.rendering.plan import COMPONENTS
from photonrelax.rendering.view import resized

# A true error is to be at most, and at least, so many times the estimate.
_MOST, _LEAST = 1.25, 0.5
# Photons of envelopes for light without images; misplaced light over that of the last row, at most.
_PHOTONS_OF_ENVELOPE, _FINER = 100_000, 0.9
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
    reference_photons, counts : int
        Photons counted and photons of indirect light, of each of so many images.
    has_indirect : bool
        Indirect light is not left out.
    numbers : tuple of int
        Photons of the single choices that chosen ones are compared with; none are without.
    folder : path, optional
        What references and single choices are kept in.
    trials : tuple of int
        Photons of trials, few to many.
    misplaced : tuple of float
        Light that envelopes may misplace.
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
    counts: int = 4
    has_indirect: bool = False
    numbers: tuple[int, ...] = (3000, 10_000, 30_000, 100_000, 300_000)
    folder: Path | None = None
    trials: tuple[int, ...] = ()
    misplaced: tuple[float, ...] = ()

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
    parser.add_argument(
        "--numbers", type=numbers, default=list(default.numbers), help="photons of single choices"
    )
    parser.add_argument(
        "--trials", type=numbers, default=[], help="photons of trials to tell, in place of goals"
    )
    parser.add_argument(
        "--misplaced", default="", help="light that envelopes may misplace, to tell their errors"
    )
    parser.add_argument("--folder", type=Path, help="references and single choices are kept in it")
    parser.add_argument("--reference-error", type=float, default=default.reference_error)
    parser.add_argument("--counts", type=int, default=default.counts)
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
        numbers=tuple(options.numbers),
        counts=options.counts,
        folder=options.folder,
        trials=tuple(options.trials),
        misplaced=tuple(float(text) for text in options.misplaced.split(",") if text),
    )
    if study.misplaced:
        print(envelopes_markdown(study))
    else:
        print(trials_markdown(study) if study.trials else markdown(study))


def markdown(study: Study) -> str:
    """Table of the study, a row each scene, method and goal."""
    titles = ["scene", "method", "asked", "runs", "estimate", "true / estimate, median, 5…95 %"]
    titles += [f"≤ {_MOST:g}", f"≥ {_LEAST:g}", "met", "seconds, median, worst"]
    titles += ["CPU, all", "CPU, chosen", "CPU, best", "chosen / best"]
    return (
        f"{markdown_table(titles, rows(study))}\n\nRelative L1 of radiance over {study.pixels} x "
        f"{study.pixels} pixels, {'with' if study.has_indirect else 'without'} indirect light. "
        "Processor seconds of all that was rendered, of the chosen settings alone, and of the best "
        "single render of that error, camera rays included.\n"
    )


def rows(study: Study) -> Iterator[list[str]]:
    """Yield the rows of the table."""
    goals = [{"error": error} for error in study.errors]
    goals += [{"seconds": float(seconds)} for seconds in study.seconds]
    for name in study.scenes:
        scene = resized(gallery.scene(name), study.pixels, None)
        expected = _kept_reference(scene, study)
        path = None if study.folder is None else study.folder / f"{name}.json"
        renders = WholeRenders(scene, study.light, path)
        choices = single_choices(study.numbers, envelopes=name not in study.counted)
        singles = renders.measured(choices, expected) if study.numbers else []
        for method in study.methods:
            for goal in goals:
                asked = goal | {"method": method or None, "components": study.light}
                runs = [_run(scene, expected, asked, seed) for seed in range(study.seeds)]
                cells = [_method(runs, method), _text(goal), *_cells(runs)]
                yield [name, *cells, *_compared(runs, renders, singles, goal)]


def trials_markdown(study: Study) -> str:
    """Table of estimates of trials of photons beside true errors, a row each scene and number."""
    titles = ["scene", "photons", "estimate", "noise", "true", "true / estimate, least…most"]
    rows = [row for name in study.scenes for row in _trial_rows(name, study)]
    return f"{markdown_table(titles, rows)}\n\nMedians of {study.seeds} seeds; `mapped`, k = 8."


def _trial_rows(name: str, study: Study) -> Iterator[list[str]]:
    scene = resized(gallery.scene(name), study.pixels, None)
    expected = _kept_reference(scene, study)
    found = np.array([_trials(scene, expected, study, seed) for seed in range(study.seeds)])
    for n, of_number in zip(study.trials, found.swapaxes(0, 1), strict=True):
        estimate, noise, true = np.median(of_number, axis=0)
        ratio = of_number[:, 2] / of_number[:, 0]
        yield [
            *(name, f"{n:,}", f"{estimate:.4f}", f"{noise:.4f}", f"{true:.4f}"),
            f"{ratio.min():.2f}…{ratio.max():.2f}",
        ]


def _trials(scene: pr.Scene, expected: NDArray, study: Study, seed: int) -> list[list[float]]:
    """Estimate, its noise and the true error of one trial after the other."""

    def render(n: int, of_image: int) -> pr.Image:
        return pr.render(scene, preset="draft", n_emitted=n, seed=of_image, components=study.light)

    trials, found = PhotonTrials(render, seed, "radiance"), []
    for n in study.trials:
        trials.add(n)
        true = relative_l1(trials.image.layers["radiance"], expected)
        found.append([trials.estimate.total, trials.estimate.noise, true])
    return found


def envelopes_markdown(study: Study) -> str:
    """Table of true errors of envelopes by what they misplace, a row each scene and envelope."""
    titles = ["scene", "misplaced", "error", "error / misplaced", "of photons", "their noise"]
    rows = [row for name in study.scenes for row in _envelope_rows(name, study)]
    return f"{markdown_table(titles, rows)}\n\nRelative L1 of the caustic over pixels."


def _envelope_rows(name: str, study: Study) -> Iterator[list[str]]:
    scene = resized(gallery.scene(name), study.pixels, None)
    expected, last = _kept_reference(scene, study), np.inf
    for misplaced in study.misplaced:
        settings = pr.EnvelopeSettings(error=misplaced, n_photons=_PHOTONS_OF_ENVELOPE)
        image = pr.render(scene, method="envelope", envelope=settings, components=study.light)
        found = image.stats["envelope"]
        # The first division may be finer than it needs to be.
        if found["error"] < _FINER * last:
            light = np.abs(image.layers["caustic"]).sum()
            error = np.abs(image.layers["radiance"] - expected).sum() / light
            numbers = (error, found["of_photons"], found["noise"])
            error_text, share, noise = (f"{each:.4f}" for each in numbers)
            last = found["error"]
            yield [name, f"{last:.4f}", error_text, f"{error / last:.2f}", share, noise]


def _kept_reference(scene: pr.Scene, study: Study) -> NDArray:
    """The reference, read if it is in the folder."""
    if study.folder is None:
        return reference(scene, study)
    study.folder.mkdir(parents=True, exist_ok=True)
    path = study.folder / f"{scene.name}.npy"
    if not path.exists():
        np.save(path, reference(scene, study))
    found: NDArray = np.load(path)
    return found


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
        for seed in range(study.counts)
    ]
    mean: NDArray = np.mean([image.layers["radiance"] for image in images], axis=0)
    return mean


class _Run(NamedTuple):
    """An image to a goal, its true error, seconds and processor seconds."""

    image: pr.Image
    true: float
    seconds: float
    cpu_seconds: float


def _run(scene: pr.Scene, expected: NDArray, asked: dict[str, Any], seed: int) -> _Run:
    started, used = perf_counter(), process_time()
    image = pr.render(scene, seed=seed, **asked)
    seconds, cpu_seconds = perf_counter() - started, process_time() - used
    return _Run(image, relative_l1(image.layers["radiance"], expected), seconds, cpu_seconds)


def _method(runs: list[_Run], method: str) -> str:
    methods = ", ".join(dict.fromkeys(run.image.metadata["photonrelax.method"] for run in runs))
    return methods if method else f"chosen: {methods}"


def _cells(runs: list[_Run]) -> list[str]:
    """Cells of errors and times."""
    told = [run.image.stats["error"] for run in runs]
    estimate = np.array([each["estimate"] for each in told])
    ratio = np.array([run.true for run in runs]) / estimate
    low, middle, high = np.percentile(ratio, [5, 50, 95])
    seconds = np.array([run.seconds for run in runs])
    return [
        f"{len(runs)}",
        f"{np.median(estimate):.4f}",
        f"{middle:.2f}, {low:.2f}…{high:.2f}",
        f"{(ratio <= _MOST).mean():.0%}",
        f"{(ratio >= _LEAST).mean():.0%}",
        f"{np.mean([each['is_met'] for each in told]):.0%}",
        f"{np.median(seconds):.1f}, {seconds.max():.1f}",
    ]


def _compared(
    runs: list[_Run], renders: WholeRenders, singles: list[Whole], goal: dict[str, float]
) -> list[str]:
    """Processor seconds of all, of the first run's choice alone, and of the best single render."""
    used = f"{np.median([run.cpu_seconds for run in runs]):.2f}"
    alone, _ = renders.seconds(chosen(runs[0].image))
    if "error" not in goal or not singles:
        return [used, f"{alone:.2f}", "–", "–"]
    method, seconds = best(singles, goal["error"])
    if not np.isfinite(seconds):
        return [used, f"{alone:.2f}", "not reached", "–"]
    return [used, f"{alone:.2f}", f"{method} {seconds:.2f}", f"{alone / seconds:.2f}"]


def _text(goal: dict[str, float]) -> str:
    return f"{goal['error']:g}" if "error" in goal else f"{goal['seconds']:g} s"
