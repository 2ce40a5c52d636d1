"""Methods on the same photons: errors and times on every scene, by photons and their sampler."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

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
# Photons a pass of the reference; many passes of few and few of many are about as good.
_REFERENCE_PHOTONS = 1_000_000

Row = tuple[str, int, str, dict[str, Entry]]


def measured(
    photons: list[int], *, pixels: int, passes: int, folder: Path, scenes: tuple[str, ...] = SCENES
) -> Iterator[Row]:
    """Yield scene, photons emitted, sampler and an entry for each method and variant.

    Parameters
    ----------
    photons : list of int
        Emitted.
    pixels : int
        Width and height of pictures, of 2 x 2 samples.
    passes : int
        Of a million photons each, that references take.
    folder : Path
        Where references are kept.
    scenes : tuple of str
        Of the gallery.
    """
    most = min(_REFERENCE_PHOTONS, 10 * max(photons))
    for name in scenes:
        on = subject(name, pixels)
        whole = Plan(subject=on, n_emitted=most)
        truth = reference.kept(folder / f"{name}.exr", whole, passes)
        for n in photons:
            for sampler in SAMPLERS:
                plans = {"": Plan(subject=on, n_emitted=n, sampler=sampler)}
                for variant, (method, settings) in VARIANTS.items():
                    plans[variant] = Plan(
                        subject=on,
                        n_emitted=n,
                        sampler=sampler,
                        methods=(method,),
                        settings=settings,
                    )
                entries = {
                    variant or entry.method: entry
                    for variant, plan in plans.items()
                    for entry in compare(plan, truth).entries
                }
                yield name, n, sampler, entries


def subject(name: str, pixels: int) -> Subject:
    """Return what the gallery knows by a name."""
    if name in gallery.distribution_names():
        return DistributionSubject(name, (pixels, pixels))
    return SceneSubject(gallery.scene(name, pixels=pixels))


def markdown(
    photons: list[int], *, pixels: int, passes: int, folder: Path, scenes: tuple[str, ...] = SCENES
) -> str:
    """Return the table: relative L1, SSIM and seconds, the least L1 and the largest SSIM bold."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = []
    for row in measured(photons, pixels=pixels, passes=passes, folder=folder, scenes=scenes):
        print(f"... {row[0]}, {row[1]:,} photons, {row[2]}", file=sys.stderr, flush=True)
        rows.append(row)
    names = list(rows[0][3])
    lines = [
        f"| | {' | '.join(names)} |",
        f"| --- |{' --- |' * len(names)}",
        *(_line(*row) for row in rows),
    ]
    note = (
        f"Relative L1 of the caustic · SSIM · seconds in all. {pixels} x {pixels} pixels of 2 x 2 "
        f"samples; references: progressive photon mapping with {passes} passes, and the exact "
        f"irradiance of shapes. {machine.description()}."
    )
    return "\n".join([*lines, "", note, ""])


def _line(scene: str, n: int, sampler: str, entries: dict[str, Entry]) -> str:
    least = min(entry.errors.relative_l1 for entry in entries.values())
    most = max(entry.errors.ssim for entry in entries.values())
    cells = [_cell(entry, least, most) for entry in entries.values()]
    return f"| {scene}, {n:,} {sampler} | {' | '.join(cells)} |"


def _cell(entry: Entry, least: float, most: float) -> str:
    l1, ssim = entry.errors.relative_l1, entry.errors.ssim
    shown = [f"{l1:.1%}", f"{ssim:.3f}"]
    marked = [
        f"**{text}**" if best else text
        for text, best in zip(shown, (l1 == least, ssim == most), strict=True)
    ]
    return " · ".join([*marked, f"{sum(entry.seconds.values()):.1f} s"])
