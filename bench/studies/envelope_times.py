"""Times of envelopes to an error over the texels of a map, tracing and drawing included."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from time import perf_counter, process_time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import photonrelax as pr
from bench.arguments import numbers
from bench.markdown import markdown_table
from bench.studies.pixel_means import Errors, FloorMap, Study, reference, texel_means
from photonrelax import gallery
from photonrelax.transport.raycast import RayCaster

# Texels beyond so many means are cut off in the errors that are asked for.
_CLIP = 5.0


@dataclass(frozen=True)
class Case:
    """A scene and the clipped L1 error asked for.

    Attributes
    ----------
    errors : tuple of float
        Shares of light that envelopes may misplace, the largest first.
    block : int
        Texels along the sides of squares whose means are compared.
    fine : float, optional
        Error of the envelope that is the reference; counted photons are by default.
    """

    asked: float
    errors: tuple[float, ...]
    block: int = 1
    fine: float | None = None


CASES = {
    "ring": Case(0.01, (0.1, 0.05, 0.03, 0.02), fine=0.001),
    "sphere": Case(0.01, (0.1, 0.07, 0.065, 0.05, 0.03), fine=0.006),
    "ripples": Case(0.015, (0.1, 0.05, 0.02, 0.01), fine=0.003),
    "prism": Case(0.03, (0.2, 0.1, 0.05), block=4),
}


class Taken(NamedTuple):
    """Wall and processor seconds of an envelope and its map, the least of some rounds each."""

    wall: float
    processor: float


class Subject:
    """A scene and the map of its floor."""

    def __init__(self, name: str, texels: int, n_threads: int) -> None:
        self.scene = gallery.scene(name)
        self.caster = RayCaster(self.scene.surfaces)
        photons = pr.trace_photons(self.scene, 100_000, caster=self.caster)
        self.floor, self._n_threads = FloorMap.of(photons, texels), n_threads

    def map(self, error: float) -> tuple[NDArray, pr.Envelope]:
        """Means over texels, and their envelope."""
        envelope = pr.trace_envelope(
            self.scene,
            error=error,
            footprint=self.floor.side / self.floor.texels,
            caster=self.caster,
            n_threads=self._n_threads,
        )
        field = pr.irradiance_field(envelope, method="envelope", n_threads=self._n_threads)
        return self.floor.means(field), envelope

    def timed(self, error: float, n_rounds: int) -> tuple[NDArray, pr.Envelope, Taken]:
        """Map, envelope and what they take."""
        taken = []
        for _ in range(n_rounds):
            started = perf_counter(), process_time()
            means, envelope = self.map(error)
            taken.append((perf_counter() - started[0], process_time() - started[1]))
        return means, envelope, Taken(*np.min(taken, axis=0))

    def truth(self, case: Case, passes: Study) -> NDArray:
        """Means over texels of a fine envelope, or of counted photons."""
        if case.fine is not None:
            return self.map(case.fine)[0]
        return texel_means(reference(passes, self.scene, self.caster, self.floor).mean(axis=0))


def rows(names: Sequence[str], n_rounds: int, n_threads: int, passes: Study) -> Iterator[list[str]]:
    """Yield the rows of the table."""
    for name in names:
        case, subject = CASES[name], Subject(name, passes.texels, n_threads)
        exact = _squares(subject.truth(case, passes), case.block)
        mean = exact.mean()
        for error in case.errors:
            found, envelope, taken = subject.timed(error, n_rounds)
            found = _squares(found, case.block)
            cut = (np.minimum(each, _CLIP * mean) for each in (found, exact))
            clipped = np.abs(np.subtract(*cut)).mean() / mean
            errors = Errors.of(found, exact)
            yield [
                name,
                f"{error:g}",
                f"{envelope.n_rays:,} / {envelope.n_segments:,}",
                f"{clipped:.4f} of {case.asked:g}",
                f"{errors.l1:.4f} {errors.rms:.3f}",
                f"{taken.wall:.3f}",
                f"{taken.processor:.3f}",
            ]


def _squares(texels: NDArray, block: int) -> NDArray:
    """Means over squares of so many texels a side."""
    n = len(texels) // block
    means: NDArray = texels.reshape(n, block, n, block).mean(axis=(1, 3))
    return means


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add scenes, texels, rounds, threads, and passes of the reference of `prism`."""
    parser.add_argument("--scenes", default=",".join(CASES))
    parser.add_argument("--texels", type=int, default=400)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--reference-passes", type=int, default=20)
    parser.add_argument("--photons-per-pass", type=numbers, default=[5_000_000])


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    passes = Study(
        texels=options.texels,
        reference_passes=options.reference_passes,
        photons_per_pass=options.photons_per_pass[0],
    )
    titles = ["scene", "error", "rays / segments", "L1, clipped", "L1, rms"]
    titles += ["seconds", "processor seconds"]
    cells = rows(options.scenes.split(","), options.rounds, options.threads, passes)
    print(markdown_table(titles, cells))
    print(
        f"\n{options.texels} x {options.texels} texels, {options.threads} threads, the least of "
        f"{options.rounds} rounds; load before: {os.getloadavg()[0]:.1f}."
    )
