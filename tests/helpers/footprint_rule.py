"""Means over footprints by definition, and maps and footprints that they are tested with."""

from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from tests.helpers.photon_maps import flat_map, plane

DEVIATION = 0.41
SLAB = 0.58


def tangent_frame(normal):
    """Two axes of the tangent plane and the normal, as rows."""
    u = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    u /= np.linalg.norm(u)
    return np.array([u, np.cross(normal, u), normal])


def stretch(edges):
    """Matrix of the plane that brings edges (2, 2) to right angles, or by 30° nearer to them."""
    lengths = np.hypot(*edges.T)
    if not lengths.all():
        return np.eye(2)
    first, second = edges / lengths[:, np.newaxis]
    along = first + second if first @ second > 0.0 else first - second
    along /= np.linalg.norm(along)
    half_angle = np.arccos(np.clip(abs(first @ along), 0.0, 1.0))
    factor = np.sqrt(np.tan(max(half_angle, np.pi / 6)))
    across = np.array([-along[1], along[0]])
    return factor * np.outer(along, along) + np.outer(across, across) / factor


def rectangle(edges, normal, *, skewed=True):
    """Axes, as rows, and sides of the rectangle of two edge vectors, in its metric if skewed."""
    frame = tangent_frame(normal)
    flat = edges @ frame[:2].T
    matrix = stretch(flat) if skewed else np.eye(2)
    flat = flat @ matrix
    _, sides, axes = np.linalg.svd(flat)
    along = axes[0]
    if 0.0 < sides[0] <= 1.5 * sides[1]:
        lengths = np.hypot(*flat.T)
        first, second = units = flat / lengths[:, np.newaxis]
        sine = np.linalg.det(units)
        turn = np.array([[0, -1], [1, 0]]) * np.sign(sine)
        along = first + turn.T @ second
        along /= np.linalg.norm(along)
        sides = lengths * np.sqrt(abs(sine))
    both = np.array([along, [-along[1], along[0]]])
    return np.vstack([both @ matrix @ frame[:2], normal]), sides


@cache
def gauss(n):
    """Nodes and weights of Gauss's quadrature on [-1, 1]."""
    return np.polynomial.legendre.leggauss(n)


def profile(x, side, deviation):
    """Mean of the normal density over a side around x."""
    if side == 0.0:
        return np.exp(-0.5 * (x / deviation) ** 2) / (np.sqrt(2.0 * np.pi) * deviation)
    if side < 0.1 * deviation:
        nodes, weights = gauss(8)
        z = (np.abs(x)[..., np.newaxis] + 0.5 * side * nodes) / deviation
        return np.exp(-0.5 * z**2) @ weights / (2.0 * np.sqrt(2.0 * np.pi) * deviation)
    x = np.abs(x)
    return (ndtr((0.5 * side - x) / deviation) - ndtr((-0.5 * side - x) / deviation)) / side


def panels(edges, n=40):
    """Nodes and weights of Gauss's quadrature between each two edges and the next."""
    nodes, weights = gauss(n)
    half = 0.5 * np.diff(edges)[:, np.newaxis]
    return ((nodes + 1) * half + np.array(edges)[:-1, np.newaxis]).ravel(), (weights * half).ravel()


def integral_by_quadrature(sides, radius):
    """Integral of the cut kernel over the plane."""
    deviation = DEVIATION * radius
    halves = 0.5 * np.array(sides)
    angle, weight = panels(np.linspace(0, np.pi / 2, 4))
    depth = np.linspace(0, min(9 * deviation, halves[1]), 4)
    inner, inner_weight = panels(halves[1] - depth[::-1])
    y = np.concatenate([halves[1] + radius * np.sin(angle), inner])
    reach = np.concatenate([radius * np.cos(angle), np.full(len(inner), radius)])
    weight = np.concatenate([radius * np.cos(angle) * weight, inner_weight])
    weight = weight * profile(y, sides[1], deviation)

    def along(reach):
        x, dx = panels(halves[0] - np.linspace(0, min(9 * deviation, halves[0]), 4)[::-1])
        flat = profile(x, sides[0], deviation) @ dx
        flat += max(0.0, halves[0] - 9 * deviation) / max(sides[0], 1e-300)
        x, dx = panels([0.0, 1.0])
        beside = halves[0] + x * reach[:, np.newaxis]
        return 2 * (flat + profile(beside, sides[0], deviation) @ dx * reach)

    middle = 2 * max(0.0, halves[1] - 9 * deviation) / max(sides[1], 1e-300)
    return 2 * weight @ along(reach) + middle * along(np.array([radius]))[0]


