"""Sample points: the Halton sequence, and the area-preserving map of the square to the disk.

The map distorts little, so Halton points stay evenly spaced. SJ13 (§4.1) emits photons so; its
maps to caps, hemispheres and the sphere are in the kernel.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .._ext.transport import sampling as _kernel
from .._util.memory import check_memory
from .._util.parallel import thread_count
from .._util.validation import Floats, check_seed, count, float_array


def halton(
    first: int,
    n: int,
    *,
    shift: tuple[float, float] = (0.0, 0.0),
    n_threads: int | None = None,
) -> Floats:
    """Points `first` … `first + n - 1` of the Halton sequence in bases 2 and 3.

    Parameters
    ----------
    first, n : int
        Index of the first point, and number of points. A point depends on its index alone.
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
    MemoryError
        If the points cannot fit in memory.
    """
    u, v = float_array(shift, "shift", (2,)).tolist()
    if not (0.0 <= u < 1.0 and 0.0 <= v < 1.0):
        raise ValueError(f"shift should lie in [0, 1)², but is {(u, v)}")
    n = count(n, "n", low=0)
    check_memory(16.0 * n, f"{n:,} Halton points", "ask for fewer at a time")
    out = np.empty((n, 2))
    _kernel.halton(count(first, "first", low=0), u, v, out, thread_count(n_threads))
    return out


def seed_shift(seed: int, stream: int = 0) -> tuple[float, float]:
    """Shift of a seed, in [0, 1)²; each stream, such as an emitter, has its own."""
    u, v = _kernel.seed_shifts(check_seed(seed), count(stream, "stream", low=0), 2)
    return u, v


def seed_shifts(seed: int, stream: int, n: int) -> Floats:
    """As many shifts of a seed and stream; the first two are those of `seed_shift`."""
    return np.array(_kernel.seed_shifts(seed, stream, n))


def square_to_disk(points: ArrayLike, *, n_threads: int | None = None) -> Floats:
    """Concentric map of the unit square to the unit disk (Shirley & Chiu 1997).

    Parameters
    ----------
    points : (n, 2) array_like
        In [0, 1]².
    n_threads : int, optional
        Threads to use; None for all cores.

    Returns
    -------
    (n, 2) float64
        With constant density where the points have one.

    Raises
    ------
    TypeError, ValueError
        If the points have another shape or lie outside of the square.
    """
    square = float_array(points, "points", (None, 2))
    if (np.abs(square - 0.5) > 0.5).any():
        raise ValueError(
            f"points should lie in [0, 1]², but they reach from {square.min()} to {square.max()}"
        )
    out = np.empty_like(square)
    _kernel.square_to_disk(square, out, thread_count(n_threads))
    return out
