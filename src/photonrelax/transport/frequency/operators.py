"""Local frequency spectra of light (Durand et al. 2005): conventions, operators, kernel radii.

The poster on frequency-driven kernels (FPPM) gives no derivations; docs/methods/frequency.md has
those used here, with the operators. Conventions:

- Around a ray, L(x, θ) is the light at distance x across the ray, m, at the angle θ to it, rad, to
  first order in both. In three dimensions there are two such sections, s = 2, the first in the
  plane of incidence; vectors are then (x₁, x₂, θ₁, θ₂).
- Its Fourier transform over Ω = (Ω_x, Ω_θ), cycles/m and cycles/rad, is taken to be the Gaussian
  exp(-½ Ωᵀ Σ⁻¹ Ω), of amplitude, with Σ = [[a, c], [c, b]]. Larger means rougher.
- An operator K takes frequencies from before an event to after it: Ω' = K Ω, Σ' = K Σ Kᵀ. Spectra
  are propagated as roots F, Σ = F Fᵀ.
- Photons store (e, b, c), where e is the variance of the spectrum of the irradiance that they
  deposit on a Lambertian surface.
"""

from __future__ import annotations

import numpy as np

from ..._util.validation import Floats

BIAS = 0.05
"""Largest bias of the mean over a disc, relative to the amplitude of the light."""

COSINE_LOBE = 1.0 / (4.0 * np.pi**2 * (np.pi**2 / 4.0 - 2.0))
"""Variance of the spectrum of cos θ over angle, cycles²/rad²."""

_WINDOW = 1.0 / (2.0 * np.pi**2)
# Operators are singular at grazing incidence.
_MIN_COSINE = 1e-6


def propagate(distance: Floats, sections: int = 1) -> Floats:
    """Operator (n, 2s, 2s) of free flight over `distance` (n,), m."""
    operator = _identity(len(distance), sections)
    for i in range(sections):
        operator[:, sections + i, i] = -distance
    return operator


def project(cosine: Floats, sections: int = 1) -> Floats:
    """Operator of the projection from across a ray onto a surface, at the cosine (n,) of incidence.

    Only the first section, in the plane of incidence, is tilted. 1 / cosine projects back.
    """
    operator = _identity(len(cosine), sections)
    operator[:, 0, 0] = cosine
    return operator


def curvature(gradient: Floats) -> Floats:
    """Operator that adds `gradient` (n, s, s), rad/m, times x to the angles."""
    n, sections, _ = gradient.shape
    operator = _identity(n, sections)
    operator[:, :sections, sections:] = -np.swapaxes(gradient, 1, 2)
    return operator


def scale_angles(scale: Floats) -> Floats:
    """Operator that multiplies the angles in each section by `scale` (n, s)."""
    n, sections = scale.shape
    operator = _identity(n, sections)
    for i in range(sections):
        operator[:, sections + i, sections + i] = 1.0 / scale[:, i]
    return operator


def rotate(rotation: Floats) -> Floats:
    """Operator of another frame across the ray: `rotation` (n, 2, 2) has its axes as rows."""
    operator = np.zeros((len(rotation), 4, 4))
    operator[:, :2, :2] = operator[:, 2:, 2:] = rotation
    return operator


def reflect(cosine: Floats, shape: Floats) -> Floats:
    """Operator of a mirror.

    Parameters
    ----------
    cosine : (n,)
        Of incidence.
    shape : (n, s, s)
        Shape operator of the surface for the normal that faces the light, 1/m: positive where
        it is convex.

    Returns
    -------
    (n, 2s, 2s)
        Angles of the outgoing light are measured in the mirrored frame.
    """
    sections = shape.shape[1]
    cosine = np.maximum(cosine, _MIN_COSINE)
    bend = curvature(2.0 * _angle_gradient(shape, cosine))
    operator: Floats = project(1.0 / cosine, sections) @ bend @ project(cosine, sections)
    return operator


def refract(cosine: Floats, cosine_out: Floats, ratio: Floats, shape: Floats) -> Floats:
    """Operator of a dielectric interface.

    Parameters
    ----------
    cosine, cosine_out : (n,)
        Of incidence and of refraction.
    ratio : (n,)
        Index of refraction on the side of the light over that beyond.
    shape : (n, s, s)
        As for `reflect`.

    Returns
    -------
    (n, 2s, 2s)
    """
    sections = shape.shape[1]
    cosine = np.maximum(cosine, _MIN_COSINE)
    cosine_out = np.maximum(cosine_out, _MIN_COSINE)
    scale = np.repeat(ratio[:, np.newaxis], sections, axis=1)
    scale[:, 0] *= cosine / cosine_out
    onto = curvature(_angle_gradient(shape, cosine)) @ project(cosine, sections)
    off = project(1.0 / cosine_out, sections) @ curvature(-_angle_gradient(shape, cosine_out))
    operator: Floats = off @ scale_angles(scale) @ onto
    return operator


