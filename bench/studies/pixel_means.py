"""Means over texels and pixels against counted photons: errors at points and over footprints."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import photonrelax as pr
from bench.arguments import numbers
from bench.markdown import markdown_table
from photonrelax import gallery
from photonrelax.estimation.methods import METHODS, PHOTON_METHODS
from photonrelax.estimation.refinement import REFINEMENTS as ALL_REFINEMENTS
from photonrelax.rendering.view import View, resized
from photonrelax.transport.raycast import RayCaster

SCENES = ("ring", "sphere", "ripples", "prism")
# Refinements, and their largest number of photons.
REFINEMENTS = tuple(name for name in ALL_REFINEMENTS if name != "none")
MOST_PHOTONS = 200
# Share of the photons that lie beyond the map on each side.
_MARGIN = 0.02
# Cells a side of a texel that photons are counted in.
_CELLS = 4
# Samples a side of a pixel that tell what it sees, and of the pictures compared.
_LOOKS, _SAMPLES = 8, 2
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Study:
    """Scenes, numbers of photons emitted, methods and refinements of the standard one; texels and
    pixels a side; k; passes.
    """

    scenes: tuple[str, ...] = SCENES
    photons: tuple[int, ...] = (300_000, 1_000_000, 3_000_000)
    methods: tuple[str, ...] = (*PHOTON_METHODS, *REFINEMENTS)
    texels: int = 350
    pixels: int = 300
    k: int = 15
    reference_passes: int = 40
    photons_per_pass: int = 2_000_000


class Errors(NamedTuple):
    """Root mean square error over the mean, relative L1, and total energy over the reference's."""

    rms: float
    l1: float
    energy: float

    @classmethod
    def of(cls, image: NDArray, reference: NDArray) -> Errors:
        """Errors of an image of one channel, where its reference is known."""
        known = np.isfinite(reference)
        image, reference = image[known], reference[known]
        error = image - reference
        return cls(
            float(np.sqrt(np.mean(error**2)) / reference.mean()),
            float(np.abs(error).sum() / reference.sum()),
            float(image.sum() / reference.sum()),
        )


@dataclass(frozen=True)
class FloorMap:
    """Square texels on the floor of a scene, around its caustic.

    Attributes
    ----------
    low : (2,)
        Corner of least x and y, m.
    side : float
        Of the map, m.
    height : float
        z of the floor, m.
    texels : int
        Of a side.
    """

    low: NDArray
    side: float
    height: float
    texels: int

    @classmethod
    def of(cls, photons: pr.PhotonMap, texels: int) -> FloorMap:
        """Map that holds most photons on the lowest surface that faces up."""
        height = float(np.median(photons.position[_on_floor(photons), 2]))
        xy = photons.position[_on_floor(photons), :2]
        low, high = np.quantile(xy, [_MARGIN, 1.0 - _MARGIN], axis=0)
        side = float((high - low).max())
        return cls((low + high - side) / 2.0, side, height, texels)

    def counted(self, photons: pr.PhotonMap) -> NDArray:
        """Flux of the photons in each cell of the texels over its area, row 0 at least y."""
        there = _on_floor(photons)
        cells = _CELLS * self.texels
        x, y = ((photons.position[there, :2] - self.low) / self.side * cells).T
        counts, _, _ = np.histogram2d(
            *(y, x), bins=cells, range=[(0, cells)] * 2, weights=photons.flux[there].mean(axis=1)
        )
        return counts / (self.side / cells) ** 2

    def holds(self, points: NDArray) -> NDArray[np.bool_]:
        """Whether points (m, 3) are on the map."""
        offset = points - [*self.low, self.height]
        inside: NDArray[np.bool_] = (offset[:, :2] >= 0.0).all(axis=1)
        inside &= (offset[:, :2] < self.side).all(axis=1)
        return inside & (np.abs(offset[:, 2]) < 1e-6 * self.side)

    def means(self, field: pr.Field) -> NDArray:
        """Means of a field over the texels."""
        corner, u, v = self.frame
        return pr.irradiance_map(field, corner, u, v, (self.texels, self.texels)).mean(axis=2)

    def points(self, field: pr.Field) -> NDArray:
        """Means of a field at 2 x 2 points in each texel."""
        n = 2 * self.texels
        at = (np.arange(n) + 0.5) / n * self.side
        y, x = np.meshgrid(self.low[1] + at, self.low[0] + at, indexing="ij")
        points = np.stack([x, y, np.full_like(x, self.height)], axis=-1).reshape(-1, 3)
        normals = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
        values = field(points, normals).mean(axis=1)
        return values.reshape(self.texels, 2, self.texels, 2).mean(axis=(1, 3))

    @property
    def frame(self) -> tuple[NDArray, NDArray, NDArray]:
        """Corner and sides, (3,) each."""
        corner = np.array([*self.low, self.height])
        return corner, np.array([self.side, 0.0, 0.0]), np.array([0.0, self.side, 0.0])


