"""Means over texels of light that is relaxed to the density its map prescribes, and to even one.

With ``--cost`` times of both.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
from numpy.typing import NDArray

import photonrelax as pr
from bench.arguments import numbers
from bench.markdown import markdown_table
from bench.speed import machine
from bench.studies import pixel_means
from bench.studies.pixel_means import Errors, FloorMap, reference, texel_means
from photonrelax import gallery
from photonrelax.gallery.meshes import floor, grid_faces, join
from photonrelax.transport.raycast import RayCaster

PLAIN = ((2, 2), (3, 3), (3, 7), (7, 7))
MAPPED = ((5, 5), (14, 14))
# Waves of the water: their number, shortest and longest, m, and the rms of the slope of all.
_N_WAVES, _LENGTHS, _SLOPE = 24, (0.15, 0.7), 0.15
# Pairs whose times are measured.
_ROUNDS = 7


@dataclass(frozen=True)
class Study:
    """Scenes, numbers of photons emitted, seeds; k of estimates; passes of references.

    Attributes
    ----------
    cache : Path, optional
        Folder that references are kept in.
    """

    scenes: tuple[str, ...] = ("ring", "ripples", "prism", "sphere", "water")
    photons: tuple[int, ...] = (300_000, 1_000_000)
    seeds: tuple[int, ...] = (1, 2)
    texels: int = 350
    k: int = 8
    reference_passes: int = 20
    photons_per_pass: int = 2_000_000
    n_threads: int | None = None
    cache: Path | None = None


def water(*, half_size: float = 1.0, depth: float = 0.8, resolution: int = 256) -> pr.Scene:
    """Smooth waves over a floor, in collimated light from above.

    Parameters
    ----------
    half_size, depth : float
        Half the side of the square pool, and its mean depth, m.
    resolution : int
        Cells along each side of the surface.
    """
    side = np.linspace(-half_size, half_size, resolution + 1)
    x, y = (a.ravel() for a in np.meshgrid(side, side))
    height, slope_x, slope_y = _waves(x, y)
    top = np.column_stack([x, y, depth + height])
    normals = np.column_stack([-slope_x, -slope_y, np.ones_like(x)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    faces = grid_faces(resolution + 1, resolution + 1)
    # A hair above the floor: both at one height would be one surface.
    base = np.column_stack([x, y, np.full_like(x, 1e-3)])
    down = np.tile([0.0, 0.0, -1.0], (len(x), 1))
    rim = np.arange(len(x)).reshape(resolution + 1, -1)
    walls = []
    for edge in (rim[0], rim[:, -1], rim[-1, ::-1], rim[::-1, 0]):
        along = top[edge[-1], :2] - top[edge[0], :2]
        outside = np.array([along[1], -along[0], 0.0]) / np.linalg.norm(along)
        vertices = np.concatenate([base[edge], top[edge]])
        walls.append((vertices, np.tile(outside, (len(vertices), 1)), grid_faces(2, len(edge))))
    mesh = join([(top, normals, faces), (base, down, faces[:, ::-1]), *walls])
    return pr.Scene(
        [floor(20.0 * half_size), pr.SceneObject(mesh, pr.Dielectric(1.33), "water", smooth=True)],
        [pr.CollimatedEmitter((0.0, 0.0, -1.0), 1.0)],
        name="water",
    )


def _waves(x: NDArray, y: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Height and slopes along x and y of plane waves in all directions."""
    rng = np.random.default_rng(1)
    turn, shift = rng.uniform(0.0, 2.0 * np.pi, (2, _N_WAVES))
    number = 2.0 * np.pi / np.geomspace(*_LENGTHS, _N_WAVES)
    kx, ky = number * np.cos(turn), number * np.sin(turn)
    phase = np.multiply.outer(x, kx) + np.multiply.outer(y, ky) + shift
    slope = _SLOPE * np.sqrt(2.0 / _N_WAVES) * np.cos(phase)
    height = _SLOPE * np.sqrt(2.0 / _N_WAVES) * np.sin(phase) @ (1.0 / number)
    return height, slope @ np.cos(turn), slope @ np.sin(turn)


