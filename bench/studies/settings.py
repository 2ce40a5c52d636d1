"""Errors over pixels by iterations, k and step of relaxation, for both samplers."""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np
from numpy.typing import NDArray

import photonrelax as pr
from bench.arguments import numbers
from bench.markdown import markdown_table
from bench.studies import fronts
from photonrelax import gallery
from photonrelax._util.files import write_json
from photonrelax.estimation.methods import MethodInput, prepare
from photonrelax.evaluation.reference import uncertainty_of
from photonrelax.imaging.image import Image
from photonrelax.imaging.metrics import relative_l1
from photonrelax.rendering.presets import Choice
from photonrelax.rendering.view import StoredView, View, resized
from photonrelax.transport.emission import SAMPLERS

# The paper's settings; others are told as ratios of error and time to them.
PAPER = {"parameterised": ((7, 7), 15, 1.0), "mapped": ((14, 14), 15, 1.0)}
_ITERATIONS = {
    "parameterised": ((2, 2), (3, 3), (3, 7), (7, 7)),
    "mapped": ((2, 2), (3, 3), (5, 5), (14, 14)),
}
_KS, _LARGE_STEP = (8, 15), ((4, 3), 8, 2.0)
_STATE = "settings.json"

Relaxing = tuple[tuple[int, int], int, float]
"""Iterations, k and step."""


@dataclass(frozen=True)
class Study:
    """Scenes, photons and seeds.

    Attributes
    ----------
    reference : fronts.Study
        With the folder and the scenes.
    numbers : tuple of int
        Photons emitted.
    seeds : int
        Errors are means over so many.
    """

    reference: fronts.Study
    numbers: tuple[int, ...] = (30_000, 100_000, 300_000)
    samplers: tuple[str, ...] = SAMPLERS
    seeds: int = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    default = fronts.Study(Path())
    parser.add_argument("folder", type=Path, help="of `python -m bench fronts`, or a new one")
    parser.add_argument("--scenes", default=",".join(default.scenes))
    parser.add_argument("--photons", type=numbers, default=[30_000, 100_000, 300_000])
    parser.add_argument("--pixels", type=int, default=default.pixels)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--reference-error", type=float, default=default.reference_error)


def run(options: argparse.Namespace) -> None:
    """Print the tables."""
    reference = fronts.Study(
        options.folder,
        tuple(options.scenes.split(",")),
        pixels=options.pixels,
        reference_error=options.reference_error,
    )
    print(markdown(Study(reference, tuple(options.photons), seeds=options.seeds)))


def choices(method: str) -> list[Relaxing]:
    """Iterations, k and step of a method, the paper's first."""
    found = [(n, k, 1.0) for n in _ITERATIONS[method] for k in _KS]
    found.append(_LARGE_STEP)
    paper = PAPER[method]
    return [paper, *(each for each in found if each != paper)]


def markdown(study: Study) -> str:
    """Means over scenes, and a table each method: errors and times over those of the paper's."""
    measured = [(name, Measured(name, study)) for name in study.reference.scenes]
    tables = (_table(method, measured, study) for method in PAPER)
    return "\n\n".join([_means([found for _, found in measured], study), *tables])


def _means(measured: list[Measured], study: Study) -> str:
    """Table of geometric means over scenes and photons, a row each method and settings."""
    rows = []
    for method in PAPER:
        paper, *others = choices(method)
        for settings in others:
            errors, seconds = [], []
            for sampler in study.samplers:
                ratios = [
                    np.divide(
                        found.point(method, settings, sampler, n),
                        found.point(method, paper, sampler, n),
                    )
                    for found in measured
                    for n in study.numbers
                ]
                error, time = np.exp(np.log(ratios).mean(axis=0))
                least, most = np.min(ratios, axis=0)[0], np.max(ratios, axis=0)[0]
                errors.append(f"{error:.2f}, {least:.2f}…{most:.2f}")
                seconds.append(time)
            mean = np.exp(np.log(seconds).mean())
            rows.append([method, _text(settings), *errors, f"{mean:.2f}"])
    return markdown_table(["method", "settings", *study.samplers, "seconds"], rows)


