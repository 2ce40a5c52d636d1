"""Image layers."""

from __future__ import annotations

import numpy as np

from .._util.validation import Floats
from ..estimation.field import Field
from .view import Band, View, joined


class PhotonLayers:
    """What the photons of a field make of a picture: light, and means of what they carry."""

    def __init__(self, field: Field) -> None:
        mean = field.flux.mean(axis=1, keepdims=True)
        self._attributes = field.layers
        weighted = [mean * values for values in self._attributes.values()]
        self._densities = field.densities(np.hstack([field.flux, mean, *weighted]))

    def __call__(self, band: Band) -> dict[str, Floats]:
        """Return ``caustic`` and the means over photons in each pixel, weighted with flux."""
        hits = band.hits
        densities = self._densities(hits.position, hits.normal)
        return {"caustic": band.radiance(densities[:, :3]), **self._means(band, densities[:, 3:])}

    def _means(self, band: Band, densities: Floats) -> dict[str, Floats]:
        sums = band.sums(band.hits.weight.mean(axis=1, keepdims=True) * densities)
        total = sums[..., :1]
        means = np.divide(sums[..., 1:], total, out=np.zeros_like(sums[..., 1:]), where=total > 0)
        layers, first = {}, 0
        for name, values in self._attributes.items():
            layer = means[..., first : first + values.shape[1]]
            layers[name] = layer[..., 0] if values.shape[1] == 1 else layer
            first += values.shape[1]
        return layers


def photon_layers(view: View, field: Field) -> dict[str, Floats]:
    """Return what the photons of a field carry, as layers, and their caustic."""
    layers = PhotonLayers(field)
    return joined([layers(band) for band in view.bands])


LAYERS = {
    "radiance": "caustic + direct, W/(m² sr)",
    "caustic": "radiance from photons",
    "direct": "radiance from emitters in plain sight",
    "albedo": "of the diffuse surfaces seen",
    "N": "normal of the first surface",
    "Z": "distance of the first surface along the viewing axis, m",
    "photons.constraint": "mean constraint of the photons gathered, in [0, 1]",
    "photons.emitter": "mean of their emitter coordinates as colours (SJ13 Fig. 5c)",
    "photons.bounces": "mean of their specular events",
}
"""What a picture holds; means over photons are weighted with their flux."""


def _layers(band: Band, from_photons: PhotonLayers) -> dict[str, Floats]:
    """Return the layers of some rows, in the order of `LAYERS`."""
    fixed, of_photons = band.fixed_layers(), from_photons(band)
    radiance = of_photons["caustic"] + fixed["direct"]
    return {"radiance": radiance, "caustic": of_photons.pop("caustic"), **fixed, **of_photons}
