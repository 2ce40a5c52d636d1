"""Methods on the same photons: errors and times on every scene, by photons and their sampler."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from time import perf_counter

import numpy as np

import photonrelax as pr
from bench.arguments import numbers
from bench.markdown import markdown_table
from bench.speed import machine
from photonrelax.estimation.methods import Settings
from photonrelax.evaluation import ComparisonRequest, Entry, compare, gallery_subject
from photonrelax.evaluation.reference import (
    ReferenceSettings,
    Uncertainty,
    cached_reference,
    uncertainty_of,
)
from photonrelax.imaging.metrics import check_installed, relative_l1

SCENES = ("prism", "ring", "ripples", "shapes")
SAMPLERS = ("halton", "random")
# Measured in addition to the methods with their default settings. SJ13's diffusion is that of
# SSO08 with eigenvalues over the largest of the map.
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
REFERENCES = ReferenceSettings(passes=200, photons=2_000_000)
"""Settings of the references; `refinements` and `initial_radius` share the files."""
FOLDER = Path("build/bench/methods")
# Fresh photons are given the initial radius of references.
_FRESH = pr.ProgressiveSettings(k=REFERENCES.k)


def reference_of(
    request: ComparisonRequest, settings: ReferenceSettings = REFERENCES, folder: Path = FOLDER
) -> pr.Image:
    """Return the reference of a comparison; it is cached in the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    return cached_reference(folder / f"{request.subject.name}.exr", request, settings)


def caustic_error(image: pr.Image, reference: pr.Image) -> float:
    """Return the relative L1 of the caustic."""
    return relative_l1(image.layers["caustic"], reference.layers["caustic"])


def uncertainty_cell(uncertainty: Uncertainty | None) -> str:
    """Return noise and bias of a reference for a table of relative L1."""
    return (
        "exact" if uncertainty is None else f"{uncertainty.noise_l1:.1%}, {uncertainty.bias_l1:.1%}"
    )


@dataclass(frozen=True, eq=False)
class Row:
    """Results of all methods for the same photons.

    Attributes
    ----------
    label : str
        Scene, photons emitted and sampler.
    entries : dict
        By method or variant.
    brightest : str
        Share of the squared error of the parameterised relaxation in the brightest pixels.
    uncertainty : Uncertainty or None
        Noise and bias of the reference; None for an exact one.
    analytic : float or None
        Relative L1 of the reference where irradiance is analytic.
    progressive : str
        Passes and seconds of progressive photon mapping to the error of the parameterised
        relaxation.
    """

    label: str
    entries: dict[str, Entry]
    brightest: str
    uncertainty: Uncertainty | None
    analytic: float | None
    progressive: str


@dataclass(frozen=True)
class Matrix:
    """A study: scenes, photons and the settings of references.

    Attributes
    ----------
    photons : tuple of int
        Emitted.
    scenes, samplers : tuple of str
        Of the gallery, and of the photons.
    pixels : int
        Width and height of images, of 2 x 2 samples.
    references : ReferenceSettings
        Of the references.
    folder : Path
        Cache of references.
    longest : int
        Most passes of progressive photon mapping of fresh photons; 0 for none.
    """

    photons: tuple[int, ...]
    scenes: tuple[str, ...] = SCENES
    samplers: tuple[str, ...] = SAMPLERS
    pixels: int = 256
    references: ReferenceSettings = REFERENCES
    folder: Path = FOLDER
    longest: int = 64

    def rows(self) -> Iterator[Row]:
        """Measure."""
        for name in self.scenes:
            subject = gallery_subject(name, self.pixels, self.pixels)
            for n, sampler in product(self.photons, self.samplers):
                request = ComparisonRequest(
                    subject=subject,
                    variants=VARIANTS,
                    n_emitted=n,
                    sampler=sampler,
                    supersampling=_SAMPLES,
                    rounds=_ROUNDS if self._timed(n, sampler) else 1,
                )
                yield self._row(request, reference_of(request, self.references, self.folder))

    def _timed(self, n: int, sampler: str) -> bool:
        return (n, sampler) == (max(self.photons), "halton")

    def _row(self, request: ComparisonRequest, reference: pr.Image) -> Row:
        comparison = compare(request, reference)
        entries = {entry.name: entry for entry in comparison.entries}
        parameterised = entries["parameterised"]
        longer = ""
        if self._timed(request.n_emitted, request.sampler):
            error = parameterised.errors.relative_l1
            longer = passes_to_error(request, reference, error, self.longest)
        return Row(
            f"{request.subject.name}, {request.n_emitted:,} {request.sampler}",
            entries,
            at_the_brightest(parameterised.image, reference),
            uncertainty_of(reference),
            comparison.reference.analytic_errors.get("relative_l1"),
            longer,
        )


def at_the_brightest(image: pr.Image, reference: pr.Image, n: int = _BRIGHTEST) -> str:
    """Return the share of the squared error, and of the light, in the brightest pixels."""
    found, exact = (np.asarray(each.layers["caustic"]).sum(axis=2) for each in (image, reference))
    squares = (found - exact) ** 2
    pixels = np.argsort(exact, axis=None)[-n:]
    share = squares.ravel()[pixels].sum() / squares.sum()
    light = found.ravel()[pixels].sum() / exact.ravel()[pixels].sum()
    return f"{share:.0%} of it is in the {n} brightest pixels, which it shows at {light:.0%}"


