"""Changes between neighbouring frames of `pool`, over those of frames of many photons."""

from __future__ import annotations

import argparse
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bench.markdown import markdown_table
from photonrelax import gallery
from photonrelax.estimation.methods import DEFAULT_METHOD
from photonrelax.imaging.metrics import flip_map
from photonrelax.rendering.animation import Animation

# What of the scene changes from frame to frame with the water.
_COMPONENTS = ("emission", "direct", "caustic")


def changes(frames: list[NDArray]) -> list[float]:
    """FLIP between neighbours."""
    shown = [np.clip(frame, 0.0, 1.0) for frame in frames]
    return [float(flip_map(b, a).mean()) for a, b in pairwise(shown)]


def frames(options: argparse.Namespace, n_emitted: int, seeds: list[int], method: str) -> list:
    """Frames with photons that leave alike, or with a seed each that is their own."""
    times = [number / options.fps for number in range(options.frames)]
    build = partial(gallery.scene, "pool", pixels=options.pixels)
    found = []
    for number in range(len(times)):
        animation = Animation(
            lambda time: build(time=time),
            times,
            n_emitted=n_emitted,
            n_global=0,
            components=_COMPONENTS,
            method=method,
            seed=seeds[number],
        )
        found.append(animation.frame(number).layers["radiance"])
    return found


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the study."""
    parser.add_argument("--frames", type=int, default=4)
    parser.add_argument("--fps", type=float, default=24.0)
    parser.add_argument("--pixels", type=int, default=200)
    parser.add_argument("--photons", type=lambda text: int(float(text)), default=1_000_000)
    parser.add_argument("--reference", type=lambda text: int(float(text)), default=10_000_000)


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    alike, apart = [0] * options.frames, list(range(options.frames))
    reference = changes(frames(options, options.reference, alike, "standard"))
    rows = [["reference", f"{options.reference:,}", f"{np.mean(reference):.4f}", ""]]
    for name, seeds in (("photons that leave alike", alike), ("a seed for each frame", apart)):
        found = changes(frames(options, options.photons, seeds, DEFAULT_METHOD))
        ratio = np.divide(found, reference)
        rows.append([name, f"{options.photons:,}", f"{np.mean(found):.4f}", f"{ratio.max():.2f}"])
    print(markdown_table(["frames", "photons", "FLIP, mean", "largest ratio"], rows))
