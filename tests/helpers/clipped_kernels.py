"""Integrals of kernels over polygons, column by column: independent of the flow over edges."""

import numpy as np
from scipy.optimize import brentq

from tests.helpers.footprint_rule import DEVIATION, gauss, profile


def integral(polygon, sides, radius, *, is_area=False):
    """Integral over a convex polygon (n, 2) of a kernel cut at a radius from a rectangle.

    The kernel is the rectangle, whose middle is the origin, convolved with a Gaussian; with
    `is_area` it is one.
    """
    x, dx = _nodes(_breaks(polygon, sides, radius))
    low, high = _span(polygon, x)
    top = _top(x, sides, radius)
    low, high = np.maximum(low, -top), np.minimum(high, top)
    inside = high > low
    x, dx, low, high = x[inside], dx[inside], low[inside], high[inside]
    if is_area:
        return dx @ (high - low)
    y, share = _nodes([0.0, 1.0])
    y = low[:, np.newaxis] + np.multiply.outer(high - low, y)
    deviation = DEVIATION * radius
    columns = profile(y, sides[1], deviation) @ share * (high - low)
    return dx @ (columns * profile(x, sides[0], deviation))


def _top(x, sides, radius):
    beside = np.maximum(np.abs(x) - 0.5 * sides[0], 0.0)
    return 0.5 * sides[1] + np.sqrt(np.maximum(radius**2 - beside**2, 0.0))


def _span(polygon, x):
    """Lowest and highest y of a convex polygon at x; low above high beside it."""
    low, high = np.full(len(x), np.inf), np.full(len(x), -np.inf)
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if a[0] == b[0]:
            continue
        t = (x - a[0]) / (b[0] - a[0])
        y = np.where((t >= 0.0) & (t <= 1.0), a[1] + t * (b[1] - a[1]), np.nan)
        low, high = np.fmin(low, y), np.fmax(high, y)
    return low, high


def _breaks(polygon, sides, radius):
    """Places along x between which the limits of columns are smooth."""
    reach = 0.5 * sides[0] + radius
    breaks = [-reach, -0.5 * sides[0], 0.5 * sides[0], reach, *polygon[:, 0]]
    grid = np.linspace(-reach, reach, 4001)
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if a[0] == b[0]:
            continue
        for sign in (1.0, -1.0):

            def gap(x, a=a, b=b, sign=sign):
                y = a[1] + (x - a[0]) / (b[0] - a[0]) * (b[1] - a[1])
                return y - sign * _top(x, sides, radius)

            changes = np.flatnonzero(np.diff(np.sign(gap(grid))))
            breaks += [brentq(gap, grid[i], grid[i + 1], xtol=1e-15) for i in changes]
    return np.unique(np.clip(breaks, -reach, reach))


def _nodes(breaks, n=48):
    """Nodes and weights between breaks, close together towards these, for roots there."""
    nodes, weights = gauss(n)
    u, weights = 0.5 * (nodes + 1.0), 0.5 * weights
    smooth, rate = u * u * (3.0 - 2.0 * u), 6.0 * u * (1.0 - u)
    breaks = np.array(breaks)
    length = np.diff(breaks)[:, np.newaxis]
    return (breaks[:-1, np.newaxis] + length * smooth).ravel(), (length * rate * weights).ravel()
