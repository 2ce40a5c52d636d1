"""Errors of stored flux by what float32 has to tell apart: gaps, thicknesses, widths of floors."""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable
from functools import cache

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

import photonrelax as pr
from bench.markdown import markdown_table

PHOTONS = 100_000
IOR = 1.5
# Half the width of the plate, m; a metre is the size of the scene but for wide floors.
HALF = 1.0
DECADES = 10
LEVEL = Rotation.identity()
TILTED = Rotation.from_rotvec([0.3, 0.5, 0.2])


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--photons", type=float, default=PHOTONS, help="default 100000")


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    print(markdown(int(options.photons), DECADES))


def markdown(n_emitted: int, decades: int) -> str:
    """Return a table of relative errors of flux, and whether objects were named as too thin."""
    sizes = [10.0**-i for i in range(1, decades + 1)]
    rows = [
        [
            f"{size:.0e}",
            _error(lambda s=size: through_plate(n_emitted, gap=s)),
            _error(lambda s=size: through_plate(n_emitted, gap=0.5, thickness=s)),
            f"{1 / size:.0e}",
            _error(lambda s=size: beside_wide_floor(n_emitted, 1.0 / s, LEVEL)),
            _error(lambda s=size: beside_wide_floor(n_emitted, 1.0 / s, TILTED)),
        ]
        for size in sizes
    ]
    touching = _error(lambda: through_plate(n_emitted, gap=0.0))
    titles = ["m", "gap below a plate of 0.1 m", "thickness of a plate", "half width of a floor, m"]
    titles += ["hollow ball of 0.1 m on it", "and tilted"]
    table = markdown_table(titles, rows)
    return f"{table}\n\nA plate that stands on the floor, without a gap: {touching}.\n"


def _error(ratio: Callable[[], float]) -> str:
    """The error of a ratio that should be 1; in brackets if the program warned."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        text = f"{ratio() - 1.0:+.2%}"
    return f"({text})" if caught else text


def through_plate(n_emitted: int, *, gap: float, thickness: float = 0.1) -> float:
    """Return the flux stored below a plate of glass, over the exact one."""
    extents = (2.0 * HALF, 2.0 * HALF, thickness)
    plate = trimesh.creation.box(extents).apply_translation([0.0, 0.0, gap + thickness / 2.0])
    flux = _stored(plate, 20.0, (0.0, 0.0, -1.0), n_emitted)
    reflected = ((IOR - 1.0) / (IOR + 1.0)) ** 2
    return flux / (4.0 * HALF**2 * (1.0 - reflected) / (1.0 + reflected))


def beside_wide_floor(n_emitted: int, half_width: float, rotation: Rotation) -> float:
    """Flux stored near a hollow ball on a wide floor, over that on a floor 2 m wide."""
    wide, narrow = (near_ball(n_emitted, half, rotation) for half in (half_width, 1.0))
    return wide / narrow


@cache
def near_ball(n_emitted: int, half_width: float, rotation: Rotation) -> float:
    """Flux stored within 1 m of a hollow ball with walls of 2 mm, W."""
    outer, inner = (trimesh.creation.icosphere(4, radius) for radius in (0.05, 0.048))
    inner.invert()
    ball = trimesh.util.concatenate(outer, inner).apply_translation([0.0, 0.0, 0.08])
    return _stored(ball, half_width, (0.2, 0.0, -1.0), n_emitted, rotation)


def _stored(
    glass: trimesh.Trimesh,
    half_width: float,
    direction: tuple[float, ...],
    n_emitted: int,
    rotation: Rotation = LEVEL,
) -> float:
    corners = half_width * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    floor = trimesh.Trimesh(rotation.apply(corners), [[0, 1, 2], [0, 2, 3]], process=False)
    glass = trimesh.Trimesh(rotation.apply(glass.vertices), glass.faces, process=False)
    objects = [pr.SceneObject(glass, pr.Dielectric(IOR)), pr.SceneObject(floor, pr.Diffuse(0.5))]
    scene = pr.Scene(objects, [pr.CollimatedEmitter(rotation.apply(direction))])
    photons = pr.trace_photons(scene, n_emitted, max_bounces=1000)
    near = np.linalg.norm(photons.position, axis=1) < np.sqrt(2.0) * HALF
    return float(photons.flux[near, 0].sum())
