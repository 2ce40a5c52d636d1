"""A disc, a square and three lines of equal density on black, after SSO08 Fig. 3.

The kinds of shapes and the number of photons are those of the figure, positions and sizes are not.
The lines slant, so that they are aligned neither with pixels nor with range axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._util.memory import check_memory
from .._util.validation import MAX_REPEATS, Floats, check_seed, count, float_array, positive
from ..photons.photon_map import PhotonMap
from ..transport.sampling import halton, seed_shift, square_to_disk
from .photon_pattern import PhotonPattern

DISC = ((0.27, 0.76), 0.17)
SQUARE = ((0.73, 0.76), 0.15)
_LINES_LEFT, _LINES_RIGHT = 0.08, 0.92
# Rise of a line from left to right, and the heights of the middles.
_RISE = 0.15
LINE_MIDDLES = (0.44, 0.28, 0.12)
LINE_WIDTHS = (0.01, 0.02, 0.04)
# Share of a line, at either end, without points.
_MARGIN = 0.1
# Bytes of a photon.
PHOTON_BYTES = 124
# Wider lines would leave the square.
_MAX_WIDTH = 0.08


def shapes(
    *,
    n: int = 48_000,
    sampler: str = "random",
    seed: int = 0,
    irradiance: float = 1.0,
    line_widths: Sequence[float] = LINE_WIDTHS,
) -> PhotonPattern:
    """Photons of collimated light through a stencil onto the unit square.

    Parameters
    ----------
    n : int
        Number of photons; all that are emitted pass the stencil and are stored.
    sampler : {"random", "halton"}
        Independent photons, as in SSO08, or evenly spaced ones within each shape.
    seed : int
        Of the random numbers, or of the shift of the sequence.
    irradiance : float
        Within the shapes, W/m².
    line_widths : three floats
        From the uppermost line, the thinnest, down, m.

    Raises
    ------
    TypeError, ValueError
        If an argument is of a wrong type, or a line is wider than 0.08 m.
    """
    n, lit = count(n, "n", low=0), positive(irradiance, "irradiance")
    check_memory(PHOTON_BYTES * n, f"{n:,} photons", "emit fewer")
    parts = _parts(float_array(line_widths, "line_widths", (3,)))
    areas = np.array([part.area for part in parts])
    area = areas.sum()
    xy = _placed(_square(n, sampler, seed), parts, areas / area)
    photons = _photons(xy, lit * area, n / area, seed=seed, sampler=sampler)
    light = _Stencil(parts, lit)
    return PhotonPattern("shapes", photons, light.irradiance_at, light.pixel_means)


def _photons(
    xy: Floats, power: float, emitter_density: float, *, seed: int, sampler: str
) -> PhotonMap:
    """Photons at points (n, 2) of the plane, from straight above."""
    n = len(xy)
    up = np.tile([0.0, 0.0, 1.0], (n, 1))
    return PhotonMap(
        np.column_stack([xy, np.zeros(n)]),
        up,
        np.full(n, power / max(n, 1)),
        wi=up,
        emitter_coords=xy,
        emitter_density=np.full(n, emitter_density),
        emitter_id=np.zeros(n, dtype=np.int32),
        n_emitted=n,
        well_spaced=sampler == "halton",
        seed=seed,
        sampler=sampler,
    )


@dataclass(frozen=True)
class _Stencil:
    """Shapes of one irradiance on black."""

    parts: list[_Disc | _Parallelogram]
    irradiance: float

    def irradiance_at(self, points: Floats) -> Floats:
        xy = float_array(points, "points", (None, 3))[:, :2]
        return _grey(self.irradiance * np.any([part.holds(xy) for part in self.parts], axis=0))

    def pixel_means(self, width: int, height: int) -> Floats:
        x = np.linspace(0.0, 1.0, count(width, "width", high=MAX_REPEATS) + 1)
        y = np.linspace(1.0, 0.0, count(height, "height", high=MAX_REPEATS) + 1)
        below = sum(part.area_below(x, y[:, np.newaxis]) for part in self.parts)
        covered = -np.diff(np.diff(below, axis=0), axis=1) * width * height
        return _grey(self.irradiance * covered)


def line_points(number: int, uv: Floats, width: float) -> Floats:
    """Map points of the unit square uniformly to a line without a margin at its ends, (n, 2)."""
    line = _line(LINE_MIDDLES[number], width)
    return line.placed(uv * [1.0, 1.0 - 2 * _MARGIN] + [0.0, _MARGIN])


def _grey(values: Floats) -> Floats:
    return np.repeat(values[..., np.newaxis], 3, axis=-1)


def _square(n: int, sampler: str, seed: int) -> Floats:
    if sampler == "halton":
        return halton(0, n, shift=seed_shift(seed))
    if sampler == "random":
        return np.random.default_rng(check_seed(seed)).random((n, 2))
    raise ValueError(f"sampler should be random or halton, but is {sampler!r}")


def _placed(uv: Floats, parts: Sequence[_Disc | _Parallelogram], shares: Floats) -> Floats:
    """Map the unit square to the shapes: a vertical strip to each, in proportion to its area."""
    edges = np.cumsum(shares)
    number = np.searchsorted(edges[:-1], uv[:, 0], side="right")
    xy = np.empty_like(uv)
    for i, part in enumerate(parts):
        rows = number == i
        across = (uv[rows, 0] - (edges[i] - shares[i])) / shares[i]
        # Rounding of the shares may lead out of the strip.
        inside = np.column_stack([np.clip(across, 0.0, np.nextafter(1.0, 0.0)), uv[rows, 1]])
        xy[rows] = part.placed(inside)
    return xy


def _parts(line_widths: Floats) -> list[_Disc | _Parallelogram]:
    (x, y), half = SQUARE
    square = _Parallelogram((x - half, y - half), (2 * half, 0.0), (0.0, 2 * half))
    lines = [_line(*line) for line in zip(LINE_MIDDLES, line_widths, strict=True)]
    return [_Disc(*DISC), square, *lines]


def _line(middle: float, width: float) -> _Parallelogram:
    """Line with vertical ends; the width is perpendicular to it."""
    if not 0.0 < width <= _MAX_WIDTH:
        raise ValueError(f"line_widths should lie in (0, {_MAX_WIDTH}], but one is {width}")
    run = _LINES_RIGHT - _LINES_LEFT
    upright = width * np.hypot(run, _RISE) / run
    corner = (_LINES_LEFT, middle - 0.5 * (_RISE + upright))
    return _Parallelogram(corner, (0.0, float(upright)), (run, _RISE))


@dataclass(frozen=True)
class _Disc:
    centre: tuple[float, float]
    radius: float

    @property
    def area(self) -> float:
        return float(np.pi * self.radius**2)

    def placed(self, uv: Floats) -> Floats:
        """Map points of the unit square uniformly to the disc."""
        return self.centre + self.radius * square_to_disk(uv)

    def holds(self, xy: Floats) -> NDArray[np.bool_]:
        return np.linalg.norm(xy - self.centre, axis=1) <= self.radius

    def area_below(self, x: Floats, y: Floats) -> Floats:
        """Area of the part whose coordinates are less than x and y.

        For the unit disc: ∫ from -1 to x of min(y, s) - min(y, -s), s = √(1 - t²); the integrand
        is y + s where s > |y|, and otherwise 2s above the centre and nothing below.
        """
        u = np.clip((x - self.centre[0]) / self.radius, -1.0, 1.0)
        v = np.clip((y - self.centre[1]) / self.radius, -1.0, 1.0)
        half_chord = np.sqrt(1.0 - v * v)
        middle = np.clip(u, -half_chord, half_chord)
        between = v * (middle + half_chord) + _cap(middle) - _cap(-half_chord)
        outside = _cap(u) - _cap(-1.0) - (_cap(middle) - _cap(-half_chord))
        return self.radius**2 * (between + np.where(v > 0.0, 2.0 * outside, 0.0))


def _cap(t: Floats | float) -> Floats:
    """Integral of √(1 - t²)."""
    return 0.5 * (t * np.sqrt(1.0 - np.square(t)) + np.arcsin(t))


@dataclass(frozen=True)
class _Parallelogram:
    """Parallelogram spanned by two sides from a corner, in either orientation."""

    corner: tuple[float, float]
    first: tuple[float, float]
    second: tuple[float, float]

    @property
    def area(self) -> float:
        return float(abs(np.linalg.det([self.first, self.second])))

    def placed(self, uv: Floats) -> Floats:
        """Map points of the unit square uniformly to the parallelogram."""
        return self.corner + uv @ np.array([self.first, self.second])

    def holds(self, xy: Floats) -> NDArray[np.bool_]:
        uv = (xy - self.corner) @ np.linalg.inv([self.first, self.second])
        return (uv.min(axis=1) >= 0.0) & (uv.max(axis=1) <= 1.0)

    def area_below(self, x: Floats, y: Floats) -> Floats:
        """Area of the part whose coordinates are less than x and y."""
        corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) @ np.array([self.first, self.second])
        corners = corners + self.corner
        total = sum(
            _area_under(start, end, x, y)
            for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True)
        )
        turns = np.sign(np.linalg.det([self.first, self.second]))
        # Anticlockwise, the upper sides lead to lesser x.
        return -turns * total


def _area_under(start: Floats, end: Floats, x: Floats, y: Floats) -> Floats:
    """Integral of min(height of a side, y) along it up to x; negative for sides to the left."""
    (left, low), (right, high) = sorted([tuple(start), tuple(end)])
    if right == left:
        return np.zeros(np.broadcast(x, y).shape)
    run = np.clip(x, left, right) - left
    slope = (high - low) / (right - left)
    reached = low + slope * run
    # The mean over the run of min(t, y), t going linearly from `low` to `reached`.
    rise = np.where(reached == low, 1.0, reached - low)
    mean = (_ramp(reached, y) - _ramp(np.full_like(reached, low), y)) / rise
    mean = np.where(reached == low, np.minimum(low, y), mean)
    return run * mean * np.sign(end[0] - start[0])


def _ramp(t: Floats, y: Floats) -> Floats:
    """Integral of min(t, y) over t."""
    return np.where(t <= y, 0.5 * t * t, y * t - 0.5 * y * y)
