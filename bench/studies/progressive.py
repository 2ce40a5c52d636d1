"""Convergence of progressive photon mapping to analytic irradiance.

Two independent runs separate noise from bias: the mean square of their difference is twice the
squared noise, the mean product of their errors is the squared bias.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from functools import cache

import numpy as np
from tests.analytic.glass_sphere import GlassSphere
from tests.analytic.metal_ring import MetalRing

import photonrelax as pr
from bench.markdown import markdown_table
from photonrelax import gallery
from photonrelax.estimation.progressive import initial_radius
from photonrelax.rendering.passes import pass_seed
from photonrelax.transport.raycast import RayCaster

ALPHA = 0.7
# Slopes are fitted from this pass on, when radii have adapted to the light.
FIRST = 8
# Largest ratio of irradiances within the initial radius around a point of the ring; beyond it the
# point counts as part of the singularity or of the border of light.
MOST_CONTRAST = 1.45


@dataclass(frozen=True)
class Case:
    """A scene, points (m, 3) of its floor away from singularities, their irradiance (m,), W/m².

    With an initial `radius`, m, at which bias is seen against noise.
    """

    scene: pr.Scene
    points: np.ndarray
    exact: np.ndarray
    radius: float


@dataclass(frozen=True)
class Errors:
    """Relative errors, root mean square over points, one for each number of passes."""

    passes: np.ndarray
    total: np.ndarray
    noise: np.ndarray
    bias: np.ndarray

    def slope(self, name: str) -> float:
        """Return the exponent of an error over passes."""
        errors, late = getattr(self, name), self.passes >= FIRST
        late &= errors > 0.0
        return float(np.polyfit(np.log(self.passes[late]), np.log(errors[late]), 1)[0])


@cache
def sphere() -> Case:
    """Circles between the bright spot and the fold of the glass sphere's caustic."""
    distance = np.linspace(0.25, 0.45, 9)
    exact = GlassSphere(gap=0.2, irradiance=0.8).irradiance_at(distance, orders=range(-1, 12))
    distance, turn = np.repeat(distance, 64), np.tile(2 * np.pi * np.arange(64) / 64, 9)
    points = np.column_stack([distance * np.cos(turn), distance * np.sin(turn), 0 * turn])
    return Case(gallery.scene("sphere"), points, np.repeat(exact, 64), 0.08)


@cache
def ring() -> Case:
    """Points of the ring's floor away from the nephroid and the border of light."""
    radius = 0.04
    known = MetalRing(height=0.4, elevation=np.radians(28.0), irradiance=1.6, reflectance=0.95)
    axis = np.linspace(-0.9, 0.9, 121)
    xy = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    # Farther out there is light that was reflected twice.
    xy = xy[np.linalg.norm(xy, axis=1) < 0.92]
    xy = xy[known.irradiance_at(xy, 2001) > 0.0]
    # A few directions rule most points out.
    for n_directions in (4, 16):
        xy = xy[_is_even(known, xy, radius, n_directions)]
    points = np.column_stack([xy, np.zeros(len(xy))])
    return Case(gallery.scene("ring"), points, known.irradiance_at(xy), radius)


def _is_even(known: MetalRing, xy: np.ndarray, radius: float, n_directions: int) -> np.ndarray:
    """True for points around which irradiance varies little, in some directions."""
    turn = np.arange(n_directions) * 2 * np.pi / n_directions
    around = xy[:, np.newaxis] + radius * np.column_stack([np.cos(turn), np.sin(turn)])
    seen = known.irradiance_at(around.reshape(-1, 2), 2001).reshape(-1, n_directions)
    even: np.ndarray = seen.max(axis=1) < MOST_CONTRAST * seen.min(axis=1)
    return even


CASES = {"sphere": sphere, "ring": ring}
SAMPLERS = ("random", "halton")
THEORY = {"total": "", "noise": f"{-ALPHA / 2:.2f}", "bias": f"{ALPHA - 1:.2f}"}


def converge(case: Case, n_passes: int, photons_per_pass: int, *, sampler: str) -> Errors:
    """Return the errors after 1, 2, 4, … passes."""
    settings = pr.ProgressiveSettings(alpha=ALPHA, radius=case.radius)
    caster = RayCaster(case.scene.objects)
    runs: list[pr.ProgressiveStatistics] = []
    wanted, found = [2**i for i in range(n_passes.bit_length())], []
    for number in range(1, wanted[-1] + 1):
        for seed in (1, 2):
            photons = pr.trace_photons(
                case.scene,
                photons_per_pass,
                seed=pass_seed(seed, number),
                sampler=sampler,
                caster=caster,
            )
            if len(runs) < seed:
                runs.append(_first_pass(case, photons, settings))
            runs[seed - 1].add(photons)
        if number in wanted:
            found.append(_errors(case, runs))
            print(f"... {number} passes", file=sys.stderr, flush=True)
    return Errors(np.array(wanted), *np.transpose(found))


def _first_pass(
    case: Case, photons: pr.PhotonMap, settings: pr.ProgressiveSettings
) -> pr.ProgressiveStatistics:
    up = np.tile([0.0, 0.0, 1.0], (len(case.points), 1))
    radius = initial_radius(photons, case.points, up, settings)
    return pr.ProgressiveStatistics(case.points, up, radius, alpha=settings.alpha)


def _errors(case: Case, runs: list[pr.ProgressiveStatistics]) -> tuple[float, float, float]:
    one, other = (run.irradiance()[:, 0] / case.exact - 1.0 for run in runs)
    total = np.sqrt((one**2 + other**2).mean() / 2)
    noise = np.sqrt(((one - other) ** 2).mean() / 2)
    return total, noise, np.sqrt(max((one * other).mean(), 0.0))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--passes", type=int, default=1024, help="default 1024")
    parser.add_argument("--photons", type=float, default=20e3, help="in each pass, default 20e3")


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    print(markdown(options.passes, int(options.photons)))


def markdown(n_passes: int, photons_per_pass: int) -> str:
    """Return errors and slopes for both scenes, from random and from Halton photons."""
    passes = [str(2**i) for i in range(n_passes.bit_length())]
    rows = []
    for scene, case in CASES.items():
        for sampler in SAMPLERS:
            errors = converge(case(), n_passes, photons_per_pass, sampler=sampler)
            rows += [_row(f"{scene}, {sampler}", errors, name) for name in THEORY]
    table = markdown_table(["scene, photons", "error", *passes, "slope", "theory"], rows)
    radii = ", ".join(f"{case().radius:g} m on {scene}" for scene, case in CASES.items())
    return f"{table}\n\n{photons_per_pass:,} photons a pass, α = {ALPHA}; initial radius {radii}.\n"


def _row(title: str, errors: Errors, name: str) -> list[str]:
    values = [f"{100 * value:.2f} %" for value in getattr(errors, name)]
    return [title, name, *values, f"{errors.slope(name):.2f}", THEORY[name]]
