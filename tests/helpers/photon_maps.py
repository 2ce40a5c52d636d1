"""Photon maps whose irradiance is known."""

from itertools import pairwise

import numpy as np
from scipy.stats import qmc

import photonrelax as pr
from photonrelax.photons.parts import PhotonParts


def unit_square(n, kind, seed=0, start=0):
    """Points of the unit square: independent, or of a randomly shifted Halton sequence."""
    rng = np.random.default_rng(seed)
    if kind == "random":
        return rng.random((n, 2))
    sequence = qmc.Halton(2, scramble=False).fast_forward(start)
    return (sequence.random(n) + rng.random(2)) % 1.0


def flat_map(xy, n_emitted, coords=None, **fields):
    """Photons of 1 W emitted over one m², landed at xy in the plane z = 0."""
    n = len(xy)
    return pr.PhotonMap(
        np.column_stack([xy, np.zeros(n)]),
        np.tile([0.0, 0.0, 1.0], (n, 1)),
        np.full((n, 3), 1.0 / n_emitted),
        emitter_coords=xy if coords is None else coords,
        emitter_density=np.full(n, float(n_emitted)),
        n_emitted=n_emitted,
        **fields,
    )


def uniform_map(n, kind, seed=0):
    """1 W/m² over the unit square."""
    return flat_map(unit_square(n, kind, seed), n, well_spaced=kind == "halton")


def endless_map(n, kind, seed=0, margin=0.6):
    """1 W/m² of n photons over the unit square and copies of these around it, up to a margin.

    Means over the square have no noise from photons that come and go at its border. Each seed
    has a part of the sequence to itself.
    """
    xy = unit_square(n, kind, seed, start=seed * n)
    copies = np.concatenate([np.add(xy, [i, j]) for i in (-1, 0, 1) for j in (-1, 0, 1)])
    copies = copies[(np.abs(copies - 0.5) <= 0.5 + margin).all(axis=1)]
    return flat_map(copies, n, well_spaced=kind == "halton")


def even_points(n, seed, side=1.0):
    """A Fibonacci lattice, shifted at random, over a square in the middle of the unit square."""
    i, shift = np.arange(n), np.random.default_rng(seed).random(2)
    xy = np.column_stack([i / n, i * 0.5 * (np.sqrt(5.0) - 1.0)]) + shift
    return plane(0.5 + side * (xy % 1.0 - 0.5))


def mean_irradiance(photons, side=1.0):
    """That of the first channel of the photons on a square in the middle of the unit square."""
    inside = (np.abs(photons.position[:, :2] - 0.5) < 0.5 * side).all(axis=1)
    return photons.flux[inside, 0].sum() / side**2


# Positions along x of photons that are even over u, for densities with a slope.
_MAPS = {
    "exponential": lambda u: np.log1p(u * np.expm1(3.0)) / 3.0,
    "linear": np.sqrt,
    "folded": lambda u: (2.0 * u - 1.0) ** 2,
}
MAPS = tuple(_MAPS)


def mapped(name, n, kind, seed=3):
    """Photons even over the unit square of emitter coordinates, mapped to one of MAPS along x."""
    uv = unit_square(n, kind, seed)
    return flat_map(np.column_stack([_MAPS[name](uv[:, 0]), uv[:, 1]]), n, coords=uv)


def plane(xy):
    """Points of the plane z = 0 and their normals."""
    return np.column_stack([xy, np.zeros(len(xy))]), np.tile([0.0, 0.0, 1.0], (len(xy), 1))


def in_parts(photons, folder, n_parts=3):
    """Photons of any map as a folder of parts."""
    parts = PhotonParts.create(folder, {})
    bounds = np.linspace(0, len(photons), n_parts + 1).astype(int)
    for start, stop in pairwise(bounds):
        some = photons.subset(slice(start, stop)).replace(
            n_emitted=len(photons), emitted_ranges=[(start, stop)]
        )
        parts = parts.append(some)
    return parts
