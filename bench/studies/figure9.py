"""SJ13's Fig. 9: a close-up of rings at three numbers of photons, beside a reference."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

import photonrelax as pr
from bench.arguments import numbers
from bench.markdown import markdown_table
from photonrelax import gallery
from photonrelax.imaging.image import srgb
from photonrelax.imaging.metrics import flip_map

# The inside of one ring, cm, and the angle that shows it, degrees.
_TARGET, _FOV = (1.55, 0.85, 0.1), 8.5
# Photons emitted to find the share that is stored.
_PILOT = 200_000
_EXPOSURE = 0.3
_GAP = 4


def scene(pixels: int) -> pr.Scene:
    """`rings` with a camera that looks into a ring."""
    wide = gallery.scene("rings", pixels=pixels)
    camera = replace(wide.camera, target=_TARGET, vertical_fov=_FOV)
    # The light of the surroundings would hide noise of caustics.
    return replace(wide, camera=camera, emitters=wide.emitters[:1])


def close_ups(options: argparse.Namespace) -> tuple[list[NDArray], list[list[str]]]:
    """Pictures, the last of them the reference, and rows of the table."""
    rings = scene(options.pixels)
    reference = pr.render_progressive(
        rings,
        n_passes=options.reference_passes,
        photons_per_pass=options.photons_per_pass,
        seed=1,
        n_threads=options.threads,
    ).layers["radiance"]
    share = len(pr.trace_photons(rings, _PILOT)) / _PILOT
    pictures, rows = [], []
    for n in options.photons:
        started = perf_counter()
        image = pr.render(rings, n_emitted=round(n / share), n_global=0, n_threads=options.threads)
        seconds, stored = perf_counter() - started, image.stats["stages"]["trace"]["stored"]
        radiance = image.layers["radiance"]
        error = np.abs(radiance - reference).sum() / reference.sum()
        flip = flip_map(_shown(radiance), _shown(reference)).mean()
        rows.append([f"{stored:,.0f}", f"{100 * error:.2f} %", f"{flip:.4f}", f"{seconds:.0f} s"])
        pictures.append(radiance)
    return [*pictures, reference], rows


def _shown(radiance: NDArray) -> NDArray:
    return np.clip(2.0**_EXPOSURE * radiance, 0.0, 1.0)


def write(pictures: list[NDArray], path: Path) -> None:
    """Write pictures side by side as a PNG file."""
    from PIL import Image

    gap = np.ones((len(pictures[0]), _GAP, 3))
    row = [part for picture in pictures for part in (gap, srgb(_shown(picture)))][1:]
    Image.fromarray(np.rint(255 * np.hstack(row)).astype(np.uint8)).save(path)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the study."""
    parser.add_argument("-o", "--output", type=Path, default=Path("figure9.png"))
    parser.add_argument("--photons", type=numbers, default=[134_000, 670_000, 3_300_000])
    parser.add_argument("--pixels", type=int, default=200)
    parser.add_argument("--reference-passes", type=int, default=60)
    parser.add_argument("--photons-per-pass", type=int, default=1_000_000)
    parser.add_argument("--threads", type=int, help="all by default")


def run(options: argparse.Namespace) -> None:
    """Write the picture and print the table."""
    pictures, rows = close_ups(options)
    write(pictures, options.output)
    titles = ["photons", "relative L1", "FLIP", "time"]
    print(f"{markdown_table(titles, rows)}\n\nwrote {options.output}")
