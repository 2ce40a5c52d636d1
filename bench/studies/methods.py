"""Methods on the same photons: errors and times on every scene, by photons and their sampler."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from time import perf_counter

import numpy as np

import photonrelax as pr
from bench.speed import machine
from photonrelax.estimation.methods import Settings
from photonrelax.evaluation import ComparisonRequest, Entry, compare, gallery_subject, reference
from photonrelax.imaging.metrics import check_installed, relative_l1

SCENES = ("prism", "ring", "ripples", "shapes")
SAMPLERS = ("halton", "random")
# Beside the methods as they are by default: what else the same photons give. SJ13's diffusion is
# that of SSO08 with eigenvalues over the largest of the map.
VARIANTS = {
    "standard, K = 50": ("standard", Settings(gather=pr.GatherSettings(k=50))),
    "parameterised, 3 + 3": (
        "parameterised",
        Settings(relax=pr.RelaxSettings(n_iterations=(3, 3))),
    ),
    "diffusion, q = 0.02, maximum": (
        "diffusion",
        Settings(diffusion=pr.DiffusionSettings(edge_threshold=0.02, normalisation="maximum")),
    ),
}
_SAMPLES = 2
_ROUNDS = 3
_OWN_SEED = 2
_BRIGHTEST = 50
REFERENCES = reference.ReferenceSettings(passes=200, photons=2_000_000)
"""What scenes are measured against here; `refinements` and `first_discs` share the files."""
FOLDER = Path("build/bench/methods")
# Discs of fresh photons start as small as those of references.
_FRESH = pr.ProgressiveSettings(k=REFERENCES.k)


def truth_of(
    plan: ComparisonRequest, effort: reference.ReferenceSettings = REFERENCES, folder: Path = FOLDER
) -> pr.Image:
    """Return what a plan is measured against; it is kept in the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    return reference.cached_reference(folder / f"{plan.subject.name}.exr", plan, effort)


def doubt_cell(doubt: reference.Uncertainty | None) -> str:
    """Return noise and bias of a reference for a table of relative L1."""
    return "exact" if doubt is None else f"{doubt.noise_l1:.1%}, {doubt.bias_l1:.1%}"


