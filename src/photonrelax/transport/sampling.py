"""Where samples go: Halton points, and area-preserving maps of the square with their inverses.

The maps take points of [0, 1)² to the unit disk, a cap, the cosine-weighted hemisphere around z
and the sphere. They distort little, so Halton points stay evenly spaced (SJ13 emits so).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from .._ext.transport import sampling as _kernel
from .._util.parallel import thread_count
from .._util.validation import Floats, check_seed, count, float_array, unit_vectors


def halton(
    first: int,
    n: int,
    *,
    shift: tuple[float, float] = (0.0, 0.0),
    n_threads: int | None = None,
) -> Floats:
    """Return points `first` … `first + n - 1` of the Halton sequence in bases 2 and 3.

    Parameters
    ----------
    first, n : int
        Index of the first point, and how many. A point depends on its index alone.
    shift : (float, float)
        In [0, 1)², added modulo one (Cranley–Patterson rotation); see `seed_shift`.
    n_threads : int, optional
        Threads to use; None for all cores.

    Returns
    -------
    (n, 2) float64
        In [0, 1)².

    Raises
    ------
    TypeError, ValueError
        If an index is negative or the shift is outside [0, 1)².
    """
    u, v = float_array(shift, "shift", (2,)).tolist()
    if not (0.0 <= u < 1.0 and 0.0 <= v < 1.0):
        raise ValueError(f"shift should lie in [0, 1)², but is {(u, v)}")
    out = np.empty((count(n, "n", low=0), 2))
    _kernel.halton(count(first, "first", low=0), u, v, out, thread_count(n_threads))
    return out


def seed_shift(seed: int, stream: int = 0) -> tuple[float, float]:
    """Return the shift of a seed, in [0, 1)²; each stream (say, emitter) has its own."""
    return _kernel.seed_shift(check_seed(seed), count(stream, "stream", low=0))


def square_to_disk(points: ArrayLike, *, n_threads: int | None = None) -> Floats:
    """Map (n, 2) points of the unit square to the unit disk, uniformly (Shirley & Chiu 1997)."""
    return _mapped(_kernel.square_to_disk, _square(points), 2, n_threads)


def disk_to_square(points: ArrayLike, *, n_threads: int | None = None) -> Floats:
    """Invert `square_to_disk`."""
    inside = float_array(points, "points", (None, 2))
    return _mapped(_kernel.disk_to_square, inside, 2, n_threads)


def disk_pdf(points: ArrayLike) -> Floats:
    """Return the density of `square_to_disk` at (n, 2) points: 1/π, and zero outside."""
    radius = np.linalg.norm(float_array(points, "points", (None, 2)), axis=1)
    return np.where(radius <= 1.0, 1.0 / np.pi, 0.0)


def one_minus_cos(angle: float) -> float:
    """Return 1 - cos(angle) with all its digits, for tiny angles too."""
    return 2.0 * np.sin(0.5 * angle) ** 2


def square_to_cap(points: ArrayLike, half_angle: float, *, n_threads: int | None = None) -> Floats:
    """Map the unit square uniformly to the directions within `half_angle` (radians) of z.

    Any half angle in (0, π] keeps its digits, tiny ones too.
    """
    height = one_minus_cos(_half_angle(half_angle))
    return _mapped(_kernel.square_to_cap, _square(points), 3, n_threads, height)


def cap_to_square(
    directions: ArrayLike, half_angle: float, *, n_threads: int | None = None
) -> Floats:
    """Invert `square_to_cap`."""
    height = one_minus_cos(_half_angle(half_angle))
    return _mapped(_kernel.cap_to_square, _directions(directions), 2, n_threads, height)


def cap_pdf(directions: ArrayLike, half_angle: float) -> Floats:
    """Return the density of `square_to_cap`, per steradian; zero outside the cap."""
    rays = _directions(directions)
    angle = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
    inside = angle <= _half_angle(half_angle)
    return np.where(inside, 1.0 / (2.0 * np.pi * one_minus_cos(half_angle)), 0.0)


def square_to_hemisphere(points: ArrayLike, *, n_threads: int | None = None) -> Floats:
    """Map the unit square to the hemisphere around z with cosine density."""
    return _mapped(_kernel.square_to_hemisphere, _square(points), 3, n_threads)


def hemisphere_to_square(directions: ArrayLike, *, n_threads: int | None = None) -> Floats:
    """Invert `square_to_hemisphere`."""
    return disk_to_square(_directions(directions)[:, :2], n_threads=n_threads)


def hemisphere_pdf(directions: ArrayLike) -> Floats:
    """Return the density of `square_to_hemisphere`, per steradian: cos θ/π, zero below."""
    return np.maximum(_directions(directions)[:, 2], 0.0) / np.pi


def square_to_sphere(points: ArrayLike, *, n_threads: int | None = None) -> Floats:
    """Map the unit square uniformly to the unit sphere (octahedral, Clarberg 2008)."""
    return _mapped(_kernel.square_to_sphere, _square(points), 3, n_threads)


def sphere_to_square(directions: ArrayLike, *, n_threads: int | None = None) -> Floats:
    """Invert `square_to_sphere`."""
    return _mapped(_kernel.sphere_to_square, _directions(directions), 2, n_threads)


def sphere_pdf(directions: ArrayLike) -> Floats:
    """Return the density of `square_to_sphere`, per steradian: 1/4π."""
    return np.full(len(_directions(directions)), 0.25 / np.pi)


def _mapped(
    kernel: Callable[..., None],
    points: Floats,
    columns: int,
    n_threads: int | None,
    *numbers: float,
) -> Floats:
    out = np.empty((len(points), columns))
    kernel(points, *numbers, out, thread_count(n_threads))
    return out


def _square(points: ArrayLike) -> Floats:
    array = float_array(points, "points", (None, 2))
    if (np.abs(array - 0.5) > 0.5).any():
        raise ValueError(
            f"points should lie in [0, 1]², but they reach from {array.min()} to {array.max()}"
        )
    return array


def _directions(directions: ArrayLike) -> Floats:
    return unit_vectors(directions, "directions", (None, 3))


def _half_angle(value: float) -> float:
    angle = float(float_array(value, "half_angle", ()))
    if not 0.0 < angle <= np.pi:
        raise ValueError(f"half_angle should lie in (0, π], but is {angle}")
    return angle
