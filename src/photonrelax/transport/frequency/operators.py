"""Local spectra of light, after Durand et al. 2005: conventions, operators, the radius they allow.

The poster on frequency-driven kernels (FPPM) leaves out its derivations; this is what is used here.

**Light field.** Around a ray, L(x, θ) is the light at distance x across the ray, m, that travels at
the angle θ to it, rad, to first order in both. In three dimensions there are two such sections,
one in the plane of incidence and one across it; vectors are then (x₁, x₂, θ₁, θ₂).

**Spectrum.** Its Fourier transform over Ω = (Ω_x, Ω_θ), cycles/m and cycles/rad, is taken to be
the Gaussian exp(-½ Ωᵀ Σ⁻¹ Ω), of *amplitude*, not power, around Ω = 0, with

    Σ = [[a, c], [c, b]],    a: cycles²/m²,    b: cycles²/rad²,    c: cycles²/(m rad).

So a, b are squared bandwidths: light that is exp(-x²/2s²) has a = 1/(4π²s²). Larger means
rougher, and the larger of two is the conservative bound. (FPPM's radius grows with √a: its a is
the inverse of this one.)

**Lossless operators.** To first order every event maps rays linearly, v' = M v, and keeps radiance:
L'(v) = L(M⁻¹ v). By the change of variables in the Fourier integral L̂'(Ω) = |det M| L̂(Mᵀ Ω), so

    Ω' = K Ω,    Σ' = K Σ Kᵀ,    K = M⁻ᵀ.

========== ================== =========================== ======================================
event      rays               frequencies                 where it comes from
========== ================== =========================== ======================================
travel     x' = x + d θ       Ω_θ' = Ω_θ - d Ω_x          shear (Durand et al. 2005, §3)
project    x' = x / cos θ₀    Ω_x' = cos θ₀ Ω_x           a tilted surface cuts the beam
curve      θ' = θ + G x       Ω_x' = Ω_x - Gᵀ Ω_θ         angles to a normal that turns by G x
turn       θ' = ρ θ           Ω_θ' = Ω_θ / ρ              Snell's law, differentiated
rotate     v' = R v           Ω' = R Ω                    another frame across the ray
========== ================== =========================== ======================================

A mirror is project, curve, curve, project back; an interface has turn between the two curves:
n₁ sin θ₁ = n₂ sin θ₂ gives dθ₂ = n₁ cos θ₁ / (n₂ cos θ₂) dθ₁ in the plane of incidence and
n₁ / n₂ across it. Where the normal turns by S x along the surface, angles in the plane of incidence
change by S x and those across it by cos θ₀ S x, the share of the ray that lies along the normal.
(Belcour et al.'s covariance tracing is the same algebra on power spectra.)

**Occlusion.** Light cut off, or bent in another way, at a distance s is multiplied by a window,
exp(-x²/s²); spectra convolve, and those of Gaussians add: Σ' = Σ + diag(1 / (2π²s²), 0). The width
is for light whose sheet is stretched by A, with s = |A / A'| the distance at which the stretch
would vanish, in a fold: its irradiance 1/A has E''/E = 3 / (As)², which the bound below takes for
8π² a, or a = 3 / (8π²s²) before the stretch; a third more keeps the bias at a fold, with all its
orders, at 5 %. Next to a shadow's edge kernels then stay off the edge. Light that is not cut off
but changes by half of itself at that distance, as at the angle of total reflection, counts as if.

**Deposit.** A Lambertian surface keeps E(x) = ∫ L cos θ dθ. The cosine, as the Gaussian of its
variance σ² = π²/4 - 2, widens the spectrum over angle; the integral is its slice Ω_θ = 0, of
variance

    e = a - c² / (b + 1/(4π²σ²)).

What is reflected has no angular frequency of its own, so FPPM's r_θ is infinite and r_x decides.
Photons carry (e, b, c) rather than (a, b, c): a follows from these, while in light that is nearly
parallel a and what is taken from it have all their digits in common. For the same reason spectra
are carried along a path as roots F, Σ = F Fᵀ, and e is what F leaves (see `deposited`).

**Radius.** Around a wave of frequency f the mean over a disc of radius r is 2 J₁(z)/z of its value,
z = 2πfr, and 1 - 2 J₁(z)/z ≤ z²/8. Of an irradiance whose spectrum has variance a along both axes,
so that the mean of f² is 2a, a disc loses at most (πr)² a where all waves peak, and of a single
wave, a = f², half of that. So

    r = √β / (π √a),    β = 0.05,

keeps bias at or below 5 % of the amplitude, whatever the shape of the spectrum. Of the Gaussian
exp(-2π²a|x|²) a disc keeps e^-t · sinh(t)/t ≥ e^-t, t = π²ar², which would allow FPPM's
β₉₅ = -log 0.95 = 0.0513.
"""

