"""Photons and settings that diffusion is tested with."""

from dataclasses import replace

import numpy as np

import photonrelax as pr
from tests.helpers.photon_maps import flat_map, unit_square

METHODS = ("diffusion", "isotropic-diffusion")
FIXED = pr.DiffusionSettings(
    k=None, bandwidth=0.1, normalisation="maximum", edge_threshold=0.2, least_eigenvalue=0.01
)
LOCAL = replace(FIXED, normalisation="local", edge_threshold=0.5)


def half_lit(n=20_000, seed=0):
    """1 W/m² where x < 1/2, as independent photons."""
    xy = unit_square(n, "random", seed)
    return flat_map(xy[xy[:, 0] < 0.5], n)


def steep_map(n, seed=0):
    """Photons of any flux, thick on the left, that came from all over the sky."""
    rng = np.random.default_rng(seed)
    wi = rng.normal(size=(n, 3))
    wi[:, 2] = np.abs(wi[:, 2]) + 0.2
    photons = flat_map(rng.random((n, 2)) ** 2, n)
    return photons.replace(flux=rng.random((n, 3)) / n, wi=wi)


def rotation(seed=0):
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.linalg.det(q)


def turned(photons, q, scale=1.0, shift=0.0):
    return photons.replace(
        position=scale * photons.position @ q.T + shift,
        normal=photons.normal @ q.T,
        wi=None if photons.wi is None else photons.wi @ q.T,
    )
