"""Noise of colour and of luminance behind plates of glass, by how light is dispersed."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from unittest import mock

import numpy as np
import trimesh
from numpy.typing import NDArray

import photonrelax as pr
from bench.markdown import markdown_table
from photonrelax.scene.sky_map import LUMINANCE
from photonrelax.transport import batch, trace

CROWN, FLINT = pr.Abbe(1.5168, 64.17), pr.Abbe(1.78472, 25.68)
# Thickness of the plates, m: the light of all wavelengths is within a fifth of the distance
# between paths, and within several.
PLATES = {"thin crown": (CROWN, 0.02), "thick flint": (FLINT, 0.5)}
_HEIGHT = 0.3
# Half the side of the part of the floor that is looked at, and its middle, m.
_HALF, _MIDDLE = 0.8, 0.15
# The most neighbours that a map from emitter coordinates is fitted to.
_MOST_MAPPED = 64
# Paths a texel, in the mean: with eight wavelengths 12 and 100 photons.
_PATHS_A_TEXEL = (1.5, 12.5)


@dataclass(frozen=True)
class Way:
    """A way to disperse light.

    Attributes
    ----------
    name : str
    n_wavelengths : int
        Of a path; zero for one index of refraction.
    of_parts : bool
        Photons are neighbours within a part of the spectrum, not among all.
    k : int
        Paths in an estimate.
    """

    name: str
    n_wavelengths: int
    of_parts: bool = True
    k: int = 15


WAYS = (
    Way("one index", 0),
    Way("1 wavelength a path", 1),
    Way("1, k = 120", 1, k=120),
    Way("4, neighbours within a part", 4),
    Way("8, neighbours within a part", 8),
    Way("16, neighbours within a part", 16),
    Way("8, neighbours of all parts", 8, of_parts=False),
)


def scene(glass: float | pr.Abbe, thickness: float) -> pr.Scene:
    """A plate over a floor, in slanting light."""
    at = trimesh.transformations.translation_matrix
    plate = trimesh.creation.box((3.0, 3.0, thickness), at((0.0, 0.0, _HEIGHT + thickness / 2)))
    floor = trimesh.creation.box((8.0, 8.0, 0.1), at((0.0, 0.0, -0.05)))
    return pr.Scene(
        [pr.SceneObject(plate, pr.Dielectric(glass)), pr.SceneObject(floor, pr.Diffuse())],
        [pr.CollimatedEmitter((0.5, 0.2, -1.0))],
    )


def traced(way: Way, glass: pr.Abbe, thickness: float, n_photons: int) -> pr.PhotonMap:
    """Photons of a way, about as many of each."""
    with (
        mock.patch.object(batch, "N_WAVELENGTHS", way.n_wavelengths or 1),
        mock.patch.object(trace, "N_WAVELENGTHS", way.n_wavelengths or 1),
    ):
        used = glass if way.n_wavelengths else glass.index_d
        # With one index as many paths as with eight wavelengths.
        n_paths = n_photons // (way.n_wavelengths or 8)
        return pr.trace_photons(scene(used, thickness), n_paths)


def field(way: Way, photons: pr.PhotonMap, method: str) -> pr.Field:
    """Irradiance by a method, from k paths."""
    if way.of_parts:
        return pr.irradiance_field(photons, method=method, gather=pr.GatherSettings(k=way.k))
    n = way.n_wavelengths
    return pr.irradiance_field(
        photons.replace(n_wavelengths=None),
        method=method,
        structure=pr.StructureSettings(k=50 * n),
        relax=pr.RelaxSettings((5, 5), k=16 * n, step=2.0),
        rest_density=pr.RestDensitySettings(k=_MOST_MAPPED),
        gather=pr.GatherSettings(k=way.k * n),
    )


def means(estimated: pr.Field, side: float) -> NDArray[np.float64]:
    """Means over texels (m, 3) of the middle of the light."""
    places = np.arange(-_HALF, _HALF, side) + _MIDDLE
    x, y = np.meshgrid(places, places - _MIDDLE)
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    up = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    return estimated(points, up, footprint=np.full(len(points), side))


def noise(values: NDArray[np.float64]) -> tuple[float, float]:
    """Rms of the colour's deviation from its mean, over all channels, and of the luminance's."""
    luminance = values @ LUMINANCE
    chromaticity = values / luminance[:, np.newaxis]
    deviation = chromaticity / chromaticity.mean(axis=0) - 1.0
    return float(np.sqrt(np.mean(deviation**2))), float(luminance.std() / luminance.mean())


def spacing_of(photons: pr.PhotonMap) -> float:
    """Distance between paths of eight wavelengths for as many photons, m."""
    seen = (np.abs(photons.position[:, :2] - [_MIDDLE, 0.0]) < _HALF).all(axis=1)
    n_paths = np.count_nonzero(seen) / (8 if photons.wavelength is not None else 1)
    return 2.0 * _HALF / float(np.sqrt(n_paths))


def rows(n_photons: int, methods: tuple[str, ...]) -> Iterator[list[str]]:
    """Noise of each plate, way and method, in texels of both sizes."""
    for plate, (glass, thickness) in PLATES.items():
        for way in WAYS:
            photons = traced(way, glass, thickness, n_photons)
            spacing = spacing_of(photons)
            for method in methods:
                estimated, cells = field(way, photons, method), []
                for paths in _PATHS_A_TEXEL:
                    of_colour, of_luminance = noise(means(estimated, spacing * np.sqrt(paths)))
                    cells += [f"{100 * of_colour:.2f} %", f"{100 * of_luminance:.2f} %"]
                yield [plate, way.name, method, f"{len(photons):,}", *cells]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the study."""
    parser.add_argument("--photons", type=lambda text: int(float(text)), default=320_000)
    parser.add_argument("--methods", default="standard,mapped", help="names, with commas between")


def run(options: argparse.Namespace) -> None:
    """Print the table of noise."""
    print(markdown(options.photons, tuple(options.methods.split(","))))


def markdown(n_photons: int, methods: tuple[str, ...]) -> str:
    """Table of noise by numbers of photons and methods."""
    titles = ["plate", "wavelengths", "method", "stored"]
    for paths in _PATHS_A_TEXEL:
        titles += [f"colour, {8 * paths:g} photons a texel", "luminance"]
    return markdown_table(titles, rows(n_photons, methods))
