"""Images rendered until their estimated error is what is asked for, or the time is up.

Photons are added, a trial of three images each time: see `photonrelax.rendering.error_estimate`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from time import perf_counter
from typing import NamedTuple, Protocol

import numpy as np

from .._util import validation
from .._util.frozen import set_field
from ..imaging.image import Image
from .error_estimate import QUARTER, Earlier, ErrorEstimate, estimated
from .passes import pass_seed

# Photons of the first pilot, and the share of those expected to suffice; factors from one number to
# the next.
_PILOT, _PILOT_SHARE, _LEAST_FACTOR, _LARGEST_FACTOR = 4000, 1 / 64, 1.6, 10.0
# Photons of a trial over those of an earlier one that it is compared with, if there is such a one.
_APART = 3.0
# Photons of all three images of a trial over those of the whole.
_IN_ALL = 1.0 + 2.0 / QUARTER
# Exponents of the error over photons: expected, and believed when measured.
_EXPONENT, _EXPONENTS = 0.45, (0.45, 0.65)
# Photons are chosen for an error that is less than asked, as estimates have noise too, and for a
# time that is less; all that fit into it are taken at once if they are fewer than so many steps.
_ERROR_SHARE, _TIME_SHARE, _LAST_FACTOR = 0.93, 0.9, 2.0

Render = Callable[[int, int], Image]
"""Maps a number of photons and a seed to an image."""


@dataclass(frozen=True)
class Goal:
    """Error that a render is to reach, or time that it may take.

    Attributes
    ----------
    error : float, optional
        Relative L1 of radiance over pixels.
    seconds : float, optional
        Time.
    """

    error: float | None = None
    seconds: float | None = None

    def __post_init__(self) -> None:
        for name in ("error", "seconds"):
            if getattr(self, name) is not None:
                set_field(self, name, validation.positive(getattr(self, name), name))

    @property
    def is_given(self) -> bool:
        """True if there is anything to reach."""
        return (self.error, self.seconds) != (None, None)

    @property
    def preset_error(self) -> float | None:
        """Error that a preset is chosen by: the least where a time alone is given."""
        return 0.0 if self.error is None and self.is_given else self.error

    def is_met(self, error: float) -> bool:
        """True if an error is not more than asked."""
        return self.error is not None and error <= self.error

    def left(self, started: float) -> float:
        """Seconds that are left, infinite without a time."""
        return np.inf if self.seconds is None else self.seconds - (perf_counter() - started)


class _Trial(NamedTuple):
    """Images of some photons, their estimated error, and what the whole and a quarter took."""

    n: int
    image: Image
    seconds: float
    quarter_seconds: float
    estimate: ErrorEstimate
    parts: dict[str, ErrorEstimate]

    def seconds_of(self, n: int) -> float:
        """Seconds of a trial of n photons."""
        more = max(self.seconds - self.quarter_seconds, 0.1 * self.seconds)
        each = more / ((1.0 - 1.0 / QUARTER) * self.n)
        return self.seconds + 2.0 * self.quarter_seconds + _IN_ALL * each * (n - self.n)


class PhotonTrials:
    """Images of ever more photons, with their estimated errors, three a trial.

    Parameters
    ----------
    render : callable
        ``render(n, seed)``.
    seed : int
        Seeds of the images follow from it.
    layer : str
        Of which the error is.
    """

    def __init__(self, render: Render, seed: int, layer: str) -> None:
        self._render, self._seed, self.layer = render, seed, layer
        self._trials: list[_Trial] = []

    def add(self, n: int) -> None:
        """Render two images of n/4 photons, and one of n."""
        number, quarter = len(self._trials), -(-n // QUARTER)
        n = QUARTER * quarter
        times, images = [perf_counter()], []
        for i, photons in enumerate((quarter, quarter, n)):
            images.append(self._render(photons, pass_seed(self._seed, 3 * number + i)))
            times.append(perf_counter())
        first, second, whole = images
        found = estimated(first, second, whole, self.layer, self._earlier(n))
        estimate, parts, image = found
        # The first image of all has to trace the camera's rays too.
        _, of_quarter, of_whole = np.diff(times).tolist()
        self._trials.append(_Trial(n, image, of_whole, of_quarter, estimate, parts))

    def _earlier(self, n: int) -> Earlier | None:
        if not self._trials:
            return None
        enough = [trial for trial in self._trials if _APART * trial.n <= n]
        before = enough[-1] if enough else self._trials[0]
        differences = {name: found.difference for name, found in before.parts.items()}
        return Earlier(n / before.n, differences)

    @property
    def image(self) -> Image:
        """The best mean of the last three images."""
        return self._trials[-1].image

    @property
    def estimate(self) -> ErrorEstimate:
        """Its error."""
        return self._trials[-1].estimate

    def error_of(self, components: Iterable[str]) -> float:
        """Its error in some components of the light, over all of it."""
        parts = self._trials[-1].parts
        return float(np.linalg.norm([parts[each].total for each in components if each in parts]))

    @property
    def counts(self) -> dict[str, int]:
        """Photons emitted for all images, and for the last three."""
        return {
            "photons": sum(_in_all(trial.n) for trial in self._trials),
            "photons_of_image": _in_all(self._trials[-1].n),
        }

    def next_number(self, error: float | None, left: float) -> int | None:
        """Photons of the next trial, for an error and within a time, s; None for no more."""
        last = self._trials[-1]
        n = int(_LARGEST_FACTOR * last.n)
        if error is not None:
            ratio = last.estimate.total / (_ERROR_SHARE * error)
            n = min(n, int(last.n * max(ratio ** (1.0 / self._exponent), _LEAST_FACTOR)))
        if not np.isfinite(left):
            return n
        most = _within(last, _TIME_SHARE * left)
        if error is None and most < _LAST_FACTOR * n:
            # A step that leaves too little for another is the last one.
            n = most
        n = min(n, most)
        return n if n > last.n else None

    def photons_for(self, error: float, component: str) -> float:
        """Photons of a trial in which a component of the light has an error; 0 without it."""
        last = self._trials[-1]
        found = last.parts.get(component)
        if found is None:
            return 0.0
        return float(last.n * (found.total / error) ** (1.0 / self._exponent))

    def error_within(self, left: float) -> float:
        """Error that a trial reaches within a time, s."""
        last = self._trials[-1]
        n = max(_within(last, _TIME_SHARE * left), last.n)
        return float(last.estimate.total * (last.n / n) ** self._exponent)

    @property
    def _exponent(self) -> float:
        if len(self._trials) < 2:
            return _EXPONENT
        before, last = self._trials[-2:]
        ratio = before.estimate.total / max(last.estimate.total, 1e-12)
        found = np.log(max(ratio, 1e-12)) / np.log(last.n / before.n)
        return float(np.clip(found, *_EXPONENTS))


class Alternative(Protocol):
    """Another way to an image, tried once."""

    def is_worth(self, trials: PhotonTrials, goal: Goal, left: float) -> bool:
        """Whether it may well be quicker than photons."""

    def image(self, trials: PhotonTrials, goal: Goal, left: float) -> Image | None:
        """The image; None where it is left to photons."""


def render_to_goal(
    render: Render,
    goal: Goal,
    n_expected: int,
    seed: int,
    layer: str,
    *,
    alternative: Alternative | None = None,
) -> Image:
    """Render ever more photons until a goal is reached.

    Parameters
    ----------
    render : callable
        ``render(n, seed)``.
    goal : Goal
    n_expected : int
        Photons that may suffice.
    seed : int
        Seeds of the images follow from it.
    layer : str
        Of which the error is.
    alternative : Alternative, optional
        Tried once where it is worth it.

    Returns
    -------
    Image
        The best mean of the last three, with ``error`` in its metadata and `stats`.
    """
    started = perf_counter()
    trials = PhotonTrials(render, seed, layer)
    trials.add(first_number(n_expected, goal))
    while not goal.is_met(trials.estimate.total):
        if alternative is not None and alternative.is_worth(trials, goal, goal.left(started)):
            image = alternative.image(trials, goal, goal.left(started))
            if image is not None:
                return image
            alternative = None
        n = trials.next_number(goal.error, goal.left(started))
        if n is None:
            break
        try:
            trials.add(n)
        except MemoryError:
            # What is reached is worth more than none.
            break
    counts, seconds = trials.counts, perf_counter() - started
    return told(trials.image, trials.estimate, goal, layer, seconds=seconds, **counts)


def first_number(n_expected: int, goal: Goal) -> int:
    """Photons of the first trial."""
    if goal.error is None:
        return _PILOT
    return max(int(_PILOT_SHARE * n_expected), _PILOT)


def _within(trial: _Trial, seconds: float) -> int:
    """Most photons that take no more than a time."""
    now = trial.seconds_of(trial.n)
    each = max(trial.seconds_of(trial.n + 1) - now, 1e-12)
    return int(trial.n + (seconds - now) / each)


def _in_all(n: int) -> int:
    """Photons of all three images of a trial, of n and twice a quarter."""
    return n + 2 * (n // QUARTER)


def photons_of_whole(photons_of_image: int) -> int:
    """Photons of the image of a trial that has most of them, by those of all three."""
    return round(photons_of_image / _IN_ALL)


def told(
    image: Image,
    estimate: ErrorEstimate,
    goal: Goal,
    layer: str,
    *,
    seconds: float,
    photons: int,
    photons_of_image: int,
) -> Image:
    """An image, with what was reached in its metadata and stats."""
    reached = {
        "of": layer,
        "metric": "relative L1",
        "asked": goal.error,
        "asked_seconds": goal.seconds,
        "estimate": estimate.total,
        "noise": estimate.noise,
        "bias": estimate.bias,
        "photons": photons,
        "photons_of_image": photons_of_image,
        "seconds": seconds,
        "is_met": goal.error is None or estimate.total <= goal.error,
    }
    of_last = image.stats.get("stages", {})
    others = seconds - sum(stage["seconds"] for stage in of_last.values())
    pilots = {"seconds": max(others, 0.0), "emitted": photons - photons_of_whole(photons_of_image)}
    stages = {"pilots": pilots, **of_last}
    stats = image.stats | {"stages": stages, "seconds": seconds, "error": reached}
    metadata = {**image.metadata, "photonrelax.error": json.dumps(reached)}
    return replace(image, metadata=metadata, stats=stats)
