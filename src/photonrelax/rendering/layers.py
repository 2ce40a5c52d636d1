"""Output layers of images, a record each.

A layer is a function of the hit points of a band and of the estimates of a field there. To add one,
add its record to `RECORDS`: it is then rendered, merged over progressive passes and written. Layers
that a field names itself, `Field.layers`, need no record.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from .._util.validation import Floats
from ..estimation.field import Field
from .view import Band, concatenate_bands

Estimates = Mapping[str, Floats]
"""Estimates of a field by name, (rows, width, c) each; empty without a field."""


@dataclass(frozen=True)
class Merge:
    """Combination of the values that a layer has in several passes.

    Attributes
    ----------
    combine : ufunc
        Combines two passes.
    is_mean : bool
        The result is divided by the number of passes.
    """

    combine: np.ufunc
    is_mean: bool


MEAN, MINIMUM = Merge(np.add, is_mean=True), Merge(np.minimum, is_mean=False)


@dataclass(frozen=True)
class Layer:
    """An output layer.

    Attributes
    ----------
    name : str
        In `Image.layers`, and of channels in files.
    meaning : str
        Description, with the unit.
    values : callable
        Maps a `Band` and the `Estimates` there to values (rows, width, channels); None if the
        layer needs estimates that are not among them, or nothing of the kind is in the scene.
    channels : int
        1 or 3.
    merge : Merge
        Combination over the passes of a progressive render.
    is_light : bool
        The layer is a component of the radiance.
    """

    name: str
    meaning: str
    values: Callable[[Band, Estimates], Floats | None]
    channels: int = 3
    merge: Merge = MEAN
    is_light: bool = False


def _estimate(name: str) -> Callable[[Band, Estimates], Floats | None]:
    """Values of a layer that is one of the estimates."""
    return lambda band, estimates: estimates.get(name)


def _direct(band: Band, estimates: Estimates) -> Floats | None:
    return None if band.direct is None else band.radiance(band.direct)


def _albedo(band: Band, estimates: Estimates) -> Floats:
    return band.sums(band.hits.albedo, weight=band.hits.weight)


def _emission(band: Band, estimates: Estimates) -> Floats | None:
    hits, background = band.hits, band.first.background
    if hits.emission is None:
        return background
    emission = band.sums(hits.emission, weight=hits.weight)
    return emission if background is None else emission + background


RECORDS = (
    Layer("caustic", "radiance from photons", _estimate("caustic"), is_light=True),
    Layer("direct", "radiance from unoccluded emitters", _direct, is_light=True),
    Layer(
        "indirect",
        "radiance of light that diffuse surfaces have scattered before",
        _estimate("indirect"),
        is_light=True,
    ),
    Layer("emission", "radiance of emitters and background seen", _emission, is_light=True),
    Layer("albedo", "of the diffuse surfaces seen", _albedo),
    Layer("N", "normal of the first surface", lambda band, _: band.first.normal),
    Layer(
        "Z",
        "distance of the first surface along the viewing axis, m",
        lambda band, _: band.first.depth[..., np.newaxis],
        channels=1,
        merge=MINIMUM,
    ),
    Layer(
        "photons.constraint",
        "mean constraint of the photons gathered, in [0, 1]",
        _estimate("photons.constraint"),
        channels=1,
    ),
    Layer(
        "photons.emitter",
        "mean of their emitter coordinates as colours (SJ13 Fig. 5c)",
        _estimate("photons.emitter"),
    ),
    Layer(
        "photons.bounces",
        "mean number of their specular events",
        _estimate("photons.bounces"),
        channels=1,
    ),
    Layer(
        "envelope.error",
        "estimated error of the light of an envelope over that light, in [0, 1]",
        _estimate("envelope.error"),
        channels=1,
    ),
    Layer(
        "envelope.photons",
        "share of the light of an envelope that is of photons",
        _estimate("envelope.photons"),
        channels=1,
    ),
)
LAYERS = {
    "radiance": f"{' + '.join(layer.name for layer in RECORDS if layer.is_light)}, W/(m² sr)",
    **{layer.name: layer.meaning for layer in RECORDS},
}
"""Meaning of each layer of an image. Means over photons are weighted with their flux."""


def band_layers(band: Band, estimates: Estimates | None = None) -> dict[str, Floats]:
    """Layers of a band; without estimates those that do not depend on photons."""
    estimates = estimates or {}
    layers = {}
    for layer in _records(estimates):
        values = layer.values(band, estimates)
        if values is not None:
            layers[layer.name] = values[..., 0] if layer.channels == 1 else values
    return layers


def _records(estimates: Estimates) -> list[Layer]:
    """All records, and those of estimates that have none."""
    names = {layer.name for layer in RECORDS}
    others = [
        Layer(name, "mean over what was gathered", _estimate(name), channels=values.shape[2])
        for name, values in estimates.items()
        if name not in names
    ]
    return [*RECORDS, *others]


def fixed_layers(bands: Iterable[Band]) -> dict[str, Floats]:
    """Layers of an image that do not depend on photons."""
    return concatenate_bands([band_layers(band) for band in bands])


def total_radiance(layers: Mapping[str, Floats]) -> Floats:
    """Sum of the light components among some layers."""
    light = [layers[layer.name] for layer in RECORDS if layer.is_light and layer.name in layers]
    return reduce(np.add, light) if light else np.zeros_like(layers["albedo"])


def with_radiance(layers: Mapping[str, Floats]) -> dict[str, Floats]:
    """Layers with their `total_radiance` as the first, ``radiance``."""
    return {"radiance": total_radiance(layers), **layers}


# --- merging of passes ----------------------------------------------------------------------------


def merge_passes(before: dict[str, Floats], layers: dict[str, Floats]) -> dict[str, Floats]:
    """Combination of the layers of earlier passes, {} if there are none, and of another pass."""
    if not before:
        return layers
    merges = _merges()
    return {name: merges[name].combine(before[name], layers[name]) for name in layers}


def merged_layers(combined: dict[str, Floats], n_passes: int) -> dict[str, Floats]:
    """Layers of an image from those that `merge_passes` combined."""
    merges = _merges()
    return {
        name: values / n_passes if merges[name].is_mean else values
        for name, values in combined.items()
    }


def _merges() -> dict[str, Merge]:
    return {layer.name: layer.merge for layer in RECORDS}


# --- estimates from photons -----------------------------------------------------------------------


class FieldEstimates:
    """Caustic of a field, and means of the attributes of its elements, in each pixel."""

    def __init__(self, field: Field) -> None:
        mean = field.flux.mean(axis=1, keepdims=True)
        self._attributes = field.layers
        weighted = [mean * values for values in self._attributes.values()]
        self._densities = field.densities(np.hstack([field.flux, mean, *weighted]))

    def __call__(self, band: Band) -> dict[str, Floats]:
        """Radiance ``caustic`` and means weighted with flux, (rows, width, c) each."""
        densities, of_hit = band.estimates(self._densities)
        return {
            "caustic": band.radiance(densities[:, :3], of_hit),
            **self._means(band, densities[:, 3:], of_hit),
        }

    def _means(
        self, band: Band, densities: Floats, of_hit: NDArray[np.intp] | None
    ) -> dict[str, Floats]:
        red, green, blue = band.hits.weight.T
        weight = (red + green + blue) / 3.0
        sums = band.sums(densities, of_hit, weight=weight[:, np.newaxis])
        total = sums[..., :1]
        means = np.divide(sums[..., 1:], total, out=np.zeros_like(sums[..., 1:]), where=total > 0)
        parts, first = {}, 0
        for name, values in self._attributes.items():
            end = first + values.shape[1]
            parts[name], first = means[..., first:end], end
        return parts


def photon_layers(bands: Iterable[Band], field: Field) -> dict[str, Floats]:
    """Layers of an image that depend on photons."""
    estimates, parts = FieldEstimates(field), []
    for band in bands:
        found = estimates(band)
        parts.append({n: v for n, v in band_layers(band, found).items() if n in found})
    return concatenate_bands(parts)
