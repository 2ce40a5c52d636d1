"""Indices of refraction over wavelength, and the colours of wavelengths."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cache
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from .._ext.scene import dispersion as _kernel
from .._util.frozen import frozen, read_only, set_field
from .._util.validation import Floats, float_array, positive

SHORTEST, LONGEST = _kernel.RANGE
"""Wavelengths of the light that is dispersed, nm."""
N_WAVELENGTHS = 8
"""Wavelengths into which a path of white light is dispersed."""

# Fraunhofer lines of indices and Abbe numbers: of helium, and of hydrogen, nm.
D_LINE, F_LINE, C_LINE = 587.5618, 486.1327, 656.2725
_NM = 1e-3
# Lobes (weight, peak, widths below and above it, in nm) of the fit of several lobes to the colour
# matching functions of the CIE's observer of 1931, of Wyman, Sloan & Shirley 2013 (JCGT 2 (2)).
_LOBES = (
    ((1.056, 599.8, 37.9, 31.0), (0.362, 442.0, 16.0, 26.7), (-0.065, 501.1, 20.4, 26.2)),
    ((0.821, 568.8, 46.9, 40.5), (0.286, 530.9, 16.3, 31.1)),
    ((1.217, 437.0, 11.8, 36.0), (0.681, 459.0, 26.0, 13.8)),
)
# From XYZ to linear sRGB, IEC 61966-2-1.
_SRGB = np.array(
    [
        [3.2404542, -1.5371385, -0.4985314],
        [-0.9692660, 1.8760108, 0.0415560],
        [0.0556434, -0.2040259, 1.0572252],
    ]
)


class Dispersion(ABC):
    """Index of refraction over wavelength.

    Cameras see by the index at the d line of helium, 587.56 nm.
    """

    @abstractmethod
    def _index(self, micrometres: Floats) -> Floats:
        """Index at wavelengths in vacuum, µm."""

    def index(self, wavelength: ArrayLike) -> Floats:
        """Index at wavelengths in vacuum, nm, of any shape."""
        index: Floats = self._index(_NM * np.asarray(wavelength, dtype=np.float64))
        return index

    @property
    def index_d(self) -> float:
        """Index at the d line, n_d."""
        return float(self.index(D_LINE))

    @property
    def abbe_number(self) -> float:
        """Abbe number V_d = (n_d - 1) / (n_F - n_C); infinite for one index at all wavelengths."""
        spread = float(self.index(F_LINE) - self.index(C_LINE))
        return (self.index_d - 1.0) / spread if spread != 0.0 else np.inf

    def __post_init__(self) -> None:
        wavelengths = table_wavelengths()
        index = self.index(wavelengths)
        bad = ~((index > 0.0) & np.isfinite(index))
        if bad.any():
            first = np.argmax(bad)
            raise ValueError(
                f"{self!r} should have positive indices from {SHORTEST:g} to {LONGEST:g} nm, but "
                f"has {index[first]:g} at {wavelengths[first]:g} nm; coefficients are for "
                "wavelengths in µm"
            )


@dataclass(frozen=True)
class Cauchy(Dispersion):
    """Index a + b/λ², λ in µm.

    Parameters
    ----------
    a : float
        Index at long wavelengths.
    b : float
        µm²; 0.0042 of a crown glass.
    """

    a: float
    b: float

    def __post_init__(self) -> None:
        set_field(self, "a", float(float_array(self.a, "a", ())))
        set_field(self, "b", float(float_array(self.b, "b", ())))
        super().__post_init__()

    def _index(self, micrometres: Floats) -> Floats:
        return self.a + self.b / np.square(micrometres)


@dataclass(frozen=True, eq=False)
class Sellmeier(Dispersion):
    """Index √(1 + Σ bᵢ λ² / (λ² - cᵢ)), λ in µm, as catalogues of glass have it.

    Parameters
    ----------
    b, c : (n,) array_like
        Coefficients bᵢ, and cᵢ in µm².
    """

    b: ArrayLike
    c: ArrayLike

    def __post_init__(self) -> None:
        b = frozen(float_array(self.b, "b", (None,)))
        set_field(self, "b", b)
        set_field(self, "c", frozen(float_array(self.c, "c", b.shape)))
        super().__post_init__()

    def _index(self, micrometres: Floats) -> Floats:
        square = np.square(micrometres)[..., np.newaxis]
        b, c = np.asarray(self.b), np.asarray(self.c)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.sqrt(1.0 + np.sum(b * square / (square - c), axis=-1))


@dataclass(frozen=True)
class Abbe(Dispersion):
    """Index of Cauchy's form a + b/λ² that has an index at the d line and an Abbe number.

    Parameters
    ----------
    n_d : float
        Index at the d line of helium, 587.56 nm.
    v_d : float
        Abbe number (n_d - 1) / (n_F - n_C): 64 of a crown glass, 25 of a dense flint.
    """

    n_d: float
    v_d: float

    _PER_SPREAD: ClassVar[float] = 1.0 / ((_NM * F_LINE) ** -2 - (_NM * C_LINE) ** -2)

    def __post_init__(self) -> None:
        set_field(self, "n_d", positive(self.n_d, "n_d"))
        set_field(self, "v_d", positive(self.v_d, "v_d"))
        super().__post_init__()

    def _index(self, micrometres: Floats) -> Floats:
        b = (self.n_d - 1.0) / self.v_d * self._PER_SPREAD
        return self.n_d + b * (np.square(1.0 / micrometres) - (_NM * D_LINE) ** -2)


@cache
def table_wavelengths() -> Floats:
    """Wavelengths (nodes,) at which indices and colours are tabulated for kernels, nm."""
    return read_only(np.linspace(SHORTEST, LONGEST, _kernel.NODES))


@cache
def colour_table() -> Floats:
    """Linear sRGB (nodes, 3) of light of the wavelengths of tables.

    Interpolated, their mean over wavelengths is (1, 1, 1): white light is of the same power at all.
    Colours outside of sRGB have a negative component.
    """
    colours = colour_matching(table_wavelengths()) @ _SRGB.T
    return read_only(colours / (0.5 * (colours[1:] + colours[:-1])).mean(axis=0))


def colour_matching(wavelength: ArrayLike) -> Floats:
    """Colour matching functions x̄, ȳ, z̄ (n, 3) of the CIE's observer of 1931 at n wavelengths, nm.

    They are the fit of Wyman, Sloan & Shirley 2013, within 0.02 of the tables.
    """
    wavelengths = np.asarray(wavelength, dtype=np.float64)
    columns = [sum(_lobe(wavelengths, *lobe) for lobe in lobes) for lobes in _LOBES]
    return np.stack(columns, axis=-1)


def _lobe(wavelength: Floats, weight: float, peak: float, below: float, above: float) -> Floats:
    width = np.where(wavelength < peak, below, above)
    lobe: Floats = weight * np.exp(-0.5 * np.square((wavelength - peak) / width))
    return lobe
