"""Changes of the caustic of `cognac` where its glass and liquid have twice the facets."""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

import photonrelax as pr
from bench.markdown import markdown_table
from photonrelax import gallery
from photonrelax.scene.casters import common_targets

Floats = NDArray[np.float64]

# The caustic on the table, dm, in blocks as large as 8 x 8 pixels of the picture there.
_LOW, _HIGH, _BLOCK = np.array([0.03, -0.87]), np.array([0.47, -0.38]), 0.0225
# Least mean irradiance of blocks that count, over that of all.
_LEAST = 0.1
# Standard errors that are doubt, and the change beyond it that shows.
_DOUBT, _ALLOWED = 2.0, 0.02


def blocks(scene: pr.Scene, n: int, seeds: int) -> Floats:
    """Mean irradiance (seeds, …) of blocks by counted photons."""
    counts = np.round((_HIGH - _LOW) / _BLOCK).astype(int)
    edges = [np.linspace(*ends) for ends in zip(_LOW, _HIGH, counts + 1, strict=True)]
    maps = []
    for seed in range(seeds):
        photons = pr.trace_photons(scene, n, seed=seed)
        x, y = photons.position[photons.object_id == 0, :2].T
        flux = photons.flux[photons.object_id == 0].mean(axis=1)
        maps.append(np.histogram2d(x, y, edges, weights=flux)[0] / _BLOCK**2)
    return np.array(maps)


def row(before: Floats, after: Floats) -> list[str]:
    """Changes of blocks from one tessellation to another."""
    mean, difference = after.mean(axis=0), after - before
    bright = mean > _LEAST * mean.mean()
    change = np.abs(difference.mean(axis=0))[bright] / mean[bright]
    # Photons of a seed leave alike for both, so that most of their noise cancels.
    error = difference.std(axis=0, ddof=1)[bright] / np.sqrt(len(after)) / mean[bright]
    beyond = np.maximum(change - _DOUBT * error, 0.0)
    values = (np.median(change), np.median(error), beyond.max())
    return [
        str(bright.sum()),
        *(f"{100 * v:.2f} %" for v in values),
        str((beyond > _ALLOWED).sum()),
    ]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the study."""
    parser.add_argument("--photons", type=lambda text: int(float(text)), default=1_000_000)
    parser.add_argument("--seeds", type=int, default=16)
    parser.add_argument("--sections", type=int, default=512)
    parser.add_argument("--rings", type=int, default=256)
    parser.add_argument("--scales", type=_scales, default=(0.5, 1.0, 2.0), help="of both")


def _scales(text: str) -> tuple[float, ...]:
    return tuple(float(scale) for scale in text.split(","))


def run(options: argparse.Namespace) -> None:
    """Print the table of changes from each tessellation to the next."""
    sizes = [
        {"sections": int(scale * options.sections), "rings": int(scale * options.rings)}
        for scale in options.scales
    ]
    scenes = [gallery.scene("cognac", **each) for each in sizes]
    aim = common_targets([scene.targets for scene in scenes])
    found = [blocks(replace(scene, aim=aim), options.photons, options.seeds) for scene in scenes]
    names = [" x ".join(str(value) for value in each.values()) for each in sizes]
    rows = [[names[i], names[i + 1], *row(found[i], found[i + 1])] for i in range(len(sizes) - 1)]
    titles = [
        *("facets", "facets then", "blocks", "median change", "median doubt"),
        *("largest change beyond two of doubt", "blocks with more than 2 %"),
    ]
    print(markdown_table(titles, rows))