def _on_floor(photons: pr.PhotonMap) -> NDArray[np.bool_]:
    up: NDArray[np.bool_] = photons.normal[:, 2] > 0.999
    return up


def reference(study: Study, scene: pr.Scene, caster: RayCaster, floor: FloorMap) -> NDArray:
    """Counted means of two halves of the passes in the cells of texels."""
    return counted_halves(study, scene, caster, floor.counted)[0]


def counted_halves(
    study: Study,
    scene: pr.Scene,
    caster: RayCaster,
    *counters: Callable[[pr.PhotonMap], NDArray],
) -> list[NDArray]:
    """Means over even and over odd passes of what each of some counters makes of their photons."""
    sums: list[list[NDArray | float]] = [[0.0, 0.0] for _ in counters]
    for number in range(study.reference_passes):
        # Far from the seeds of the maps compared.
        photons = pr.trace_photons(scene, study.photons_per_pass, seed=1000 + number, caster=caster)
        for total, counter in zip(sums, counters, strict=True):
            total[number % 2] = total[number % 2] + counter(photons)
    return [np.array(total) / (study.reference_passes / 2) for total in sums]


def texel_means(cells: NDArray) -> NDArray:
    """Means over texels of the values of their cells."""
    n = len(cells) // _CELLS
    return cells.reshape(n, _CELLS, n, _CELLS).mean(axis=(1, 3))


class Film:
    """Pixels of a pinhole camera, onto which points in space are projected."""

    def __init__(self, camera: pr.Camera) -> None:
        self._right, self._up, self._forward = camera.axes()
        self._origin = np.asarray(camera.origin)
        # Pixels in a unit of the film at a distance of 1 m.
        self._scale = 0.5 * camera.height / np.tan(np.radians(0.5 * camera.vertical_fov))
        self.shape = camera.height, camera.width

    def project(self, points: NDArray, up: NDArray) -> tuple[NDArray, NDArray]:
        """Pixels (m,), -1 off the image, and pixels in an area of 1 m² at points facing up."""
        height, width = self.shape
        offset = points - self._origin
        depth = offset @ self._forward
        with np.errstate(divide="ignore", invalid="ignore"):
            x = 0.5 * width + self._scale * (offset @ self._right) / depth
            y = 0.5 * height - self._scale * (offset @ self._up) / depth
            density = self._scale**2 * np.abs(offset @ up) / depth**3
        seen = (depth > 0.0) & (x >= 0.0) & (x < width) & (y >= 0.0) & (y < height)
        pixel = np.full(len(points), -1)
        pixel[seen] = np.floor(y[seen]).astype(int) * width + np.floor(x[seen]).astype(int)
        return pixel, density


class Pictures:
    """Caustics that the camera of a scene sees, one channel."""

    def __init__(self, scene: pr.Scene, floor: FloorMap, pixels: int) -> None:
        self._scene = resized(scene, pixels, None)
        self._film = Film(self._scene.camera)
        self._bands = list(View(self._scene, supersampling=_SAMPLES).bands())
        self._reflectance = self._reflectance_of(floor)

    def _reflectance_of(self, floor: FloorMap) -> NDArray:
        """Radiance over irradiance (height, width), NaN unless pixels see all of them the map.

        Past no other object, and neither through glass nor in a mirror.
        """
        parts = []
        for band in View(self._scene, supersampling=_LOOKS).bands():
            pixel, _ = self._film.project(band.hits.position, _UP)
            there = floor.holds(band.hits.position) & (pixel == band.hits.pixel)
            parts.append(band.sums(np.column_stack([there, band.reflectance.mean(axis=1)])))
        n_seen, reflectance = np.moveaxis(np.concatenate(parts), 2, 0)
        return np.where(n_seen == _LOOKS**2, reflectance, np.nan)

    def counted(self, photons: pr.PhotonMap) -> NDArray:
        """Means over the pixels of the photons' flux over the area that it lands on."""
        there = _on_floor(photons)
        pixel, density = self._film.project(photons.position[there], _UP)
        flux = photons.flux[there].mean(axis=1) * density
        height, width = self._film.shape
        sums = np.bincount(pixel[pixel >= 0], flux[pixel >= 0], minlength=height * width)
        return self._reflectance * sums.reshape(height, width)

    def points(self, field: pr.Field) -> NDArray:
        """Means of a field at the samples of each pixel."""
        at_hits = [(field(band.hits.position, band.hits.normal), None) for band in self._bands]
        return self._picture(at_hits)

    def means(self, field: pr.Field) -> NDArray:
        """Means of a field over the pixels, as of `render`."""
        return self._picture([band.estimates(field) for band in self._bands])

    def _picture(self, estimates: list[tuple[NDArray, NDArray | None]]) -> NDArray:
        """The picture of estimates, and of which of them each hit point has."""
        pairs = zip(self._bands, estimates, strict=True)
        return np.concatenate([band.radiance(*found).mean(axis=2) for band, found in pairs])