from __future__ import annotations

import numpy as np

from ..._util.validation import Floats

BIAS = 0.05
"""Largest bias of a disc over the amplitude of what it averages."""

COSINE_LOBE = 1.0 / (4.0 * np.pi**2 * (np.pi**2 / 4.0 - 2.0))
"""Variance of the spectrum of cos θ over angle, cycles²/rad²."""

_WINDOW = 1.0 / (2.0 * np.pi**2)
# Grazing rays would make operators singular.
_LEAST_COSINE = 1e-6


def carried(spectrum: Floats, operator: Floats) -> Floats:
    """Return spectra (n, 2s, 2s) after an operator: K Σ Kᵀ."""
    moved: Floats = operator @ spectrum @ np.swapaxes(operator, -1, -2)
    return moved


def travel(distance: Floats, sections: int = 1) -> Floats:
    """Return the operator (n, 2s, 2s) of `distance` (n,), m, through free space."""
    operator = _identity(len(distance), sections)
    for i in range(sections):
        operator[:, sections + i, i] = -distance
    return operator


def project(cosine: Floats, sections: int = 1) -> Floats:
    """Return the operator of a surface at the cosine (n,): from across the ray to along it.

    Only the first section, in the plane of incidence, is tilted. With 1 / cosine it leads back.
    """
    operator = _identity(len(cosine), sections)
    operator[:, 0, 0] = cosine
    return operator


def curve(gradient: Floats) -> Floats:
    """Return the operator that adds `gradient` (n, s, s), rad/m, times x to the angles."""
    n, sections, _ = gradient.shape
    operator = _identity(n, sections)
    operator[:, :sections, sections:] = -np.swapaxes(gradient, 1, 2)
    return operator


def turn(scale: Floats) -> Floats:
    """Return the operator that multiplies the angles in each section by `scale` (n, s)."""
    n, sections = scale.shape
    operator = _identity(n, sections)
    for i in range(sections):
        operator[:, sections + i, sections + i] = 1.0 / scale[:, i]
    return operator


def rotate(rotation: Floats) -> Floats:
    """Return the operator of another frame: `rotation` (n, 2, 2) has its axes as rows."""
    operator = np.zeros((len(rotation), 4, 4))
    operator[:, :2, :2] = operator[:, 2:, 2:] = rotation
    return operator


def reflect(cosine: Floats, shape: Floats) -> Floats:
    """Return the operator of a mirror.

    Parameters
    ----------
    cosine : (n,)
        Of incidence.
    shape : (n, s, s)
        How the normal that faces the light turns along the surface, 1/m: positive for convex ones.

    Returns
    -------
    (n, 2s, 2s)
        Angles of the outgoing light are measured in the mirrored frame.
    """
    sections = shape.shape[1]
    cosine = np.maximum(cosine, _LEAST_COSINE)
    bend = 2.0 * _weighed(shape, cosine)
    operator: Floats = project(1.0 / cosine, sections) @ curve(bend) @ project(cosine, sections)
    return operator


def refract(cosine: Floats, cosine_out: Floats, ratio: Floats, shape: Floats) -> Floats:
    """Return the operator of an interface.

    Parameters
    ----------
    cosine, cosine_out : (n,)
        Of incidence and of refraction.
    ratio : (n,)
        Index of refraction on the side of the light over that beyond.
    shape : (n, s, s)
        As for `reflect`.
    """
    sections = shape.shape[1]
    cosine = np.maximum(cosine, _LEAST_COSINE)
    cosine_out = np.maximum(cosine_out, _LEAST_COSINE)
    scale = np.repeat(ratio[:, np.newaxis], sections, axis=1)
    scale[:, 0] *= cosine / cosine_out
    onto = curve(_weighed(shape, cosine)) @ project(cosine, sections)
    off = project(1.0 / cosine_out, sections) @ curve(-_weighed(shape, cosine_out))
    operator: Floats = off @ turn(scale) @ onto
    return operator


