"""What a camera sees, traced once and kept, and the layers photons make of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ._arrays import Floats
from .camera import FirstSurfaces, HitPoints, direct_irradiance, trace_hit_points
from .estimate import Field
from .raycast import RayCaster
from .scene import Camera, Scene

# Camera rays followed at a time, which bounds the memory a picture takes.
_RAYS_PER_BAND = 400_000


@dataclass(frozen=True, eq=False)
class Band:
    """Some rows of a picture: the points seen, and all that does not depend on photons.

    Attributes
    ----------
    rows : range
        Of the picture, row 0 at the top.
    width : int
        Of the picture.
    hits : HitPoints
        The diffuse points seen.
    first : FirstSurfaces
        Normal and depth of the first surface.
    direct : (m, 3)
        Irradiance at the hit points from emitters in plain sight, W/m².
    """

    rows: range
    width: int
    hits: HitPoints
    first: FirstSurfaces
    direct: Floats

    def fixed_layers(self) -> dict[str, Floats]:
        """Return the layers that need no photons."""
        return {
            "direct": self.radiance(self.direct),
            "albedo": self.sums(self.hits.weight * self.hits.albedo),
            "N": self.first.normal,
            "Z": self.first.depth,
        }

    def radiance(self, irradiance: Floats) -> Floats:
        """Return radiance (rows, width, 3) of irradiance (m, 3) at the hit points."""
        return self.sums(self.hits.weight * self.hits.albedo / np.pi * irradiance)

    def sums(self, values: Floats) -> Floats:
        """Return the sums (rows, width, c) over the hit points of each pixel."""
        pixel = self.hits.pixel - self.rows.start * self.width
        sums = np.zeros((len(self.rows) * self.width, values.shape[1]))
        for channel, column in enumerate(values.T):
            sums[:, channel] = np.bincount(pixel, column, minlength=len(sums))
        return sums.reshape(len(self.rows), self.width, -1)


def bands(
    scene: Scene,
    camera: Camera,
    *,
    supersampling: int,
    max_depth: int,
    n_threads: int,
    offset: tuple[float, float] = (0.5, 0.5),
    caster: RayCaster | None = None,
) -> Iterator[Band]:
    """Yield what a camera sees, from the top down, so many rows at a time as memory allows.

    Where samples are in the cells of their pixel's grid is `offset`; see `camera.pixel_rays`.
    Making the caster of the scene's objects takes time, unless it is given.
    """
    caster = caster or RayCaster(scene.objects)
    rows_per_band = max(_RAYS_PER_BAND // (camera.width * supersampling**2), 1)
    for top in range(0, camera.height, rows_per_band):
        rows = range(top, min(top + rows_per_band, camera.height))
        hits, first = trace_hit_points(
            scene,
            caster,
            camera,
            rows,
            supersampling=supersampling,
            offset=offset,
            max_depth=max_depth,
            n_threads=n_threads,
        )
        direct = direct_irradiance(scene, caster, hits.position, hits.normal, n_threads=n_threads)
        yield Band(rows, camera.width, hits, first, direct)


def resized(scene: Scene, width: int | None, height: int | None) -> Scene:
    """Return a scene with pictures of another size; in proportion if one side alone is given."""
    camera = scene.camera
    if camera is None:
        raise ValueError("scene should have a camera to be resized")
    if width is None and height is None:
        return scene
    if width is None or height is None:
        scale = (width or camera.width) / camera.width * (height or camera.height) / camera.height
        width = max(round(scale * camera.width), 1)
        height = max(round(scale * camera.height), 1)
    return replace(scene, camera=replace(camera, width=width, height=height))


def joined(parts: list[dict[str, Floats]]) -> dict[str, Floats]:
    """Return the layers of a picture whose bands are given from the top down."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


class PhotonLayers:
    """What the photons of a field make of a picture: light, and means of what they carry."""

    def __init__(self, field: Field) -> None:
        photons = field.photons
        mean = photons.flux.mean(axis=1, keepdims=True)
        self._attributes = photon_attributes(field)
        weighted = [mean * values for values in self._attributes.values()]
        self._densities = field.densities(np.hstack([photons.flux, mean, *weighted]))

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


def photon_attributes(field: Field) -> dict[str, Floats]:
    """Return what photons carry beside flux, by layer, each (n, 1) or (n, 3)."""
    photons, attributes = field.photons, {}
    if field.structure is not None:
        attributes["photons.constraint"] = field.structure.constraint[:, np.newaxis]
    if photons.emitter_coords is not None:
        attributes["photons.emitter"] = emitter_colours(photons.emitter_coords)
    if photons.n_bounces is not None:
        attributes["photons.bounces"] = photons.n_bounces[:, np.newaxis].astype(np.float64)
    return attributes


def emitter_colours(emitter_coords: Floats) -> Floats:
    """Return emitter coordinates as colours (n, 3) in [0, 1], for pictures as SJ13 Fig. 6e.

    Each coordinate is stretched over the range it has in the map; on emitter planes blue falls
    as red and green rise.
    """
    low = emitter_coords.min(axis=0, initial=np.inf)
    extent = emitter_coords.max(axis=0, initial=-np.inf) - low
    colours = np.divide(
        emitter_coords - low, extent, out=np.zeros_like(emitter_coords), where=extent > 0.0
    )
    if colours.shape[1] == 2:
        colours = np.column_stack([colours, 1.0 - colours.mean(axis=1)])
    return colours
