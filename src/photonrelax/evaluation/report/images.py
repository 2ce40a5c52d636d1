"""Eight-bit images of a comparison: of methods, of their errors, and of photon attributes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._util.validation import Floats
from ...imaging.image import srgb
from ..comparison import Comparison

Bytes = NDArray[np.uint8]

# Colours of error maps, from 0 to 1.
_ERROR_COLOURS = np.array(
    [[0.0, 0.0, 0.02], [0.32, 0.07, 0.48], [0.72, 0.22, 0.47], [0.99, 0.53, 0.38], [1.0, 1.0, 0.75]]
)
# Colours of differences; where there is none it is black.
_TOO_DARK, _TOO_BRIGHT = np.array([0.25, 0.6, 1.0]), np.array([1.0, 0.45, 0.1])
# Factor of differences of display values.
DIFFERENCE_GAIN = 4.0
# Colours of path edges, from few to many.
_EDGE_COLOURS = np.array(
    [[0.2, 0.35, 0.95], [0.1, 0.75, 0.8], [0.35, 0.85, 0.25], [0.98, 0.85, 0.15], [0.95, 0.2, 0.15]]
)
_CONSTRAINED = np.array([1.0, 0.08, 0.05])


@dataclass(frozen=True)
class PhotonAttribute:
    """An attribute of photons that has an image.

    Attributes
    ----------
    layer : str
        Name of its layer.
    caption : str
        As in SJ13 Fig. 6.
    colours : callable
        Maps the layer to colours (height, width, 3) and their meaning.
    """

    layer: str
    caption: str
    colours: Callable[[Floats], tuple[Floats, str]]


@dataclass(frozen=True, eq=False)
class PhotonImage:
    """Image (height, width, 3) of an attribute of the photons, and the meaning of its colours."""

    image: Bytes
    about: str


def method_images(comparison: Comparison) -> dict[str, dict[str, Bytes]]:
    """The ``image``, ``flip`` and ``difference`` of each method, ``image`` of the ``reference``.

    Each is (height, width, 3).
    """
    exposure = comparison.request.exposure
    reference = displayed(comparison.reference.image.layers["radiance"], exposure)
    images = {}
    for entry in comparison.entries:
        shown = displayed(entry.image.layers["radiance"], exposure)
        images[entry.name] = {
            "image": _bytes(shown),
            "flip": _bytes(_ramp(np.asarray(entry.image.layers["flip"]), _ERROR_COLOURS)),
            "difference": _bytes(_signed(_largest(shown - reference))),
        }
    return {**images, "reference": {"image": _bytes(reference)}}


def photon_images(comparison: Comparison) -> dict[str, PhotonImage]:
    """Images of photon attributes (SJ13 Fig. 6e–g) by file name."""
    layers = comparison.photon_layers
    shade = _shade(layers["caustic"], comparison.request.exposure)
    images = {}
    for name, attribute in PHOTON_ATTRIBUTES.items():
        if attribute.layer in layers:
            colours, about = attribute.colours(layers[attribute.layer])
            images[name] = PhotonImage(_bytes(shade * colours), about)
    return images


def displayed(radiance: ArrayLike, exposure: float) -> Floats:
    """Display values in [0, 1] of radiance."""
    return srgb(np.asarray(radiance) * 2.0**exposure)


def _path_edges(bounces: Floats) -> tuple[Floats, str]:
    """Colours of the mean number of path edges, and their meaning."""
    edges = bounces + 1.0
    seen = edges[bounces > 0.0]
    # Without the rarest, longest paths, which would take most of the colours.
    low, high = np.quantile(seen, [0.01, 0.99]).round() if seen.size else (1.0, 2.0)
    high = max(high, low + 1.0)
    about = f"Edges of photons' paths, {low:.0f} (blue) to {high:.0f} (red)"
    return _ramp((edges - low) / (high - low), _EDGE_COLOURS), about


def _emitter_colours(colours: Floats) -> tuple[Floats, str]:
    return colours, "Where photons left their emitter, as colours"


def _constraint_colours(constraint: Floats) -> tuple[Floats, str]:
    share = np.clip(constraint, 0.0, 1.0)[..., np.newaxis]
    colours = (1.0 - share) * np.full(3, 0.75) + share * _CONSTRAINED
    return colours, "Red where photons may not move across an edge"


PHOTON_ATTRIBUTES = {
    "parameter-space": PhotonAttribute("photons.emitter", "Parameter space", _emitter_colours),
    "path-edges": PhotonAttribute("photons.bounces", "Path edges", _path_edges),
    "constraints": PhotonAttribute(
        "photons.constraint", "Derived constraints", _constraint_colours
    ),
}
"""Attributes of photons that have an image, by file name."""


def _shade(caustic: Floats, exposure: float) -> Floats:
    """Brightness (height, width, 1) of images of attributes, in which dim light still shows."""
    return np.sqrt(displayed(caustic, exposure).mean(axis=2, keepdims=True))


def _largest(difference: Floats) -> Floats:
    """Differences (height, width) of the channel that differs most in each pixel.

    Their mean would cancel where one channel is too bright and another too dark.
    """
    channel = np.abs(difference).argmax(axis=2)[..., np.newaxis]
    return np.take_along_axis(difference, channel, axis=2)[..., 0]


def _signed(difference: Floats) -> Floats:
    """Colours of differences (height, width) of display values, one hue for either sign."""
    size = np.clip(DIFFERENCE_GAIN * np.abs(difference), 0.0, 1.0)[..., np.newaxis]
    return size * np.where(difference[..., np.newaxis] > 0.0, _TOO_BRIGHT, _TOO_DARK)


def _ramp(values: Floats, colours: Floats) -> Floats:
    """Values in [0, 1] as colours, interpolated between those given at even distances."""
    knots = np.linspace(0.0, 1.0, len(colours))
    return np.stack([np.interp(values, knots, channel) for channel in colours.T], axis=-1)


def _bytes(display: Floats) -> Bytes:
    return np.rint(255.0 * np.clip(display, 0.0, 1.0)).astype(np.uint8)
