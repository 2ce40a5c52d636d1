"""Eight-bit pictures of a comparison: what methods made, how it differs, what photons carry."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._util.validation import Floats
from ...imaging.image import srgb
from ..comparison import Comparison

Bytes = NDArray[np.uint8]

# From nothing to the largest, dark to light, for error maps.
_HEAT = np.array(
    [[0.0, 0.0, 0.02], [0.32, 0.07, 0.48], [0.72, 0.22, 0.47], [0.99, 0.53, 0.38], [1.0, 1.0, 0.75]]
)
# Too dark and too bright, over black for no difference.
_TOO_DARK, _TOO_BRIGHT = np.array([0.25, 0.6, 1.0]), np.array([1.0, 0.45, 0.1])
# Differences of a display are shown so many times as large.
DIFFERENCE_GAIN = 4.0
# Few path edges to many.
_EDGES = np.array(
    [[0.2, 0.35, 0.95], [0.1, 0.75, 0.8], [0.35, 0.85, 0.25], [0.98, 0.85, 0.15], [0.95, 0.2, 0.15]]
)
_CONSTRAINED = np.array([1.0, 0.08, 0.05])


def method_pictures(comparison: Comparison) -> dict[str, dict[str, Bytes]]:
    """Return for each method its ``picture``, ``flip`` and ``difference``, for the reference one.

    Each is (height, width, 3).
    """
    exposure = comparison.request.exposure
    reference = displayed(comparison.reference.image.layers["radiance"], exposure)
    pictures = {}
    for entry in comparison.entries:
        shown = displayed(entry.image.layers["radiance"], exposure)
        pictures[entry.name] = {
            "picture": _bytes(shown),
            "flip": _bytes(_ramp(np.asarray(entry.image.layers["flip"]), _HEAT)),
            "difference": _bytes(_signed(_largest(shown - reference))),
        }
    return {**pictures, "reference": {"picture": _bytes(reference)}}


def photon_pictures(comparison: Comparison) -> dict[str, dict[str, Any]]:
    """Return pictures of what photons carry (SJ13 Fig. 6e–g), each with ``picture``, ``about``."""
    layers = comparison.photon_layers
    shade = _shade(layers["caustic"], comparison.request.exposure)
    made: dict[str, dict[str, Any]] = {}
    if "photons.emitter" in layers:
        about = "Where photons left their emitter, as colours"
        colours = layers["photons.emitter"]
        made["parameter-space"] = {"picture": _bytes(shade * colours), "about": about}
    if "photons.bounces" in layers:
        colours, about = _path_edges(layers["photons.bounces"])
        made["path-edges"] = {"picture": _bytes(shade * colours), "about": about}
    if "photons.constraint" in layers:
        about = "Red where photons may not move across an edge"
        colours = _constraint_colours(layers["photons.constraint"])
        made["constraints"] = {"picture": _bytes(shade * colours), "about": about}
    return made


def displayed(radiance: ArrayLike, exposure: float) -> Floats:
    """Return display values in [0, 1] of radiance."""
    return srgb(np.asarray(radiance) * 2.0**exposure)


def _path_edges(bounces: Floats) -> tuple[Floats, str]:
    """Return the number of edges of the mean path as colours, and what they mean."""
    edges = bounces + 1.0
    seen = edges[bounces > 0.0]
    # The rarest, longest paths would take most of the colours.
    low, high = np.quantile(seen, [0.01, 0.99]).round() if seen.size else (1.0, 2.0)
    high = max(high, low + 1.0)
    about = f"Edges of photons' paths, {low:.0f} (blue) to {high:.0f} (red)"
    return _ramp((edges - low) / (high - low), _EDGES), about


def _constraint_colours(constraint: Floats) -> Floats:
    share = np.clip(constraint, 0.0, 1.0)[..., np.newaxis]
    return (1.0 - share) * np.full(3, 0.75) + share * _CONSTRAINED


def _shade(caustic: Floats, exposure: float) -> Floats:
    """Return how bright a picture of attributes is, (height, width, 1): dim light still shows."""
    return np.sqrt(displayed(caustic, exposure).mean(axis=2, keepdims=True))


def _largest(difference: Floats) -> Floats:
    """Return of differences (height, width, 3) those of the channel that differs most.

    Their mean would show nothing where one channel is too bright and another too dark.
    """
    channel = np.abs(difference).argmax(axis=2)[..., np.newaxis]
    return np.take_along_axis(difference, channel, axis=2)[..., 0]


def _signed(difference: Floats) -> Floats:
    """Return differences (height, width) of display values as two hues."""
    size = np.clip(DIFFERENCE_GAIN * np.abs(difference), 0.0, 1.0)[..., np.newaxis]
    return size * np.where(difference[..., np.newaxis] > 0.0, _TOO_BRIGHT, _TOO_DARK)


def _ramp(values: Floats, colours: Floats) -> Floats:
    """Return values in [0, 1] as colours between those given, evenly spaced."""
    knots = np.linspace(0.0, 1.0, len(colours))
    return np.stack([np.interp(values, knots, channel) for channel in colours.T], axis=-1)


def _bytes(display: Floats) -> Bytes:
    return np.rint(255.0 * np.clip(display, 0.0, 1.0)).astype(np.uint8)