def passes_to_error(
    request: ComparisonRequest, reference: pr.Image, error: float, longest: int
) -> str:
    """Return the passes, in powers of two, and seconds that fresh photons take to an error.

    Camera rays count, as for every method.
    """
    scene, passes, found, seconds = request.subject.scene, 1, np.inf, 0.0
    if scene is None or longest < 1:
        return "–"
    while found > error and passes <= longest:
        started = perf_counter()
        # A seed of its own: photons of the reference would lower the error.
        image = pr.render_progressive(
            scene,
            n_passes=passes,
            photons_per_pass=request.n_emitted,
            seed=_OWN_SEED,
            settings=_FRESH,
            n_global=0,
        )
        text, seconds = f"{passes} passes", perf_counter() - started
        found = caustic_error(image, reference)
        passes *= 2
    reached = "" if found <= error else f", still {found:.1%}"
    return f"{text}, {seconds:.1f}{reached}"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--photons", type=numbers, default=[100_000, 1_000_000])
    parser.add_argument("--scenes", nargs="+", default=SCENES, metavar="SCENE")
    parser.add_argument("--pixels", type=int, default=256, help="default 256")
    parser.add_argument(
        "--passes", type=int, default=REFERENCES.passes, help="of references, default 200"
    )
    parser.add_argument(
        "--reference-photons", type=float, default=REFERENCES.photons, help="in each"
    )
    parser.add_argument("--out", type=Path, default=FOLDER)


def run(options: argparse.Namespace) -> None:
    """Print the tables."""
    matrix = Matrix(
        photons=tuple(options.photons),
        scenes=tuple(options.scenes),
        pixels=options.pixels,
        references=ReferenceSettings(options.passes, int(options.reference_photons)),
        folder=options.out,
    )
    print(markdown(matrix))


def markdown(matrix: Matrix) -> str:
    """Return a table of errors, the least L1 and the largest SSIM bold, and one of times."""
    check_installed()
    rows = []
    for row in matrix.rows():
        print(f"... {row.label}", file=sys.stderr, flush=True)
        rows.append(row)
    names = [f"{name}, split passes" if name == "progressive" else name for name in rows[0].entries]
    errors = ["", *names, "reference: noise, bias"]
    timed = [row for row in rows if row.progressive]
    times = ["seconds", *names, "progressive, fresh photons, to the error of parameterised"]
    parts = [
        markdown_table(errors, map(_errors, rows)),
        _note(matrix),
        *_notes_on_references(rows),
        "Relative L2:",
        markdown_table(errors, map(_squares, rows)),
        *(
            f"Squared error of parameterised, {row.label}: {row.brightest}."
            for row in timed
            if row.uncertainty is not None
        ),
        markdown_table(times, map(_times, timed)),
        f"Medians of {_ROUNDS} interleaved rounds; camera rays count. {machine.description()}.",
    ]
    return "\n\n".join(parts) + "\n"


def _note(matrix: Matrix) -> str:
    return (
        f"Relative L1 of the caustic · SSIM, {matrix.pixels} x {matrix.pixels} pixels of "
        f"{_SAMPLES} x {_SAMPLES} samples. References: the exact irradiance of shapes at the same "
        f"samples; otherwise progressive photon mapping, {matrix.references.passes} passes of "
        f"{matrix.references.photons:,} photons in two runs. Split passes: of the photons of "
        "the same map."
    )


def _notes_on_references(rows: list[Row]) -> Iterator[str]:
    for row in rows:
        if row.analytic is not None:
            errors = ", ".join(
                f"{e.name} {e.analytic_errors['relative_l1']:.1%}" for e in row.entries.values()
            )
            yield (
                f"Reference of {row.label} where irradiance is analytic: off by "
                f"{row.analytic:.1%}; {errors}"
            )


def _errors(row: Row) -> list[str]:
    each = [entry.errors for entry in row.entries.values()]
    least, most = min(e.relative_l1 for e in each), max(e.ssim for e in each)
    cells = [
        f"{_bold_if(f'{e.relative_l1:.1%}', e.relative_l1 == least)} · "
        f"{_bold_if(f'{e.ssim:.3f}', e.ssim == most)}"
        for e in each
    ]
    return [row.label, *cells, uncertainty_cell(row.uncertainty)]


def _squares(row: Row) -> list[str]:
    each = [entry.errors.relative_l2 for entry in row.entries.values()]
    cells = [_bold_if(f"{error:.1%}", error == min(each)) for error in each]
    of = row.uncertainty
    return [row.label, *cells, f"{of.noise_l2:.1%}, {of.bias_l2:.1%}" if of else "exact"]


def _bold_if(text: str, best: bool) -> str:
    return f"**{text}**" if best else text


def _times(row: Row) -> list[str]:
    totals = (f"{sum(entry.seconds.values()):.1f}" for entry in row.entries.values())
    return [row.label, *totals, row.progressive]
