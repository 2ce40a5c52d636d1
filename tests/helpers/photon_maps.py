"""Photon maps whose irradiance is known."""

from itertools import pairwise

import numpy as np
from scipy.stats import qmc

import photonrelax as pr
from photonrelax.photons.parts import PhotonParts


def unit_square(n, kind, seed=0):
    """Points of the unit square: independent, or along a randomly shifted Halton sequence."""
    rng = np.random.default_rng(seed)
    if kind == "random":
        return rng.random((n, 2))
    return (qmc.Halton(2, scramble=False).random(n) + rng.random(2)) % 1.0


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
