"""SSO08's Fig. 4: the shapes estimated in twelve ways, as pictures and as figures.

Noise is the deviation of estimates at a point between photon maps of different seeds, root mean
square over the points of a region, over the irradiance of the shapes; unlike the deviation over
the points of one map, it has no part of bias.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

import numpy as np

import photonrelax as pr
from bench.speed.morton import Floats
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
# Deep inside is farther from the edge than any kernel looks; along an edge is next to it.
_DEEP, _ALONG = 0.06, 0.01
_POINTS = 600


@dataclass(frozen=True)
class Way:
    """A method and its settings."""

    name: str
    method: str
    settings: object

    def prepare(self, photons: pr.PhotonMap) -> Callable[[Floats, Floats], Floats]:
        name = "gather" if self.method == "standard" else "diffusion"
        return pr.irradiance_field(photons, method=self.method, **{name: self.settings})


@dataclass(frozen=True)
class Measures:
    """What a way makes of the shapes; all relative to the shapes' irradiance.

    Attributes
    ----------
    line : float
        Mean over the thinnest line, away from its ends.
    noise, edge_noise, line_noise : float
        Deep inside the disc and the square; within 1 cm of their edges; on the thinnest line.
    error : float
        Relative L1 over the pixels of one picture, against the truth at the same samples; NaN if
        not asked.
    """

    line: float
    noise: float
    edge_noise: float
    line_noise: float
    error: float = float("nan")


def nearest(k: int, **settings: object) -> Way:
    return Way(f"k = {k}", "standard", pr.GatherSettings(k=k, **settings))


def diffusion(
    threshold: float, *, isotropic: bool = False, normalisation: str = "maximum", **settings: float
) -> Way:
    """Return SSO08's: a fixed bandwidth, λ₁ over its largest value."""
    how = pr.DiffusionSettings(
        k=None,
        edge_threshold=threshold,
        normalisation=normalisation,
        **{"bandwidth": BANDWIDTH, "noise_scale": NOISE_SCALE, "least_eigenvalue": 1e-3} | settings,
    )
    method = "isotropic-diffusion" if isotropic else "diffusion"
    return Way(f"q = {threshold}", method, how)


def figure4() -> dict[str, list[Way]]:
    """Return the rows of the figure."""
    return {
        "k nearest photons": [nearest(k) for k in KS],
        "anisotropic diffusion": [diffusion(q) for q in THRESHOLDS],
        "isotropic diffusion": [diffusion(q, isotropic=True) for q in THRESHOLDS],
    }


def plain_estimates() -> list[Way]:
    """Return every kernel of the standard method, and fixed bandwidths, from smooth to noisy."""
    fixed = [
        Way(f"fixed bandwidth {h:.4f} m", "standard", pr.GatherSettings(k=10**6, gather_radius=h))
        for h in BANDWIDTH * np.sqrt(np.array(_STANDARD_KS) / KS[0])
    ]
    counted = [
        Way(f"{kernel}, k = {k}", "standard", pr.GatherSettings(k=k, kernel=kernel))
        for kernel in ("epanechnikov", "cone", "constant")
        for k in _STANDARD_KS
    ]
    return counted + fixed


