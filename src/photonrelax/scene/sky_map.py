"""Light from all around, by a latitude–longitude map.

Radiance is the same all over a texel. Texels are sampled by luminance times solid angle, and are
uniform in solid angle within: all samples stand for the same luminance, and differ in colour.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .._ext.scene.sky_map import SkyMap as SkyMapKernel
from .._util.validation import Floats

# Texels along the longer edge of a footprint at most, before coarser ones are taken; samples along
# it for each of these, and at least.
_MAX_EXTENT, _SAMPLES, _LEAST = 8.0, 2.0, 8

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Weights of red, green and blue in the luminance (Rec. 709)."""


@dataclass(frozen=True, eq=False)
class SkyMap:
    """A map of radiance: row 0 towards +z, column j of w at azimuth π (1 - 2 (j + ½) / w).

    Azimuths are from +x to +y.

    Attributes
    ----------
    radiance : (h, w, 3) float64
        W/(m² sr).
    """

    radiance: Floats

    @cached_property
    def _heights(self) -> Floats:
        """Heights of unit vectors to the edges of the rows (h + 1,)."""
        heights: Floats = np.cos(np.pi * np.arange(len(self.radiance) + 1) / len(self.radiance))
        return heights

    @cached_property
    def _solid_angle(self) -> Floats:
        """Of a texel in each row (h,), sr."""
        solid_angle: Floats = -2.0 * np.pi / self.radiance.shape[1] * np.diff(self._heights)
        return solid_angle

    @cached_property
    def flux_per_area(self) -> Floats:
        """Integral (3,) of the radiance over all directions, W/m²."""
        return np.einsum("hwc,h->c", self.radiance, self._solid_angle)

    @cached_property
    def irradiance_up(self) -> Floats:
        """Irradiance (3,) of a plate that faces up, W/m²."""
        square = np.square(np.maximum(self._heights, 0.0))
        projected = -np.pi / self.radiance.shape[1] * np.diff(square)
        return np.einsum("hwc,h->c", self.radiance, projected)

    @cached_property
    def cumulative(self) -> tuple[Floats, Floats]:
        """Shares of the luminance up to each row (h,), and in each row up to each column (h, w)."""
        light = self.radiance @ LUMINANCE * self._solid_angle[:, np.newaxis]
        if not light.any():
            light = np.tile(self._solid_angle[:, np.newaxis], (1, light.shape[1]))
        rows, columns = np.cumsum(light.sum(axis=1)), np.cumsum(light, axis=1)
        # No sample is in a row without light.
        columns[columns[:, -1] == 0.0] = 1.0
        return rows / rows[-1], np.ascontiguousarray(columns / columns[:, -1:])

    @cached_property
    def colours(self) -> Floats:
        """Flux (h w, 3) of a photon of each texel over that of the mean photon."""
        flux = self.flux_per_area
        radiance = self.radiance.reshape(-1, 3)
        with np.errstate(invalid="ignore", divide="ignore"):
            colours = radiance / (radiance @ LUMINANCE)[:, np.newaxis] * (flux @ LUMINANCE / flux)
        return np.nan_to_num(colours, copy=False, nan=0.0)

    def kernel(self) -> SkyMapKernel:
        """The map for kernels that sample it."""
        return SkyMapKernel(*self.cumulative)

    def seen(self, direction: Floats) -> Floats:
        """Radiance (m, 3) in the directions of unit vectors (m, 3)."""
        return self.radiance.reshape(-1, 3)[self.kernel().texels(direction)]

    def means(self, direction: Floats, edges: Floats) -> Floats:
        """Means (m, 3) of the radiance over parallelograms around unit vectors (m, 3).

        `edges` (m, 2, 3) are changes of the vectors. Means are of a grid of directions; where
        texels are much smaller than the parallelogram, of those of a coarser map.
        """
        size = np.pi * min(1.0 / self.radiance.shape[0], 2.0 / self.radiance.shape[1])
        extent = np.linalg.norm(edges, axis=2).max(axis=1, initial=0.0) / size
        level = np.ceil(np.log2(np.maximum(extent / _MAX_EXTENT, 1.0))).astype(int)
        level = np.minimum(level, self._max_level)
        wanted = np.clip(_SAMPLES * extent / 2.0**level, _LEAST, _SAMPLES * _MAX_EXTENT)
        n_points = np.ceil(wanted).astype(np.int64)
        out = np.empty_like(direction)
        for coarse in np.unique(level).tolist():
            some, sky = np.flatnonzero(level == coarse), self._halved(coarse)
            texels = np.ascontiguousarray(sky.radiance.reshape(-1, 3))
            points = direction[some], edges[some], n_points[some]
            out[some] = sky.kernel().means(texels, *points)
        return out

    @property
    def _max_level(self) -> int:
        """Number of times that the map can be halved."""
        return int(np.ceil(np.log2(max(self.radiance.shape[:2]))))

    def _halved(self, times: int) -> SkyMap:
        """The map of the same light with half as many rows and columns, a number of times."""
        return self if times == 0 else self._half._halved(times - 1)

    @cached_property
    def _half(self) -> SkyMap:
        weight = np.broadcast_to(self._solid_angle[:, np.newaxis, np.newaxis], self.radiance.shape)
        light, area = (_halved(_halved(each, 0), 1) for each in (self.radiance * weight, weight))
        return SkyMap(np.ascontiguousarray(light / area))

    def sampled(self, sample: Floats) -> tuple[Floats, Floats]:
        """Unit vectors (m, 3) by luminance, for samples (m, 2), and irradiances (m, 3), W/m².

        The mean of the irradiances, by the cosine, is that of a plate.
        """
        direction, texel = self.kernel().directions(np.ascontiguousarray(sample))
        return direction, self.flux_per_area * self.colours[texel]


def _halved(values: Floats, axis: int) -> Floats:
    """Sums of values along an axis in half as many intervals, rounded up, of equal widths."""
    values = np.moveaxis(values, axis, 0)
    n = len(values)
    summed = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    edge = np.linspace(0.0, n, -(-n // 2) + 1)
    below = np.minimum(edge.astype(int), n - 1)
    part = (edge - below)[:, np.newaxis, np.newaxis]
    sums: Floats = np.diff(summed[below] + part * values[below], axis=0)
    return np.moveaxis(sums, 0, axis)