@dataclass(frozen=True, eq=False)
class Row:
    """What methods did with one lot of photons.

    Attributes
    ----------
    label : str
        Scene, photons emitted and sampler.
    entries : dict
        By method or variant.
    brightest : str
        What of the squared error of the parameterised relaxation the brightest pixels have.
    doubt : Uncertainty or None
        How far the reference may be off; None for an exact one.
    known : float or None
        Relative L1 of the reference where light is known without photons.
    progressive : str
        What progressive photon mapping takes to come as near as the parameterised relaxation.
    """

    label: str
    entries: dict[str, Entry]
    brightest: str
    doubt: reference.Uncertainty | None
    known: float | None
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
    effort : reference.ReferenceSettings
        Of the references.
    folder : Path
        Where references are kept.
    longest : int
        Passes after which progressive photon mapping is given up; 0 for none.
    """

    photons: tuple[int, ...]
    scenes: tuple[str, ...] = SCENES
    samplers: tuple[str, ...] = SAMPLERS
    pixels: int = 256
    effort: reference.ReferenceSettings = REFERENCES
    folder: Path = FOLDER
    longest: int = 64

    def rows(self) -> Iterator[Row]:
        """Measure."""
        for name in self.scenes:
            on = gallery_subject(name, self.pixels, self.pixels)
            for n, sampler in product(self.photons, self.samplers):
                plan = ComparisonRequest(
                    subject=on,
                    variants=VARIANTS,
                    n_emitted=n,
                    sampler=sampler,
                    supersampling=_SAMPLES,
                    rounds=_ROUNDS if self._timed(n, sampler) else 1,
                )
                yield self._row(plan, truth_of(plan, self.effort, self.folder))

    def _timed(self, n: int, sampler: str) -> bool:
        return (n, sampler) == (max(self.photons), "halton")

    def _row(self, plan: ComparisonRequest, truth: pr.Image) -> Row:
        made = compare(plan, truth)
        found = {entry.name: entry for entry in made.entries}
        longer = ""
        if self._timed(plan.n_emitted, plan.sampler):
            longer = as_near(plan, truth, found["parameterised"].errors.relative_l1, self.longest)
        label = f"{plan.subject.name}, {plan.n_emitted:,} {plan.sampler}"
        known = made.reference.analytic_errors.get("relative_l1")
        brightest = at_the_brightest(found["parameterised"].image, truth)
        return Row(label, found, brightest, reference.uncertainty_of(truth), known, longer)


def at_the_brightest(image: pr.Image, truth: pr.Image, n: int = _BRIGHTEST) -> str:
    """Return the share of the squared error in the brightest pixels, and how bright they are."""
    found, exact = (np.asarray(each.layers["caustic"]).sum(axis=2) for each in (image, truth))
    squares = (found - exact) ** 2
    pixels = np.argsort(exact, axis=None)[-n:]
    share = squares.ravel()[pixels].sum() / squares.sum()
    light = found.ravel()[pixels].sum() / exact.ravel()[pixels].sum()
    return f"{share:.0%} of it is in the {n} brightest pixels, which it shows at {light:.0%}"


def as_near(plan: ComparisonRequest, truth: pr.Image, error: float, longest: int) -> str:
    """Return the passes, in powers of two, and seconds that fresh photons take to an error.

    Camera rays count, as for every method.
    """
    scene, passes, found, seconds = plan.subject.scene, 1, np.inf, 0.0
    if scene is None or longest < 1:
        return "–"
    while found > error and passes <= longest:
        # Photons of the reference would flatter it.
        started = perf_counter()
        image = pr.render_progressive(
            scene,
            n_passes=passes,
            photons_per_pass=plan.n_emitted,
            seed=_OWN_SEED,
            settings=_FRESH,
        )
        told, seconds = f"{passes} passes", perf_counter() - started
        found = relative_l1(image.layers["caustic"], truth.layers["caustic"])
        passes *= 2
    reached = "" if found <= error else f", still {found:.1%}"
    return f"{told}, {seconds:.1f}{reached}"


def markdown(matrix: Matrix) -> str:
    """Return a table of errors, the least L1 and the largest SSIM bold, and one of times."""
    check_installed()
    rows = []
    for row in matrix.rows():
        print(f"... {row.label}", file=sys.stderr, flush=True)
        rows.append(row)
    names = [f"{name}, dealt" if name == "progressive" else name for name in rows[0].entries]
    errors = [["", *names, "reference: noise, bias"], *map(_errors, rows)]
    squares = [["", *names, "reference: noise, bias"], *map(_squares, rows)]
    timed = [row for row in rows if row.progressive]
    longer = "progressive, fresh photons, until as near as parameterised"
    times = [["seconds", *names, longer], *map(_times, timed)]
    note = (
        f"Relative L1 of the caustic · SSIM, {matrix.pixels} x {matrix.pixels} pixels of "
        f"{_SAMPLES} x {_SAMPLES} samples. References: the exact irradiance of shapes at the same "
        f"samples; otherwise progressive photon mapping, {matrix.effort.passes} passes of "
        f"{matrix.effort.photons:,} photons in two runs. Dealt: the photons of the same map."
    )
    known = [
        f"Reference of {row.label} where its light is known: off by {row.known:.1%}; "
        + ", ".join(
            f"{e.name} {e.analytic_errors['relative_l1']:.1%}" for e in row.entries.values()
        )
        for row in rows
        if row.known is not None
    ]
    bright = [
        f"Squared error of parameterised, {row.label}: {row.brightest}."
        for row in timed
        if row.doubt is not None
    ]
    rounds = f"Medians of {_ROUNDS} interleaved rounds; camera rays count."
    tables = (_table(errors), note, *known, "Relative L2:", _table(squares), *bright, _table(times))
    return "\n\n".join([*tables, f"{rounds} {machine.description()}."]) + "\n"


def _table(lines: list[list[str]]) -> str:
    head, *body = [f"| {' | '.join(line)} |" for line in lines]
    return "\n".join([head, f"|{' --- |' * len(lines[0])}", *body])


def _errors(row: Row) -> list[str]:
    each = [entry.errors for entry in row.entries.values()]
    least, most = min(e.relative_l1 for e in each), max(e.ssim for e in each)
    cells = [
        f"{_marked(f'{e.relative_l1:.1%}', e.relative_l1 == least)} · "
        f"{_marked(f'{e.ssim:.3f}', e.ssim == most)}"
        for e in each
    ]
    return [row.label, *cells, doubt_cell(row.doubt)]


def _squares(row: Row) -> list[str]:
    each = [entry.errors.relative_l2 for entry in row.entries.values()]
    cells = [_marked(f"{error:.1%}", error == min(each)) for error in each]
    doubt = row.doubt
    return [row.label, *cells, f"{doubt.noise_l2:.1%}, {doubt.bias_l2:.1%}" if doubt else "exact"]


def _marked(text: str, best: bool) -> str:
    return f"**{text}**" if best else text


def _times(row: Row) -> list[str]:
    totals = (f"{sum(entry.seconds.values()):.1f}" for entry in row.entries.values())
    return [row.label, *totals, row.progressive]
