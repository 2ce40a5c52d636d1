"""SSO08's Fig. 4: the shapes by twelve estimates, as images and as figures.

Noise is the deviation of estimates at a point between photon maps of different seeds, root mean
square over the points of a region, over the irradiance of the shapes. Unlike the deviation over
the points of one map, it does not include bias.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

import numpy as np

import photonrelax as pr
from bench.markdown import markdown_table
from bench.speed.inputs import Floats
from bench.studies.fields import field_with
from photonrelax import gallery
from photonrelax.gallery import shapes as layout
from photonrelax.gallery.photon_pattern import PhotonPattern
from photonrelax.imaging.metrics import relative_l1

KS = (1200, 600, 300, 150)
THRESHOLDS = (0.8, 0.4, 0.2, 0.1)
# The fewest photons of refinements; by default 15.
_LEAST_KS = (15, 50, 150, 500)
SEEDS = 8
# Within the shapes it holds as many photons as the first of KS; the noise scale is a quarter of it,
# the width of the thinnest line.
BANDWIDTH = 0.042
NOISE_SCALE = 0.0105
_STANDARD_KS = (9600, 4800, 2400, 1200, 850, 600, 425, 300, 212, 150, 106, 75, 53, 38, 27)
# Deep inside: farther from the edge than any bandwidth. Along an edge: within this distance of it.
_DEEP, _ALONG = 0.06, 0.01
_POINTS = 600


@dataclass(frozen=True)
class Estimate:
    """A method and its settings."""

    name: str
    method: str
    settings: object

    def prepare(self, photons: pr.PhotonMap) -> Callable[[Floats, Floats], Floats]:
        return field_with(photons, self.method, self.settings)


@dataclass(frozen=True)
class Measures:
    """Figures of an estimate, all relative to the shapes' irradiance.

    Attributes
    ----------
    line : float
        Mean over the thinnest line, away from its ends.
    noise, edge_noise, line_noise : float
        Deep inside the disc and the square; within 1 cm of their edges; on the thinnest line.
    error : float
        Relative L1 over the pixels of one image, against the exact irradiance at the same samples;
        NaN if not asked.
    """

    line: float
    noise: float
    edge_noise: float
    line_noise: float
    error: float = float("nan")


def nearest(k: int, **settings: object) -> Estimate:
    return Estimate(f"k = {k}", "standard", pr.GatherSettings(k=k, **settings))


def diffusion(threshold: float, *, isotropic: bool = False, **settings: float) -> Estimate:
    """Return an estimate of SSO08: a fixed bandwidth, λ₁ over its largest value."""
    chosen = pr.DiffusionSettings(
        k=None,
        edge_threshold=threshold,
        normalisation="maximum",
        **{"bandwidth": BANDWIDTH, "noise_scale": NOISE_SCALE, "least_eigenvalue": 1e-3} | settings,
    )
    method = "isotropic-diffusion" if isotropic else "diffusion"
    return Estimate(f"q = {threshold}", method, chosen)


def figure4() -> dict[str, list[Estimate]]:
    """Return the rows of the figure."""
    return {
        "k nearest photons": [nearest(k) for k in KS],
        "anisotropic diffusion": [diffusion(q) for q in THRESHOLDS],
        "isotropic diffusion": [diffusion(q, isotropic=True) for q in THRESHOLDS],
    }


def plain_estimates() -> list[Estimate]:
    """Return every kernel of the standard method, and fixed bandwidths, from smooth to noisy."""
    fixed = [
        Estimate(
            f"fixed bandwidth {h:.4f} m", "standard", pr.GatherSettings(k=10**6, gather_radius=h)
        )
        for h in BANDWIDTH * np.sqrt(np.array(_STANDARD_KS) / KS[0])
    ]
    counted = [
        Estimate(f"{kernel}, k = {k}", "standard", pr.GatherSettings(k=k, kernel=kernel))
        for kernel in ("epanechnikov", "cone", "constant")
        for k in _STANDARD_KS
    ]
    return counted + fixed


def refined_estimates() -> list[Estimate]:
    """Return every refinement of the standard method, from smooth to noisy."""
    return [
        Estimate(
            f"{name} from {k_min}, k = {k}",
            "standard",
            pr.GatherSettings(k=k, k_min=k_min, refinement=name),
        )
        for name in ("differential-checking", "bias-compensation")
        for k_min in _LEAST_KS
        for k in _STANDARD_KS
        if k > 2 * k_min
    ]


# --- measures ------------------------------------------------------------------------------------


@lru_cache(maxsize=SEEDS)
def pattern(seed: int) -> PhotonPattern:
    return gallery.pattern("shapes", seed=seed)


def regions() -> dict[str, Floats]:
    """Return points deep inside, along edges and on the thinnest line, (n, 2) each."""
    n = _POINTS
    rng = np.random.default_rng(0)
    (centre, radius), (middle, half) = layout.DISC, layout.SQUARE
    turn = 2 * np.pi * rng.random(n // 2)
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    inner = (radius - _DEEP) * np.sqrt(rng.random((n // 2, 1)))
    deep = [centre + inner * circle, middle + rng.uniform(_DEEP - half, half - _DEEP, (n // 2, 2))]
    beside = _ALONG * rng.random((n // 2, 1))
    side = np.sign(rng.random(n // 2) - 0.5)[:, np.newaxis] * (half - beside)
    rim = np.hstack([side, rng.uniform(_DEEP - half, half - _DEEP, (n // 2, 1))])
    swapped = rng.random((n // 2, 1)) < 0.5
    edges = [centre + (radius - beside) * circle, middle + np.where(swapped, rim[:, ::-1], rim)]
    return {
        "deep": np.concatenate(deep),
        "edges": np.concatenate(edges),
        "line": layout.line_points(0, rng.random((n, 2)), layout.LINE_WIDTHS[0]),
    }


def measured(estimate: Estimate, seeds: int = SEEDS, *, pixels: int = 0) -> Measures:
    """Measure over photon maps of so many seeds, and the error of one image if asked."""
    parts = regions()
    points = np.concatenate(list(parts.values()))
    points = np.column_stack([points, np.zeros(len(points))])
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    fields = [estimate.prepare(pattern(seed).photons) for seed in range(seeds)]
    found = np.array([field(points, normals)[:, 0] for field in fields])
    ends = np.cumsum([len(part) for part in parts.values()])[:-1]
    deep, edges, line = np.split(found, ends, axis=1)
    error = float("nan")
    if pixels:
        exact, shown = (pattern(0).image(f, pixels, pixels, 2) for f in (_exact, fields[0]))
        error = relative_l1(shown, exact)
    noise = [float(np.sqrt(part.var(axis=0, ddof=1).mean())) for part in (deep, edges, line)]
    return Measures(float(line.mean()), *noise, error)


def _exact(points: Floats, normals: Floats) -> Floats:
    return pattern(0).irradiance(points)


def line_at_equal_noise(found: Sequence[Measures], noise: float) -> float | None:
    """Return the share of the line that estimates of one kind keep at a noise.

    Interpolated on the logarithm of noise; None outside the range of the estimates' noise.
    """
    order = np.argsort([m.noise for m in found])
    noises = [found[i].noise for i in order]
    if not noises[0] <= noise <= noises[-1]:
        return None
    return float(np.interp(np.log(noise), np.log(noises), [found[i].line for i in order]))


# --- tables and images ----------------------------------------------------------------------------


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seeds", type=int, default=SEEDS, help="photon maps, default 8")
    parser.add_argument("--out", type=Path, default=Path("build/bench/shapes.png"))


def run(options: argparse.Namespace) -> None:
    """Save the images and print the tables."""
    save(options.out)
    print(f"saved in {options.out}", file=sys.stderr)
    print(markdown(options.seeds))


def markdown(seeds: int = SEEDS, pixels: int = 200) -> str:
    """Return the measures of the twelve images, and the best of the standard estimates."""
    found = {
        f"{row}, {estimate.name}": (estimate, measured(estimate, seeds, pixels=pixels))
        for row, estimates in figure4().items()
        for estimate in estimates
    }
    coarse = diffusion(THRESHOLDS[-1], noise_scale=0.5 * BANDWIDTH)
    measures = {name: each for name, (_, each) in found.items()} | {
        f"noise scale half the bandwidth, {coarse.name}": measured(coarse, seeds, pixels=pixels)
    }
    adaptive = {n: each for n, (estimate, each) in found.items() if estimate.method == "diffusion"}
    titles = ["line kept", "noise inside", "along edges", "on the line", "L1"]
    table = markdown_table(
        ["shapes, 48,000 photons", *titles], ([name, *_cells(m)] for name, m in measures.items())
    )
    return f"{table}\n\n{_comparison(adaptive, seeds)}\n"


def _cells(m: Measures) -> list[str]:
    shares = (m.line, m.noise, m.edge_noise, m.line_noise)
    return [*(f"{share:.1%}" for share in shares), f"{m.error:.3f}"]


def most_kept(estimates: Sequence[Estimate], noise: float, seeds: int = SEEDS) -> tuple[float, str]:
    """Return the largest share of the line kept at a noise, and the kind of estimate.

    Kinds that do not reach this noise are named after it.
    """
    kinds: dict[str, list[Measures]] = {}
    for estimate in estimates:
        kinds.setdefault(estimate.name.rsplit(",", 1)[0].split(" 0.")[0], []).append(
            _standard_measured(estimate, seeds)
        )
    kept = {kind: line_at_equal_noise(found, noise) for kind, found in kinds.items()}
    reached = {kind: line for kind, line in kept.items() if line is not None}
    if not reached:
        return float("nan"), "not reached"
    kind = max(reached, key=lambda name: reached[name])
    missing = ", ".join(name for name in kept if name not in reached)
    return reached[kind], f"{kind}; not reached by {missing}" if missing else kind


@cache
def _standard_measured(estimate: Estimate, seeds: int) -> Measures:
    return measured(estimate, seeds)


def _comparison(adaptive: dict[str, Measures], seeds: int) -> str:
    rows = []
    for name, found in adaptive.items():
        cells = [
            f"{kept:.1%} ({kind})"
            for estimates in (plain_estimates(), refined_estimates())
            for kept, kind in [most_kept(estimates, found.noise, seeds)]
        ]
        rows.append([name, f"{found.line:.1%}", *cells])
    titles = ["line kept", "best standard estimate of equal noise", "best of the refined"]
    return markdown_table(["compared with", *titles], rows)


def save(path: Path, pixels: int = 300) -> None:
    """Write the twelve images as one contact sheet, in the order of the figure."""
    from PIL import Image

    shapes, gap = pattern(0), 4
    rows = []
    for estimates in figure4().values():
        images = [shapes.image(e.prepare(shapes.photons), pixels, pixels, 2) for e in estimates]
        rows.append(np.concatenate([_framed(image[..., 0], gap) for image in images], axis=1))
    sheet = np.clip(np.concatenate(rows), 0.0, 1.25) / 1.25
    grey = np.round(255 * sheet ** (1 / 2.2)).astype(np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(grey).save(path)


def _framed(image: Floats, gap: int) -> Floats:
    return np.pad(image, gap, constant_values=0.3)
