"""Estimated errors of images, from independent ones of half as many photons, or from a coarser one.

An image of N photons is compared with the mean of two of N/2: all three are independent. With h the
norm of the difference of the two over √2, the noise of an image of N/2, and d that of the whole and
their mean: what d has beyond noise is bias. How both fall with N is known of each layer. The result
is the mean of the three with the least error.

An envelope has no noise. It is compared with a coarser one, and both tell what they misplace.
"""

from __future__ import annotations

from dataclasses import replace
from functools import reduce
from typing import NamedTuple

import numpy as np

from .._util.validation import Floats
from ..imaging.image import Image
from .layers import RECORDS, total_radiance

# Misplaced light over that of a coarser image, at most, that tells the error of the finer.
_MOST_RATIO = 0.9
SEEN = 0.6
"""Exponent of the error over pixels over misplaced light: 0.5 to 1 in `ring`, `ripples`, `sphere`
and `pool`, see docs/measurements/tradeoff.md."""


class Falls(NamedTuple):
    """Variance and bias of an image of half as many photons over those of the whole."""

    variance: float
    bias: float


PHOTONS = Falls(2.0, 2.0**0.5)
"""Of k photons in each estimate: the bias is that of a kernel over a fold, ∝ N^-½."""
# Of estimates of k ∝ N^½ photons on smooth light, whose bias is ∝ k/N.
_WIDER = Falls(2.0**0.5, 2.0**0.5)
# Of shadow rays, of which there are as many in all images.
_SAME = Falls(1.0, 1.0)
_FALLS = {"indirect": _WIDER, "direct": _SAME, "emission": _SAME}


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


def estimate_error(
    first: Floats, second: Floats, whole: Floats, falls: Falls = PHOTONS
) -> ErrorEstimate:
    """Error of the best mean of two images of half as many photons and of one of all.

    Parameters
    ----------
    first, second, whole : (height, width, 3)
        Independent images.
    falls : Falls
        Of their noise and bias.
    """
    scale = np.abs(whole).sum()
    if not scale > 0.0:
        return ErrorEstimate(0.0, 0.0, 0.0, 1.0)
    h = float(np.abs(first - second).sum() / np.sqrt(2.0) / scale)
    d = float(np.abs(whole - 0.5 * (first + second)).sum() / scale)
    of_whole, more = 1.0 / falls.variance, falls.bias - 1.0
    square = max(d * d - (0.5 + of_whole) * h * h, 0.0)
    bias = np.sqrt(square) / more if more > 0.0 else 0.0
    weight = _best_weight(h, bias, falls)
    bias *= weight + falls.bias * (1.0 - weight)
    noise = h * np.sqrt(of_whole * weight**2 + 0.5 * (1.0 - weight) ** 2)
    return ErrorEstimate(float(np.hypot(noise, bias)), float(noise), float(bias), weight)


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
    first: Image, second: Image, whole: Image, layer: str
) -> tuple[ErrorEstimate, dict[str, ErrorEstimate], Image]:
    """Error of a layer and of its components, and the best mean of three images.

    Errors of components are over all light of the layer. They are independent; where they lie in
    other places their L1 norms add up to more than the root of squares, and their noise tells how
    much.

    Parameters
    ----------
    first, second : Image
        Of half as many photons.
    whole : Image
    layer : str
        ``radiance``, say.
    """
    images = [first, second, whole]
    parts, scale = {}, float(np.abs(whole.layers[layer]).sum())
    for name in _components(whole, layer):
        one, other, both = (np.asarray(image.layers[name]) for image in images)
        total, noise, bias, weight = estimate_error(one, other, both, _FALLS.get(name, PHOTONS))
        share = float(np.abs(both).sum()) / scale if scale > 0.0 else 0.0
        parts[name] = ErrorEstimate(share * total, share * noise, share * bias, weight)
    apart = _apart([first.layers[name] - second.layers[name] for name in parts])
    noise = apart * float(np.linalg.norm([error.noise for error in parts.values()]))
    bias = apart * float(np.linalg.norm([error.bias for error in parts.values()]))
    weights = {name: error.weight for name, error in parts.items()}
    image = _mean(images, weights, layer)
    found = ErrorEstimate(float(np.hypot(noise, bias)), noise, bias, next(iter(weights.values())))
    return found, parts, image


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
    """Mean of two images of half the photons, and of one of all, whose layers have weights."""
    first, second, whole = images
    others = next(iter(weights.values()))
    layers = {}
    for name, values in whole.layers.items():
        weight = weights.get(name, others)
        halves = 0.5 * (np.asarray(first.layers[name]) + np.asarray(second.layers[name]))
        with np.errstate(invalid="ignore"):
            mean = weight * np.asarray(values) + (1.0 - weight) * halves
        # Depths may be infinite.
        layers[name] = np.where(np.isfinite(mean), mean, values)
    if layer not in weights:
        layers[layer] = total_radiance(layers)
    return replace(whole, layers=layers)


def refined_error(coarse: Floats, fine: Floats, ratio: float) -> float:
    """L1 norm of the error of an image by that of its difference from a coarser one.

    Parameters
    ----------
    coarse, fine : (height, width, 3)
    ratio : float
        Light that is misplaced in the finer over that in the coarser; errors over pixels fall as
        its power of 0.6. What is misplaced in the finer is taken to be independent of it.

    Returns
    -------
    float
        Infinite if the ratio is not under 0.9.
    """
    if not ratio < _MOST_RATIO:
        return float("inf")
    of_errors = ratio**SEEN
    return float(np.abs(fine - coarse).sum() * of_errors / np.sqrt(1.0 - of_errors**2))
