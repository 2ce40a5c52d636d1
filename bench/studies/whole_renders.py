"""Times and errors of whole renders by single choices of settings: what a goal is chosen from."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time
from typing import Any, NamedTuple

from numpy.typing import NDArray

import photonrelax as pr
from photonrelax._util.files import write_json
from photonrelax.estimation.methods import METHODS
from photonrelax.evaluation.tradeoff import seconds_for
from photonrelax.imaging.metrics import relative_l1
from photonrelax.rendering.error_target import photons_of_whole
from photonrelax.rendering.presets import Choice

_K8 = {"gather": {"k": 8}}
OF_PHOTONS = (
    Choice("standard", 0, stages={"gather": {"k": 15}}),
    Choice("parameterised", 0, stages={"relax": {"n_iterations": [2, 2]}, **_K8}),
    Choice("mapped", 0, stages={"relax": {"n_iterations": [3, 3]}, **_K8}),
)
"""Choices that are the best of those with photons on some scene."""
MISPLACED = (0.4, 0.2, 0.1, 0.05, 0.02, 0.01)
"""Misplaced light of envelopes."""
# Processor seconds up to which a render is timed twice.
_QUICK = 1.0


class Whole(NamedTuple):
    """A choice, the processor seconds of its render, and relative L1 of radiance.

    It has what is read of points of sweeps.
    """

    choice: Choice
    total: float
    error: float


@dataclass(frozen=True)
class WholeRenders:
    """Renders of a scene by single choices.

    Attributes
    ----------
    scene : Scene
    light : tuple of str
        Components that are rendered.
    path : Path, optional
        File that what is measured is kept in, and read from.
    """

    scene: pr.Scene
    light: tuple[str, ...]
    path: Path | None = None

    def seconds(self, choice: Choice) -> tuple[float, NDArray]:
        """Processor seconds of a render, the less of two if it is quick, and its radiance."""
        times: list[float] = []
        while not times or (len(times) < 2 and times[0] < _QUICK):
            started = process_time()
            image = pr.render(
                self.scene,
                method=choice.method,
                n_emitted=choice.n_emitted or None,
                supersampling=choice.supersampling,
                components=self.light,
                **choice.settings.given,
            )
            times.append(process_time() - started)
        return min(times), image.layers["radiance"]

    def measured(self, choices: Iterable[Choice], reference: NDArray) -> list[Whole]:
        """Renders by choices; what is in the file is not measured again."""
        found, points = self._read(), []
        for choice in choices:
            key = f"{choice.name}, {choice.n_emitted}"
            if key not in found:
                seconds, radiance = self.seconds(choice)
                found[key] = [seconds, relative_l1(radiance, reference)]
                self._write(found)
            points.append(Whole(choice, *found[key]))
        return points

    def _read(self) -> dict[str, Any]:
        if self.path is None or not self.path.exists():
            return {}
        return dict(json.loads(self.path.read_text()))

    def _write(self, found: dict[str, Any]) -> None:
        if self.path is not None:
            write_json(self.path, found)


def single_choices(numbers: Iterable[int], *, envelopes: bool) -> Iterator[Choice]:
    """Envelopes, if wanted, and choices with numbers of photons."""
    for misplaced in MISPLACED if envelopes else ():
        yield Choice("envelope", 0, stages={"envelope": {"error": misplaced, "seconds": 20.0}})
    for n in numbers:
        for choice in OF_PHOTONS:
            yield replace(choice, n_emitted=n)


def best(points: Iterable[Whole], error: float) -> tuple[str, float]:
    """Method that reaches an error first, and its seconds."""
    points = list(points)
    methods = dict.fromkeys(point.choice.method for point in points)
    seconds: dict[str, float] = {
        method: seconds_for([p for p in points if p.choice.method == method], error)  # type: ignore[misc]
        for method in methods
    }
    method = min(seconds, key=seconds.__getitem__)
    return method, seconds[method]


def chosen(image: pr.Image) -> Choice:
    """The method and settings of an image that was rendered to a goal."""
    settings = json.loads(image.metadata["photonrelax.settings"])
    method = image.metadata["photonrelax.method"]
    stages = {name: settings[name] for name in METHODS[method].stages if name in settings}
    n = photons_of_whole(image.stats["error"]["photons_of_image"])
    n = n if METHODS[method].needs_photons else 0
    return Choice(method, n, settings["supersampling"], stages)
