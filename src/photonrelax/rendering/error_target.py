"""Images rendered until their estimated error is what is asked for, or the time is up.

An image of N photons is compared with the mean of two of N/2: all three are independent. With h the
norm of the difference of the two over √2, the noise of an image of N/2, and d that of the whole and
their mean, whose noise is h, what d has beyond h is bias. Bias is taken for ∝ N^-½, as of a kernel
over a fold, so that d² − h² = (√2 − 1)² b² with b the bias of N photons. The result is the mean of
the three with the least error.

An envelope has no photons: one is compared with another of twice the misplaced light, whose
difference is the error of the coarser, and taken for that of the finer.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter
from typing import NamedTuple

import numpy as np

from .._util import validation
from .._util.frozen import set_field
from .._util.validation import Floats
from ..imaging.image import Image
from .passes import pass_seed

# Bias of an image of half as many photons, and what it has more than that of the whole.
_HALF, _MORE = 2.0**0.5, 2.0**0.5 - 1.0
# Photons of the first pilot, and the share of those expected to suffice; factors from one number to
# the next.
_PILOT, _PILOT_SHARE, _LEAST_FACTOR, _LARGEST_FACTOR = 4000, 1 / 16, 1.6, 24.0
# Exponents of the error over photons: expected, and believed when measured.
_EXPONENT, _EXPONENTS = 0.4, (0.25, 0.5)
# Photons are chosen for an error that is less than asked, as estimates have noise too, and for a
# time that is less.
_ERROR_SHARE, _TIME_SHARE = 0.93, 0.9

# Misplaced light of the first envelopes over the error asked for, and its least. Pixels do not see
# most of what is misplaced.
_FIRST_MISPLACED, _LEAST_MISPLACED = 4.0, 1e-4

Render = Callable[[int, int], Image]
"""Maps a number of photons and a seed to an image."""
Divide = Callable[[float, int], Image]
"""Maps a share of misplaced light and a seed to an image."""


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

    def is_met(self, error: float) -> bool:
        """True if an error is not more than asked."""
        return self.error is not None and error <= self.error


class ErrorEstimate(NamedTuple):
    """Estimated relative L1 of an image, and of its noise and bias.

    Attributes
    ----------
    total, noise, bias : float
    weight : float
        Of the image of all photons, the rest that of the mean of the two of half as many.
    """

    total: float
    noise: float
    bias: float
    weight: float


def estimate_error(first: Floats, second: Floats, whole: Floats) -> ErrorEstimate:
    """Error of the best mean of two images of half as many photons and of one of all.

    Parameters
    ----------
    first, second, whole : (height, width, 3)
        Independent images.
    """
    mean = 0.5 * (first + second)
    scale = np.abs(whole).sum()
    if not scale > 0.0:
        return ErrorEstimate(0.0, 0.0, 0.0, 1.0)
    h = float(np.abs(first - second).sum() / np.sqrt(2.0) / scale)
    d = float(np.abs(whole - mean).sum() / scale)
    bias = np.sqrt(max(d * d - h * h, 0.0)) / _MORE
    weight = _best_weight(h, bias)
    bias *= weight + _HALF * (1.0 - weight)
    noise = h * np.sqrt(0.5 * (weight**2 + (1.0 - weight) ** 2))
    return ErrorEstimate(float(np.hypot(noise, bias)), float(noise), float(bias), weight)


def _best_weight(h: float, bias: float) -> float:
    """Weight of the whole that minimises noise and bias of the mean.

    h²/2 (w² + (1 − w)²) + b² (w + √2 (1 − w))² has its minimum there.
    """
    if not h > 0.0:
        return 1.0
    square = (bias / h) ** 2
    found = (0.5 + _HALF * _MORE * square) / (1.0 + _MORE * _MORE * square)
    return float(min(found, 1.0))


class _Trial(NamedTuple):
    """Images of some photons, what they took and their estimated error."""

    n: int
    image: Image
    seconds: float
    half_seconds: float
    estimate: ErrorEstimate

    def seconds_of(self, n: int) -> float:
        """Seconds of a trial of n photons."""
        whole = self.seconds - 2.0 * self.half_seconds
        each = max(whole - self.half_seconds, 0.1 * whole) / (0.5 * self.n)
        return self.seconds + 2.0 * each * (n - self.n)


def render_to_goal(render: Render, goal: Goal, n_expected: int, seed: int, layer: str) -> Image:
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

    Returns
    -------
    Image
        The best mean of the last three, with ``error`` in its metadata and `stats`.
    """
    started = perf_counter()
    trials = [_trial(render, _first(n_expected, goal), seed, 0, layer)]
    while not goal.is_met(trials[-1].estimate.total):
        left = np.inf if goal.seconds is None else goal.seconds - (perf_counter() - started)
        n = _next(trials, goal, left)
        if n is None:
            break
        try:
            trials.append(_trial(render, n, seed, len(trials), layer))
        except MemoryError:
            # What is reached is worth more than none.
            break
    return _told(trials, goal, layer, perf_counter() - started)