def rows(study: Study) -> Iterator[list[str]]:
    """Yield the rows of the table."""
    for name in study.scenes:
        scene = gallery.scene(name)
        caster = RayCaster(scene.objects)
        floor = FloorMap.of(pr.trace_photons(scene, 100_000, caster=caster), study.texels)
        pictures = Pictures(scene, floor, study.pixels)
        cells, of_film = counted_halves(study, scene, caster, floor.counted, pictures.counted)
        texels, pixels = texel_means(cells.mean(axis=0)), of_film.mean(axis=0)
        doubts = Errors.of(*map(texel_means, cells)), Errors.of(*of_film)
        of_texels, of_pixels = (f"{d.rms / 2:.3f} {d.l1 / 2:.3f}" for d in doubts)
        yield [name, "reference", "", "", of_texels, "", of_pixels]
        for n in study.photons:
            photons = pr.trace_photons(
                scene, n, caster=caster, frequency_share=pr.FrequencySettings().share
            )
            for method in study.methods:
                field = field_of(study, photons, method, scene)
                found = (
                    Errors.of(floor.points(field), texels),
                    Errors.of(floor.means(field), texels),
                    Errors.of(pictures.points(field), pixels),
                    Errors.of(pictures.means(field), pixels),
                )
                yield [name, method, f"{n:,}", *map(_cell, found)]


def field_of(study: Study, photons: pr.PhotonMap, name: str, scene: pr.Scene) -> pr.Field:
    """Field of a method, or of a refinement of the standard estimate."""
    if name in METHODS:
        gather = pr.GatherSettings(k=study.k)
        return pr.irradiance_field(photons, method=name, scene=scene, gather=gather)
    gather = pr.GatherSettings(k=MOST_PHOTONS, refinement=name)
    return pr.irradiance_field(photons, method="standard", scene=scene, gather=gather)


def _cell(errors: Errors) -> str:
    return f"{errors.rms:.3f} {errors.l1:.3f} {100 * (errors.energy - 1):+.2f} %"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the scenes, the numbers of photons, and the size of references."""
    default = Study()
    parser.add_argument("--scenes", default=",".join(default.scenes))
    parser.add_argument("--photons", type=numbers, default=list(default.photons))
    parser.add_argument("--methods", default=",".join(default.methods))
    parser.add_argument("--k", type=int, default=default.k)
    parser.add_argument("--reference-passes", type=int, default=default.reference_passes)


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    study = Study(
        scenes=tuple(options.scenes.split(",")),
        photons=tuple(options.photons),
        methods=tuple(options.methods.split(",")),
        k=options.k,
        reference_passes=options.reference_passes,
    )
    print(markdown(study))


def markdown(study: Study) -> str:
    """Table of the study."""
    titles = [
        *("scene", "method", "emitted", "texels, 2 x 2 points", "texels, footprints"),
        *("pixels, 2 x 2 points", "pixels, footprints"),
    ]
    return (
        f"{markdown_table(titles, rows(study))}\n\nRoot mean square error over the mean, relative "
        f"L1 and total energy, against {study.reference_passes} counted passes of "
        f"{study.photons_per_pass:,} photons; {study.texels} x {study.texels} texels of the floor, "
        f"and pixels of a picture {study.pixels} wide that see nothing else, whose photons are "
        "counted where they are projected to. Reference: half the difference between the halves "
        "of its passes.\n"
    )
