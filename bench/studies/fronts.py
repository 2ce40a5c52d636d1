"""Times of methods by error, on many scenes: sweeps of `photonrelax.tradeoff`, and their table."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import photonrelax as pr
from bench.arguments import numbers
from bench.markdown import markdown_table
from photonrelax import gallery
from photonrelax.evaluation.reference import UNCERTAINTY, Uncertainty
from photonrelax.evaluation.report import front
from photonrelax.evaluation.tradeoff import Tradeoff, TradeoffRequest, seconds_for
from photonrelax.imaging.image import Image, read_exr
from photonrelax.imaging.metrics import relative_l1, relative_l2
from photonrelax.rendering.view import resized

METHODS = ("envelope", "parameterised", "mapped", "standard", "progressive")
# Methods whose times are told beside those of the best.
TOLD = ("parameterised", "standard", "progressive")
_REFERENCE, _ENVELOPE = "converged.exr", "an envelope"
# A reference's doubt over an error that is told, at most.
_DOUBT_SHARE = 1.0 / 3.0
# Share of its own noise that a difference of images is known to.
_RESOLVED = 0.1


@dataclass(frozen=True)
class Study:
    """Scenes, methods and photons of sweeps, and their references.

    Attributes
    ----------
    counts : int
        Images of counted photons, `counted` emitted each, that check envelopes.
    reference_error : float
        Misplaced light of envelopes that are references.
    is_cpu : bool
        Times are of the processors, not of the clock.
    """

    folder: Path
    scenes: tuple[str, ...] = ("ring", "sphere", "ripples", "prism", "pool")
    methods: tuple[str, ...] = METHODS
    n_emitted: int = 1_000_000
    pixels: int = 200
    counts: int = 8
    counted: int = 2_000_000
    reference_error: float = 0.003
    is_cpu: bool = False


def add_arguments(parser: argparse.ArgumentParser) -> None:
    default = Study(Path())
    parser.add_argument("folder", type=Path, help="a folder of each scene is made in it, or read")
    parser.add_argument("--scenes", default=",".join(default.scenes))
    parser.add_argument("--methods", default=",".join(default.methods))
    parser.add_argument("--photons", type=numbers, default=[default.n_emitted])
    parser.add_argument("--pixels", type=int, default=default.pixels)
    parser.add_argument("--counts", type=int, default=default.counts)
    parser.add_argument("--counted-photons", type=numbers, default=[default.counted])
    parser.add_argument("--reference-error", type=float, default=default.reference_error)
    parser.add_argument("--cpu", action="store_true", help="times of processors, not of the clock")


def run(options: argparse.Namespace) -> None:
    """Sweep the scenes that have not been swept, and print the table."""
    study = Study(
        options.folder,
        tuple(options.scenes.split(",")),
        tuple(options.methods.split(",")),
        options.photons[0],
        options.pixels,
        options.counts,
        options.counted_photons[0],
        options.reference_error,
        options.cpu,
    )
    sweeps = [swept(name, study) for name in study.scenes]
    print(markdown(sweeps, is_cpu=study.is_cpu))
    print(by_scene(sweeps, is_cpu=study.is_cpu))


def swept(name: str, study: Study) -> Tradeoff:
    """The sweep of a scene, which goes on where it was."""
    scene = resized(gallery.scene(name), study.pixels, None)
    folder = study.folder / name
    image = kept_reference(scene, study)
    # Where envelopes are left to photons, they would be measured twice.
    is_left = not image.metadata["photonrelax.reference"].startswith(_ENVELOPE)
    methods = [each for each in study.methods if not (is_left and each == "envelope")]
    found = pr.tradeoff(
        scene, folder, TradeoffRequest(study.n_emitted, tuple(methods)), reference=image
    )
    front.write(found, folder)
    return found


def kept_reference(scene: pr.Scene, study: Study) -> Image:
    """The reference in the folder of a scene, which is made if it is not there."""
    folder = study.folder / scene.name
    study.folder.mkdir(parents=True, exist_ok=True)
    front.prepare_folder(folder)
    path = folder / _REFERENCE
    if not path.exists():
        reference(scene, study).write_exr(path)
    return read_exr(path)


def reference(scene: pr.Scene, study: Study) -> Image:
    """The caustic of an envelope, or of counted photons, whichever is in less doubt.

    What an envelope differs from counts by, beyond their noise, is its doubt; that of counts is
    their noise.
    """
    halves = [_counted(scene, study, first) for first in range(2)]
    mean = 0.5 * (halves[0] + halves[1])
    noise = [0.5 * metric(halves[0], halves[1]) for metric in (relative_l1, relative_l2)]
    found, doubt, text = mean, noise, f"counts of {study.counts} x {study.counted:,} photons"
    envelope = _envelope(scene, study)
    if envelope is not None:
        apart = [metric(envelope, mean) for metric in (relative_l1, relative_l2)]
        beyond = [
            max(d * d - h * h, (_RESOLVED * h) ** 2) ** 0.5
            for d, h in zip(apart, noise, strict=True)
        ]
        if beyond[0] < doubt[0]:
            found, doubt = envelope, beyond
            text = f"{_ENVELOPE} of error {study.reference_error:g}, checked by {text}"
    fixed = pr.render(scene, n_emitted=1000, components=("emission", "direct"))
    metadata = {
        "photonrelax.reference": text,
        UNCERTAINTY: json.dumps(asdict(Uncertainty(doubt[0], doubt[1], 0.0, 0.0))),
    }
    layers = {"radiance": found + np.asarray(fixed.layers["radiance"]), "caustic": found}
    return Image(layers, metadata)


def _counted(scene: pr.Scene, study: Study, first: int) -> NDArray:
    """Mean caustic of every second image of counted photons."""
    images = [
        pr.render(
            scene,
            method="standard",
            n_emitted=study.counted,
            seed=1000 + number,
            gather=pr.GatherSettings(k=4),
            components=("caustic",),
        )
        for number in range(first, study.counts, 2)
    ]
    return np.mean([image.layers["caustic"] for image in images], axis=0)


def _envelope(scene: pr.Scene, study: Study) -> NDArray | None:
    """Caustic of a converged envelope; None where much of it is of photons, or all."""
    if scene.has_dispersion:
        return None
    settings = pr.EnvelopeSettings(error=study.reference_error)
    trial = replace(settings, error=0.4, n_rays=40_000, n_photons=20_000)
    for each in (trial, settings):
        image = pr.render(scene, method="envelope", envelope=each, components=("caustic",))
        if image.stats["envelope"]["of_photons"] > 0.5:
            return None
    return np.asarray(image.layers["caustic"])


def markdown(sweeps: list[Tradeoff], *, is_cpu: bool = False) -> str:
    """Table of the sweeps, a row each scene and error above the doubt of its reference."""
    titles = ["scene", "error", "doubt", "best method", "s", *TOLD]
    clock = "of the processors, without" if is_cpu else "of the clock, with"
    rows = [row for found in sweeps for row in _rows(found, is_cpu)]
    return (
        f"{markdown_table(titles, rows)}\n\nSeconds {clock} those of camera rays, until "
        "relative L1 of the caustic is the error; – where no settings of the sweep reach it.\n"
    )


def by_scene(sweeps: list[Tradeoff], *, is_cpu: bool = False) -> str:
    """Table of the sweeps, a row each scene: the same seconds, errors beside one another."""
    errors = [f"{error:.0%}" for error in front.ERRORS]
    titles = ["scene", *(f"best, {error}" for error in errors)]
    titles += [f"{method}, {' / '.join(errors)}" for method in TOLD]
    rows = []
    for found in sweeps:
        seconds = [_seconds(found, error, is_cpu) for error in front.ERRORS]
        told = ([_text(each.get(m, np.inf)) if each else "" for each in seconds] for m in TOLD)
        beside = (" / ".join(each).rstrip(" /") for each in told)
        rows.append([found.about["scene"], *map(_best, seconds), *beside])
    return markdown_table(titles, rows)


def _best(seconds: dict[str, float]) -> str:
    """The quickest method and its seconds; a dash if none reaches an error, empty in doubt."""
    if not seconds:
        return ""
    name, text = _quickest(seconds)
    return f"{name} {text}" if name != "–" else name


def _quickest(seconds: dict[str, float]) -> tuple[str, str]:
    """The quickest method and its seconds; dashes if none reaches an error."""
    name = min(seconds, key=seconds.__getitem__)
    text = _text(seconds[name])
    return (name, text) if text != "–" else (text, text)


def _seconds(found: Tradeoff, error: float, is_cpu: bool) -> dict[str, float]:
    """Seconds of each method to an error; empty if that of the reference is in doubt."""
    # Unknown doubt is not known to be small.
    if not found.doubt < _DOUBT_SHARE * error:
        return {}
    if is_cpu:
        points = [replace(each, seconds={"cpu": each.cpu_seconds}) for each in found.points]
        found = replace(found, points=tuple(points))
    methods = dict.fromkeys(point.choice.method for point in found.points)
    return {method: seconds_for(found.of(method), error) for method in methods}


def _rows(found: Tradeoff, is_cpu: bool) -> Iterator[list[str]]:
    for error in front.ERRORS:
        seconds = _seconds(found, error, is_cpu)
        if not seconds:
            continue
        told = [_text(seconds.get(method, np.inf)) for method in TOLD]
        scene, doubt = found.about["scene"], f"{found.doubt:.2%}"
        yield [scene, f"{error:.0%}", doubt, *_quickest(seconds), *told]


def _text(seconds: float) -> str:
    return f"{seconds:.2f}" if np.isfinite(seconds) else "–"
