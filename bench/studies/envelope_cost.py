"""Time and memory of envelopes of `water`, by rays, elements and triangles that are laid down."""

from __future__ import annotations

import argparse
import tracemalloc
from collections.abc import Iterator, Sequence
from time import process_time

import numpy as np

import photonrelax as pr
from bench.arguments import numbers
from bench.markdown import markdown_table
from bench.studies.slopes import water
from photonrelax.transport.raycast import RayCaster

_RAYS = (100_000, 300_000, 1_000_000)
# Texels along each side of the map, and half that side, m.
_TEXELS, _HALF = 400, 1.0


def rows(n_rays: Sequence[int]) -> Iterator[list[str]]:
    """Yield the rows of the table, and the powers of rays and of elements that seconds rise by."""
    scene = water()
    caster, texel = RayCaster(scene.surfaces), 2.0 * _HALF / _TEXELS
    found = []
    for n in n_rays:
        tracemalloc.start()
        started = process_time()
        envelope = pr.trace_envelope(scene, n_rays=n, footprint=texel, caster=caster)
        traced = process_time()
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        drawing = process_time()
        field = pr.irradiance_field(envelope, method="envelope")
        corner, sides = (-_HALF, -_HALF, 0.0), ((2.0 * _HALF, 0.0, 0.0), (0.0, 2.0 * _HALF, 0.0))
        pr.irradiance_map(field, corner, *sides, (_TEXELS, _TEXELS))
        seconds = traced - started, process_time() - drawing
        held = sum(each.nbytes for each in vars(envelope).values() if isinstance(each, np.ndarray))
        found.append((envelope.n_rays, envelope.n_elements, sum(seconds)))
        yield [
            *(f"{each:,}" for each in (envelope.n_rays, envelope.n_elements, len(envelope))),
            f"{seconds[0]:.2f} + {seconds[1]:.2f}",
            *(f"{each / len(envelope):.0f}" for each in (held, most)),
        ]
    of_rays, of_elements, seconds_taken = np.log(found).T
    powers = [np.polyfit(each, seconds_taken, 1)[0] for each in (of_rays, of_elements)]
    yield ["power", *(f"{each:.2f}" for each in powers), *[""] * 3]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the numbers of rays."""
    parser.add_argument("--rays", type=numbers, default=list(_RAYS))


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    titles = ["rays", "elements", "triangles", "seconds", "bytes a triangle", "at most"]
    print(markdown_table(titles, rows(options.rays)))
