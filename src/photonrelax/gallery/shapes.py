"""A disc, a square and three lines of equal density on black, after SSO08 Fig. 3.

The kinds of shapes and the number of photons are those of the figure, positions and sizes are not.
The lines slant, so that they are aligned neither with pixels nor with range axes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .._util.validation import Floats, float_array, positive
from .photon_pattern import PhotonPattern
from .stencil import Disc, Parallelogram, Stencil

DISC = ((0.27, 0.76), 0.17)
SQUARE = ((0.73, 0.76), 0.15)
_LINES_LEFT, _LINES_RIGHT = 0.08, 0.92
# Rise of a line from left to right, and the heights of the middles.
_RISE = 0.15
LINE_MIDDLES = (0.44, 0.28, 0.12)
LINE_WIDTHS = (0.01, 0.02, 0.04)
# Share of a line, at either end, without points.
_MARGIN = 0.1
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
    lit = positive(irradiance, "irradiance")
    parts = _parts(float_array(line_widths, "line_widths", (3,)))
    stencil = Stencil(parts, np.full(len(parts), lit), np.zeros((len(parts), 2)))
    return stencil.pattern("shapes", n, sampler, seed)


def line_points(number: int, uv: Floats, width: float) -> Floats:
    """Map points of the unit square uniformly to a line without a margin at its ends, (n, 2)."""
    line = _line(LINE_MIDDLES[number], width)
    return line.placed(uv * [1.0, 1.0 - 2 * _MARGIN] + [0.0, _MARGIN])


def _parts(line_widths: Floats) -> list[Disc | Parallelogram]:
    (x, y), half = SQUARE
    square = Parallelogram((x - half, y - half), (2 * half, 0.0), (0.0, 2 * half))
    lines = [_line(*line) for line in zip(LINE_MIDDLES, line_widths, strict=True)]
    return [Disc(*DISC), square, *lines]


def _line(middle: float, width: float) -> Parallelogram:
    """Line with vertical ends; the width is perpendicular to it."""
    if not 0.0 < width <= _MAX_WIDTH:
        raise ValueError(f"line_widths should lie in (0, {_MAX_WIDTH}], but one is {width}")
    run = _LINES_RIGHT - _LINES_LEFT
    upright = width * np.hypot(run, _RISE) / run
    corner = (_LINES_LEFT, middle - 0.5 * (_RISE + upright))
    return Parallelogram(corner, (0.0, float(upright)), (run, _RISE))
