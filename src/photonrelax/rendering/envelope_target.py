"""Envelopes divided until the estimated error of an image is what is asked for.

An envelope tells what it misplaces, of which pixels see a share. All other light is that of photons
and shadow rays, rendered by itself until its error is no larger. Where neither method is given,
`EnvelopeAttempt` tells by a pilot of photons whether envelopes are worth a try, and gives up where
they are not.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from .._util.validation import Floats
from ..estimation.envelope.envelope import EnvelopeSettings
from ..estimation.envelope.field import EnvelopeField
from ..imaging.image import Image
from ..scene.scene import Scene
from .error_estimate import ErrorEstimate
from .error_target import Goal, PhotonTrials, Render, first_number, told
from .layers import with_radiance
from .passes import pass_seed
from .plan import checked_components, plan
from .presets import Work

# Error over pixels over misplaced light: 0.25 to 0.9, see docs/measurements/tradeoff.md.
_SEEN = 0.48
# Misplaced light of the first envelope over the error asked for, which may be unknown. Of the next
# over the last, at least and at most; within a time, where the second tells how long others take.
_FIRST, _UNKNOWN_ERROR, _NEXT, _IN_TIME = 2.0, 1 / 16, (0.1, 0.5), (0.15, 0.7)
_SECOND = 0.4
# Share of the error asked for that envelopes are divided for, as the next estimate may be larger.
_ERROR_SHARE = 0.8
# Least misplaced light; what an envelope misplaces over what a coarser one does where its limits
# keep it from being finer.
_LEAST_MISPLACED, _LIMITED = 1e-4, 0.9
# Rays of a first division, and misplaced light over rays: as of quadratic maps with borders.
_FIRST_RAYS, _EXPONENT = 20_000, 1.5
# Rays of a first division, at most: where they do not suffice nearly all light is left to photons.
_MOST_FIRST_RAYS = 40_000
# Time that has to be left, over that of a first division, and share of it that is planned with.
_TIMES_FIRST, _TIME_SHARE = 3.0, 0.9
# Exponents of the time of an envelope over its misplaced light: expected, and believed when
# measured.
_OF_TIME, _OF_TIMES = 1.3, (0.7, 2.0)
# Photons for light without images, of a first division and at least, and at most; their
# noise over the error asked for.
_LEAST_PHOTONS, _MOST_PHOTONS = 20_000, 1_000_000
_NOISE_SHARE = 0.25
_SETTINGS = "photonrelax.settings"
# Relaxed photons of a map whose relative L1 error would be one: it falls with their root. Error of
# the fewest. Both are of sharp light, see docs/measurements/tradeoff.md; those of even light less.
_PHOTONS_OF_NOISE, _MOST_NOISE = 80.0, 1.2
# Share of the light that is of photons from which on an envelope is given up.
_OF_PHOTONS = 0.5


class DivisionLimits(NamedTuple):
    """Limits at which the division of an envelope ends.

    Attributes
    ----------
    misplaced : float
        Share of the light that may be misplaced.
    n_rays, n_photons : int, optional
        Rays, and photons for light without images, at most.
    """

    misplaced: float
    n_rays: int | None = None
    n_photons: int | None = None

    def applied_to(self, given: EnvelopeSettings) -> EnvelopeSettings:
        """Settings with these limits, where they have none."""
        return replace(
            given,
            error=self.misplaced,
            n_rays=given.n_rays or self.n_rays,
            n_photons=given.n_photons or self.n_photons,
        )


def envelope_summary(field: EnvelopeField) -> dict[str, float]:
    """Misplaced share and rays of an envelope; share of light of its photons, and their noise."""
    n_photons = len(field.flux) - len(field.envelope)
    of_photons, total = field.flux[len(field.envelope) :].sum(), field.flux.sum()
    share = float(of_photons / total) if total > 0.0 else 0.0
    noise = min((_PHOTONS_OF_NOISE / max(n_photons, 1)) ** 0.5, _MOST_NOISE)
    return {
        "error": field.envelope.error,
        "rays": field.envelope.n_rays,
        "of_photons": share,
        "noise": share * noise,
    }


@dataclass(frozen=True)
class Parts:
    """Renders of the light of an envelope and of all other light.

    Attributes
    ----------
    divide : callable
        Maps limits to an image of the light of an envelope.
    others : callable, optional
        ``others(n, seed)``, of the light that is none of an envelope.
    has_indirect, is_noisy : bool
        Indirect light is among others; images of others differ by their seeds.
    """

    divide: Callable[[DivisionLimits], Image]
    others: Render | None = None
    has_indirect: bool = False
    is_noisy: bool = False

    @classmethod
    def of(
        cls,
        scene: Scene,
        divide: Callable[[DivisionLimits, Iterable[str] | None], Image],
        once: Callable[..., Image],
        components: Iterable[str] | None,
        *,
        is_whole: bool,
    ) -> Parts:
        """Parts of a render.

        Parameters
        ----------
        divide, once : callable
            ``divide(limits, components)`` and ``once(n, seed, only=components)``.
        components : iterable of str, optional
            Those asked for.
        is_whole : bool
            All light is rendered with that of envelopes, and its noise not told.
        """
        wanted = checked_components(components)
        others = tuple(name for name in wanted if name != "caustic")
        if is_whole or not others:
            return cls(lambda limits: divide(limits, wanted))
        spread = any(emitter.is_extended for emitter in scene.emitters)
        has_indirect = plan(scene, n_emitted=1, components=others).models("indirect")
        return cls(
            lambda limits: divide(limits, ("caustic",)),
            partial(once, only=others),
            has_indirect,
            has_indirect or ("direct" in others and spread),
        )


class _Division(NamedTuple):
    """An image of an envelope, what it misplaces, and what it took."""

    image: Image
    misplaced: float
    rays: int
    n_photons: int
    seconds: float

    @property
    def caustic(self) -> Floats:
        return np.asarray(self.image.layers["radiance"])

    @property
    def noise(self) -> float:
        """L1 norm of the noise of its photons."""
        return float(self.image.stats["envelope"]["noise"] * self.caustic.sum())

    @property
    def of_photons(self) -> float:
        """Share of its light that is of photons."""
        return float(self.image.stats["envelope"]["of_photons"])


class EnvelopeTrials:
    """Envelopes that are divided ever more, and trials of other light.

    Parameters
    ----------
    parts : Parts
    goal : Goal
    seed : int
    n_photons : int, optional
        Photons for light without images, at most.
    started : float, optional
        Time of `perf_counter` from which the goal's counts; now by default.
    """

    def __init__(
        self,
        parts: Parts,
        goal: Goal,
        seed: int,
        n_photons: int | None = None,
        started: float | None = None,
    ) -> None:
        self._parts, self._goal, self._seed = parts, goal, seed
        self._n_photons = n_photons
        self._started = perf_counter() if started is None else started
        self._divisions: list[_Division] = []
        self._others: PhotonTrials | None = None
        self._fixed: Image | None = None
        self._fixed_noise = 0.0

    def start(
        self, misplaced: float, n_rays: int | None = None, known: PhotonTrials | None = None
    ) -> None:
        """Render the first envelope, of some rays at most, and the first images of other light.

        Direct light is taken from images that are known.
        """
        self._divide(misplaced, n_rays)
        render = self._parts.others
        if known is not None and not self._parts.has_indirect:
            self._fixed = _without_caustics(known.image)
            self._fixed_noise = known.error_of(("direct", "emission")) * _norm(known.image)
        elif render is not None and self._parts.is_noisy:
            self._others = PhotonTrials(render, self._seed, "radiance")
            self._others.add(first_number(0, self._goal))
        elif render is not None:
            self._fixed = render(1, pass_seed(self._seed, 0))

    def _divide(self, misplaced: float, n_rays: int | None = None) -> None:
        started = perf_counter()
        n_photons = self._photons_needed()
        image = self._parts.divide(DivisionLimits(misplaced, n_rays, n_photons))
        found = image.stats["envelope"]
        seconds = perf_counter() - started
        division = _Division(image, found["error"], found["rays"], n_photons, seconds)
        self._divisions.append(division)

    def _photons_needed(self) -> int:
        """Photons of the next envelope, whose noise is to be a share of its error."""
        most = self._n_photons or _MOST_PHOTONS
        if not self._divisions:
            return min(_LEAST_PHOTONS, most)
        last, error = self._divisions[-1], self._goal.error
        if error is None:
            error = 0.5 * min(self.estimate.total, _UNKNOWN_ERROR)
        ratio = last.noise / (_NOISE_SHARE * error * max(_norm(self.image), 1e-300))
        return int(np.clip(ratio**2 * last.n_photons, _LEAST_PHOTONS, most))

    @property
    def first(self) -> _Division:
        """The first envelope."""
        return self._divisions[0]

    @property
    def image(self) -> Image:
        """The last envelope and the best image of other light together."""
        mine = self._divisions[-1].image
        others = self._fixed if self._others is None else self._others.image
        return mine if others is None else _together(others, mine)

    @property
    def estimate(self) -> ErrorEstimate:
        """Its error."""
        scale, last = max(_norm(self.image), 1e-300), self._divisions[-1]
        bias = _SEEN * last.misplaced * float(np.abs(last.caustic).sum()) / scale
        noise = np.hypot(last.noise, self._fixed_noise) / scale
        if self._others is not None:
            share = _norm(self._others.image) / scale
            bias = np.hypot(bias, share * self._others.estimate.bias)
            noise = np.hypot(noise, share * self._others.estimate.noise)
        return ErrorEstimate(float(np.hypot(noise, bias)), float(noise), float(bias), 1.0)

    def improve(self, most_rays: float = np.inf) -> bool:
        """Make the part with the larger error better; False if that takes too much."""
        left = self._goal.left(self._started)
        if self._others is not None and self._share_of_others > 0.5:
            n = self._others.next_number(self._error_of_others, left)
            if n is not None:
                self._others.add(n)
            return n is not None
        misplaced, last = self._next_misplaced(), self._divisions[-1]
        rays = last.rays * (last.misplaced / misplaced) ** (1.0 / _EXPONENT)
        if np.isfinite(left):
            least = last.misplaced * self._ratio_within(left)
            if least > _IN_TIME[1] * last.misplaced:
                return False
            misplaced = max(misplaced, least)
        if self._is_limited or misplaced < _LEAST_MISPLACED or rays > most_rays:
            return False
        self._divide(misplaced)
        return True

    def error_within(self, left: float) -> float:
        """Error that is reached within a time, s."""
        return self.estimate.total * min(self._ratio_within(left), 1.0)

    def _ratio_within(self, left: float) -> float:
        """Misplaced light of an envelope that takes a time, s, over that of the last."""
        times = _TIME_SHARE * max(left, 1e-9) / max(self._divisions[-1].seconds, 1e-9)
        return float(times ** (-1.0 / self._exponent_of_time))

    @property
    def _exponent_of_time(self) -> float:
        if len(self._divisions) < 2:
            return _OF_TIME
        before, last = self._divisions[-2:]
        of_light = np.log(before.misplaced / max(last.misplaced, 1e-12))
        of_time = np.log(max(last.seconds, 1e-9) / max(before.seconds, 1e-9))
        return float(np.clip(of_time / max(of_light, 1e-3), *_OF_TIMES))

    @property
    def _is_limited(self) -> bool:
        if len(self._divisions) < 2:
            return False
        before, last = self._divisions[-2:]
        return last.misplaced >= _LIMITED * before.misplaced

    def _next_misplaced(self) -> float:
        last, error = self._divisions[-1].misplaced, self.estimate.total
        if self._goal.error is None:
            return last * (_SECOND if len(self._divisions) < 2 else _IN_TIME[0])
        return last * float(np.clip(_ERROR_SHARE * self._goal.error / error, *_NEXT))

    @property
    def _share_of_others(self) -> float:
        """Share of the square of the error that is of other light."""
        assert self._others is not None
        total = self.estimate.total
        if not 0.0 < total < np.inf:
            return 0.0
        return (self._scaled_to_others(1.0) * self._others.estimate.total / total) ** 2

    @property
    def _error_of_others(self) -> float | None:
        """Error that other light may have of itself, if an error is asked for."""
        if self._goal.error is None:
            return None
        return self._goal.error / np.sqrt(2.0) / self._scaled_to_others(1.0)

    def _scaled_to_others(self, error: float) -> float:
        assert self._others is not None
        return error * _norm(self._others.image) / max(_norm(self.image), 1e-300)

    def told(self, **before: int) -> Image:
        """The image with what was reached; photons emitted before are counted."""
        counts = {"photons": 0, "photons_of_image": 0}
        if self._others is not None:
            counts = self._others.counts
        counts["photons"] += before.get("photons", 0)
        seconds = perf_counter() - self._started
        return told(self.image, self.estimate, self._goal, "radiance", seconds=seconds, **counts)


def divide_to_goal(parts: Parts, goal: Goal, seed: int) -> Image:
    """Divide envelopes ever more until a goal is reached; see `render_to_goal`."""
    trials = EnvelopeTrials(parts, goal, seed)
    trials.start(_FIRST * (goal.error or _UNKNOWN_ERROR))
    while not goal.is_met(trials.estimate.total):
        if not trials.improve():
            break
    return trials.told()


@dataclass(frozen=True)
class EnvelopeAttempt:
    """Envelopes in place of photons, where these would take longer.

    Attributes
    ----------
    parts : Parts
    work : Work
        What photons and envelopes take in scenes of the class.
    seed : int
    """

    parts: Parts
    work: Work
    seed: int

    def is_worth(self, trials: PhotonTrials, goal: Goal, left: float) -> bool:
        """Whether photons for the error would take longer than a first division.

        By counts and measured times of other scenes, so that the same is chosen on every machine,
        unless a time is given.
        """
        is_in_time = left > _TIMES_FIRST * self.work.envelope
        if goal.error is None:
            return is_in_time and trials.photons_for(1.0, "caustic") > 0.0
        return is_in_time and self._seconds(trials, goal.error) > self.work.envelope

    def _seconds(self, trials: PhotonTrials, error: float) -> float:
        """Seconds of the images of the next trial, were they of caustics alone."""
        return 2.0 * self.work.photon * trials.photons_for(error, "caustic")

    def image(self, trials: PhotonTrials, goal: Goal, left: float) -> Image | None:
        """Image of an envelope; None where photons are sooner there."""
        started = perf_counter() - (0.0 if goal.seconds is None else goal.seconds - left)
        most_rays, n_photons = np.inf, None
        if goal.error is not None:
            most_rays = _FIRST_RAYS * self._seconds(trials, goal.error) / self.work.envelope
            n_photons = int(min(trials.photons_for(goal.error, "caustic"), _MOST_PHOTONS))
        found = EnvelopeTrials(self.parts, goal, self.seed, n_photons, started)
        error = goal.error or _UNKNOWN_ERROR
        found.start(_FIRST * error / max(_share(trials.image), 1e-3), _MOST_FIRST_RAYS, trials)
        if found.first.of_photons > _OF_PHOTONS:
            return None
        while not _is_worse(found, trials, goal.left(started)):
            if goal.is_met(found.estimate.total) or not found.improve(most_rays):
                is_enough = goal.seconds is not None or goal.is_met(found.estimate.total)
                return found.told(**trials.counts) if is_enough else None
        return None


def _is_worse(found: EnvelopeTrials, trials: PhotonTrials, left: float) -> bool:
    """Whether photons would reach a smaller error in the time that is left."""
    return np.isfinite(left) and found.error_within(left) > trials.error_within(left)


def _share(image: Image) -> float:
    """Share of the light of an image that is of caustics."""
    radiance = _norm(image)
    return float(np.abs(image.layers["caustic"]).sum()) / radiance if radiance > 0.0 else 1.0


def _norm(image: Image) -> float:
    return float(np.abs(image.layers["radiance"]).sum())


def _without_caustics(image: Image) -> Image:
    """The light and surfaces of an image without what is of photons."""
    layers = {
        name: values
        for name, values in image.layers.items()
        if name not in ("radiance", "caustic") and not name.startswith("photons.")
    }
    return Image(with_radiance(layers), {}, {"stages": {}})


def _together(others: Image, mine: Image) -> Image:
    """Image of the light of two, with what is known of both."""
    layers = {**others.layers, **mine.layers}
    del layers["radiance"]
    settings = {
        name: value
        for image in (others, mine)
        for name, value in json.loads(image.metadata.get(_SETTINGS, "{}")).items()
    }
    metadata = {**others.metadata, **mine.metadata, _SETTINGS: json.dumps(settings)}
    stages: dict[str, Any] = {**others.stats["stages"], **mine.stats["stages"]}
    for name in others.stats["stages"].keys() & mine.stats["stages"].keys():
        both = (each.stats["stages"][name] for each in (others, mine))
        stages[name] = {**stages[name], "seconds": sum(stage["seconds"] for stage in both)}
    return Image(with_radiance(layers), metadata, {**mine.stats, "stages": stages})
