"""Irradiance of indirect light: estimates at a share of its photons, and means of these elsewhere.

Indirect light varies slowly, and its photons are too few to be relaxed: an estimate takes hundreds
of them, and costs accordingly. Estimates close to one another take nearly the same photons, so they
are made at a share of these alone (Christensen 1999), which lies where the light is. Elsewhere
irradiance is the mean of the few nearest, weighted by the kernel of `GatherSettings` and by the
area that each stands for, the inverse of the density of photons: there are more of them where
there is more light.

Light in water is another than above it, however near to the waterline: photons on surfaces in
dielectrics and on those outside have estimates of their own.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from .._util.parallel import thread_count
from .._util.validation import Floats
from ..photons.photon_map import PhotonMap
from ..scene.scene import Scene
from .field import Densities, check_points
from .footprint import check_footprint
from .immersion import Immersion
from .nearest import GatherSettings, IrradianceField
from .surface import Surface, lit_objects

# Photons per estimate, and from what number of photons stored there are more; of few photons no
# estimate takes more than a share, or it would be of the whole scene.
_K, _K_OF_MANY, _MANY = 800, 1600, 3_000_000
_SMALLEST_K, _SHARE = 50, 50
# Photons stored by default.
_USUAL = 1_000_000
# Estimates among the photons of one, and those that a mean is taken of: the mean adds a sixth to
# the area of a kernel.
_ESTIMATES, _NEAREST = 50, 8


class IndirectField:
    """Irradiance of indirect light at any points.

    Parameters
    ----------
    photons : PhotonMap
        Of ``paths="global"``; there may be none, and those that are all at one point are left out.
    settings : GatherSettings, optional
        Of the estimates at photons. By default k is 800, or 1600 of three million photons and
        more, but a fiftieth of the photons at most.
    scene : Scene, optional
        Estimates beside edges of its surfaces are right, and those on both sides of a line where a
        dielectric ends at a surface take photons of their own side; without it all surface is taken
        to go on for ever.
    n_threads : int, optional
        Threads; all available by default. Results do not depend on it.

    Attributes
    ----------
    settings : GatherSettings
        Those of the estimates, with the largest gather radius in use; a part of the surfaces that
        is in dielectrics of its own has fewer photons, and a k by their number.
    has_footprints : bool
        There are means over footprints.
    """

    has_footprints = True

    def __init__(
        self,
        photons: PhotonMap,
        settings: GatherSettings | None = None,
        *,
        scene: Scene | None = None,
        n_threads: int | None = None,
    ) -> None:
        at = photons.position, photons.normal
        surfaces = () if scene is None else scene.surfaces
        self._immersion = Immersion.of(surfaces, *at, n_threads)
        label = self._immersion.labels(*at)
        self._means: dict[int, Densities] = {}
        radii = []
        for one in np.unique(label).tolist() or [0]:
            some = photons.subset(np.flatnonzero(label == one)) if label.any() else photons
            surface = None
            if scene is not None:
                lit, part = lit_objects(scene, some), self._immersion.part(one)
                surface = Surface(scene, thread_count(n_threads), lit, part)
            self._means[one], radius = _means(some, settings, surface, n_threads)
            radii += [] if radius is None else [radius]
        settings = settings or default_settings(_n_paths(photons))
        self.settings = replace(settings, gather_radius=max(radii, default=None))

    @property
    def reach(self) -> float:
        """Largest distance, m, of the photons in an estimate."""
        radius = self.settings.gather_radius
        return 0.0 if radius is None else radius

    def __call__(
        self, points: ArrayLike, normals: ArrayLike, *, footprint: ArrayLike | None = None
    ) -> Floats:
        """Irradiance (m, 3) at points on surfaces, or its means over footprints, W/m².

        Arguments and errors are those of `Field`. Zero where no photon is within the gather radius.
        """
        points, normals = check_points(points, normals)
        edges = check_footprint(footprint, len(points))
        label = self._immersion.labels(points, normals)
        densities = np.zeros((len(points), 4))
        for one, means in self._means.items():
            rows = np.flatnonzero(label == one)
            of_rows = None if edges is None else edges[rows]
            densities[rows] = means(points[rows], normals[rows], footprint=of_rows)
        total = densities[:, 3:]
        irradiance = np.zeros((len(densities), 3))
        return np.divide(densities[:, :3], total, out=irradiance, where=total > 0.0)


def _means(
    photons: PhotonMap,
    settings: GatherSettings | None,
    surface: Surface | None,
    n_threads: int | None,
) -> tuple[Densities, float | None]:
    """Means of the estimates at a share of the photons, and the gather radius of these, m."""
    if len(photons) and not np.ptp(photons.position, axis=0).any():
        # From one point no radius follows, and such light is next to none.
        photons = photons.subset([])
    settings = settings or default_settings(_n_paths(photons))
    field = IrradianceField(photons, settings, n_threads=n_threads)
    field.surface = surface
    some = photons.subset(np.arange(0, len(photons), max(settings.k // _ESTIMATES, 1)))
    at = some.position, some.normal
    carried = np.column_stack([photons.flux, np.ones(len(photons))])
    values = field.densities(carried)(*at)
    area = 1.0 / values[:, 3:]
    values[:, 3] = 1.0
    radius = field.settings.gather_radius
    nearest = GatherSettings(k=_NEAREST, gather_radius=radius)
    means = IrradianceField(some.replace(well_spaced=False), nearest, n_threads=n_threads)
    return means.densities(area * values), radius


def _n_paths(photons: PhotonMap) -> int:
    return round(len(photons) / photons.photons_per_path)


def widening_settings(n_photons: int) -> GatherSettings:
    """Settings whose k goes with the root of a number of photons, the default of a million.

    Noise and bias then both fall with each photon: n^-¼ and, on smooth light, n^-½.
    """
    return GatherSettings(k=max(round(_K * (n_photons / _USUAL) ** 0.5), _SMALLEST_K))


def default_settings(n_photons: int) -> GatherSettings:
    """Settings of estimates of indirect light from a number of photons."""
    k = _K_OF_MANY if n_photons >= _MANY else _K
    return GatherSettings(k=max(min(k, n_photons // _SHARE), _SMALLEST_K))