def _table(method: str, measured: list[tuple[str, Measured]], study: Study) -> str:
    settings = choices(method)
    titles = ["scene", "sampler", "photons", "error", *(_text(each) for each in settings[1:])]
    rows = [
        [name, sampler, f"{n:,}", *_cells(found, [(method, each, sampler, n) for each in settings])]
        for name, found in measured
        for sampler in study.samplers
        for n in study.numbers
    ]
    doubts = ", ".join(f"{name} {found.doubt:.1%}" for name, found in measured)
    return (
        f"`{method}`, the error with {_text(settings[0])}, and that of others over it and, in "
        f"brackets, their processor seconds:\n\n{markdown_table(titles, rows)}\n\n"
        f"Relative L1 of the caustic over pixels; doubt of references: {doubts}."
    )


def _cells(found: Measured, asked: list[tuple[str, Relaxing, str, int]]) -> list[str]:
    (error, seconds), *others = (found.point(*each) for each in asked)
    return [f"{error:.4f}", *(f"{e / error:.2f} ({s / seconds:.2f})" for e, s in others)]


def _text(settings: Relaxing) -> str:
    (first, second), k, step = settings
    return f"{first},{second} k={k}" + (f" step={step:g}" if step != 1.0 else "")


class Measured:
    """Errors and times of a scene, which are kept in its folder."""

    def __init__(self, name: str, study: Study) -> None:
        self._scene = resized(gallery.scene(name), study.reference.pixels, None)
        self._reference: Image = fronts.kept_reference(self._scene, study.reference)
        self._path = study.reference.folder / name / _STATE
        self._found: dict[str, list[float]] = {}
        if self._path.exists():
            self._found = json.loads(self._path.read_text())
        self._view = View(self._scene)
        self._stored: StoredView | None = None
        for sampler in study.samplers:
            for n in study.numbers:
                self._measure(sampler, n, study.seeds)

    @property
    def doubt(self) -> float:
        """Relative L1 of the reference's noise and bias."""
        found = uncertainty_of(self._reference)
        return float("nan") if found is None else float(np.hypot(found.noise_l1, found.bias_l1))

    def point(self, method: str, settings: Relaxing, sampler: str, n: int) -> list[float]:
        """Error and processor seconds."""
        return self._found[_key(method, settings, sampler, n)]

    def _measure(self, sampler: str, n: int, seeds: int) -> None:
        """Measure all settings on the same photons, unless they are there."""
        wanted = [(method, each) for method in PAPER for each in choices(method)]
        if all(_key(*each, sampler, n) in self._found for each in wanted):
            return
        runs = []
        for seed in range(seeds):
            photons = pr.trace_photons(self._scene, n, seed=seed, sampler=sampler, sensors=False)
            runs.append([self._run(photons, *each) for each in wanted])
        for each, point in zip(wanted, np.mean(runs, axis=0).tolist(), strict=True):
            self._found[_key(*each, sampler, n)] = point
        write_json(self._path, self._found)

    def _run(self, photons: pr.PhotonMap, method: str, settings: Relaxing) -> list[float]:
        iterations, k, step = settings
        relax = {"n_iterations": iterations, "step": step}
        choice = Choice(method, 0, stages={"relax": relax, "gather": {"k": k}})
        if self._stored is None:
            self._stored = self._view.stored(None)
        started = process_time()
        inputs = photons, choice.settings, self._scene, None, None
        field = prepare(method, MethodInput(*inputs, caster=self._view.caster))
        caustic: NDArray = self._stored.caustic(field, None)
        return [relative_l1(caustic, self._reference.layers["caustic"]), process_time() - started]


def _key(method: str, settings: Relaxing, sampler: str, n: int) -> str:
    return f"{method} {_text(settings)}, {sampler}, {n}"
