"""How small discs start: progressive photon mapping of fresh photons, and of photons dealt out."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import photonrelax as pr
from bench.studies.methods import FOLDER, REFERENCES, doubt_cell, truth_of
from photonrelax.estimation.methods import Settings
from photonrelax.evaluation import ComparisonRequest, compare, gallery_subject, reference
from photonrelax.imaging.metrics import relative_l1

KS = (30, 15, 8, 5, 4, 2)
K_STANDARD = 30
# Photons that discs start short of, and passes that photons of one map are dealt to.
DEALT = ((15, 16), (8, 8), (5, 8), (5, 4))
LOTS = tuple(
    (scene, n, sampler)
    for n, samplers in ((100_000, ("halton", "random")), (1_000_000, ("halton",)))
    for sampler in samplers
    for scene in ("prism", "ring", "ripples", "reflector")
)
_OWN_SEED = 3


def markdown(
    passes: int = 64,
    photons: int = 125_000,
    *,
    pixels: int = 256,
    effort: reference.ReferenceSettings = REFERENCES,
    folder: Path = FOLDER,
) -> str:
    """Return the relative L1 of passes by k, and of standard estimates from as many photons."""
    plan = ComparisonRequest(
        subject=gallery_subject("prism", pixels, pixels), n_emitted=passes * photons
    )
    truth = truth_of(plan, effort, folder)
    scene = plan.subject.scene
    assert scene is not None, "the prism is a scene"
    lines = [f"| prism, {passes} passes of {photons:,} photons | L1 |", "| --- | --- |"]

    def told(name: str, image: pr.Image) -> None:
        error = relative_l1(image.layers["caustic"], truth.layers["caustic"])
        lines.append(f"| {name} | {error:.1%} |")
        print(f"... {name}", file=sys.stderr, flush=True)

    for k in KS:
        image = pr.render_progressive(
            scene,
            n_passes=passes,
            photons_per_pass=photons,
            seed=_OWN_SEED,
            settings=pr.ProgressiveSettings(k=k),
        )
        told(f"discs from the photon k = {k}", image)
    gather = pr.GatherSettings(k=K_STANDARD)
    at_once = pr.render(
        scene, method="standard", n_emitted=passes * photons, seed=_OWN_SEED, gather=gather
    )
    told(f"standard, K = {K_STANDARD}, from as many at once", at_once)
    doubt = reference.uncertainty_of(truth)
    note = "" if doubt is None else f"The reference: {doubt.text()}."
    return "\n".join([*lines, "", note, ""])


def dealt(
    lots: Sequence[tuple[str, int, str]] = LOTS,
    *,
    pixels: int = 256,
    effort: reference.ReferenceSettings = REFERENCES,
    folder: Path = FOLDER,
) -> str:
    """Return the relative L1 of photons dealt to passes, by k and passes."""
    settings = [Settings(progressive=pr.ProgressiveSettings(k=k, n_passes=n)) for k, n in DEALT]
    names = [f"k = {k}, {n} passes" for k, n in DEALT]
    head = ["dealt", *names, "reference: noise, bias"]
    lines = [f"| {' | '.join(head)} |", f"|{' --- |' * len(head)}"]
    for scene, n, sampler in lots:
        plan = ComparisonRequest(
            subject=gallery_subject(scene, pixels, pixels),
            methods=("progressive",),
            settings=settings[0],
            variants={
                name: ("progressive", how)
                for name, how in zip(names[1:], settings[1:], strict=True)
            },
            n_emitted=n,
            sampler=sampler,
        )
        truth = truth_of(plan, effort, folder)
        cells = [f"{entry.errors.relative_l1:.1%}" for entry in compare(plan, truth).entries]
        cells.append(doubt_cell(reference.uncertainty_of(truth)))
        lines.append(f"| {scene}, {n:,} {sampler} | {' | '.join(cells)} |")
        print(f"... {scene}, {n:,} {sampler}", file=sys.stderr, flush=True)
    return "\n".join([*lines, ""])