def refined_estimates() -> list[Way]:
    """Return every refinement of the standard method, from smooth to noisy."""
    return [
        Way(
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
def distribution(seed: int) -> PhotonPattern:
    return gallery.pattern("shapes", seed=seed)


def regions(n: int = _POINTS) -> dict[str, Floats]:
    """Return points deep inside, along edges and on the thinnest line, (n, 2) each."""
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


def measured(way: Way, seeds: int = SEEDS, *, pixels: int = 0) -> Measures:
    """Measure a way over photon maps of so many seeds, and one picture's error if asked."""
    places = regions()
    points = np.concatenate(list(places.values()))
    points = np.column_stack([points, np.zeros(len(points))])
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    fields = [way.prepare(distribution(seed).photons) for seed in range(seeds)]
    found = np.array([field(points, normals)[:, 0] for field in fields])
    ends = np.cumsum([len(place) for place in places.values()])[:-1]
    deep, edges, line = np.split(found, ends, axis=1)
    error = float("nan")
    if pixels:
        exact, shown = (distribution(0).image(f, pixels, pixels, 2) for f in (_truth, fields[0]))
        error = relative_l1(shown, exact)
    noise = [float(np.sqrt(part.var(axis=0, ddof=1).mean())) for part in (deep, edges, line)]
    return Measures(float(line.mean()), *noise, error)


def _truth(points: Floats, normals: Floats) -> Floats:
    return distribution(0).irradiance(points)


def line_at_equal_noise(found: Sequence[Measures], noise: float) -> float | None:
    """Return what estimates of one kind keep of the line where their noise is so much.

    Interpolated between those that are next to it in noise, logarithmically; None if none is as
    quiet, or all are quieter.
    """
    order = np.argsort([m.noise for m in found])
    noises = [found[i].noise for i in order]
    if not noises[0] <= noise <= noises[-1]:
        return None
    return float(np.interp(np.log(noise), np.log(noises), [found[i].line for i in order]))


# --- tables and pictures -------------------------------------------------------------------------


def markdown(seeds: int = SEEDS, pixels: int = 200) -> str:
    """Return the measures of the twelve pictures, and what standard estimates keep of the line."""
    lines = [
        "| shapes, 48,000 photons | line kept | noise inside | along edges | on the line | L1 |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    adaptive: list[tuple[str, Measures]] = []
    for row, ways in figure4().items():
        for way in ways:
            found = measured(way, seeds, pixels=pixels)
            lines.append(_line(f"{row}, {way.name}", found))
            if way.method == "diffusion":
                adaptive.append((f"{row}, {way.name}", found))
    coarse = measured(diffusion(THRESHOLDS[-1], noise_scale=0.5 * BANDWIDTH), seeds, pixels=pixels)
    lines.append(_line(f"noise scale half the bandwidth, q = {THRESHOLDS[-1]}", coarse))
    return "\n".join([*lines, "", *_comparison(adaptive, seeds), ""])


def _line(name: str, m: Measures) -> str:
    return (
        f"| {name} | {m.line:.1%} | {m.noise:.1%} | {m.edge_noise:.1%} | {m.line_noise:.1%} "
        f"| {m.error:.3f} |"
    )


def most_kept(ways: Sequence[Way], noise: float, seeds: int = SEEDS) -> tuple[float, str]:
    """Return the most of the line that ways of this noise keep, and which does.

    Kinds that do not reach this noise are named after it.
    """
    kinds: dict[str, list[Measures]] = {}
    for way in ways:
        kinds.setdefault(way.name.rsplit(",", 1)[0].split(" 0.")[0], []).append(
            _standard_measured(way, seeds)
        )
    kept = {kind: line_at_equal_noise(found, noise) for kind, found in kinds.items()}
    reached = {kind: line for kind, line in kept.items() if line is not None}
    if not reached:
        return float("nan"), "not reached"
    kind = max(reached, key=lambda name: reached[name])
    missing = ", ".join(name for name in kept if name not in reached)
    return reached[kind], f"{kind}; not reached by {missing}" if missing else kind


@cache
def _standard_measured(way: Way, seeds: int) -> Measures:
    return measured(way, seeds)


def _comparison(adaptive: list[tuple[str, Measures]], seeds: int) -> list[str]:
    lines = [
        "| beside | line kept | best standard estimate of equal noise | best of the refined |",
        "| --- | --- | --- | --- |",
    ]
    for name, found in adaptive:
        cells = [
            f"{kept:.1%} ({kind})"
            for ways in (plain_estimates(), refined_estimates())
            for kept, kind in [most_kept(ways, found.noise, seeds)]
        ]
        lines.append(f"| {name} | {found.line:.1%} | {' | '.join(cells)} |")
    return lines


def save(path: Path, pixels: int = 300) -> None:
    """Write the twelve pictures as one sheet, in the order of the figure."""
    from PIL import Image

    shapes, gap = distribution(0), 4
    rows = []
    for ways in figure4().values():
        pictures = [shapes.image(w.prepare(shapes.photons), pixels, pixels, 2) for w in ways]
        rows.append(np.concatenate([_framed(p[..., 0], gap) for p in pictures], axis=1))
    sheet = np.clip(np.concatenate(rows), 0.0, 1.25) / 1.25
    grey = np.round(255 * sheet ** (1 / 2.2)).astype(np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(grey).save(path)


def _framed(picture: Floats, gap: int) -> Floats:
    return np.pad(picture, gap, constant_values=0.3)
