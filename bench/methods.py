"""Methods on the same photons: errors and times on every scene, by photons and their sampler."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import photonrelax as pr
from photonrelax import gallery
from photonrelax.compare import (
    DistributionSubject,
    Entry,
    Plan,
    SceneSubject,
    compare,
    reference,
)
from photonrelax.compare.subject import Subject
from photonrelax.measures import check_installed, relative_l1
from photonrelax.methods import Settings

from . import machine

SCENES = ("prism", "ring", "ripples", "shapes")
SAMPLERS = ("halton", "random")
# Beside the methods as they are by default: what else the same photons give.
VARIANTS = {
    "standard, K = 50": ("standard", Settings(gather=pr.GatherSettings(k=50))),
    "parameterised, 3 + 3": (
        "parameterised",
        Settings(relax=pr.RelaxSettings(n_iterations=(3, 3))),
    ),
}
# Photons a pass of references takes.
_REFERENCE_PHOTONS = 1_000_000
_SAMPLES = 2
_OWN_SEED = 2


@dataclass(frozen=True, eq=False)
class Row:
    """What methods did with one lot of photons.

    Attributes
    ----------
    label : str
        Scene, photons emitted and sampler.
    entries : dict
        By method or variant.
    noise : float
        Relative L1 error that the reference has from its own noise.
    progressive : str
        What progressive photon mapping takes to come as near as the parameterised relaxation.
    """

    label: str
    entries: dict[str, Entry]
    noise: float
    progressive: str


@dataclass(frozen=True)
class Matrix:
    """What is measured.

    Attributes
    ----------
    photons : tuple of int
        Emitted.
    scenes, samplers : tuple of str
        Of the gallery, and of the photons.
    pixels : int
        Width and height of pictures, of 2 x 2 samples.
    passes : int
        Of photons that each of the two halves of a reference takes.
    folder : Path
        Where references are kept.
    longest : int
        Passes after which progressive photon mapping is given up; 0 for none.
    """

    photons: tuple[int, ...]
    scenes: tuple[str, ...] = SCENES
    samplers: tuple[str, ...] = SAMPLERS
    pixels: int = 256
    passes: int = 50
    folder: Path = Path("build/bench/methods")
    longest: int = 64

    def rows(self) -> Iterator[Row]:
        """Measure."""
        for name in self.scenes:
            on = subject(name, self.pixels)
            truth, noise = self._reference(on)
            for n in self.photons:
                for sampler in self.samplers:
                    plan = Plan(subject=on, n_emitted=n, sampler=sampler, supersampling=_SAMPLES)
                    found, longer = entries(plan, truth), ""
                    if (n, sampler) == (max(self.photons), "halton") and self.longest:
                        least = found["parameterised"].errors.relative_l1
                        longer = as_near(plan, truth, least, self.longest)
                    yield Row(f"{name}, {n:,} {sampler}", found, noise, longer)

    def _reference(self, on: Subject) -> tuple[pr.Image, float]:
        """Return the mean of two references, and the relative L1 of its noise.

        What is left of noise in a mean of two is half of how they differ.
        """
        n = min(_REFERENCE_PHOTONS, 10 * max(self.photons))
        plan = Plan(subject=on, n_emitted=n, supersampling=_SAMPLES)
        self.folder.mkdir(parents=True, exist_ok=True)
        paths = [self.folder / f"{on.name}-{seed}.exr" for seed in range(2)]
        halves = [
            reference.kept(path, plan, self.passes, seed=seed) for seed, path in enumerate(paths)
        ]
        layers = {
            layer: sum(np.asarray(half.layers[layer]) for half in halves) / 2
            for layer in ("radiance", "caustic")
        }
        caustics = (half.layers["caustic"] for half in halves)
        return pr.Image(layers, halves[0].metadata), 0.5 * relative_l1(*caustics)


def entries(plan: Plan, truth: pr.Image) -> dict[str, Entry]:
    """Return an entry for each method and variant."""
    found = {entry.method: entry for entry in compare(plan, truth).entries}
    for name, (method, settings) in VARIANTS.items():
        varied = replace(plan, methods=(method,), settings=settings)
        (found[name],) = compare(varied, truth).entries
    return found


def as_near(plan: Plan, truth: pr.Image, error: float, longest: int) -> str:
    """Return the passes, in powers of two, and seconds that fresh photons take to an error."""
    scene, passes, found, seconds = plan.subject.scene, 1, np.inf, 0.0
    if scene is None:
        return "–"
    while found > error and passes <= longest:
        # Photons of the reference would flatter it.
        image = pr.render_progressive(
            scene, n_passes=passes, photons_per_pass=plan.n_emitted, seed=_OWN_SEED
        )
        found = relative_l1(image.layers["caustic"], truth.layers["caustic"])
        told, seconds = f"{passes} passes", image.stats["seconds"]
        passes *= 2
    reached = "" if found <= error else f", still {found:.1%}"
    return f"{told}, {seconds:.1f}{reached}"


def subject(name: str, pixels: int) -> Subject:
    """Return what the gallery knows by a name."""
    if name in gallery.distribution_names():
        return DistributionSubject(name, (pixels, pixels))
    return SceneSubject(gallery.scene(name, pixels=pixels))


def markdown(matrix: Matrix) -> str:
    """Return a table of errors, the least L1 and the largest SSIM bold, and one of times."""
    check_installed()
    rows = []
    for row in matrix.rows():
        print(f"... {row.label}", file=sys.stderr, flush=True)
        rows.append(row)
    names = list(rows[0].entries)
    errors = [["", *names, "noise of reference"], *map(_errors, rows)]
    timed = [row for row in rows if row.label.endswith(f"{max(matrix.photons):,} halton")]
    longer = "progressive, fresh photons, until as near as parameterised"
    times = [["seconds", *names, longer], *map(_times, timed)]
    note = (
        f"Relative L1 of the caustic · SSIM, {matrix.pixels} x {matrix.pixels} pixels of "
        f"{_SAMPLES} x {_SAMPLES} samples. References: the exact irradiance of shapes; otherwise "
        f"the mean of two runs of progressive photon mapping, {matrix.passes} passes each."
    )
    return "\n".join([_table(errors), "", note, "", _table(times), "", machine.description(), ""])


def _table(lines: list[list[str]]) -> str:
    head, *body = [f"| {' | '.join(line)} |" for line in lines]
    return "\n".join([head, f"|{' --- |' * len(lines[0])}", *body])


def _errors(row: Row) -> list[str]:
    least = min(entry.errors.relative_l1 for entry in row.entries.values())
    most = max(entry.errors.ssim for entry in row.entries.values())
    cells = [
        f"{_marked(f'{e.relative_l1:.1%}', e.relative_l1 == least)} · "
        f"{_marked(f'{e.ssim:.3f}', e.ssim == most)}"
        for e in (entry.errors for entry in row.entries.values())
    ]
    return [row.label, *cells, f"{row.noise:.1%}"]


def _marked(text: str, best: bool) -> str:
    return f"**{text}**" if best else text


def _times(row: Row) -> list[str]:
    totals = (f"{sum(entry.seconds.values()):.1f}" for entry in row.entries.values())
    return [row.label, *totals, row.progressive]
