"""Changes of the caustic of `cognac` where its glass and liquid have twice the facets."""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

import photonrelax as pr
from bench.markdown import markdown_table
from photonrelax import gallery

Floats = NDArray[np.float64]

# The caustic on the table, dm, in blocks as large as 8 x 8 pixels of the picture there.
_LOW, _HIGH, _BLOCK = np.array([0.03, -0.87]), np.array([0.47, -0.38]), 0.0225
# Least mean irradiance of blocks that count, over that of all.
_LEAST = 0.1
# Standard deviations that are doubt.
_DOUBT = 2.0


def blocks(n: int, seeds: int, **sizes: int) -> tuple[Floats, Floats]:
    """Mean irradiance of blocks by counted photons, and its standard error over seeds."""
    scene = gallery.scene("cognac", **sizes)
    counts = np.round((_HIGH - _LOW) / _BLOCK).astype(int)
    edges = [np.linspace(*ends) for ends in zip(_LOW, _HIGH, counts + 1, strict=True)]
    maps = []
    for seed in range(seeds):
        photons = pr.trace_photons(scene, n, seed=seed)
        x, y = photons.position[photons.object_id == 0, :2].T
        flux = photons.flux[photons.object_id == 0].mean(axis=1)
        maps.append(np.histogram2d(x, y, edges, weights=flux)[0] / _BLOCK**2)
    found = np.array(maps)
    return found.mean(axis=0), found.std(axis=0, ddof=1) / np.sqrt(seeds)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the study."""
    parser.add_argument("--photons", type=lambda text: int(float(text)), default=3_000_000)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--sections", type=int, default=512)
    parser.add_argument("--rings", type=int, default=256)


def run(options: argparse.Namespace) -> None:
    """Print the table: changes from half as many facets, and to twice as many."""
    sizes = [
        {"sections": int(scale * options.sections), "rings": int(scale * options.rings)}
        for scale in (0.5, 1, 2)
    ]
    found = [blocks(options.photons, options.seeds, **each) for each in sizes]
    rows = []
    for i, j in ((0, 1), (1, 2)):
        (before, doubt_before), (after, doubt_after) = found[i], found[j]
        bright = after > _LEAST * after.mean()
        change = np.abs(after - before)[bright] / after[bright]
        doubt = np.hypot(doubt_before, doubt_after)[bright] / after[bright]
        beyond = np.maximum(change - _DOUBT * doubt, 0.0)
        names = [" x ".join(str(value) for value in sizes[k].values()) for k in (i, j)]
        values = np.median(change), np.median(doubt), beyond.max(), (beyond > 0.02).sum()
        rows.append(
            [*names, str(bright.sum()), *(f"{100 * v:.2f} %" for v in values[:3]), values[3]]
        )
    titles = [
        *("facets", "facets then", "blocks", "median change", "median doubt"),
        *("largest change beyond two of doubt", "blocks with more than 2 %"),
    ]
    print(markdown_table(titles, [[str(cell) for cell in row] for row in rows]))
