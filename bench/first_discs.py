"""Where light is sharp: progressive photon mapping by how small its discs start, on the prism."""

from __future__ import annotations

import sys
from pathlib import Path

import photonrelax as pr
from photonrelax.compare import Plan, named, reference
from photonrelax.measures import relative_l1

from .methods import FOLDER, REFERENCES

KS = (30, 15, 8, 4, 2)
K_STANDARD = 30
_OWN_SEED = 3


def markdown(
    passes: int = 64,
    photons: int = 125_000,
    *,
    pixels: int = 256,
    effort: reference.Effort = REFERENCES,
    folder: Path = FOLDER,
) -> str:
    """Return the relative L1 of passes by k, and of standard estimates from as many photons."""
    plan = Plan(subject=named("prism", pixels, pixels), n_emitted=passes * photons)
    folder.mkdir(parents=True, exist_ok=True)
    truth = reference.kept(folder / "prism.exr", plan, effort)
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
    doubt = reference.doubt(truth)
    note = "" if doubt is None else f"The reference: {doubt.text()}."
    return "\n".join([*lines, "", note, ""])
