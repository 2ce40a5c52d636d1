"""Refinements of standard estimates beside what moves photons: relative L1, best of several."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import photonrelax as pr
from bench.studies.methods import FOLDER, REFERENCES, truth_of
from photonrelax.estimation.methods import METHODS, Settings
from photonrelax.evaluation import ComparisonRequest, compare, gallery_subject, reference

KS = (15, 50, 100, 200)
MOST_KS = (100, 200, 500)
# What is compared on: scene, photons emitted, sampler.
LOTS = (("shapes", 48_000, "random"), ("ring", 200_000, "random"), ("ring", 200_000, "halton"))


@dataclass(frozen=True)
class Study:
    """What is measured on pictures of so many pixels, and the references of scenes."""

    pixels: int = 256
    effort: reference.ReferenceSettings = REFERENCES
    folder: Path = FOLDER
    lots: tuple[tuple[str, int, str], ...] = LOTS

    def columns(self) -> Iterator[dict[str, tuple[float, str]]]:
        """Yield relative L1, and the number of photons it is of, by row."""
        for name, n, sampler in self.lots:
            print(f"... {name}, {n:,} {sampler}", file=sys.stderr, flush=True)
            plan = ComparisonRequest(
                subject=gallery_subject(name, self.pixels, self.pixels),
                methods=("relaxation", "parameterised"),
                variants=variants(),
                n_emitted=n,
                sampler=sampler,
            )
            truth = truth_of(plan, self.effort, self.folder)
            if (doubt := reference.uncertainty_of(truth)) is not None:
                print(f"... its reference: {doubt.text()}", file=sys.stderr, flush=True)
            yield _least({e.name: e.errors.relative_l1 for e in compare(plan, truth).entries})


def variants() -> dict[str, tuple[str, Settings]]:
    """Return standard estimates by kind and number of photons."""
    made = {f"standard, k = {k}": ("standard", _gather(k=k)) for k in KS}
    for kind in ("differential-checking", "bias-compensation"):
        made |= {f"{kind}, k = {k}": ("standard", _gather(k=k, refinement=kind)) for k in MOST_KS}
    return made


def _gather(**settings: object) -> Settings:
    return Settings(gather=pr.GatherSettings(**settings))


def _least(errors: dict[str, float]) -> dict[str, tuple[float, str]]:
    """Return the least error of each kind, and what of it has it."""
    found: dict[str, tuple[float, str]] = {}
    for name, error in errors.items():
        kind, _, k = name.partition(", ")
        if kind not in found or error < found[kind][0]:
            found[kind] = error, k
    return found


def _cell(error: float, k: str) -> str:
    return f"{error:.3f}, {k}" if k else f"{error:.3f}"


def markdown(study: Study) -> str:
    """Return the table."""
    columns = list(study.columns())
    heads = (f"{name}, {n:,} {sampler}" for name, n, sampler in study.lots)
    lines = [f"| relative L1 | {' | '.join(heads)} |", "| --- |" + len(columns) * " --- |"]
    for row in sorted(columns[0], key=lambda row: row in list(METHODS)[1:]):
        cells = [_cell(*column[row]) for column in columns]
        lines.append(f"| {row} | {' | '.join(cells)} |")
    tried = (
        f"The best of k = {', '.join(map(str, KS))}, and of up to "
        f"{', '.join(map(str, MOST_KS))} photons; {study.pixels} x {study.pixels} pixels."
    )
    return "\n".join([*lines, "", tried, ""])