@dataclass(frozen=True)
class Subject:
    """A scene, the map of its floor, and counted means of two halves of the passes over texels."""

    scene: pr.Scene
    caster: RayCaster
    floor: FloorMap
    halves: NDArray

    @classmethod
    def of(cls, study: Study, name: str) -> Subject:
        """The scene of a name, with its reference."""
        return cls.of_scene(study, water() if name == "water" else gallery.scene(name), name)

    @classmethod
    def of_scene(cls, study: Study, scene: pr.Scene, name: str) -> Subject:
        """A scene with its reference, from the cache if it is there under a name."""
        caster = RayCaster(scene.objects)
        first = pr.trace_photons(scene, 100_000, caster=caster, n_threads=study.n_threads)
        floor_map = FloorMap.of(first, study.texels)
        passes = pixel_means.Study(
            texels=study.texels,
            reference_passes=study.reference_passes,
            photons_per_pass=study.photons_per_pass,
        )
        counted = f"{study.texels}_{study.reference_passes}x{study.photons_per_pass}"
        file = None if study.cache is None else study.cache / f"{name}_{counted}.npy"
        if file is not None and file.exists():
            return cls(scene, caster, floor_map, np.load(file))
        cells = reference(passes, scene, caster, floor_map)
        halves = np.stack([texel_means(half) for half in cells])
        if file is not None:
            file.parent.mkdir(parents=True, exist_ok=True)
            np.save(file, halves)
        return cls(scene, caster, floor_map, halves)

    @property
    def doubt(self) -> Errors:
        """Noise of the reference: half the difference between its halves."""
        difference = Errors.of(*self.halves)
        return Errors(difference.rms / 2.0, difference.l1 / 2.0, difference.energy)

    def errors(self, photons: pr.PhotonMap, k: int, n_threads: int | None) -> Errors:
        """Errors of the means over texels that photons have, as they are."""
        field = pr.irradiance_field(
            photons,
            method="standard",
            scene=self.scene,
            gather=pr.GatherSettings(k=k),
            n_threads=n_threads,
        )
        return Errors.of(self.floor.means(field), self.halves.mean(axis=0))


def errors_of_settings(
    study: Study, subject: Subject, photons: pr.PhotonMap
) -> Iterator[tuple[str, Errors]]:
    """Yield the errors of every number of iterations, plain and mapped."""
    threads = {"n_threads": study.n_threads}
    structure = pr.detect_structure(photons, **threads)
    rest = pr.rest_density(photons, **threads)
    for iterations in (*PLAIN, *MAPPED):
        mapped = iterations in MAPPED
        moved = pr.relax(
            photons,
            structure,
            pr.RelaxSettings(iterations, step=2.0 if mapped else 1.0),
            rest=rest if mapped else None,
            scene=subject.scene,
            **threads,
        )
        name = f"{'mapped' if mapped else 'plain'} {iterations}"
        yield name, subject.errors(moved, study.k, study.n_threads)


def rows(study: Study) -> Iterator[list[str]]:
    """Yield the rows of the table."""
    for name in study.scenes:
        subject = Subject.of(study, name)
        yield [name, "reference", "", _cell(subject.doubt), *[""] * (len(PLAIN) + len(MAPPED) + 1)]
        for n in study.photons:
            for seed in study.seeds:
                photons = pr.trace_photons(
                    subject.scene, n, seed=seed, caster=subject.caster, n_threads=study.n_threads
                )
                found = dict(errors_of_settings(study, subject, photons))
                unmoved = subject.errors(photons, study.k, study.n_threads)
                cells = [_cell(unmoved), *map(_cell, found.values()), _ratios(list(found.values()))]
                yield [name, f"{n:,}", f"{seed}", *cells]


def _cell(errors: Errors) -> str:
    return f"{errors.rms:.3f} {errors.l1:.4f}"


