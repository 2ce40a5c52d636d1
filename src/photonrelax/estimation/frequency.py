"""Frequency-driven progressive photon mapping (FPPM).

Progressive photon mapping shrinks every disc for ever, at the expense of noise. Here a disc is left
as it is while the local frequency spectra of the light (see
`photonrelax.transport.frequency.operators`) say that its mean is off by no more than 5 % of the
amplitude of the light, so that smooth regions keep large discs and all their photons.

Some of the photons carry spectra (see `trace_photons`). At every pass a hit point takes the largest
of each coefficient among those in and around its disc, as diffuse surfaces reflect them, and the
disc shrinks, by the rule of progressive photon mapping, no farther than this bound allows. FPPM
keeps the largest of all that were ever seen; here the bound is that of the disc as it is, so that
an edge the disc no longer reaches is forgotten, and it is taken from the photons of all passes, not
of those gone by. Where none of the photons carries a spectrum it shrinks as ever. So do all discs
of a map so small that none was chosen to carry one, whose estimates are those of progressive photon
mapping.

The 5 % are those of a disc. An estimate is the mean over passes of discs as they were: of one that
stays at its first size it has the bias, at most 5 %; of one that shrank all the way to the size
allowed, R² ~ i^(α - 1), that of a disc of R²/α, at most 5 %/α = 7 %; and of one that has not come
down to it yet, what progressive photon mapping has.

One photon map is split into passes. Passes of fresh photons, as of `render_progressive`, do not
carry spectra.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from .._ext.estimation.frequency import MaxInRadius
from .._ext.spatial.blocks import to_soa_blocks
from .._util import validation
from .._util.validation import Floats
from ..photons.neighbourhoods import normal_range
from ..photons.photon_map import PhotonMap
from ..photons.photon_trees import PhotonTrees
from ..transport.frequency import operators
from .progressive import ProgressiveSettings
from .split_passes import ProgressiveField


@dataclass(frozen=True)
class FrequencySettings:
    """Share of photons with local frequency spectra, and the bias that these allow.

    Attributes
    ----------
    share : float
        Of the photons that carry spectra, in (0, 1], where `render` traces them. Each is chosen
        or not by itself, so that of few photons perhaps none is.
    bias : float
        Largest bias of a disc over the amplitude of the light it averages, in (0, 1) (5 %); that
        of an estimate is up to 1/α times as large.
    reach : float
        Spectra are looked for within so many radii of a disc. FPPM looks within the disc; but few
        photons carry spectra, and none of these may be among the first of brighter light that a
        disc in dim light reaches over an edge.
    """

    share: float = 0.02
    bias: float = operators.BIAS
    reach: float = 2.0

    def __post_init__(self) -> None:
        share = validation.positive(self.share, "FrequencySettings.share")
        if share > 1.0:
            raise ValueError(f"FrequencySettings.share should be at most 1, but is {share}")
        bias = validation.positive(self.bias, "FrequencySettings.bias")
        if bias >= 1.0:
            raise ValueError(f"FrequencySettings.bias should be less than 1, but is {bias}")
        object.__setattr__(self, "share", share)
        object.__setattr__(self, "bias", bias)
        reach = validation.positive(self.reach, "FrequencySettings.reach")
        object.__setattr__(self, "reach", reach)


class FrequencyField(ProgressiveField):
    """Frequency-driven progressive photon mapping of one photon map at any points: a `Field`.

    Parameters
    ----------
    photons : PhotonMap
        Traced with a `frequency_share`, whichever were chosen; an empty map needs none.
    settings : ProgressiveSettings, optional
        Of the passes, first radii and the rule by which these shrink.
    frequency : FrequencySettings, optional
    n_threads : int, optional
        Threads; all available by default. Results do not depend on it.

    Raises
    ------
    ValueError
        If the photons were traced without spectra, or radii are left open and all are at one point.
    """

    def __init__(
        self,
        photons: PhotonMap,
        settings: ProgressiveSettings | None = None,
        frequency: FrequencySettings | None = None,
        *,
        n_threads: int | None = None,
    ) -> None:
        carriers = _spectrum_photons(photons)
        super().__init__(photons, settings, n_threads=n_threads)
        self.frequency = frequency or FrequencySettings()
        self.used["frequency"] = asdict(self.frequency)
        assert carriers.spectrum is not None, "photons with spectra"
        self._trees = PhotonTrees(carriers, self._n_threads)
        # Variance of all light that diffuse surfaces reflect.
        self._variance = np.ascontiguousarray(operators.diffused(carriers.spectrum)[:, :1])
        self._maxima: dict[int, MaxInRadius] = {}

    def least_radius(self, points: Floats, normals: Floats, radius: Floats) -> Floats:
        """Radii (m,), m, that spectra in and around the discs allow; zero where there are none."""
        variance = np.full((len(points), 1), -np.inf)
        reach = self.frequency.reach * radius
        for part, queries, rows in self._trees.parts(points, normals, np.arange(len(points))):
            self._maximum(part).update(
                queries, rows, reach, out=variance, n_threads=self._n_threads
            )
        known = variance[:, 0] >= 0.0
        allowed = operators.kernel_radius(np.maximum(variance[:, 0], 0.0), self.frequency.bias)
        # Finite where the variance is zero: no radius grows.
        return np.where(known, np.minimum(allowed, radius), 0.0)

    def _maximum(self, part: int) -> MaxInRadius:
        """The largest variance within a radius, among the photons of a tree."""
        if part not in self._maxima:
            tree, rows = self._trees.tree(part)
            values = to_soa_blocks(self._variance, rows, self._n_threads)
            self._maxima[part] = MaxInRadius(tree.kernel, values, range_radius=normal_range(tree))
        return self._maxima[part]


def _spectrum_photons(photons: PhotonMap) -> PhotonMap:
    """Photons that carry spectra; raises ValueError if the map was traced without."""
    spectra = photons.spectrum
    if spectra is None:
        if len(photons):
            raise ValueError(
                'photons should carry spectra for method="frequency", but none of them does: '
                "trace_photons(…, frequency_share=0.02) gives them"
            )
        spectra = np.empty((0, 3))
    return photons.replace(spectrum=spectra).subset(~np.isnan(spectra[:, 0]))
