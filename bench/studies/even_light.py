"""Noise of even light from photons relaxed to the density of their map, and to an even one."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from tests.helpers.photon_maps import endless_map, even_points

import photonrelax as pr
from bench.arguments import numbers
from bench.markdown import markdown_table

_PLAIN = (7, 7)
# Method and iterations.
_SETTINGS = (
    ("parameterised", (5, 5)),
    ("mapped", (5, 5)),
    ("mapped", (7, 7)),
    ("mapped", (14, 14)),
)
# Photons of a pixel; none at points.
_OF_PIXEL = (0.0, 0.6, 2.5, 10.0)
_POINTS = 10_000


def relaxed(photons: pr.PhotonMap, method: str, iterations: tuple[int, int]) -> pr.PhotonMap:
    """Photons after some iterations of a method."""
    structure = pr.detect_structure(photons)
    if method == "mapped":
        settings = pr.RelaxSettings(iterations, step=2.0)
        return pr.relax(photons, structure, settings, rest=pr.rest_density(photons))
    return pr.relax(photons, structure, pr.RelaxSettings(iterations))


def noise(photons: pr.PhotonMap, n: int, k: int, seed: int) -> NDArray:
    """Variance over the squared mean of estimates at points, and in pixels, of n photons a m²."""
    field = pr.irradiance_field(photons, method="standard", gather=pr.GatherSettings(k=k))
    points, normals = even_points(_POINTS, seed)
    found = []
    for of_pixel in _OF_PIXEL:
        footprint = np.full(_POINTS, np.sqrt(of_pixel / n)) if of_pixel else None
        values = field(points, normals, footprint=footprint)[:, 0]
        found.append(values.var() / values.mean() ** 2)
    return np.array(found)


def rows(options: argparse.Namespace) -> Iterator[list[str]]:
    """Yield the rows of the table."""
    n = options.photons[0]
    for kind in ("halton", "random"):
        maps = [endless_map(n, kind, seed) for seed in range(options.seeds)]

        def deviation(
            method: str, iterations: tuple[int, int], maps: list[pr.PhotonMap] = maps
        ) -> NDArray:
            found = (
                noise(relaxed(photons, method, iterations), n, options.k, seed)
                for seed, photons in enumerate(maps)
            )
            return np.sqrt(np.mean(list(found), axis=0))

        plain = deviation("parameterised", _PLAIN)
        yield [kind, f"parameterised {_PLAIN}", *(f"{each:.2%}" for each in plain)]
        for method, iterations in _SETTINGS:
            ratios = deviation(method, iterations) / plain
            yield [kind, f"{method} {iterations}", *(f"{each:.2f}" for each in ratios)]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the number of photons, of seeds and of photons of an estimate."""
    parser.add_argument("--photons", type=numbers, default=[20_000])
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--k", type=int, default=8)


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    pixels = (f"pixels of {each:g}" for each in _OF_PIXEL[1:])
    table = markdown_table(["photons", "relaxed", "points", *pixels], rows(options))
    print(
        f"{table}\n\n{options.photons[0]:,} photons over a square that repeats, k = {options.k}: "
        f"standard deviation over the mean of parameterised {_PLAIN}, and of others over that; at "
        f"points and in pixels of so many photons, over {options.seeds} seeds.\n"
    )
