"""Extremes of photon maps: errors of any method's field, by what prepares it.

Each error is a function of `field_of`, ``field_of(photons, **settings)``, which returns a field.
"""

from functools import partial

import numpy as np

import photonrelax as pr
from tests.extremes.case import Case
from tests.helpers.photon_maps import flat_map, plane, unit_square

N = 400
UNIFORM = unit_square(N, "halton")
INTERIOR = plane(np.random.default_rng(7).uniform(0.25, 0.75, (20, 2)))
# Kernels of 500 photons have no meaning in maps of 400.
SMALL = {"diffusion": pr.DiffusionSettings(k=50)}


# Photons that are all at one point have no distance from which a radius follows.
RADII = {
    "gather": pr.GatherSettings(gather_radius=0.1),
    "diffusion": pr.DiffusionSettings(k=None, bandwidth=0.1),
    "progressive": pr.ProgressiveSettings(radius=0.1),
}


def spread(xy):
    """Photons at xy that are even over the emitter."""
    n = max(len(xy), 1)
    return flat_map(xy, n, coords=unit_square(n, "halton")[: len(xy)])


def change(found, expected):
    """The largest difference over the largest value."""
    return float(np.abs(found - expected).max() / np.abs(expected).max())


def estimates(field_of, photons, scale=1.0, shift=0.0, **settings):
    points, normals = INTERIOR
    return field_of(photons, **SMALL | settings)(scale * points + shift, normals)


# --- invariances ------------------------------------------------------------------------------


def of_unit(field_of, *, scale):
    """Lengths times a scale: irradiance over its square."""
    photons = flat_map(UNIFORM, N)
    scaled = photons.replace(
        position=scale * photons.position,
        emitter_coords=scale * photons.emitter_coords,
        emitter_density=photons.emitter_density / scale**2,
    )
    found = scale**2 * estimates(field_of, scaled, scale)
    return change(found, estimates(field_of, photons))


def of_shift(field_of, *, sizes):
    """Photons so many sizes away from the origin."""
    photons = flat_map(UNIFORM, N)
    shift = sizes * np.array([1.0, -0.7, 0.3])
    moved = photons.replace(position=photons.position + shift)
    return change(estimates(field_of, moved, shift=shift), estimates(field_of, photons))


def of_flux(field_of, *, scale):
    """Flux times a scale: irradiance times it."""
    photons = flat_map(UNIFORM, N)
    found = estimates(field_of, photons.replace(flux=scale * photons.flux)) / scale
    return change(found, estimates(field_of, photons))


def of_dark_channels(field_of):
    """Channels without light are exactly black, and the others as they are."""
    photons = flat_map(UNIFORM, N)
    green = photons.replace(flux=photons.flux * [0.0, 1.0, 0.0])
    return change(estimates(field_of, green), estimates(field_of, photons) * [0.0, 1.0, 0.0])


def of_unequal_flux(field_of):
    """A photon in two is fainter by 1e6: its share of the light is not what changes estimates."""
    alternate = np.where(np.arange(N) % 2 == 0, 2.0, 2e-6)[:, np.newaxis]
    photons = flat_map(UNIFORM, N)
    bright = photons.flux * np.where(alternate > 1.0, alternate, 0.0)
    found = estimates(field_of, photons.replace(flux=photons.flux * alternate))
    return change(found, estimates(field_of, photons.replace(flux=bright)))


# --- closed forms -----------------------------------------------------------------------------


def energy(field_of, photons, half=4.0, **settings):
    """Error of the flux of an irradiance map that reaches far around all photons."""
    field = field_of(photons, **SMALL | settings)
    centre = photons.position.mean(axis=0) if len(photons) else np.zeros(3)
    side = 2.0 * half
    corner = centre - [half, half, 0.0]
    shown = pr.irradiance_map(field, corner, [side, 0, 0], [0, side, 0], (16, 16), normal=[0, 0, 1])
    flux = shown.sum(axis=(0, 1)) * (side / 16) ** 2
    expected = photons.flux.sum(axis=0)
    return float(np.abs(flux - expected).max() / max(expected.max(), 1e-300))


