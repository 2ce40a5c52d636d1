"""SSO08's Table 1: photons, and time, that k nearest photons take for the error of diffusion.

Errors are relative L1 over the pixels of a square of the floor. The reference is the flux of many
photons that fall into each pixel, which depends on no estimate. As in the paper, k is the best
for each map; so is the bandwidth of diffusion.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from statistics import median
from time import perf_counter

import numpy as np

import photonrelax as pr
from bench.markdown import markdown_table
from bench.speed.inputs import Floats
from bench.studies.fields import field_with
from photonrelax import gallery

# Photons of SSO08's Fig. 6(d) and 7(d), and how many times as many its Table 1 has for (c).
PAPER = {"ring": (40_000, 160_000 / 40_000), "ripples": (70_000, 520_000 / 70_000)}
HALF_SIZES = {"ring": 1.05, "ripples": 1.0}
PIXELS = 200
_REFERENCE_PASSES, _REFERENCE_EMITTED = 10, 4_000_000
_KS = (6, 10, 15, 25, 40, 60, 100, 160, 250, 400)
_DIFFUSION_KS = (30, 50, 75, 100, 150, 250, 500, 1000)
_BANDWIDTH_COUNTS = (6, 12, 25, 50, 100, 200, 400)
# Noise scales over the bandwidth.
_NOISE_SHARES = (0.25, 0.5)
_TIMES_AS_MANY = (1, 2, 4, 8, 16, 32)
_ROUNDS = 3
Estimate = tuple[str, str, object]
"""Description, method and settings."""


@dataclass(frozen=True)
class Run:
    """An image of the floor; seconds from emission to image, the median of some rounds."""

    settings: str
    n: int
    error: float
    seconds: float


@dataclass(frozen=True)
class Floor:
    """The square of a scene's floor that errors are measured on."""

    scene: str
    half: float
    n_pixels: int

    def counted(self, photons: pr.PhotonMap) -> Floats:
        """Return the mean irradiance of pixels (rows, columns) from the photons in each."""
        above = (np.abs(photons.position[:, 2]) < 1e-6) & (photons.normal[:, 2] > 0.5)
        edges = np.linspace(-self.half, self.half, self.n_pixels + 1)
        y, x = photons.position[above, 1], photons.position[above, 0]
        flux = photons.flux[above].mean(axis=1)
        return (
            np.histogram2d(y, x, bins=(edges, edges), weights=flux)[0] / (edges[1] - edges[0]) ** 2
        )

    def samples(self, s: int = 2) -> tuple[Floats, Floats]:
        """Return s·s points in each pixel, and normals."""
        side = (np.arange(self.n_pixels * s) + 0.5) / (self.n_pixels * s)
        x, y = np.meshgrid(*2 * [self.half * (2 * side - 1)])
        points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
        return points, np.tile([0.0, 0.0, 1.0], (len(points), 1))

    def image(self, field: pr.IrradianceField, s: int = 2) -> Floats:
        found = field(*self.samples(s)).mean(axis=1)
        return found.reshape(self.n_pixels, s, self.n_pixels, s).mean(axis=(1, 3))


@lru_cache
def counted_reference(floor: Floor, passes: int, n_emitted: int) -> Floats:
    """Return the mean of counted irradiance over passes."""
    scene = gallery.scene(floor.scene)
    total = np.zeros((floor.n_pixels, floor.n_pixels))
    for seed in range(passes):
        total += floor.counted(pr.trace_photons(scene, n_emitted, seed=1000 + seed))
        print(f"... reference of {floor.scene}, pass {seed + 1} of {passes}", file=sys.stderr)
    return total / passes


def tracing(scene: str, n: int, sampler: str) -> Callable[[], pr.PhotonMap]:
    """Return a call that traces about n photons."""
    built = gallery.scene(scene)
    share = len(pr.trace_photons(built, 20_000)) / 20_000
    return partial(pr.trace_photons, built, int(n / share), sampler=sampler)


