"""Trees of lamps, from which some are chosen by the light that they bring to a point."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._ext.transport.light_tree import MAX_LAMPS_OF_LEAF, LightTree
from .._util.validation import Floats
from ..scene.lamps import PARALLEL, LampTable

# Children of a node.
_FAN = 4
# Difference between axes that divides lamps as well as the largest difference between positions,
# over that; the least noise of those tried.
_AXIS = 0.25
# Cones are wider than rounding makes them too narrow. Those of half angles closer to π hold all.
_ROUNDING, _ALL = 1e-6, 0.05


def light_tree(lamps: LampTable, offset: Floats) -> tuple[LightTree, LampTable]:
    """Tree of lamps, all points or all parallel, and the lamps in its order.

    Parameters
    ----------
    lamps : LampTable
        More than a leaf has.
    offset : (n,)
        Distances within which they bring no light, m.
    """
    n_levels = 0
    while _FAN**n_levels * MAX_LAMPS_OF_LEAF < len(lamps):
        n_levels += 1
    order = _order(lamps, n_levels)
    lamps = lamps[order]
    starts = [_starts(len(lamps), _FAN**level) for level in range(n_levels + 1)]
    bounds = [_bounds(lamps, first) for first in starts[1:]]
    nodes = [rows.reshape(-1, _FAN, rows.shape[1]).swapaxes(1, 2) for rows in bounds]
    n_inner = sum(len(first) for first in starts[:-1])
    child = np.full(n_inner + len(starts[-1]), -1, dtype=np.int32)
    child[:n_inner] = 1 + _FAN * np.arange(n_inner)
    span = [np.column_stack([first, _ends(first, len(lamps))]) for first in starts]
    tree = LightTree(
        lamps,
        np.ascontiguousarray(offset[order]),
        np.ascontiguousarray(np.concatenate(nodes)),
        child,
        np.concatenate(span).astype(np.int32),
    )
    return tree, lamps


def _starts(n: int, n_parts: int) -> NDArray[np.intp]:
    """First of each of equal parts of n lamps; those of parts of the parts are among others."""
    return np.arange(n_parts) * n // n_parts


def _ends(starts: NDArray[np.intp], n: int) -> NDArray[np.intp]:
    return np.append(starts[1:], n)


def _order(lamps: LampTable, n_levels: int) -> NDArray[np.intp]:
    """Order of lamps by halves, and halves of these, where positions and axes differ most.

    The halves of a part are so that the first is near the part before, as along a Hilbert curve.
    """
    n, order = len(lamps), np.arange(len(lamps))
    extent = float(np.ptp(lamps.position, axis=0).max()) or 1.0
    points = np.hstack([lamps.position, _AXIS * extent * lamps.axis])
    for level in range(n_levels * (_FAN.bit_length() - 1)):
        starts = _starts(n, 2**level)
        part = np.repeat(np.arange(len(starts)), np.diff(starts, append=n))
        at = points[order]
        widths = np.maximum.reduceat(at, starts) - np.minimum.reduceat(at, starts)
        widest = widths.argmax(axis=1)[part]
        order = order[np.lexsort((at[np.arange(n), widest], part))]
        halves = _starts(n, 2 ** (level + 1))
        middle = np.add.reduceat(points[order], halves) / np.diff(halves, append=n)[:, np.newaxis]
        turned = _turned(middle[0::2], middle[1::2])[part]
        mirrored = (starts + _ends(starts, n) - 1)[part] - np.arange(n)
        order = order[np.where(turned, mirrored, np.arange(n))]
    return order


def _turned(low: Floats, high: Floats) -> NDArray[np.bool_]:
    """Mask (p,) of parts in sequence whose higher half comes first, by the middles of halves.

    They are such that the way from half to half is short: by the half before and the next part.
    """
    after_high, after_low = (_detours(end[:-1], low[1:], high[1:]) for end in (high, low))
    onwards = _detours(0.5 * (low + high)[1:], high[:-1], low[:-1])
    turned = [False]
    for detours in zip([0.0, *after_high], [0.0, *after_low], [*onwards, 0.0], strict=True):
        turned.append(detours[turned[-1]] + detours[2] > 0.0)
    return np.array(turned[1:])


def _detours(points: Floats, one: Floats, other: Floats) -> list[float]:
    """By how much points (p, d) are farther from ones than from others."""
    to_one, to_other = (np.linalg.norm(points - each, axis=1) for each in (one, other))
    detours: list[float] = (to_one - to_other).tolist()
    return detours


def _bounds(lamps: LampTable, starts: NDArray[np.intp]) -> Floats:
    """Columns (nodes, 13) of `LightTree` of the nodes whose first lamps are given."""
    sizes = np.diff(starts, append=len(lamps))
    weight = lamps.brightness[:, np.newaxis]
    total = np.add.reduceat(weight, starts)
    at = lamps.axis if lamps.kind[0] == PARALLEL else lamps.position
    middle = np.add.reduceat(weight * at, starts) / total
    away = np.linalg.norm(at - np.repeat(middle, sizes, axis=0), axis=1)
    radius = np.maximum.reduceat(away, starts) * (1.0 + _ROUNDING)
    axis, angle = _cones(lamps, np.add.reduceat(weight * lamps.axis, starts), starts)
    # Light of lamps in the sphere is in a cone around it, with an apex farther back.
    back = np.divide(radius, np.sin(angle), out=np.zeros_like(radius), where=angle < np.pi)
    border = np.where(angle < np.pi, np.cos(angle), -1.0)
    steepness = np.where(angle < np.pi, 1.0 / (1.0 - border), 1.0)
    apex = middle - back[:, np.newaxis] * axis
    return np.column_stack([middle, radius, apex, axis, border, steepness, total])


def _cones(lamps: LampTable, along: Floats, starts: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Axes and half angles of cones that the directions of nodes' light are in; π: and no axis."""
    sizes = np.diff(starts, append=len(lamps))
    length = np.linalg.norm(along, axis=1, keepdims=True)
    axis = np.divide(along, length, out=np.zeros_like(along), where=length > 0.0)
    cosine = (lamps.axis * np.repeat(axis, sizes, axis=0)).sum(axis=1)
    reach = np.arccos(1.0 - lamps.outer)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0)) + reach + _ROUNDING
    angle = np.maximum.reduceat(angle, starts)
    axis[angle > np.pi - _ALL] = 0.0
    return axis, np.where(angle > np.pi - _ALL, np.pi, angle)