def of_coincident(field_of, *, share):
    """Energy of photons a share of which is at one point."""
    xy = UNIFORM.copy()
    xy[: int(share * N)] = 0.5
    return energy(field_of, spread(xy), **RADII)


def of_collinear(field_of):
    """Energy of photons on a line."""
    return energy(field_of, spread(UNIFORM * [1.0, 0.0]))


def of_lattice(field_of):
    """Even light from photons on a lattice."""
    side = int(np.sqrt(N))
    cells = np.stack(np.divmod(np.arange(side**2), side), axis=1)
    xy = (cells + 0.5) / side
    found = estimates(field_of, flat_map(xy, len(xy), well_spaced=True))
    return change(found.mean(axis=0), np.ones(3))


def of_contrast(field_of, *, contrast):
    """Even light in a square beside light that is denser by a contrast, both at their middles."""
    side = contrast**-0.5
    dense = UNIFORM * side + [3.0, 0.0]
    photons = flat_map(np.concatenate([UNIFORM, dense]), N, well_spaced=True)
    # A chart that light is even over on each side of.
    photons = photons.replace(
        emitter_coords=np.concatenate([UNIFORM, UNIFORM + np.array([5.0, 0.0])])
    )
    points, normals = INTERIOR
    field = field_of(photons, **SMALL)
    faint, bright = field(points, normals), field(side * points + [3.0, 0, 0], normals)
    means = np.array([faint.mean(axis=0), bright.mean(axis=0) / contrast])
    return change(means, np.ones_like(means))


def of_few(field_of, *, n):
    """Energy of a handful of photons."""
    return energy(field_of, spread(UNIFORM[:n]), **RADII if n < 2 else {})


K_OF = {
    "gather": lambda k: pr.GatherSettings(k=k),
    "diffusion": lambda k: pr.DiffusionSettings(k=k),
    "progressive": lambda k: pr.ProgressiveSettings(k=k, n_passes=1),
}


def of_k(field_of, *, k):
    """Energy of estimates from k photons."""
    photons = flat_map(UNIFORM, N)
    settings = {stage: make(k) for stage, make in K_OF.items()}
    return energy(field_of, photons, half=8.0, **settings)


CASES = (
    *(
        Case(f"unit of length {scale:g} m", "invariance", 1e-12, partial(of_unit, scale=scale))
        for scale in (1e-9, 1e9)
    ),
    *(
        Case(f"{n:g} sizes from the origin", "invariance", 1e-7, partial(of_shift, sizes=n))
        for n in (1e3, 1e6)
    ),
    *(
        Case(f"flux times {scale:g}", "invariance", 1e-12, partial(of_flux, scale=scale))
        for scale in (1e-30, 1e30)
    ),
    Case("two channels of zero", "exactly black", 1e-12, of_dark_channels),
    Case("fluxes of 1 : 1e6", "half the photons, invariance", 4e-6, of_unequal_flux),
    *(
        Case(f"densities of 1 : {c:g}", "even light", 0.05, partial(of_contrast, contrast=c))
        for c in (1e3, 1e9)
    ),
    *(
        Case(
            f"{share:.0%} of photons coincide", "energy", 0.01, partial(of_coincident, share=share)
        )
        for share in (0.15, 1.0)
    ),
    Case("collinear photons", "energy", 0.01, of_collinear),
    Case("photons on a lattice", "even light", 0.03, of_lattice),
    *(Case(f"{n} photons", "energy", 0.01, partial(of_few, n=n)) for n in range(4)),
    *(
        Case(f"k = {name}", "energy", bound, partial(of_k, k=k))
        # Kernels of `diffusion` as wide as all light lose some of it.
        for name, k, bound in (("2", 2, 0.01), ("n", N, 0.1), ("10 n", 10 * N, 0.3))
    ),
)
