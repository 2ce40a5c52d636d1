"""Light of two emitters whose photons push one another once sheets are relaxed, or never do."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

import photonrelax as pr
from bench.arguments import numbers
from bench.markdown import markdown_table
from bench.studies import slopes
from bench.studies.pixel_means import Errors
from bench.studies.slopes import Study, Subject
from photonrelax import gallery

_SCENES = ("ring", "ripples", "water")
# Degrees between two suns, and their shares of the light.
_ANGLES, _SHARES = (2.0, 20.0), (0.5, 0.8)
# Iterations among photons of a sheet, and among all that are near in space.
_SHEETS, _SPACE = 7, 7


def two_suns(name: str, angle: float, share: float) -> pr.Scene:
    """A scene under two suns, degrees apart, in place of one; a share is that of the first."""
    scene = slopes.water() if name == "water" else gallery.scene(name)
    sun = next(each for each in scene.emitters if isinstance(each, pr.CollimatedEmitter))
    along, across = np.asarray(sun.direction), np.array([0.0, 1.0, 0.0])
    turn, light = np.radians(0.5 * angle), np.asarray(sun.irradiance)
    suns = [
        pr.CollimatedEmitter(np.cos(turn) * along - np.sin(turn) * across, share * light),
        pr.CollimatedEmitter(np.cos(turn) * along + np.sin(turn) * across, (1.0 - share) * light),
    ]
    return replace(scene, emitters=suns)


def apart(photons: pr.PhotonMap, structure: pr.Structure, scene: pr.Scene) -> pr.PhotonMap:
    """Photons relaxed among those of their emitter alone."""
    return pr.relax(photons, structure, pr.RelaxSettings((_SHEETS, _SPACE)), scene=scene)


def together(photons: pr.PhotonMap, structure: pr.Structure, scene: pr.Scene) -> pr.PhotonMap:
    """The same, but after the collapse of the emitter coordinates among those of all emitters."""
    first = pr.relax(photons, structure, pr.RelaxSettings((_SHEETS, 0)), scene=scene)
    mixed = first.replace(emitter_id=None, emitter_coords=None, emitter_density=None)
    last = pr.relax(mixed, structure, pr.RelaxSettings((0, _SPACE)), scene=scene)
    return first.replace(position=last.position, normal=last.normal)


def rows(study: Study) -> Iterator[list[str]]:
    """Yield the rows of the table."""
    for name in study.scenes:
        for angle in _ANGLES:
            for share in _SHARES:
                scene = two_suns(name, angle, share)
                case = f"{name}, {angle:g}°, {share:g}"
                subject = Subject.of_scene(study, scene, f"{name}_{angle:g}_{share:g}")
                for n in study.photons:
                    found = [_errors(study, subject, n, seed) for seed in study.seeds]
                    yield [case, f"{n:,}", f"{subject.doubt.l1:.4f}", *_cells(found)]


def _errors(study: Study, subject: Subject, n: int, seed: int) -> list[Errors]:
    photons = pr.trace_photons(subject.scene, n, seed=seed, caster=subject.caster)
    structure = pr.detect_structure(photons)
    moved = (way(photons, structure, subject.scene) for way in (apart, together))
    return [subject.errors(each, study.k, study.n_threads) for each in (photons, *moved)]


def _cells(found: list[list[Errors]]) -> list[str]:
    """Means over seeds, and the ratio of the last to the one before."""
    l1, rms = ([np.mean([e[i] for e in way]) for way in zip(*found, strict=True)] for i in (1, 0))
    cells = [f"{one:.4f} {other:.3f}" for one, other in zip(l1, rms, strict=True)]
    return [*cells, f"{l1[2] / l1[1]:.3f} {rms[2] / rms[1]:.3f}"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the scenes, the numbers of photons, the seeds and the size of references."""
    parser.add_argument("--scenes", default=",".join(_SCENES))
    parser.add_argument("--photons", type=numbers, default=[300_000, 1_000_000])
    parser.add_argument("--seeds", type=numbers, default=[1, 2])
    parser.add_argument("--k", type=int, default=15)
    parser.add_argument("--reference-passes", type=int, default=Study.reference_passes)
    parser.add_argument("--photons-per-pass", type=int, default=Study.photons_per_pass)


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    study = Study(
        scenes=tuple(options.scenes.split(",")),
        photons=tuple(options.photons),
        seeds=tuple(options.seeds),
        k=options.k,
        reference_passes=options.reference_passes,
        photons_per_pass=options.photons_per_pass,
    )
    titles = ["suns", "emitted", "doubt", "unrelaxed", "apart", "together", "together over apart"]
    print(
        f"{markdown_table(titles, rows(study))}\n\nTwo suns, degrees apart, and the share of the "
        "first. Relative L1 and root mean square error over the mean, means over "
        f"{len(study.seeds)} seeds, of means over {study.texels} x {study.texels} texels of the "
        f"floor, k = {study.k}, against {study.reference_passes} counted passes of "
        f"{study.photons_per_pass:,} photons; doubt: half the L1 between halves of them.\n"
    )