def _ratios(found: list[Errors]) -> str:
    """Ratios of the first mapped setting to the best plain one, and of the second to the first."""
    plain, first, second = found[: len(PLAIN)], found[len(PLAIN)], found[-1]
    best = min(e.rms for e in plain), min(e.l1 for e in plain)
    return (
        f"{first.rms / best[0]:.2f} {first.l1 / best[1]:.2f}, "
        f"{second.rms / first.rms:.2f} {second.l1 / first.l1:.2f}"
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the scenes, the numbers of photons, the seeds, and the size and place of references."""
    default = Study()
    parser.add_argument("--scenes", default=",".join(default.scenes))
    parser.add_argument("--photons", type=numbers, default=list(default.photons))
    parser.add_argument("--seeds", type=numbers, default=list(default.seeds))
    parser.add_argument("--k", type=int, default=default.k)
    parser.add_argument("--reference-passes", type=int, default=default.reference_passes)
    parser.add_argument("--photons-per-pass", type=int, default=default.photons_per_pass)
    parser.add_argument("--threads", type=int, help="all by default")
    parser.add_argument("--cache", type=Path, help="folder that references are kept in")
    parser.add_argument("--cost", action="store_true", help="times in place of errors")


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    study = Study(
        scenes=tuple(options.scenes.split(",")),
        photons=tuple(options.photons),
        seeds=tuple(options.seeds),
        k=options.k,
        reference_passes=options.reference_passes,
        photons_per_pass=options.photons_per_pass,
        n_threads=options.threads,
        cache=options.cache,
    )
    print(cost(study) if options.cost else markdown(study))


def cost(study: Study) -> str:
    """Table of the times of structure and relaxation, plain and mapped."""
    found = []
    for name in study.scenes:
        scene = water() if name == "water" else gallery.scene(name)
        for n in study.photons:
            photons = pr.trace_photons(scene, n, n_threads=study.n_threads)
            times = np.array([_pair(study, scene, photons) for _ in range(_ROUNDS)])
            plain, mapped = np.median(times, axis=0)
            wall, cpu = np.median(times[:, 1] / times[:, 0], axis=0)
            seconds = (f"{each:.2f}" for each in (plain[1], mapped[1], cpu, wall))
            found.append([name, f"{n:,}", f"{len(photons):,}", *seconds])
    titles = ["scene", "emitted", "stored", "parameterised, CPU s", "mapped, CPU s"]
    titles += ["ratio, CPU", "ratio, wall"]
    return (
        f"{markdown_table(titles, found)}\n\nStructure, rest density and {MAPPED[0]} of mapped "
        f"over structure and {PLAIN[-1]} of parameterised; medians of {_ROUNDS} interleaved pairs. "
        f"{machine.description()}.\n"
    )


def _pair(study: Study, scene: pr.Scene, photons: pr.PhotonMap) -> list[tuple[float, float]]:
    """Wall and CPU seconds of plain and of mapped relaxation, structure included."""
    threads = {"n_threads": study.n_threads}
    taken = []
    for iterations, step in ((PLAIN[-1], 1.0), (MAPPED[0], 2.0)):
        started = perf_counter(), process_time()
        structure = pr.detect_structure(photons, **threads)
        rest = pr.rest_density(photons, **threads) if iterations in MAPPED else None
        settings = pr.RelaxSettings(iterations, step=step)
        pr.relax(photons, structure, settings, rest=rest, scene=scene, **threads)
        taken.append((perf_counter() - started[0], process_time() - started[1]))
    return taken


def markdown(study: Study) -> str:
    """Table of the study."""
    titles = [
        *("scene", "emitted", "seed", "unrelaxed"),
        *(f"parameterised {iterations}" for iterations in PLAIN),
        *(f"mapped {iterations}" for iterations in MAPPED),
        "ratios",
    ]
    return (
        f"{markdown_table(titles, rows(study))}\n\nRoot mean square error over the mean and "
        f"relative L1 of means over {study.texels} x {study.texels} texels of the floor, "
        f"k = {study.k}, against {study.reference_passes} counted passes of "
        f"{study.photons_per_pass:,} photons. Reference: half the difference between the halves "
        f"of its passes. Ratios: mapped {MAPPED[0]} over the best of parameterised, for each "
        f"measure apart, and mapped {MAPPED[1]} over mapped {MAPPED[0]}.\n"
    )