def divide_to_goal(divide: Divide, goal: Goal, seed: int, layer: str) -> Image:
    """Divide envelopes ever more until a goal is reached; see `render_to_goal`.

    ``divide(misplaced, seed)`` renders an image.
    """
    started = perf_counter()
    misplaced = _FIRST_MISPLACED * (goal.error or _PILOT_SHARE)
    image = divide(2.0 * misplaced, pass_seed(seed, 0))
    trials: list[_Trial] = []
    while True:
        before, since = image, perf_counter()
        image = divide(misplaced, pass_seed(seed, len(trials) + 1))
        seconds = perf_counter() - since
        coarse, fine = (np.asarray(each.layers[layer]) for each in (before, image))
        error = float(np.abs(fine - coarse).sum() / max(np.abs(fine).sum(), 1e-300))
        trials.append(_Trial(0, image, seconds, 0.0, ErrorEstimate(error, 0.0, error, 1.0)))
        misplaced *= 0.5
        left = np.inf if goal.seconds is None else goal.seconds - (perf_counter() - started)
        # The next takes twice as long, at the most.
        if goal.is_met(error) or misplaced < _LEAST_MISPLACED or left < 2.0 * seconds:
            return _told(trials, goal, layer, perf_counter() - started)


def _first(n_expected: int, goal: Goal) -> int:
    if goal.error is None:
        return _PILOT
    return max(int(_PILOT_SHARE * n_expected), _PILOT)


def _trial(render: Render, n: int, seed: int, number: int, layer: str) -> _Trial:
    half = -(-n // 2)
    started = perf_counter()
    seeds = [pass_seed(seed, 3 * number + i) for i in range(3)]
    first, second = (render(half, seeds[i]) for i in range(2))
    halves = perf_counter() - started
    whole = render(2 * half, seeds[2])
    values = [np.asarray(image.layers[layer]) for image in (first, second, whole)]
    estimate = estimate_error(*values)
    image = _mean([first, second, whole], estimate.weight)
    return _Trial(2 * half, image, perf_counter() - started, 0.5 * halves, estimate)


def _mean(images: list[Image], weight: float) -> Image:
    """Mean of two images of half the photons, and of one of all, which has a weight."""
    first, second, whole = images
    layers = {}
    for name, values in whole.layers.items():
        halves = 0.5 * (np.asarray(first.layers[name]) + np.asarray(second.layers[name]))
        with np.errstate(invalid="ignore"):
            mean = weight * np.asarray(values) + (1.0 - weight) * halves
        # Depths may be infinite.
        layers[name] = np.where(np.isfinite(mean), mean, values)
    return Image(layers, whole.metadata, whole.stats)


def _next(trials: list[_Trial], goal: Goal, left: float) -> int | None:
    """Photons of the next trial; None if no more are to be rendered."""
    last = trials[-1]
    n = int(_LARGEST_FACTOR * last.n)
    if goal.error is not None:
        ratio = last.estimate.total / (_ERROR_SHARE * goal.error)
        n = min(n, int(last.n * max(ratio ** (1.0 / _exponent(trials)), _LEAST_FACTOR)))
    if not np.isfinite(left):
        return n
    if last.seconds_of(n) > _TIME_SHARE * left:
        n = _within(last, _TIME_SHARE * left)
    return n if n > last.n else None


def _within(trial: _Trial, seconds: float) -> int:
    """Most photons that take no more than a time."""
    each = trial.seconds_of(trial.n + 1) - trial.seconds_of(trial.n)
    return int(trial.n + (seconds - trial.seconds) / each)


def _exponent(trials: list[_Trial]) -> float:
    if len(trials) < 2:
        return _EXPONENT
    before, last = trials[-2:]
    ratio = before.estimate.total / max(last.estimate.total, 1e-12)
    found = np.log(ratio) / np.log(last.n / before.n)
    return float(np.clip(found, *_EXPONENTS))


def _told(trials: list[_Trial], goal: Goal, layer: str, seconds: float) -> Image:
    """The last image, with what was reached in its metadata and stats."""
    last = trials[-1]
    n_photons = sum(2 * trial.n for trial in trials)
    reached = {
        "of": layer,
        "metric": "relative L1",
        "asked": goal.error,
        "asked_seconds": goal.seconds,
        "estimate": last.estimate.total,
        "noise": last.estimate.noise,
        "bias": last.estimate.bias,
        "photons": n_photons,
        "photons_of_image": 2 * last.n,
        "seconds": seconds,
        "is_met": goal.error is None or last.estimate.total <= goal.error,
    }
    of_last = last.image.stats.get("stages", {})
    others = seconds - sum(stage["seconds"] for stage in of_last.values())
    pilots = {"seconds": max(others, 0.0), "emitted": n_photons - last.n}
    stages = {"pilots and halves": pilots, **of_last}
    stats = last.image.stats | {"stages": stages, "seconds": seconds, "error": reached}
    metadata = {**last.image.metadata, "photonrelax.error": json.dumps(reached)}
    return replace(last.image, metadata=metadata, stats=stats)