def radius_of(squared, sides, k, gather_radius):
    """Radius of the rule, and whether it is that of a photon."""
    distance = np.concatenate([[0.0], np.sqrt(np.sort(squared))])
    excess = np.arange(len(distance)) - (k - 0.5)
    linear = (k - 0.5) * sum(sides)
    root = np.full(len(distance), np.inf)
    more = np.pi * excess[excess > 0]
    root[excess > 0] = linear + np.sqrt(linear**2 + more * (k - 0.5) * np.prod(sides))
    root[excess > 0] /= more
    radius = np.maximum(distance, root)
    least = np.argmin(radius)
    if not radius[least] <= gather_radius:
        return gather_radius, False
    return radius[least], distance[least] > root[least]


class Around(NamedTuple):
    """Photons seen from a footprint: rows, offsets along its axes and beyond its edges."""

    rows: np.ndarray
    offset: np.ndarray
    beside: np.ndarray
    sides: np.ndarray

    @property
    def squared(self):
        """Squared distances from the footprint."""
        return np.square(self.beside).sum(axis=1)

    def weights(self, radius, with_rim=True):
        """Weights of a radius, whose photons on the rim count or do not."""
        deviation = DEVIATION * radius
        limit = radius * (1 + 1e-12 if with_rim else 1 - 1e-12)
        within = self.squared <= limit**2
        weight = np.exp(-0.5 * (self.beside[within, 2] / deviation) ** 2)
        for i in range(2):
            weight *= profile(self.offset[within, i], self.sides[i], deviation)
        weights = np.zeros(len(within))
        weights[within] = weight / integral_by_quadrature(self.sides, radius)
        return weights


def around(photons, point, normal, edges):
    normal = normal / np.linalg.norm(normal)
    axes, sides = rectangle(edges, normal)
    rows = np.flatnonzero(np.square(photons.normal - normal).sum(axis=1) <= 1.0)
    offset = np.abs((photons.position[rows] - point) @ axes.T)
    halves = 0.5 * np.array([*sides, SLAB * np.hypot(*sides)])
    return Around(rows, offset, np.maximum(offset - halves, 0.0), sides)


def square(side):
    return side * np.eye(3)[:2]


def uneven(n=4000, seed=0):
    """Photons of any flux, denser towards a corner."""
    rng = np.random.default_rng(seed)
    return flat_map(rng.random((n, 2)) ** 1.5, n).replace(flux=rng.random((n, 3)))


def places(n=40, seed=1):
    return plane(np.random.default_rng(seed).random((n, 2)))


TURN = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0]])
FOOTPRINTS = {
    "points": square(0.0),
    "far smaller than the spacing": square(1e-5),
    "smaller than the deviation": square(2e-3),
    "of a few photons": square(0.03),
    "of hundreds": square(0.3),
    "wider than the map": square(5.0),
    "turned": 0.05 * TURN,
    "ten to one": TURN * [[0.2], [0.02]],
    "a hundred to one": TURN * [[0.4], [0.004]],
    "a line": TURN * [[0.1], [0.0]],
    "a parallelogram": np.array([[0.1, 0.02, 0.0], [0.08, 0.1, 0.0]]),
    "a thin parallelogram": np.array([[0.2, 0.02, 0.0], [0.21, 0.01, 0.0]]),
    "nearly a square": np.array([[0.05, 0.01, 0.0], [0.0, -0.05, 0.0]]),
    "edges out of the plane": np.array([[0.05, 0.01, 0.3], [0.0, 0.07, -0.2]]),
}
