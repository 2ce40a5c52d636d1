"""Frequency-driven compared with progressive photon mapping, same photons, on `reflector`.

Errors on the floor, by the variation of irradiance around each point.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter

import photonrelax as pr
from bench.arguments import numbers
from bench.markdown import markdown_table
from bench.speed import machine
from bench.speed.inputs import Floats
from photonrelax import gallery

METHODS = ("progressive", "frequency")
# The floor in front of the strip, in cells, m.
_CELL, _LOW, _HIGH = 0.015, (-1.9, -1.6), (0.0, 1.6)
# Regions by the range of the reference within this distance, m, over its value.
_WITHIN = 0.15
REGIONS = {"smooth: < 10 %": 0.10, "10 % to 25 %": 0.25, "25 % to 100 %": 1.0, "more": np.inf}
# Photons of the first pass within the initial radius.
_K = 15
# Side of the blocks that are compared one by one, cells.
_BLOCK = 10
_LEAST_LIGHT = 0.05


@dataclass(frozen=True)
class Floor:
    """Points on the floor, two independent references (2, points), and regions."""

    points: Floats
    shape: tuple[int, int]
    references: Floats
    region: NDArray[np.intp]

    @property
    def normals(self) -> Floats:
        return np.tile([0.0, 0.0, 1.0], (len(self.points), 1))


def floor(n_reference: int) -> Floor:
    """Return the floor with references of `n_reference` photons each."""
    x, y = (np.arange(*ends, _CELL) + _CELL / 2 for ends in zip(_LOW, _HIGH, strict=True))
    grid = np.meshgrid(x, y, indexing="ij")
    points = np.stack([*grid, np.zeros_like(grid[0])], axis=-1).reshape(-1, 3)
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    halves = []
    for seed in (101, 102):
        photons = pr.trace_photons(gallery.scene("reflector"), n_reference, seed=seed)
        gathered = pr.estimate_irradiance(photons, points, normals, pr.GatherSettings(k=150))
        halves.append(gathered[:, 0])
    references = np.array(halves)
    region = _regions(references.mean(axis=0).reshape(grid[0].shape)).ravel()
    return Floor(points, grid[0].shape, references, region)


def _regions(reference: Floats) -> NDArray[np.intp]:
    """Return the number of each cell's region; -1 in the dark."""
    reach = round(_WITHIN / _CELL)
    disc = np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1]) <= reach
    # Smoothed, as noise of the reference is not variation of the light.
    even = gaussian_filter(reference, 1.0)
    spread = maximum_filter(even, footprint=disc) - minimum_filter(even, footprint=disc)
    variation = spread / np.maximum(even, 1e-12)
    region = np.searchsorted(list(REGIONS.values()), variation, side="right")
    return np.where(reference > _LEAST_LIGHT, region, -1)


def errors(
    on: Floor, n_emitted: int, sampler: str, seeds: range, *, passes: int, share: float
) -> tuple[dict[str, Floats], dict[str, float]]:
    """Return squared relative errors (seeds, points) of each method, and seconds in all.

    The product of the differences from two references has the squared error as its mean, to which
    the noise of the references adds nothing.
    """
    squared: dict[str, list[Floats]] = {method: [] for method in METHODS}
    seconds = dict.fromkeys(("trace with spectra", *METHODS), 0.0)
    scene = gallery.scene("reflector")
    how: dict[str, Any] = {"progressive": pr.ProgressiveSettings(k=_K, n_passes=passes)}
    for seed in seeds:
        began = perf_counter()
        photons = pr.trace_photons(
            scene, n_emitted, seed=seed, sampler=sampler, frequency_share=share
        )
        seconds["trace with spectra"] += perf_counter() - began
        for method in METHODS:
            began = perf_counter()
            field = pr.irradiance_field(photons, method=method, **how)
            found = field(on.points, on.normals)[:, 0]
            seconds[method] += perf_counter() - began
            relative = found / np.maximum(on.references, _LEAST_LIGHT) - 1.0
            squared[method].append(relative[0] * relative[1])
    return {method: np.array(rows) for method, rows in squared.items()}, seconds


def _seconds_of_tracing(n_emitted: int, sampler: str, seeds: range) -> float:
    """Return the seconds in all of photons without spectra."""
    scene = gallery.scene("reflector")
    began = perf_counter()
    for seed in seeds:
        pr.trace_photons(scene, n_emitted, seed=seed, sampler=sampler)
    return perf_counter() - began


def blocks(on: Floor, squared: Floats) -> Floats:
    """Return root mean squares over square blocks of the floor, all of whose cells are lit."""
    lit = np.where(on.region >= 0, squared.mean(axis=0), np.nan).reshape(on.shape)
    rows, columns = (n // _BLOCK for n in on.shape)
    cut = lit[: rows * _BLOCK, : columns * _BLOCK].reshape(rows, _BLOCK, columns, _BLOCK)
    return np.sqrt(np.maximum(cut.mean(axis=(1, 3)), 0.0).ravel())


def _rows(on: Floor, squared: dict[str, Floats]) -> Iterator[list[str]]:
    """Yield a row for each region, and one for the block where frequency does worst."""
    for number, name in enumerate(REGIONS):
        inside = on.region == number
        errors = [np.sqrt(squared[method][:, inside].mean()) for method in METHODS]
        yield [name, f"{inside.mean():.0%}", *_cells(*errors)]
    progressive, frequency = (blocks(on, squared[method]) for method in METHODS)
    worst = np.nanargmax(frequency / progressive)
    name = f"worst of {np.isfinite(progressive).sum()} blocks of {_BLOCK * _CELL:.2f} m"
    yield [name, "", *_cells(progressive[worst], frequency[worst])]


def _cells(progressive: float, frequency: float) -> list[str]:
    return [f"{progressive:.2%}", f"{frequency:.2%}", f"{progressive / frequency:.2f}×"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--photons", type=numbers, default=[1_000_000, 2_000_000, 6_000_000])
    parser.add_argument("--seeds", type=int, default=3, help="default 3")
    parser.add_argument("--passes", type=int, default=64, help="default 64")


def run(options: argparse.Namespace) -> None:
    """Print the tables."""
    print(markdown(options.photons, n_seeds=options.seeds, passes=options.passes))


def markdown(
    photons: list[int],
    *,
    samplers: tuple[str, ...] = ("random", "halton"),
    n_seeds: int = 4,
    passes: int = 64,
    share: float = 0.02,
    n_reference: int = 10_000_000,
) -> str:
    """Return tables of errors by region, one for each number of photons emitted and sampler."""
    on = floor(n_reference)
    parts = []
    for n_emitted in photons:
        for sampler in samplers:
            squared, seconds = errors(
                on, n_emitted, sampler, range(n_seeds), passes=passes, share=share
            )
            seconds = {"trace": _seconds_of_tracing(n_emitted, sampler, range(n_seeds)), **seconds}
            title = f"reflector, {n_emitted:,} {sampler}, {passes} passes"
            parts += [
                markdown_table(
                    [title, "of the floor", *METHODS, "times as small"], _rows(on, squared)
                ),
                ", ".join(f"{name} {time / n_seeds:.2g} s" for name, time in seconds.items()),
            ]
    parts.append(
        f"Relative errors, root mean squares over {n_seeds} seeds; regions by the range of the "
        f"reference within {_WITHIN} m; {share:.0%} of the photons carry spectra. "
        f"{machine.description()}."
    )
    return "\n\n".join(parts) + "\n"
