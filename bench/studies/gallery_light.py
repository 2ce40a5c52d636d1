"""All light on patches of gallery scenes, by component, against particles counted by themselves."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import photonrelax as pr
from bench.markdown import markdown_table
from bench.particles import COMPONENTS, Patch, Tracer
from photonrelax import gallery
from photonrelax.estimation.indirect import IndirectField
from photonrelax.transport.direct_light import direct_irradiance
from photonrelax.transport.raycast import RayCaster

Floats = NDArray[np.float64]

# Sphere of interest, and patches: object, constant axis, its side that is lit, and two corners.
SCENES: dict[str, tuple[tuple[tuple[float, float, float], float], dict[str, Any]]] = {
    "box": (
        ((0.0, -0.2, 0.3), 1.6),
        {
            "floor, left": ("floor", 2, 1, (-0.85, -1.4, 0.0), (-0.05, -0.7, 0.0)),
            "floor, right": ("floor", 2, 1, (0.05, -1.4, 0.0), (0.85, -0.7, 0.0)),
            "shadow": ("floor", 2, 1, (-0.05, -0.65, 0.0), (0.65, 0.05, 0.0)),
            "white box": ("white box", 1, -1, (-0.8, 0.801, 0.1), (0.8, 0.801, 1.1)),
            "red box": ("red box", 0, 1, (-0.9, -1.0, 0.1), (-0.9, 0.6, 1.0)),
        },
    ),
    "lights": (
        ((0.0, -0.2, 0.2), 1.6),
        {
            "caustics": ("floor", 2, 1, (-0.3, -0.9, 0.0), (0.3, -0.3, 0.0)),
            "shadows": ("floor", 2, 1, (-0.5, -1.5, 0.0), (0.5, -0.9, 0.0)),
            "ring": ("floor", 2, 1, (-1.2, -0.7, 0.0), (-0.6, -0.1, 0.0)),
            "amber": ("floor", 2, 1, (0.7, -0.6, 0.0), (1.2, -0.1, 0.0)),
        },
    ),
    "pool": (
        ((0.0, 0.0, -0.5), 3.0),
        {
            "floor, near": ("basin", 2, 1, (-1.8, -1.8, -1.2), (0.0, 0.0, -1.2)),
            "floor, far": ("basin", 2, 1, (0.0, 0.0, -1.2), (1.8, 1.8, -1.2)),
            "wall": ("basin", 0, -1, (2.0, -1.0, -1.15), (2.0, 1.0, -0.2)),
            "dry wall": ("basin", 0, -1, (2.0, -1.0, 0.05), (2.0, 1.0, 0.12)),
        },
    ),
    "cognac": (
        ((0.1, -0.2, 0.4), 1.3),
        {
            "caustic": ("table", 2, 1, (0.05, -0.85, 0.0), (0.45, -0.40, 0.0)),
            "shadow": ("table", 2, 1, (0.0, -1.4, 0.0), (0.8, -0.9, 0.0)),
            "lit": ("table", 2, 1, (-0.8, -0.8, 0.0), (-0.4, 0.0, 0.0)),
        },
    ),
}


def tracer(name: str) -> Tracer:
    """Tracer of a scene with its patches."""
    scene = gallery.scene(name)
    (centre, radius), patches = SCENES[name]
    return Tracer(scene, (np.array(centre), radius), [_patch(scene, p) for p in patches.values()])


def _patch(scene: pr.Scene, patch: tuple[Any, ...]) -> Patch:
    name, axis, side, low, high = patch
    normal = side * np.eye(3)[axis]
    thickness = 1e-4 * np.abs(normal)
    sides = np.delete(np.subtract(high, low), axis)
    number = [item.name for item in scene.objects].index(name)
    return Patch(number, low - thickness, high + thickness, float(sides.prod()), normal)


class Found(NamedTuple):
    """Irradiance by patch, component and channel, W/m², as a render finds it.

    `photons` has photons that are counted on the patches in place of estimates from them.
    """

    render: Floats
    photons: Floats


def found(name: str, n: int, n_global: int, cells: int, seed: int) -> Found:
    """Irradiance of all patches of a scene."""
    scene = gallery.scene(name)
    caster = RayCaster(scene.objects)
    photons = pr.trace_photons(scene, n, seed=seed)
    everything = pr.trace_photons(scene, n_global, seed=seed, paths="global")
    fields = pr.irradiance_field(photons, scene=scene), IndirectField(everything, scene=scene)
    out = []
    for patch in SCENES[name][1].values():
        _, axis, side, low, high = patch
        points, edges = _grid(axis, np.array(low), np.array(high), cells)
        normals = np.tile(side * np.eye(3)[axis], (len(points), 1))
        direct = direct_irradiance(scene, caster, points, normals).mean(axis=0)
        estimates = [field(points, normals, footprint=edges).mean(axis=0) for field in fields]
        counts = [_counted(each, _patch(scene, patch)) for each in (photons, everything)]
        out.append([[direct, *estimates], [direct, *counts]])
    return Found(*np.array(out).swapaxes(0, 1))


def _counted(photons: pr.PhotonMap, patch: Patch) -> Floats:
    """Irradiance (3,) of a patch by the photons there."""
    there = (photons.object_id == patch.object_id) & (photons.wi @ patch.normal > 0.0)
    there &= ((photons.position >= patch.low) & (photons.position <= patch.high)).all(axis=1)
    irradiance: Floats = photons.flux[there].sum(axis=0) / patch.area
    return irradiance


def _grid(axis: int, low: Floats, high: Floats, cells: int) -> tuple[Floats, Floats]:
    """Middles (n, 3) of cells, and their edges (n, 2, 3)."""
    u, v = (k for k in range(3) if k != axis)
    at = (np.arange(cells) + 0.5) / cells
    points = np.tile(low, (cells, cells, 1))
    points[..., u] += (at * (high - low)[u])[:, None]
    points[..., v] += (at * (high - low)[v])[None]
    edges = np.zeros((2, 3))
    edges[0, u], edges[1, v] = (high - low)[u] / cells, (high - low)[v] / cells
    return points.reshape(-1, 3), np.tile(edges, (cells * cells, 1, 1))


def compared(name: str, options: argparse.Namespace) -> tuple[Floats, Found]:
    """Particles by batch, and what renders find by seed."""
    counted = tracer(name).irradiance(options.particles, options.batches, options.seed)
    numbers = options.photons, options.n_global or options.photons, options.cells
    seeds = range(options.seed, options.seed + options.renders)
    each = [found(name, *numbers, seed) for seed in seeds]
    return counted, Found(*(np.array(column) for column in zip(*each, strict=True)))


def rows(name: str, options: argparse.Namespace) -> Iterator[list[str]]:
    """Rows of the table of a scene: a patch each."""
    counted, found = compared(name, options)
    mean = counted.mean(axis=0)
    doubts = [_doubt(each.sum(axis=2)) for each in (counted, found.render)]
    for number, patch in enumerate(SCENES[name][1]):
        total = mean[number].sum(axis=0)
        error = found.render.mean(axis=0)[number].sum(axis=0) / total - 1.0
        yield [
            name,
            patch,
            *(f"{mean[number, i, 1] / total[1]:.0%}" for i in range(len(COMPONENTS))),
            " ".join(f"{value:.4g}" for value in total),
            *(_percent(doubt[number] / total, ".2f") for doubt in doubts),
            _percent(error, "+.2f"),
        ]


def rows_by_component(name: str, options: argparse.Namespace) -> Iterator[list[str]]:
    """Rows of the table of a scene: a component on a patch each, over all light there."""
    counted, found = compared(name, options)
    mean, doubt = counted.mean(axis=0), _doubt(counted)
    of_photons = _doubt(found.photons)
    for number, patch in enumerate(SCENES[name][1]):
        total = mean[number].sum(axis=0)
        for i, component in enumerate(COMPONENTS):
            place = number, i
            errors = [(each.mean(axis=0)[place] - mean[place]) / total for each in found]
            yield [
                name,
                patch,
                component,
                _percent(mean[place] / total, ".1f"),
                *(_percent(each[place] / total, ".2f") for each in (doubt, of_photons)),
                *(_percent(error, "+.2f") for error in reversed(errors)),
            ]


def _doubt(values: Floats) -> Floats:
    """Standard error of the mean over the first axis; NaN of a single one."""
    if len(values) < 2:
        return np.full(values.shape[1:], np.nan)
    return values.std(axis=0, ddof=1) / np.sqrt(len(values))


def _percent(values: Floats, form: str) -> str:
    return " ".join(f"{100.0 * value:{form}}" for value in values)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the study."""
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument("--particles", type=lambda t: int(float(t)), default=1_000_000)
    parser.add_argument("--batches", type=int, default=8)
    parser.add_argument("--photons", type=lambda t: int(float(t)), default=2_000_000)
    parser.add_argument("--global", dest="n_global", type=lambda t: int(float(t)))
    parser.add_argument("--renders", type=int, default=4)
    parser.add_argument("--cells", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--by-component", action="store_true", help="with photons counted too")


def run(options: argparse.Namespace) -> None:
    """Print a table of each scene."""
    titles = ["scene", "patch", *COMPONENTS, "irradiance, W/m²"]
    titles += ["doubt, %", "of renders, %", "renders less it, %"]
    table = rows
    if options.by_component:
        titles = ["scene", "patch", "component", "share, %", "doubt, %", "of photons, %"]
        titles += ["photons less it, %", "renders less it, %"]
        table = rows_by_component
    for name in options.scenes.split(","):
        print(f"{markdown_table(titles, table(name, options))}\n", flush=True)
