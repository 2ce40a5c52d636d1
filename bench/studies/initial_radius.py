"""Initial radius of progressive photon mapping, of fresh photons and of a split photon map."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import photonrelax as pr
from bench.markdown import markdown_table
from bench.studies.methods import (
    FOLDER,
    REFERENCES,
    caustic_error,
    reference_of,
    uncertainty_cell,
)
from photonrelax.estimation.methods import Settings
from photonrelax.evaluation import ComparisonRequest, compare, gallery_subject
from photonrelax.evaluation.reference import ReferenceSettings, uncertainty_of

KS = (30, 15, 8, 5, 4, 2)
K_STANDARD = 30
# Photons within the initial radius, and passes that the photons of one map are split into.
SPLIT = ((15, 16), (8, 8), (5, 8), (5, 4))
CASES = tuple(
    (scene, n, sampler)
    for n, samplers in ((100_000, ("halton", "random")), (1_000_000, ("halton",)))
    for sampler in samplers
    for scene in ("prism", "ring", "ripples", "reflector")
)
_OWN_SEED = 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """No arguments."""


def run(options: argparse.Namespace) -> None:
    """Print the tables."""
    print(markdown())
    print(split())


def markdown(
    passes: int = 64,
    photons: int = 125_000,
    *,
    pixels: int = 256,
    references: ReferenceSettings = REFERENCES,
    folder: Path = FOLDER,
) -> str:
    """Return the relative L1 of passes by k, and of standard estimates from as many photons."""
    request = ComparisonRequest(
        subject=gallery_subject("prism", pixels, pixels), n_emitted=passes * photons
    )
    reference = reference_of(request, references, folder)
    scene = request.subject.scene
    assert scene is not None, "the prism is a scene"
    rows = []
    for name, image in _images(scene, passes, photons):
        rows.append([name, f"{caustic_error(image, reference):.1%}"])
        print(f"... {name}", file=sys.stderr, flush=True)
    table = markdown_table([f"prism, {passes} passes of {photons:,} photons", "L1"], rows)
    uncertainty = uncertainty_of(reference)
    note = "" if uncertainty is None else f"The reference: {uncertainty.text()}."
    return f"{table}\n\n{note}\n"


def _images(scene: pr.Scene, passes: int, photons: int) -> Iterator[tuple[str, pr.Image]]:
    for k in KS:
        yield (
            f"initial radius of k = {k}",
            pr.render_progressive(
                scene,
                n_passes=passes,
                photons_per_pass=photons,
                seed=_OWN_SEED,
                settings=pr.ProgressiveSettings(k=k),
                n_global=0,
            ),
        )
    gather = pr.GatherSettings(k=K_STANDARD)
    yield (
        f"standard, K = {K_STANDARD}, from as many at once",
        pr.render(
            scene, method="standard", n_emitted=passes * photons, seed=_OWN_SEED, gather=gather
        ),
    )


def split(
    cases: Sequence[tuple[str, int, str]] = CASES,
    *,
    pixels: int = 256,
    references: ReferenceSettings = REFERENCES,
    folder: Path = FOLDER,
) -> str:
    """Return the relative L1 of photon maps split into passes, by k and number of passes."""
    settings = {
        f"k = {k}, {n} passes": Settings(progressive=pr.ProgressiveSettings(k=k, n_passes=n))
        for k, n in SPLIT
    }
    first, *others = settings
    rows = []
    for scene, n, sampler in cases:
        request = ComparisonRequest(
            subject=gallery_subject(scene, pixels, pixels),
            methods=("progressive",),
            settings=settings[first],
            variants={name: ("progressive", settings[name]) for name in others},
            n_emitted=n,
            sampler=sampler,
        )
        reference = reference_of(request, references, folder)
        entries = compare(request, reference).entries
        errors = [f"{entry.errors.relative_l1:.1%}" for entry in entries]
        case = f"{scene}, {n:,} {sampler}"
        rows.append([case, *errors, uncertainty_cell(uncertainty_of(reference))])
        print(f"... {case}", file=sys.stderr, flush=True)
    return markdown_table(["split passes", *settings, "reference: noise, bias"], rows) + "\n"
