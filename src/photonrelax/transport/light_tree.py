"""Trees of lamps, from which some are chosen by the light that they bring to a point."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._ext.transport.light_tree import MAX_LAMPS_OF_LEAF, LightTree
from .._util.validation import Floats
from ..scene.lamps import COSINE, PARALLEL, SPOT, LampTable

# Children of a node.
_FAN = 4
# Difference between axes that divides lamps as well as the largest difference between positions,
# over that; the least noise of those tried.
_AXIS = 0.25
# Cones are wider than rounding makes them too narrow. Those of half angles closer to π hold all.
_ROUNDING, _ALL = 1e-6, 0.05
# Less than the cosine to any axis, for these.
_EVERYWHERE = -1.0 - 1e-6
# Intensities in cones are fitted at these places from border to axis and around it, by these powers
# of the place, the constant one at least this share; of so many lamps of a node.
_PLACES, _AROUND, _POWERS = (np.arange(8) + 0.5) / 8, 8, np.array([0, 2, 4, 8])
_LEAST_SHARE, _MOST_OF_NODE = 0.01, 64
# Updates of the fit; further ones change little. Light that is less is none.
_UPDATES, _DARK = 100, 1e-9


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
    """Columns (nodes, 17) of `LightTree` of the nodes whose first lamps are given."""
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
    border = np.where(angle < np.pi, np.cos(angle), _EVERYWHERE)
    steepness = 1.0 / (1.0 - border)
    apex = middle - back[:, np.newaxis] * axis
    profile = _profiles(lamps, axis, border, starts)
    return np.column_stack([middle, radius, apex, axis, border, steepness, profile, total])


def _cones(lamps: LampTable, along: Floats, starts: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Axes and half angles of cones of the light of nodes; zero axes if none is."""
    sizes = np.diff(starts, append=len(lamps))
    length = np.linalg.norm(along, axis=1, keepdims=True)
    axis = np.divide(along, length, out=np.zeros_like(along), where=length > 0.0)
    cosine = (lamps.axis * np.repeat(axis, sizes, axis=0)).sum(axis=1)
    reach = np.arccos(1.0 - lamps.outer)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0)) + reach + _ROUNDING
    angle = np.maximum.reduceat(angle, starts)
    return axis, np.where(angle > np.pi - _ALL, np.pi, angle)


def _profiles(lamps: LampTable, axis: Floats, border: Floats, starts: NDArray[np.intp]) -> Floats:
    """Coefficients (nodes, 4) of the intensity in nodes' cones, over that on the axes of lamps.

    It is the root mean square over directions as far from the axis, to which the chance of a node
    is in proportion where noise is least.
    """
    flat = np.tile([1.0, 0.0, 0.0, 0.0], (len(starts), 1))
    if not np.isin(lamps.kind, (COSINE, SPOT)).any():
        return flat
    some, node = _some_of_nodes(lamps, starts)
    first = np.searchsorted(node, np.arange(len(starts)))
    weight = some.brightness / np.add.reduceat(some.brightness, first)[node]
    frame = _frames(axis)
    squares = np.zeros((len(starts), len(_PLACES)))
    for k, place in enumerate(_PLACES):
        cosine = border + place * (1.0 - border)
        sine = np.sqrt(np.maximum(1.0 - cosine**2, 0.0))
        for turn in 2.0 * np.pi * np.arange(_AROUND) / _AROUND:
            local = np.stack([np.cos(turn) * sine, np.sin(turn) * sine, cosine], axis=1)
            towards = np.einsum("nij,ni->nj", frame, local)[node]
            light = np.add.reduceat(weight * _intensities(some, towards), first)
            squares[:, k] += light**2 / _AROUND
    flat[:, 0] = np.sqrt(squares.mean(axis=1))
    return np.where(axis.any(axis=1, keepdims=True), _fitted(np.sqrt(squares)), flat)


def _some_of_nodes(
    lamps: LampTable, starts: NDArray[np.intp]
) -> tuple[LampTable, NDArray[np.intp]]:
    """Lamps of each node, evenly in their order if they are many, and the nodes of these."""
    sizes = np.diff(starts, append=len(lamps))
    n = np.minimum(sizes, _MOST_OF_NODE)
    node = np.repeat(np.arange(len(starts)), n)
    number = np.arange(len(node)) - (np.cumsum(n) - n)[node]
    return lamps[starts[node] + number * sizes[node] // n[node]], node


def _frames(axis: Floats) -> Floats:
    """Orthonormal vectors (n, 3, 3) of which the last are unit vectors (n, 3), or of zeros any."""
    axis = np.where(axis.any(axis=1, keepdims=True), axis, (0.0, 0.0, 1.0))
    across = np.cross(axis, np.eye(3)[np.abs(axis).argmin(axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return np.stack([across, np.cross(axis, across), axis], axis=1)


def _intensities(lamps: LampTable, towards: Floats) -> Floats:
    """Intensity (n,) of each lamp along a unit vector, over that on its axis."""
    cosine = (lamps.axis * towards).sum(axis=1)
    is_spot = lamps.kind == SPOT
    width = np.where(is_spot, lamps.outer - lamps.inner, 1.0)
    spot = np.clip((lamps.outer - 1.0 + cosine) / width, 0.0, 1.0) ** 2
    lobe = np.where(lamps.kind == COSINE, np.maximum(cosine, 0.0), 1.0)
    return np.where(is_spot, spot, lobe)


def _fitted(values: Floats) -> Floats:
    """Positive coefficients (n, powers) of least squares to values (n, places).

    By multiplicative updates (Lee & Seung 2001, *Algorithms for Non-negative Matrix
    Factorization*).
    """
    basis = _PLACES ** _POWERS[:, np.newaxis]
    values = np.maximum(values, _DARK)
    coefficients = np.repeat(values.mean(axis=1, keepdims=True), len(_POWERS), axis=1)
    for _ in range(_UPDATES):
        coefficients *= (values @ basis.T) / (coefficients @ (basis @ basis.T))
    least = _LEAST_SHARE * coefficients.sum(axis=1)
    coefficients[:, 0] = np.maximum(coefficients[:, 0], least)
    return coefficients