def best(
    floor: Floor, expected: Floats, n: int, sampler: str, estimates: Sequence[Estimate]
) -> Run:
    """Return the run of the estimate with the least error."""
    trace = tracing(floor.scene, n, sampler)
    photons = trace()
    errors = [
        float(np.abs(image_of(floor, photons, one) - expected).sum() / expected.sum())
        for one in estimates
    ]
    found = int(np.argmin(errors))
    border = " (at the border of those tried)" if found in (0, len(estimates) - 1) else ""
    seconds = []
    for _ in range(_ROUNDS):
        started = perf_counter()
        image_of(floor, trace(), estimates[found])
        seconds.append(perf_counter() - started)
    return Run(f"{estimates[found][0]}{border}", len(photons), errors[found], median(seconds))


def image_of(floor: Floor, photons: pr.PhotonMap, estimate: Estimate) -> Floats:
    _, method, settings = estimate
    return floor.image(field_with(photons, method, settings))


def nearest() -> list[Estimate]:
    return [(f"k = {k}", "standard", pr.GatherSettings(k=k)) for k in _KS]


def adaptive() -> list[Estimate]:
    return [(f"k = {k}", "diffusion", pr.DiffusionSettings(k=k)) for k in _DIFFUSION_KS]


def published(n: int, half: float, share: float) -> list[Estimate]:
    """Return the estimates of SSO08: fixed bandwidths, a noise scale of a share of each, q = 0.2,
    λ₁ over its largest value.
    """
    estimates: list[Estimate] = []
    for count in _BANDWIDTH_COUNTS:
        bandwidth = 2 * half * np.sqrt(count / (np.pi * n))
        settings = pr.DiffusionSettings(
            k=None,
            bandwidth=bandwidth,
            noise_scale=share * bandwidth,
            edge_threshold=0.2,
            normalisation="maximum",
        )
        estimates.append((f"h = {bandwidth:.3f} m", "diffusion", settings))
    return estimates


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--scenes", nargs="+", default=tuple(PAPER), metavar="SCENE")
    parser.add_argument("--sampler", choices=("random", "halton"), default="random")


def run(options: argparse.Namespace) -> None:
    """Print the table."""
    print(markdown(options.scenes, options.sampler))


def markdown(scenes: Sequence[str] = tuple(PAPER), sampler: str = "random") -> str:
    """Return the table of some scenes."""
    titles = [sampler, "photons", "L1", "seconds", "nearest for this L1: photons", "seconds"]
    floors = (Floor(scene, HALF_SIZES[scene], PIXELS) for scene in scenes)
    return markdown_table(titles, (row for floor in floors for row in _rows(floor, sampler))) + "\n"


def _rows(floor: Floor, sampler: str) -> Iterator[list[str]]:
    expected = counted_reference(floor, _REFERENCE_PASSES, _REFERENCE_EMITTED)
    n, ratio = PAPER[floor.scene]
    ladder = [best(floor, expected, n * times, sampler, nearest()) for times in _TIMES_AS_MANY]
    runs = {"diffusion, local": best(floor, expected, n, sampler, adaptive())}
    for share in _NOISE_SHARES:
        estimates = published(n, floor.half, share)
        runs[f"SSO08, noise scale {share:g} h"] = best(floor, expected, n, sampler, estimates)
    for run in ladder:
        yield [*_cells(f"{floor.scene}, nearest", run), "", ""]
    for name, run in runs.items():
        sign, photons, seconds = needed(ladder, run.error)
        times = [f"{sign}{photons / run.n:.1f}×", f"{sign}{seconds / run.seconds:.1f}×"]
        yield [*_cells(f"{floor.scene}, {name}", run), *times]
    yield [f"{floor.scene}, SSO08's own Table 1", f"{n:,}", "", "", f"{ratio:.1f}×", ""]


def _cells(name: str, run: Run) -> list[str]:
    return [f"{name}, {run.settings}", f"{run.n:,}", f"{run.error:.3f}", f"{run.seconds:.2f}"]


def needed(ladder: list[Run], error: float) -> tuple[str, float, float]:
    """Return photons and seconds of this error, interpolated on logarithms.

    Before them "<" or ">" where the error is outside the ladder, which goes from few photons to
    many.
    """
    sign = "<" if error > ladder[0].error else ">" if error < ladder[-1].error else ""
    x = -np.log([run.error for run in ladder])
    photons = np.interp(-np.log(error), x, np.log([run.n for run in ladder]))
    seconds = np.interp(-np.log(error), x, np.log([run.seconds for run in ladder]))
    return sign, float(np.exp(photons)), float(np.exp(seconds))
