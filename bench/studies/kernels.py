"""Kernels and numbers of photons of estimates at points, against analytic irradiance."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import photonrelax as pr
from bench.arguments import numbers
from bench.markdown import markdown_table
from bench.studies.pixel_means import FloorMap
from photonrelax import gallery
from photonrelax.gallery.analytic import analytic_irradiance

SCENES = ("ring", "sphere")
METHODS = ("standard", "parameterised")
KERNELS = ("epanechnikov", "gaussian")


@dataclass(frozen=True)
class Study:
    """Numbers of photons emitted, and gathered; points where estimates are compared."""

    photons: tuple[int, ...] = (300_000, 1_000_000, 3_000_000)
    k: tuple[int, ...] = (8, 15, 30)
    n_points: int = 30_000


def rows(study: Study) -> Iterator[list[str]]:
    """Yield the rows of the table."""
    for name in SCENES:
        scene = gallery.scene(name)
        points, normals, exact = known_points(name, scene, study.n_points)
        for n in study.photons:
            photons = pr.trace_photons(scene, n)
            for method in METHODS:
                prepared = pr.irradiance_field(photons, method=method).photons
                errors = [
                    relative_l1(pr.IrradianceField(prepared, settings)(points, normals), exact)
                    for settings in settings_of(study)
                ]
                yield [name, method, f"{n:,}", *(f"{error:.3f}" for error in errors)]


def known_points(name: str, scene: pr.Scene, n_points: int) -> tuple[NDArray, NDArray, NDArray]:
    """Points on the floor around the caustic, their normals and irradiance, where it is known."""
    analytic = analytic_irradiance(name)
    assert analytic is not None, "the scenes have analytic irradiance"
    floor = FloorMap.of(pr.trace_photons(scene, 100_000), 1)
    at = floor.low + floor.side * np.random.default_rng(0).random((n_points, 2))
    points = np.column_stack([at, np.full(n_points, floor.height)])
    normals = np.tile([0.0, 0.0, 1.0], (n_points, 1))
    exact, known = analytic(points, normals)
    return points[known], normals[known], exact[known]


def settings_of(study: Study) -> list[pr.GatherSettings]:
    """Settings of each column."""
    return [pr.GatherSettings(k=k, kernel=kernel) for k in study.k for kernel in KERNELS]


def relative_l1(irradiance: NDArray, exact: NDArray) -> float:
    """Sum of the errors over the sum of the exact values."""
    return float(np.abs(irradiance.mean(axis=1) - exact).sum() / exact.sum())


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the numbers of photons."""
    parser.add_argument("--photons", type=numbers, default=list(Study().photons))


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    print(markdown(Study(photons=tuple(options.photons))))


def markdown(study: Study) -> str:
    """Table of the study."""
    columns = [f"{settings.kernel}, k = {settings.k}" for settings in settings_of(study)]
    titles = ["scene", "method", "emitted", *columns]
    return (
        f"{markdown_table(titles, rows(study))}\n\nRelative L1 at {study.n_points:,} random points "
        "of the floor, where analytic irradiance is known.\n"
    )
