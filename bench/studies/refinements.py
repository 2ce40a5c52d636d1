"""Refinements of standard estimates compared with relaxations: least relative L1 of several k."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import photonrelax as pr
from bench.markdown import markdown_table
from bench.studies.methods import FOLDER, REFERENCES, reference_of
from photonrelax.estimation.methods import Settings
from photonrelax.evaluation import ComparisonRequest, compare, gallery_subject
from photonrelax.evaluation.reference import ReferenceSettings, uncertainty_of

RELAXATIONS = ("relaxation", "parameterised")
KS = (15, 50, 100, 200)
MOST_KS = (100, 200, 500)
CASES = (("shapes", 48_000, "random"), ("ring", 200_000, "random"), ("ring", 200_000, "halton"))
"""Scene, photons emitted, sampler."""


@dataclass(frozen=True)
class Study:
    """Width and height of images, settings and cache of references, and cases."""

    pixels: int = 256
    references: ReferenceSettings = REFERENCES
    folder: Path = FOLDER
    cases: tuple[tuple[str, int, str], ...] = CASES

    def columns(self) -> Iterator[dict[str, tuple[float, str]]]:
        """Yield the least relative L1, and its k, by row."""
        for name, n, sampler in self.cases:
            print(f"... {name}, {n:,} {sampler}", file=sys.stderr, flush=True)
            request = ComparisonRequest(
                subject=gallery_subject(name, self.pixels, self.pixels),
                methods=RELAXATIONS,
                variants=variants(),
                n_emitted=n,
                sampler=sampler,
            )
            reference = reference_of(request, self.references, self.folder)
            if (uncertainty := uncertainty_of(reference)) is not None:
                print(f"... its reference: {uncertainty.text()}", file=sys.stderr, flush=True)
            entries = compare(request, reference).entries
            yield _best({entry.name: entry.errors.relative_l1 for entry in entries})


def variants() -> dict[str, tuple[str, Settings]]:
    """Return standard estimates by kind and number of photons."""
    made = {f"standard, k = {k}": ("standard", _gather(k=k)) for k in KS}
    for kind in ("differential-checking", "bias-compensation"):
        made |= {f"{kind}, k = {k}": ("standard", _gather(k=k, refinement=kind)) for k in MOST_KS}
    return made


def _gather(**settings: object) -> Settings:
    return Settings(gather=pr.GatherSettings(**settings))


def _best(errors: dict[str, float]) -> dict[str, tuple[float, str]]:
    """Return the least error of each kind of estimate, and its k."""
    found: dict[str, tuple[float, str]] = {}
    for name, error in errors.items():
        kind, _, k = name.partition(", ")
        if kind not in found or error < found[kind][0]:
            found[kind] = error, k
    return found


def _cell(error: float, k: str) -> str:
    return f"{error:.3f}, {k}" if k else f"{error:.3f}"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """No arguments."""


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    print(markdown(Study()))


def markdown(study: Study) -> str:
    """Return the table."""
    columns = list(study.columns())
    titles = ["relative L1", *(f"{name}, {n:,} {sampler}" for name, n, sampler in study.cases)]
    rows = (
        [row, *(_cell(*column[row]) for column in columns)]
        for row in sorted(columns[0], key=lambda row: row in RELAXATIONS)
    )
    return (
        f"{markdown_table(titles, rows)}\n\nThe best of k = {', '.join(map(str, KS))}, and of up "
        f"to {', '.join(map(str, MOST_KS))} photons; {study.pixels} x {study.pixels} pixels.\n"
    )