def occluded(spectrum: Floats, distance: Floats, *, angular: bool = False) -> Floats:
    """Spectra of light that is occluded, or takes another path, at a distance (n,).

    The distance is in m across the ray or, if `angular`, in rad around a point.
    """
    sections = spectrum.shape[1] // 2
    out = spectrum.copy()
    for i in range(sections):
        axis = sections + i if angular else i
        out[:, axis, axis] += _WINDOW / distance**2
    return out


def root(spectrum: Floats) -> Floats:
    """Roots F (n, 2s, 2s), Σ = F Fᵀ, of positive definite spectra.

    Operators multiply them from the left: K F.
    """
    return np.asarray(np.linalg.cholesky(spectrum), dtype=np.float64)


def deposited(root: Floats) -> tuple[Floats, Floats]:
    """Spectra of the irradiance on Lambertian surfaces.

    Parameters
    ----------
    root : (n, 2s, m)
        F of spectra Σ = F Fᵀ on the surface.

    Returns
    -------
    slices : (n, s, s)
        G, where Gᵀ G is Σ sliced at Ω_θ = 0, with the lobe of the cosine. It comes from a QR
        decomposition of F, because the difference Σ_xx - Σ_xθ (…)⁻¹ Σ_θx is all rounding error in
        nearly parallel light.
    regression : (n, s, s)
        Times a frequency Ω_x, the expected Ω_θ.
    """
    n, twice, m = root.shape
    sections = twice // 2
    columns = np.zeros((n, m + sections, twice))
    columns[:, :m] = np.swapaxes(np.roll(root, sections, axis=1), 1, 2)
    columns[:, m:, :sections] = np.sqrt(COSINE_LOBE) * np.eye(sections)
    # Sorted from the largest row, the rounding error of each is in proportion to its size.
    size = np.abs(columns).max(axis=2, keepdims=True)
    columns = np.take_along_axis(columns, np.argsort(-size, axis=1), axis=1)
    upper: Floats = np.asarray(np.linalg.qr(columns, mode="r"), dtype=np.float64)
    over, beside = upper[:, :sections], upper[:, sections:, sections:]
    regression = np.linalg.solve(over[:, :, :sections], over[:, :, sections:])
    return beside, np.asarray(regression, dtype=np.float64)


def roughest(root: Floats) -> Floats:
    """(e, b, c), (n, 3), of the section in which the irradiance is roughest.

    `root` (n, 4, m) is that of the spectrum on the receiver. Along the unit vector t in which
    irradiance varies most, e = tᵀ Gᵀ G t; b and c are those of the angle that correlates most
    with Ω_x, so that e = a - c² / (b + 1/(4π²σ²)) for a = tᵀ Σ_xx t.
    """
    slices, regression = deposited(root)
    _, size, axes = np.linalg.svd(slices)
    t = axes[:, 0]
    angle = np.einsum("nji,ni->nj", regression, t)
    length = np.linalg.norm(angle, axis=1, keepdims=True)
    angle = np.where(length > 0.0, angle / np.where(length > 0.0, length, 1.0), t)
    along = np.einsum("ni,nij->nj", t, root[:, :2])
    angular = np.einsum("ni,nij->nj", angle, root[:, 2:])
    products = [np.einsum("nj,nj->n", angular, other) for other in (angular, along)]
    return np.column_stack([size[:, 0] ** 2, *products])


def diffused(spectrum: Floats) -> Floats:
    """Spectra (n, 3) that Lambertian surfaces reflect of those (e, b, c) they receive.

    They have no angular frequencies. NaN, for an unknown spectrum, stays NaN.
    """
    return spectrum * np.array([1.0, 0.0, 0.0])


def kernel_radius(variance: Floats, bias: float = BIAS) -> Floats:
    """Radius, m, of a disc whose mean differs by at most `bias` times the light's amplitude.

    `variance` is that of the irradiance's spectrum, cycles²/m²: the first coefficient of
    `diffused`. The radius is infinite where it is zero.
    """
    with np.errstate(divide="ignore"):
        radius: Floats = np.sqrt(bias / np.asarray(variance, dtype=np.float64)) / np.pi
    return radius


def _identity(n: int, sections: int) -> Floats:
    return np.tile(np.eye(2 * sections), (n, 1, 1))


def _angle_gradient(shape: Floats, cosine: Floats) -> Floats:
    """Change of angles to the normal along the surface: by cos θ₀ out of the plane of incidence."""
    gradient = shape.copy()
    gradient[:, 1:] *= cosine[:, np.newaxis, np.newaxis]
    return gradient
