"""Frequency-driven progressive photon mapping of one photon map (FPPM).

After the poster *Frequency Based Kernel Estimation for Progressive Photon Mapping*. Progressive
photon mapping reduces the radius of every disc for ever, at the expense of noise. Here a radius
stays as it is while the local frequency spectra of the light (see
`photonrelax.transport.frequency.operators`) bound the bias of its disc by 5 % of the amplitude of
the light, so that smooth regions keep large discs and all their photons.

Some of the photons carry spectra (see `trace_photons`). In every pass the bound of a hit point is
that of the largest variance among those in and around its disc, after reflection by a diffuse
surface, and the rule of progressive photon mapping reduces the radius no farther than it allows.
FPPM keeps the largest variance ever seen; here it is that of the present disc, so that an edge
beyond the disc is forgotten, and of the photons of all passes, not of those before. Where no photon
carries a spectrum radii are reduced as in progressive photon mapping; so are all radii of a map so
small that no photon was chosen to carry one.

The 5 % are those of a disc. An estimate is the mean over passes of discs as they were: its bias is
at most 5 % if the disc keeps its initial radius; at most 5 %/α = 7 % if it shrank all the way to
the radius allowed, R² ~ i^(α - 1), which is the bias of a disc of R²/α; and that of progressive
photon mapping while the radius is larger than allowed.

One map of photons is split into passes. Passes of fresh photons, as of `render_progressive`, do not
carry spectra.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property

import numpy as np

from .._ext.estimation.footprint import rectangle_sides
from .._ext.estimation.frequency import MaxInRadius
from .._ext.spatial.blocks import to_soa_blocks
from .._util import validation
from .._util.frozen import set_field
from .._util.validation import Floats
from ..photons.axes import normal_range
from ..photons.photon_map import PhotonMap
from ..photons.photon_trees import PhotonTrees
from ..transport.frequency import operators
from .progressive import ProgressiveSettings
from .split_passes import ProgressiveField


@dataclass(frozen=True)
class FrequencySettings:
    """Share of the photons that carry spectra, and the bias that these allow.

    Attributes
    ----------
    share : float
        Share of the photons that carry spectra, in (0, 1], where `render` traces them. Each is
        chosen independently: of few photons possibly none.
    bias : float
        Largest bias of a disc over the amplitude of the light it averages, in (0, 1) (5 %); that
        of an estimate is up to 1/α times as large.
    reach : float
        Radius within which spectra are searched, in radii of the disc. FPPM has 1; but few photons
        carry spectra, and possibly none of the first photons of brighter light that a disc in dim
        light extends to over an edge.
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
        set_field(self, "share", share)
        set_field(self, "bias", bias)
        reach = validation.positive(self.reach, "FrequencySettings.reach")
        set_field(self, "reach", reach)


class FrequencyField(ProgressiveField):
    """Frequency-driven progressive photon mapping of one photon map at any points.

    Parameters
    ----------
    photons : PhotonMap
        Traced with a `frequency_share`, unless it is empty.
    settings : ProgressiveSettings, optional
        Passes, initial radii and radius reduction.
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
        if settings is not None and settings.is_global:
            raise ValueError(
                'ProgressiveSettings.radius should be none or a number with method="frequency", '
                'whose spectra limit the radius of each point, but is "global"'
            )
        carriers = _spectrum_photons(photons)
        super().__init__(photons, settings, n_threads=n_threads)
        self.frequency = frequency or FrequencySettings()
        self.used["frequency"] = asdict(self.frequency)
        assert carriers.spectrum is not None, "carriers have spectra"
        self._trees = PhotonTrees(carriers, self._n_threads)
        # Variance of all light that diffuse surfaces reflect.
        self._variance = np.ascontiguousarray(operators.diffused(carriers.spectrum)[:, :1])

    def least_radius(
        self, points: Floats, normals: Floats, radius: Floats, footprint: Floats | None = None
    ) -> Floats:
        """Radii (m,), m, that spectra in and around the discs allow; zero where there are none.

        Around a footprint spectra are searched within half its diagonal more.
        """
        variance = np.full((len(points), 1), -np.inf)
        reach = self.frequency.reach * radius
        if footprint is not None:
            reach += 0.5 * np.linalg.norm(rectangle_sides(normals, footprint), axis=1)
        for part, queries, rows in self._trees.parts(points, normals, np.arange(len(points))):
            self._maximum(part).update(
                queries, rows, reach, out=variance, n_threads=self._n_threads
            )
        known = variance[:, 0] >= 0.0
        allowed = operators.kernel_radius(np.maximum(variance[:, 0], 0.0), self.frequency.bias)
        # Finite where the variance is zero: no radius grows.
        return np.where(known, np.minimum(allowed, radius), 0.0)

    @cached_property
    def _maxima(self) -> dict[int, MaxInRadius]:
        return {}

    def _maximum(self, part: int) -> MaxInRadius:
        """The largest variance within a radius, among the photons of a tree."""
        if part not in self._maxima:
            tree, rows = self._trees.tree(part)
            largest = self._trees.maxima(self._variance, part)
            values = to_soa_blocks(largest, rows, self._n_threads)
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
