"""Irradiance over rectangles, without a camera: means over texels."""

from __future__ import annotations

from concurrent.futures import Executor

import numpy as np
from numpy.typing import ArrayLike

from .._util import validation
from .._util.validation import Floats
from .._util.workers import checked_executor, n_workers, worker_map
from .field import Field
from .texels import TexelGrid

# Texels estimated together, which bounds the memory of a map beside its result.
_TEXELS_PER_BAND = 1 << 18
# Bands of each worker of an executor at least, so that all end at about the same time.
_BANDS_PER_WORKER = 4
# Largest cosine of the angle between the sides of a rectangle.
_RIGHT_ANGLE = 1e-6


def texel_grid(
    origin: ArrayLike,
    u: ArrayLike,
    v: ArrayLike,
    shape: tuple[int, int],
    *,
    normal: ArrayLike | None = None,
) -> TexelGrid:
    """Checked rectangle of texels; arguments and errors as of `irradiance_map`."""
    origin = validation.float_array(origin, "origin", (3,))
    right, down = _checked_side(u, "u"), _checked_side(v, "v")
    along = np.cross(right / np.linalg.norm(right), down / np.linalg.norm(down))
    if np.linalg.norm(along) < np.sqrt(1.0 - _RIGHT_ANGLE**2):
        degrees = np.degrees(np.arcsin(np.minimum(np.linalg.norm(along), 1.0)))
        raise ValueError(
            f"u and v should be perpendicular, but the angle between them is {degrees:.6g} degrees"
        )
    if normal is not None and _checked_normal(normal, along) @ along < 0.0:
        along = np.negative(along)
    return TexelGrid(origin, right, down, checked_shape(shape), along / np.linalg.norm(along))


def _checked_side(side: ArrayLike, name: str) -> Floats:
    array = validation.float_array(side, name, (3,))
    if not array.any():
        raise ValueError(f"{name} should be a side of the map, m, but is zero")
    return array


def _checked_normal(normal: ArrayLike, along: Floats) -> Floats:
    unit = validation.unit_vectors(normal, "normal", (3,))
    if abs(unit @ along) < _RIGHT_ANGLE:
        raise ValueError(f"normal should be on a side of the map, but {unit} is in its plane")
    return unit


def checked_shape(shape: tuple[int, int]) -> tuple[int, int]:
    """Numbers of texels along both sides.

    Raises
    ------
    TypeError, ValueError
        If there are not two positive integers.
    """
    if np.shape(shape) != (2,):
        raise ValueError(f"the size should be two numbers of texels, (nx, ny), but is {shape!r}")
    nx, ny = (
        validation.count(n, name, high=validation.MAX_REPEATS)
        for n, name in zip(shape, ("nx", "ny"), strict=True)
    )
    return nx, ny


def irradiance_map(
    field: Field,
    origin: ArrayLike,
    u: ArrayLike,
    v: ArrayLike,
    shape: tuple[int, int],
    *,
    normal: ArrayLike | None = None,
    executor: Executor | None = None,
) -> Floats:
    """Irradiance over a rectangle on a surface: means over its texels.

    Parameters
    ----------
    field : Field
        Of `irradiance_field`.
    origin, u, v : (3,) array_like
        A corner of the rectangle, and its sides from there, m; perpendicular to each other.
    shape : (int, int)
        Texels (nx, ny) along u and along v.
    normal : (3,) array_like, optional
        Any vector on the side of the surface that the light comes from; u × v by default.
    executor : concurrent.futures.Executor, optional
        Estimates bands of rows, a thread each; by default they are estimated one after the other,
        each by the threads of the field. See docs/scaling.md.

    Returns
    -------
    (ny, nx, 3) float array
        W/m². ``E[row, column]`` is the mean over the texel whose centre is at
        ``origin + u (column + ½)/nx + v (row + ½)/ny``.

    Raises
    ------
    TypeError, ValueError
        If an argument has a wrong shape or is not finite, a side has no length, the sides are not
        perpendicular, the normal is in their plane, or the method has estimates at points only.

    Examples
    --------
    >>> import photonrelax as pr
    >>> photons = pr.trace_photons(pr.gallery.scene("ring"), 100_000)
    >>> field = pr.irradiance_field(photons)
    >>> image = pr.irradiance_map(field, (-1, -1, 0), (2, 0, 0), (0, 2, 0), (64, 64))
    >>> image.shape
    (64, 64, 3)
    """
    grid = texel_grid(origin, u, v, shape, normal=normal)
    nx, ny = grid.shape
    per_band = max(_TEXELS_PER_BAND // nx, 1)
    if checked_executor(executor) is not None:
        per_band = min(per_band, -(-ny // (_BANDS_PER_WORKER * n_workers(executor))))
    bands = [range(first, min(first + per_band, ny)) for first in range(0, ny, per_band)]
    parts = worker_map(_means, (field, grid), bands, executor)
    return np.concatenate(list(parts)).reshape(ny, nx, 3)


def _means(given: tuple[Field, TexelGrid], rows: range) -> Floats:
    """Means (n, 3) over the texels of some rows."""
    field, grid = given
    return field.over_texels(grid, rows)