def occluded(spectrum: Floats, distance: Floats, *, angular: bool = False) -> Floats:
    """Return spectra of light that is cut off, or bent otherwise, at a distance (n,).

    The distance is in m across the ray or, `angular`, in rad around a point.
    """
    sections = spectrum.shape[1] // 2
    out = spectrum.copy()
    for i in range(sections):
        axis = sections + i if angular else i
        out[:, axis, axis] += _WINDOW / distance**2
    return out


def root(spectrum: Floats) -> Floats:
    """Return roots F (n, 2s, 2s), Σ = F Fᵀ, of spectra with frequencies of all kinds.

    Operators apply to them from the left: K F.
    """
    return np.asarray(np.linalg.cholesky(spectrum), dtype=np.float64)


def deposited(root: Floats) -> tuple[Floats, Floats]:
    """Return what Lambertian surfaces keep of the light that comes to them.

    Parameters
    ----------
    root : (n, 2s, m)
        F of spectra Σ = F Fᵀ on the surface.

    Returns
    -------
    slices : (n, s, s)
        G, Gᵀ G being Σ sliced at Ω_θ = 0, the lobe of the cosine included: what the rows of F over
        space leave beside those over angle. The difference Σ_xx - Σ_xθ (…)⁻¹ Σ_θx would leave
        nothing but rounding of light that is nearly parallel.
    regression : (n, s, s)
        Multiplied by a frequency Ω_x, the Ω_θ that is expected beside it.
    """
    n, twice, m = root.shape
    sections = twice // 2
    columns = np.zeros((n, m + sections, twice))
    columns[:, :m] = np.swapaxes(np.roll(root, sections, axis=1), 1, 2)
    columns[:, m:, :sections] = np.sqrt(COSINE_LOBE) * np.eye(sections)
    # From the largest row to the least, rounding stays in proportion to each.
    size = np.abs(columns).max(axis=2, keepdims=True)
    columns = np.take_along_axis(columns, np.argsort(-size, axis=1), axis=1)
    upper: Floats = np.asarray(np.linalg.qr(columns, mode="r"), dtype=np.float64)
    over, beside = upper[:, :sections], upper[:, sections:, sections:]
    regression = np.linalg.solve(over[:, :, :sections], over[:, :, sections:])
    return beside, np.asarray(regression, dtype=np.float64)


def roughest(root: Floats) -> Floats:
    """Return (e, b, c), (n, 3), of the section in which irradiance is roughest.

    `root` (n, 4, m) is that of the spectrum on the receiver. Along the unit vector t in which
    irradiance varies most, e = tᵀ Gᵀ G t; b and c are those of the angle that tells most of Ω_x,
    so that e = a - c² / (b + 1/(4π²σ²)) for a = tᵀ Σ_xx t.
    """
    slices, regression = deposited(root)
    _, size, axes = np.linalg.svd(slices)
    t = axes[:, 0]
    angle = np.einsum("nji,ni->nj", regression, t)
    length = np.linalg.norm(angle, axis=1, keepdims=True)
    angle = np.where(length > 0.0, angle / np.where(length > 0.0, length, 1.0), t)
    along = np.einsum("ni,nij->nj", t, root[:, :2])
    turning = np.einsum("ni,nij->nj", angle, root[:, 2:])
    products = [np.einsum("nj,nj->n", turning, other) for other in (turning, along)]
    return np.column_stack([size[:, 0] ** 2, *products])


def diffused(spectrum: Floats) -> Floats:
    """Return the spectra (n, 3) that Lambertian surfaces reflect of those (e, b, c) they receive.

    Angular frequency is gone; NaN, for none known, stays NaN.
    """
    return spectrum * np.array([1.0, 0.0, 0.0])


def kernel_radius(variance: Floats, bias: float = BIAS) -> Floats:
    """Return the radius, m, of a disc whose mean is off by 5 % of the light's amplitude at most.

    `variance` is that of the irradiance's spectrum, cycles²/m²: the first coefficient of what
    `diffused` returns. Infinite where it is zero. Another `bias` stands for other than 5 %.
    """
    with np.errstate(divide="ignore"):
        radius: Floats = np.sqrt(bias / np.asarray(variance, dtype=np.float64)) / np.pi
    return radius


def _identity(n: int, sections: int) -> Floats:
    return np.tile(np.eye(2 * sections), (n, 1, 1))


def _weighed(shape: Floats, cosine: Floats) -> Floats:
    """Return how a turning normal changes angles to it: across the plane of incidence, by less."""
    weighed = shape.copy()
    weighed[:, 1:] *= cosine[:, np.newaxis, np.newaxis]
    return weighed
