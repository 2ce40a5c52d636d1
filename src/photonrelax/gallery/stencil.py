"""Stencils that light passes: discs and parallelograms, each of an irradiance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._util.memory import check_memory
from .._util.validation import MAX_REPEATS, Floats, check_seed, count, float_array
from ..photons.photon_map import PhotonMap
from ..transport.sampling import halton, seed_shift, square_to_disk
from .photon_pattern import PhotonPattern

# Bytes of a photon.
PHOTON_BYTES = 124


@dataclass(frozen=True)
class Stencil:
    """Shapes of an irradiance each, W/m², that add up where they overlap.

    `shifts` (shapes, 2) are what emitter coordinates of each are from its positions, m.
    """

    parts: Sequence[Disc | Parallelogram]
    irradiance: Floats
    shifts: Floats

    def pattern(self, name: str, n: int, sampler: str, seed: int) -> PhotonPattern:
        """Photons of collimated light through the stencil, of equal flux, with what is exact."""
        n = count(n, "n", low=0)
        check_memory(PHOTON_BYTES * n, f"{n:,} photons", "emit fewer")
        areas = np.array([part.area for part in self.parts])
        power = (areas * self.irradiance).sum()
        uv = _square(n, sampler, seed)
        part = _strips(uv, areas * self.irradiance / power)
        xy = _placed(uv, part, self.parts, areas * self.irradiance / power)
        up = np.tile([0.0, 0.0, 1.0], (n, 1))
        photons = PhotonMap(
            np.column_stack([xy, np.zeros(n)]),
            up,
            np.full(n, power / max(n, 1)),
            wi=up,
            emitter_coords=xy + self.shifts[part],
            emitter_density=self.irradiance[part] * (n / power),
            emitter_id=np.zeros(n, dtype=np.int32),
            n_emitted=n,
            well_spaced=sampler == "halton",
            seed=seed,
            sampler=sampler,
        )
        return PhotonPattern(name, photons, self.irradiance_at, self.pixel_means)

    def irradiance_at(self, points: Floats) -> Floats:
        """Irradiance (m, 3) at points (m, 3) of the plane."""
        xy = float_array(points, "points", (None, 3))[:, :2]
        lit = zip(self.irradiance, self.parts, strict=True)
        return _grey(np.sum([each * part.holds(xy) for each, part in lit], axis=0))

    def pixel_means(self, width: int, height: int) -> Floats:
        """Means over the pixels (height, width, 3) of the unit square."""
        x = np.linspace(0.0, 1.0, count(width, "width", high=MAX_REPEATS) + 1)
        y = np.linspace(1.0, 0.0, count(height, "height", high=MAX_REPEATS) + 1)
        lit = zip(self.irradiance, self.parts, strict=True)
        below = sum(each * part.area_below(x, y[:, np.newaxis]) for each, part in lit)
        covered = -np.diff(np.diff(below, axis=0), axis=1) * width * height
        return _grey(covered)


def _grey(values: Floats) -> Floats:
    return np.repeat(values[..., np.newaxis], 3, axis=-1)


def _square(n: int, sampler: str, seed: int) -> Floats:
    if sampler == "halton":
        return halton(0, n, shift=seed_shift(seed))
    if sampler == "random":
        return np.random.default_rng(check_seed(seed)).random((n, 2))
    raise ValueError(f"sampler should be random or halton, but is {sampler!r}")


def _strips(uv: Floats, shares: Floats) -> NDArray[np.intp]:
    """Number of the shape of each point of the unit square: a vertical strip to each."""
    return np.searchsorted(np.cumsum(shares)[:-1], uv[:, 0], side="right")


def _placed(
    uv: Floats,
    number: NDArray[np.intp],
    parts: Sequence[Disc | Parallelogram],
    shares: Floats,
) -> Floats:
    """Map the unit square to the shapes: the strip of each, in proportion to its share."""
    edges = np.cumsum(shares)
    xy = np.empty_like(uv)
    for i, part in enumerate(parts):
        rows = number == i
        across = (uv[rows, 0] - (edges[i] - shares[i])) / shares[i]
        # Rounding of the shares may lead out of the strip.
        inside = np.column_stack([np.clip(across, 0.0, np.nextafter(1.0, 0.0)), uv[rows, 1]])
        xy[rows] = part.placed(inside)
    return xy


@dataclass(frozen=True)
class Disc:
    """Disc by its centre and radius, m."""

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
class Parallelogram:
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
