"""Validation of arguments: dtype, shape, contiguity, finiteness and range.

Kernels do not check their arguments, so every array from a user is validated here first.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._ext.common import unit_vectors as _unit_vectors

# Squares of radii in this range, and their inverses, are within the range of floats.
RADII = (1e-150, 1e150)

# Numbers checked together: few enough for the cache.
_CHUNK = 32768
_SEED_BITS = 64
# Ceiling of counts that kernels keep in integers of 64 bits, as all do by default.
MAX_COUNT = 2**63 - 1
# Ceiling of passes, iterations, pixels a side and samples: far beyond any use, and products of two
# fit in 64 bits.
MAX_REPEATS = 2**31 - 1
# Ceiling of neighbours, of which there may be fewer: twice as many fit in 64 bits.
MAX_NEIGHBOURS = 2**62
# Longer numbers are told by their order of magnitude.
_MAX_DIGITS = 25

Floats = NDArray[np.float64]
Rows = slice | NDArray[np.intp]
Shape = Sequence[int | None]


def float_array(
    value: ArrayLike, name: str, shape: Shape | None = None, *, finite: bool = True
) -> Floats:
    """Return `value` as a C-contiguous float64 array of the given shape.

    Parameters
    ----------
    value : array_like
        The argument; copied only if its dtype or layout differ.
    name : str
        The argument's name, for messages.
    shape : sequence of int or None, optional
        Required shape, None for an axis of any length; None for any shape at all.
    finite : bool
        Reject NaN and infinities.

    Raises
    ------
    TypeError
        If the values are not real numbers.
    ValueError
        If the shape is wrong or, with `finite`, a value is NaN or infinite.
    """
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "fiub":
            raise TypeError(f"dtype is {array.dtype}")
        # Of NaN that signal, which a file may hold, casts warn.
        with np.errstate(invalid="ignore"):
            array = np.ascontiguousarray(array, dtype=np.float64).reshape(array.shape)
    except (TypeError, ValueError) as error:
        raise TypeError(f"{name} should be an array of real numbers: {error}") from None
    if shape is not None:
        _check_shape(array.shape, name, shape)
    if finite:
        _check_finite(array, name)
    return array


def not_negative(value: ArrayLike, name: str, shape: Shape) -> Floats:
    """Return `value` as by `float_array`, without negative numbers.

    Raises
    ------
    TypeError, ValueError
        As `float_array`, and if a value is negative.
    """
    array = float_array(value, name, shape)
    check_not_negative(array, name)
    return array


def check_not_negative(array: Floats, name: str) -> None:
    """Raise ValueError if a number is negative."""
    if array.min(initial=0.0) < 0.0:
        raise ValueError(f"{name} should not be negative, but its least value is {array.min()}")


def distances(value: ArrayLike, name: str, shape: tuple[int, ...]) -> Floats:
    """Return numbers that are not negative, but may be infinite, broadcast to a shape.

    Raises
    ------
    TypeError, ValueError
        If they are not real numbers, do not broadcast, or one is negative or NaN.
    """
    array = float_array(value, name, finite=False)
    try:
        array = np.ascontiguousarray(np.broadcast_to(array, shape))
    except ValueError:
        raise ValueError(
            f"{name} should be a number or broadcast to shape {shape}, but has {array.shape}"
        ) from None
    if not (array >= 0.0).all():
        raise ValueError(f"{name} should hold no negative number and no NaN")
    return array


def check_magnitude(array: Floats, name: str) -> Floats:
    """Return an array of numbers whose squares are within the range of floats.

    Raises
    ------
    ValueError
        If one is NaN or infinite, or it, or its negative, is more than 1e150.
    """
    high, low = array.max(initial=0.0), array.min(initial=0.0)
    # False for NaN, which both are if one is.
    if not (high <= RADII[1] and low >= -RADII[1]):
        _check_finite(array, name)
        raise ValueError(
            f"{name} should be at most {RADII[1]:g} in size, but one is {max(high, -low):g}"
        )
    return array


def int_array(
    value: ArrayLike, name: str, shape: Shape | None = None, dtype: type = np.int64
) -> NDArray:
    """Return `value` as a C-contiguous integer array of the given shape and dtype.

    Raises
    ------
    TypeError
        If the values are not integers.
    ValueError
        If the shape is wrong or a value does not fit `dtype`.
    """
    array = np.asarray(value)
    if array.dtype.kind not in "iub" and array.size:
        raise TypeError(f"{name} should be an array of integers, but its dtype is {array.dtype}")
    if shape is not None:
        _check_shape(array.shape, name, shape)
    converted: NDArray = np.ascontiguousarray(array, dtype=dtype).reshape(array.shape)
    if converted.dtype != array.dtype and not np.array_equal(converted, array):
        raise ValueError(f"{name} should fit {np.dtype(dtype).name}, but some values do not")
    return converted


def rgb(value: ArrayLike, name: str, *, high: float = np.inf) -> Floats:
    """Return a colour as three floats in [0, high]; one number stands for all channels.

    Raises
    ------
    TypeError, ValueError
        If it is not one or three real numbers in the range.
    """
    array = float_array(value, name)
    if array.shape not in ((), (3,)):
        raise ValueError(f"{name} should be one number or three, but its shape is {array.shape}")
    array = np.ascontiguousarray(np.broadcast_to(array, (3,)))
    if (array < 0.0).any() or (array > high).any():
        raise ValueError(f"{name} should lie in [0.0, {high}], but is {array.tolist()}")
    return array


def unit_vectors(value: ArrayLike, name: str, shape: Shape, n_threads: int = 1) -> Floats:
    """Return vectors (…, 3) scaled to unit length.

    Raises
    ------
    TypeError, ValueError
        As `float_array`, and if a vector has no length.
    """
    array = float_array(value, name, shape)
    unit = np.empty_like(array)
    if not _unit_vectors.unit_vectors(array.reshape(-1, 3), unit.reshape(-1, 3), n_threads):
        bad = int(np.flatnonzero(~array.reshape(-1, 3).any(axis=1))[0])
        raise ValueError(f"{name} should hold directions, but vector {bad} is zero")
    return unit


def are_unit(vectors: Floats) -> bool:
    """True if the rows of an (n, 3) array are unit vectors but for rounding."""
    tolerance = 4.0 * np.finfo(np.float64).eps
    for first in range(0, len(vectors), _CHUNK):
        x, y, z = vectors[first : first + _CHUNK].T
        with np.errstate(over="ignore"):
            length = np.sqrt(x * x + y * y + z * z)
        if (np.abs(length - 1.0) > tolerance).any():
            return False
    return True


def positive(value: float, name: str, *, allow_inf: bool = False) -> float:
    """Return `value` as a float greater than zero.

    Raises
    ------
    TypeError, ValueError
        If it is not a positive real number.
    """
    number = float(float_array(value, name, (), finite=False))
    if not number > 0.0 or (np.isinf(number) and not allow_inf):
        raise ValueError(f"{name} should be a positive number, but is {number}")
    return number


def in_units(array: Floats) -> tuple[Floats, float]:
    """Return numbers divided by a unit near the largest of them, and the unit.

    The unit is a power of two, so that the division is exact; squares of the quotients are finite.
    """
    unit = power_of_two(float(np.abs(array).max(initial=0.0)) or 1.0)
    return array / unit, unit


def power_of_two(number: float) -> float:
    """Return the largest power of two not above a positive number."""
    return math.ldexp(0.5, math.frexp(number)[1])


def radius(value: float, name: str, *, allow_inf: bool = False) -> float:
    """Return a radius, m, with a square within the range of floats.

    Raises
    ------
    TypeError, ValueError
        If it is not a real number from 1e-150 to 1e150, or infinite if that is allowed.
    """
    number = positive(value, name, allow_inf=allow_inf)
    if not (RADII[0] <= number <= RADII[1] or np.isinf(number)):
        raise ValueError(f"{name} should lie in [{RADII[0]:g}, {RADII[1]:g}], but is {number:g}")
    return number


def count(value: int, name: str, *, low: int = 1, high: float = MAX_COUNT) -> int:
    """Return `value` as an int in [low, high]; by default high is that of 64 bits.

    Raises
    ------
    TypeError
        If it is not an integer.
    ValueError
        If it is less than `low` or more than `high`.
    """
    try:
        number = operator.index(value)
    except TypeError:
        raise TypeError(f"{name} should be an integer, but is {value!r}") from None
    if number < low:
        raise ValueError(f"{name} should be at least {low}, but is {_shown(number)}")
    if number > high:
        raise ValueError(f"{name} should be at most {high}, but is {_shown(number)}")
    return number


def _shown(number: int) -> str:
    digits = int(abs(number).bit_length() * math.log10(2.0))
    if digits < _MAX_DIGITS:
        return str(number)
    return f"about {'-' if number < 0 else ''}1e{digits}"


def check_seed(seed: int) -> int:
    """Return `seed` as an int in [0, 2^64).

    Raises
    ------
    TypeError, ValueError
        If it is not an integer in that range.
    """
    number = count(seed, "seed", low=0, high=np.inf)
    if number >= 2**_SEED_BITS:
        raise ValueError(f"seed should be below 2^{_SEED_BITS}, but is {_shown(number)}")
    return number


def check_choice(value: str, name: str, choices: Iterable[str]) -> None:
    """Raise ValueError unless `value` is one of the choices."""
    if value not in choices:
        raise ValueError(f"{name} should be one of {', '.join(choices)}, but is {value!r}")


def _check_finite(array: Floats, name: str) -> None:
    """Raise ValueError if a value is NaN or infinite; a mask of all is made only then."""
    flat = array.reshape(-1)
    if not all(np.isfinite(flat[i : i + _CHUNK]).all() for i in range(0, len(flat), _CHUNK)):
        bad = int(np.flatnonzero(~np.isfinite(flat))[0])
        raise ValueError(
            f"{name} should be finite, but flat element {bad} of shape {array.shape} is {flat[bad]}"
        )


def _check_shape(actual: tuple[int, ...], name: str, required: Shape) -> None:
    matches = len(actual) == len(required) and all(
        n is None or n == m for m, n in zip(actual, required, strict=True)
    )
    if not matches:
        letters = ", ".join("n" if n is None else str(n) for n in required)
        raise ValueError(f"{name} should have shape ({letters}), but has {actual}")
