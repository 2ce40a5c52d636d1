"""Means of irradiance over footprints, pixels or texels say, from the k nearest photons or more.

A footprint is a rectangle s₁ × s₂ in the tangent plane of its point, of area A: a parallelogram in
the metric in which its edges are perpendicular. The distance of a photon is that to the rectangle.
With B(r) all within r of it, |B(r)| = A + 2(s₁ + s₂)r + πr², and N(r) the photons there, r is the
smallest radius with

    N(r) πr² ≥ (k - ½) |B(r)|:

a disc of radius r would hold k - ½ photons at the mean density of B(r). A photon weighs what the
rectangle, convolved with a Gaussian of deviation σ = 0.41 r and cut off at r, is at its place:

    w(a, b) = Π [Φ((x + s/2)/σ) - Φ((x - s/2)/σ)] / s  over x = a, b and their s,

over the integral of what is left after the cut. Towards A = 0 that is an estimate from the k
nearest photons with a Gaussian kernel, towards infinite A the flux within the rectangle over A.

Its derivation: docs/methods/footprints.md.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._ext.estimation import footprint as _footprint
from .._ext.estimation.footprint import DEVIATION
from .._util import validation
from .._util.validation import Floats
from ..photons.axes import normal_range
from ..spatial.kdtree import KDTree
from .kernels import Number

# Rate at which the bias of evenly spaced photons falls with the sides over r.
BIAS_DECAY = 3.6
# Intervals of the table of integrals along an axis, and nodes of their quadrature: interpolated
# values are within 1e-10.
_INTERVALS = 64
_NODES = 48
# Sides, in radii, below which integrals over them are series.
_SHORT = 1e-3


def number_within(k: Number) -> Number:
    """Photons that a disc has to hold for its radius to be that of k nearest, k - ½.

    For A = 0 the radius is the distance to the k-th photon, whatever is between k - 1 and k.
    Evenly spaced photons number k - ½ within that.
    """
    return k - 0.5


def check_footprint(footprint: ArrayLike | None, n_points: int) -> Floats | None:
    """Footprints as edge vectors (m, 2, 3) or sides (m,), None for none.

    Raises
    ------
    TypeError, ValueError
        If the shape is neither, or a value is not finite or a side is negative.
    """
    if footprint is None:
        return None
    if np.ndim(footprint) == 3:
        return validation.float_array(footprint, "footprint", (n_points, 2, 3))
    if np.ndim(footprint) == 1:
        return validation.not_negative(footprint, "footprint", (n_points,))
    raise ValueError(
        f"footprint should be edge vectors ({n_points}, 2, 3) or sides ({n_points},), but has "
        f"shape {np.shape(footprint)}"
    )


def half_diagonals(footprint: Floats | None, n_points: int) -> Floats:
    """Half the longer diagonals (m,) of footprints as of `check_footprint`; zero for points."""
    if footprint is None:
        return np.zeros(n_points)
    if footprint.ndim == 1:
        return np.sqrt(0.5) * footprint
    first, second = footprint[:, 0], footprint[:, 1]
    diagonals = np.linalg.norm([first + second, first - second], axis=2)
    half: Floats = 0.5 * diagonals.max(axis=0)
    return half


class Footprints(NamedTuple):
    """Footprints of points, of which those of some rows are gathered over.

    Attributes
    ----------
    queries : (m, d) float array
        Points as the kernel of a tree reads them.
    normals : (m, 3) float array
        Of any length.
    edges : (m, 2, 3) or (m,) float array
        Edge vectors, or sides of squares.
    rows : (r,) intp array
        Those gathered over, close ones in sequence.
    """

    queries: Floats
    normals: Floats
    edges: Floats
    rows: NDArray[np.intp]


def rule_radii(
    tree: KDTree,
    footprints: Footprints,
    k: int,
    *,
    largest: float,
    edges: Any = None,
    n_threads: int,
) -> Floats:
    """Radii (r,) of the rule for k photons, m; zero where all of these are at a point.

    Where no radius up to the largest holds enough photons it is the largest. `edges` are those of
    the surface, as of `Field.edges`.
    """
    queries, normals, footprint, rows = footprints
    radius = np.empty(len(queries))
    _footprint.write_radii(
        *(tree.kernel, queries, rows, radius),
        normals=normals,
        footprint=footprint,
        number=number_within(k),
        radius=largest,
        range_radius=normal_range(tree),
        surface=edges,
        n_threads=n_threads,
    )
    return radius[rows]


@cache
def kernel_integrals() -> Floats:
    """Integral of the kernel over the plane, at evenly spaced s / (s + r) of both sides.

    It is smooth in these: 1 - exp(-½ / 0.41²) = .95 for points, 1 for wide rectangles.
    """
    share = np.arange(_INTERVALS + 1) / _INTERVALS
    # Infinite sides would be 0/0 below; the integral is one to rounding from here on.
    side = share / np.maximum(1.0 - share, 1e-13)
    integrals: Floats = kernel_integral(side[:, np.newaxis], side)
    return integrals


def kernel_integral(first: ArrayLike, second: ArrayLike) -> Floats:
    """Integral of the cut kernel over the plane, for sides in units of r.

    Beside the first side, between it and r, the second's profile is cut at the circle.
    """
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    angle, weights = np.pi / 4.0 * (nodes + 1.0), np.pi / 4.0 * weights
    first = np.asarray(first, dtype=np.float64)[..., np.newaxis]
    second = np.asarray(second, dtype=np.float64)[..., np.newaxis]
    middle = _integral_beside(first, np.zeros(1)) * _integral_beside(second, np.ones(1))
    flanks = _profile(first, np.sin(angle)) * _integral_beside(second, np.cos(angle))
    integral: Floats = middle[..., 0] + 2.0 * (flanks * np.cos(angle)) @ weights
    return integral


def _profile(side: Floats, beside: Floats) -> Floats:
    """Density along a side, at a distance beside it; in units of r."""
    from scipy.special import ndtr

    half, offset = 0.5 * side / DEVIATION, (0.5 * side + beside) / DEVIATION
    with np.errstate(invalid="ignore", divide="ignore"):
        profile = (ndtr(offset + half) - ndtr(offset - half)) / side
    # Up to the fourth power of the side.
    series = _normal(offset) / DEVIATION * (1.0 + half**2 / 6.0 * (offset**2 - 1.0))
    return np.where(side < _SHORT, series, profile)


def _integral_beside(side: Floats, beside: Floats) -> Floats:
    """Integral of `_profile` over a side and up to a distance on both sides of it."""
    from scipy.special import ndtr

    half, middle = 0.5 * side / DEVIATION, (0.5 * side + beside) / DEVIATION
    with np.errstate(invalid="ignore", divide="ignore"):
        integral = (_primitive(middle + half) - _primitive(middle - half)) * DEVIATION / side
    series = 2.0 * ndtr(middle) - 1.0 - half**2 / 3.0 * middle * _normal(middle)
    return np.where(side < _SHORT, series, integral)


def _primitive(x: Floats) -> Floats:
    """Integral of 2 Φ - 1 from 0 to x, but for a constant."""
    from scipy.special import ndtr

    return x * (2.0 * ndtr(x) - 1.0) + 2.0 * _normal(x)


def _normal(x: Floats) -> NDArray[np.float64]:
    """Density of the normal distribution."""
    return np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi)
