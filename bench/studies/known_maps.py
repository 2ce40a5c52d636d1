"""Errors of envelopes of scenes whose map from the emitter is known, by rays."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence

import numpy as np
from tests.analytic.known_maps import KNOWN_MAPS

from bench.arguments import numbers
from bench.markdown import markdown_table

_RAYS = (12_000, 25_000, 50_000, 100_000, 200_000)


def rows(n_rays: Sequence[int]) -> Iterator[list[str]]:
    """Yield the rows of the table, and the power of the rays that errors fall by."""
    for name, known_map in KNOWN_MAPS.items():
        subject = known_map()
        found = []
        for n in n_rays:
            error, envelope = subject.error(n_rays=n)
            found.append((envelope.n_rays, error))
            yield [name, f"{envelope.n_rays:,}", f"{error:.6f}", f"{envelope.error:.6f}"]
        power, _ = np.polyfit(*np.log(found).T, 1)
        yield [name, "power", f"{power:.2f}", ""]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the numbers of rays."""
    parser.add_argument("--rays", type=numbers, default=list(_RAYS))


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    print(markdown_table(["map", "rays", "L1", "told"], rows(options.rays)))
