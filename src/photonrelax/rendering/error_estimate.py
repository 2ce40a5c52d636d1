"""Estimated errors of images of photons, from independent ones of fewer photons.

An image of N photons is compared with the mean of two of N/4: all three are independent. With h the
norm of the difference of the two over √2, the noise of an image of N/4, and d that of the whole and
their mean: what d has beyond noise is the difference D of their biases. How noise and bias fall
with N is known of each layer; of caustics it is told by D in an earlier trial. The result is the
mean of the three with the least error.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial, reduce
from typing import NamedTuple

import numpy as np

from .._util.validation import Floats
from ..imaging.image import Image
from .layers import RECORDS, total_radiance

QUARTER = 4
"""Photons of the whole image over those of each of the other two."""
# Exponents of the bias of caustics over photons: of a first trial, and at least and at most of
# others. D falls more slowly than the bias: what is added to its exponent, see
# docs/measurements/tradeoff.md.
_FIRST_EXPONENT, _EXPONENTS, _SLOWER = 0.3, (0.3, 0.8), 0.1


class Falls(NamedTuple):
    """Variance and bias of an image of a quarter of the photons over those of the whole.

    Attributes
    ----------
    variance, bias : float
    difference : float
        Of both biases, over that of the whole.
    """

    variance: float
    bias: float
    difference: float


def photon_falls(exponent: float) -> Falls:
    """Falls of estimates from k photons each, whose bias is ∝ N^-exponent.

    Their difference is between that of biases that are alike, β − 1, and that of biases of which
    the larger has another one beside the smaller, √(β² − 1): the geometric mean of both.
    """
    bias = QUARTER**exponent
    return Falls(QUARTER, bias, ((bias - 1.0) * (bias**2 - 1.0) ** 0.5) ** 0.5)


PHOTONS = photon_falls(_FIRST_EXPONENT)
"""Of caustics, in a first trial."""
# Of estimates of k ∝ N^½ photons on smooth light, whose bias is ∝ k/N, and alike everywhere.
_WIDER = Falls(QUARTER**0.5, QUARTER**0.5, QUARTER**0.5 - 1.0)
# Of shadow rays, of which there are as many in all images.
_SAME = Falls(1.0, 1.0, 0.0)
_FALLS = {"indirect": _WIDER, "direct": _SAME, "emission": _SAME}


class ErrorEstimate(NamedTuple):
    """Estimated relative L1 of an image, and of its noise and bias.

    Attributes
    ----------
    total, noise, bias : float
    weight : float
        Of the image of all photons, the rest that of the mean of the two of a quarter.
    difference : float
        Of the biases of these.
    """

    total: float
    noise: float
    bias: float
    weight: float
    difference: float = 0.0

    def times(self, factor: float) -> ErrorEstimate:
        """The same error, relative to other light."""
        total, noise, bias, weight, difference = self
        return ErrorEstimate(
            factor * total, factor * noise, factor * bias, weight, factor * difference
        )


class Earlier(NamedTuple):
    """A trial with fewer photons: those of this one over its, and differences by component."""

    ratio: float
    differences: Mapping[str, float]

    def exponent(self, component: str, difference: float) -> float:
        """Exponent of the bias of a component whose difference has fallen since."""
        before = self.differences.get(component, 0.0)
        if not (before > 0.0 and self.ratio > 1.0):
            return _FIRST_EXPONENT
        of_ratio = np.log(self.ratio)
        found = np.log(before / max(difference, 1e-300)) / of_ratio + _SLOWER
        # Noise of the differences is over the ratio: small ones tell little.
        trust = min(of_ratio / np.log(QUARTER), 1.0)
        more = float(np.clip(found, *_EXPONENTS)) - _FIRST_EXPONENT
        return float(_FIRST_EXPONENT + trust * more)


def estimate_error(
    first: Floats,
    second: Floats,
    whole: Floats,
    falls: Falls | Callable[[float], Falls] = PHOTONS,
) -> ErrorEstimate:
    """Error of the best mean of two images of a quarter of the photons and of one of all.

    Parameters
    ----------
    first, second, whole : (height, width, 3)
        Independent images.
    falls : Falls, or callable
        Of their noise and bias; ``falls(difference)`` of caustics.
    """
    scale = np.abs(whole).sum()
    if not scale > 0.0:
        return ErrorEstimate(0.0, 0.0, 0.0, 1.0)
    h = float(np.abs(first - second).sum() / np.sqrt(2.0) / scale)
    d = float(np.abs(whole - 0.5 * (first + second)).sum() / scale)
    variance = falls.variance if isinstance(falls, Falls) else PHOTONS.variance
    difference = np.sqrt(max(d * d - (0.5 + 1.0 / variance) * h * h, 0.0))
    if not isinstance(falls, Falls):
        falls = falls(difference)
    bias = difference / falls.difference if falls.difference > 0.0 else 0.0
    weight = _best_weight(h, bias, falls)
    bias *= weight + falls.bias * (1.0 - weight)
    noise = h * np.sqrt(weight**2 / variance + 0.5 * (1.0 - weight) ** 2)
    total = float(np.hypot(noise, bias))
    return ErrorEstimate(total, float(noise), float(bias), weight, float(difference))


def _best_weight(h: float, bias: float, falls: Falls) -> float:
    """Weight w of the whole that minimises noise and bias of the mean.

    h² (w²/v + (1 − w)²/2) + b² (w + β (1 − w))² has its minimum there.
    """
    if not h > 0.0:
        return 1.0
    square, more = (bias / h) ** 2, falls.bias - 1.0
    found = (0.5 + falls.bias * more * square) / (0.5 + 1.0 / falls.variance + more**2 * square)
    return float(min(found, 1.0))


def estimated(
    first: Image, second: Image, whole: Image, layer: str, earlier: Earlier | None = None
) -> tuple[ErrorEstimate, dict[str, ErrorEstimate], Image]:
    """Error of a layer and of its components, and the best mean of three images.

    Errors of components are over all light of the layer. They are independent; where they lie in
    other places their L1 norms add up to more than the root of squares, and their noise tells how
    much.

    Parameters
    ----------
    first, second : Image
        Of a quarter of the photons.
    whole : Image
    layer : str
        ``radiance``, say.
    earlier : Earlier, optional
        A trial with fewer photons.
    """
    images = [first, second, whole]
    parts, scale = {}, float(np.abs(whole.layers[layer]).sum())
    for name in _components(whole, layer):
        one, other, both = (np.asarray(image.layers[name]) for image in images)
        share = float(np.abs(both).sum()) / scale if scale > 0.0 else 0.0
        falls = _FALLS.get(name) or partial(_caustic_falls, earlier, name, share)
        parts[name] = estimate_error(one, other, both, falls).times(share)
    apart = _apart([first.layers[name] - second.layers[name] for name in parts])
    noise = apart * float(np.linalg.norm([error.noise for error in parts.values()]))
    bias = apart * float(np.linalg.norm([error.bias for error in parts.values()]))
    weights = {name: error.weight for name, error in parts.items()}
    image = _mean(images, weights, layer)
    found = ErrorEstimate(float(np.hypot(noise, bias)), noise, bias, next(iter(weights.values())))
    return found, parts, image


def _caustic_falls(earlier: Earlier | None, name: str, share: float, difference: float) -> Falls:
    if earlier is None:
        return PHOTONS
    return photon_falls(earlier.exponent(name, share * difference))


def _components(image: Image, layer: str) -> list[str]:
    """Components of the light of a layer, or itself if it has none."""
    if layer != "radiance":
        return [layer]
    return [each.name for each in RECORDS if each.is_light and each.name in image.layers] or [layer]


def _apart(differences: list[Floats]) -> float:
    """L1 norm of a sum over the root of the sum of squares of the norms of its parts."""
    norms = np.linalg.norm([np.abs(each).sum() for each in differences])
    total = np.abs(reduce(np.add, differences)).sum()
    return float(total / norms) if norms > 0.0 else 1.0


def _mean(images: list[Image], weights: dict[str, float], layer: str) -> Image:
    """Mean of two images of a quarter of the photons and of that of all, which has weights."""
    first, second, whole = images
    others = next(iter(weights.values()))
    layers = {}
    for name, values in whole.layers.items():
        weight = weights.get(name, others)
        quarters = 0.5 * (np.asarray(first.layers[name]) + np.asarray(second.layers[name]))
        with np.errstate(invalid="ignore"):
            mean = weight * np.asarray(values) + (1.0 - weight) * quarters
        # Depths may be infinite.
        layers[name] = np.where(np.isfinite(mean), mean, values)
    if layer not in weights:
        layers[layer] = total_radiance(layers)
    return replace(whole, layers=layers)
