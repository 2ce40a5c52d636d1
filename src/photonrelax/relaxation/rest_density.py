"""Density in which photons are to rest, from the map of emitter coordinates to positions.

Repulsion has no rest state but uniform density, so that slopes of light flow away while noise is
smoothed. But every photon of a sheet of light is the image of an emitter coordinate u under a
smooth map x(u), and photons are even in u: the density of the light in space, its slopes and its
edges are known without their noise. A quadratic map is fitted around every photon; a lattice that
is even in u, laid through it, exerts the force that photons without noise would exert (SJ13 Eq. 8).
In a density ρ(1 + g·x) that is −c g r² for points within r, and g is what is kept. Relaxation adds
c g r², r the present radius, so that the rest state is that density. The derivation is in
docs/methods/mapped.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._ext.photons.normals import all_nearly_equal
from .._ext.relaxation import rest_density as _rest_density
from .._util import validation
from .._util.frozen import set_field
from .._util.parallel import thread_count
from .._util.progress import Progress, Reporter
from .._util.validation import Floats, Rows
from ..photons.axes import MAX_NORMAL_CHORD, hstack_rows, leaf_rows
from ..photons.neighbourhoods import Group, neighbour_groups
from ..photons.photon_map import PhotonMap
from ..spatial.kdtree import KDTree

# Force of the lattice's nearest 32 in units of slope times squared radius, measured on exponential
# densities; see docs/methods/mapped.md.
LATTICE_FORCE = 0.0778
# Largest distances from where photons started, in units of the noise and the radius of k photons:
# noise is gone when photons have gone so far, after which slopes drift; where no map fits, moves
# are as likely wrong. At the most half the radius: there g is no longer the slope.
_LIMIT_OF_NOISE, _LIMIT_WITHOUT_MAP, _LARGEST_LIMIT = 7.0, 2.0, 0.5
# Of sheets less than two thirds of whose maps fit, facets say, the limits are less, as the square:
# what is left of them is as likely wrong too.
_SMOOTH = 1.5
# The same where there are no maps, of a thousand such photons and at the most: among few, most of
# what differs is light, not noise.
_LIMIT_OF_THOUSAND, _LIMIT_OF_MANY = 0.1, 0.3
# Noise of independent photons, where that of a sheet is not known.
_NOISE_OF_INDEPENDENT = 0.075
# Photons of a neighbourhood are sorted in one chunk.
_MOST_NEIGHBOURS = 64
# Coefficients of a quadratic map.
_TERMS = 6


@dataclass(frozen=True)
class RestDensitySettings:
    """Photons that the map from emitter coordinates to positions is fitted to.

    Attributes
    ----------
    k : int
        Photons in a neighbourhood over the emitter coordinates, the photon itself among them; they
        show where a sheet ends.
    n_fitted : int
        The nearest of them, to which the map is fitted.
    max_residual : float
        Largest root mean square distance of photons from their map, in units of the radius of 16
        photons; where it is larger no slope is prescribed, and photons hardly move.
    """

    k: int = 24
    n_fitted: int = 16
    max_residual: float = 0.1

    def __post_init__(self) -> None:
        k = validation.count(self.k, "RestDensitySettings.k", low=_TERMS, high=_MOST_NEIGHBOURS)
        set_field(self, "k", k)
        name = "RestDensitySettings.n_fitted"
        set_field(self, "n_fitted", validation.count(self.n_fitted, name, low=_TERMS, high=k))
        name = "RestDensitySettings.max_residual"
        set_field(self, "max_residual", validation.positive(self.max_residual, name))


@dataclass(frozen=True, eq=False)
class RestDensity:
    """Density in which the photons of a map are to rest; row i belongs to photon i.

    Attributes
    ----------
    slope : (n, 3) float array
        Relative slope g = ∇ρ/ρ of the density prescribed, in the tangent plane, 1/m; zero where
        none is.
    residual : (n,) float array
        Root mean square distance of the photons around one from their map, in units of the radius
        of 16 photons; infinite where there is no map.
    limit : (n,) float array
        Largest distance of a photon from where it started, in units of the radius of k photons;
        infinite for photons that relax as without a density.

    Raises
    ------
    TypeError, ValueError
        If shapes differ, a slope is not finite, or a residual or limit negative.
    """

    slope: Floats
    residual: Floats
    limit: Floats

    def __post_init__(self) -> None:
        slope = validation.float_array(self.slope, "slope", (None, 3))
        set_field(self, "slope", slope)
        for name in ("residual", "limit"):
            values = validation.distances(getattr(self, name), name, slope.shape[:1])
            set_field(self, name, values)

    def __len__(self) -> int:
        return len(self.slope)

    @property
    def has_map(self) -> NDArray[np.bool_]:
        """(n,) bool array, true for photons around which there is a map."""
        return np.isfinite(self.residual)


def rest_density(
    photons: PhotonMap,
    settings: RestDensitySettings | None = None,
    *,
    n_threads: int | None = None,
    progress: Progress | None = None,
) -> RestDensity:
    """Density in which photons are to rest, from where they left their emitter.

    Parameters
    ----------
    photons : PhotonMap
        Photons, n of them. No density is prescribed for those without emitter coordinates, of
        extended emitters, in pools of several emitters, and in sheets of fewer than k photons of
        one path signature; the last two are limited all the same.
    settings : RestDensitySettings, optional
        Numbers of photons, and the residual allowed.
    n_threads : int, optional
        Threads; all available by default. The result does not depend on it.
    progress : callable, optional
        Called as ``progress("rest density", done, n)``.

    Returns
    -------
    RestDensity
        One row a photon.
    """
    settings = settings or RestDensitySettings()
    threads = thread_count(n_threads)
    report = Reporter(progress, "rest density", len(photons))
    slope, residual = np.zeros((len(photons), 3)), np.full(len(photons), np.inf)
    limit = residual.copy()
    if photons.emitter_coords is None:
        report.advance(len(photons))
        return RestDensity(slope, residual, limit)
    extended = photons.is_of_extended
    for group in neighbour_groups(photons, threads):
        # Coordinates do not tell where photons of an extended emitter are.
        of_extended = extended[group.rows].any()
        if group.mixed or group.at_rest or of_extended:
            report.advance(len(residual[group.rows]))
        else:
            slope[group.rows], residual[group.rows], limit[group.rows] = _of_group(
                photons, photons.emitter_coords, group, settings, n_threads=threads, report=report
            )
        if of_extended:
            continue
        unmapped = ~np.isfinite(residual[group.rows])
        limit[group.rows] = np.where(unmapped, limit_without(unmapped.sum()), limit[group.rows])
    return RestDensity(slope, residual, limit)


def limit_without(n: int) -> float:
    """Limit of n photons of a group that have no map.

    In steps: what moves in one corner of a scene should not move photons in another.
    """
    number = 2.0 ** np.floor(np.log2(max(n, 1)))
    return min(_LIMIT_OF_THOUSAND * float(np.sqrt(number / 1000.0)), _LIMIT_OF_MANY)


def _of_group(
    photons: PhotonMap,
    coords: Floats,
    group: Group,
    settings: RestDensitySettings,
    *,
    n_threads: int,
    report: Reporter,
) -> tuple[Floats, Floats, Floats]:
    """Slopes, residuals and limits of a group whose emitter coordinates compare."""
    sheet = _sheets(photons, group)
    columns = [photons.position, coords, photons.normal]
    slope, residual, noise = prescribed(
        columns, sheet, settings, rows=group.rows, n_threads=n_threads, report=report
    )
    n_sheets = int(sheet.max(initial=-1)) + 1
    sheets = SheetNoise(
        medians_of_sheets(noise_keys(noise, sheet), n_sheets),
        np.bincount(sheet, residual <= settings.max_residual, minlength=n_sheets)
        / np.maximum(np.bincount(sheet, minlength=n_sheets), 1),
    )
    return slope, residual, sheets.limits(residual, sheet, settings)


def prescribed(
    columns: list[Floats],
    sheet: NDArray[np.intp],
    settings: RestDensitySettings,
    *,
    rows: Rows = slice(None),
    reached: Floats | None = None,
    n_threads: int,
    report: Reporter,
) -> tuple[Floats, Floats, Floats]:
    """Slopes (m, 3), residuals and noise (m,) of the photons of some rows.

    `columns` (n, …) are positions, emitter coordinates and normals, `sheet` (m,) the numbers of
    sheets. Distances to the farthest of k neighbours are written to `reached` (m,).
    """
    _, coords, normal = columns
    tree = _emitter_tree(coords[rows], normal[rows], sheet, n_threads)
    rows = leaf_rows(tree, rows)
    # Side by side: the photons around one are read in no order.
    records = hstack_rows(columns, [1.0] * len(columns), rows, n_threads)
    places = np.arange(len(tree))
    slope = np.empty((len(tree), 3))
    residual, noise = np.empty((2, len(tree)))
    for first, end in report.chunks(len(tree)):
        _rest_density.prescribe(
            *(tree.kernel, first, end),
            records=records,
            places=places,
            k=settings.k,
            n_fitted=settings.n_fitted,
            max_residual=settings.max_residual,
            lattice_force=LATTICE_FORCE,
            slope=slope,
            residual=residual,
            noise=noise,
            reached=reached,
            n_threads=n_threads,
        )
    return slope, residual, noise


class SheetNoise(NamedTuple):
    """Median noise of each sheet (s,), and share (s,) of its photons whose map fits."""

    median: Floats
    share: Floats

    def limits(
        self, residual: Floats, sheet: NDArray[np.intp], settings: RestDensitySettings
    ) -> Floats:
        """Limits (m,) of photons with maps, by their residuals and sheets."""
        fits = residual <= settings.max_residual
        factor = np.where(fits, _LIMIT_OF_NOISE, _LIMIT_WITHOUT_MAP)
        smoothness = np.minimum((_SMOOTH * self.share[sheet]) ** 2, 1.0)
        return smoothness * np.minimum(factor * self.median[sheet], _LARGEST_LIMIT)


def noise_keys(noise: Floats, sheet: NDArray[np.intp]) -> NDArray[np.int64]:
    """Keys that sort by sheet, then by noise, of the photons where it is known.

    Single numbers sort fastest: the sheet, and the bits of its noise, which sort as it does.
    """
    known = np.isfinite(noise)
    bits = noise[known].astype(np.float32).view(np.uint32)
    return sheet[known].astype(np.int64) << 32 | bits


def medians_of_sheets(keys: NDArray[np.int64], n_sheets: int) -> Floats:
    """Median noise of each sheet, from its keys, which are sorted."""
    keys.sort()
    count = np.diff(np.searchsorted(keys, np.arange(n_sheets + 1, dtype=np.int64) << 32))
    middle = (np.cumsum(count) - count + count // 2)[count > 0]
    medians = np.full(n_sheets, _NOISE_OF_INDEPENDENT)
    medians[count > 0] = keys[middle].astype(np.uint32).view(np.float32)
    return medians


def _sheets(photons: PhotonMap, group: Group) -> NDArray[np.intp]:
    """Numbers (m,) of the sheets of a group's photons: their path signatures and labels."""
    columns: list[NDArray[Any]] = []
    if photons.path_signature is not None:
        columns.append(photons.path_signature[group.rows])
    if group.labels is not None:
        columns.append(group.labels[group.rows, 0])
    sheet = np.zeros(len(photons.position[group.rows]), dtype=np.intp)
    for column in columns:
        # Faster than an inverse, which sorts rows.
        present = np.unique(column)
        sheet = sheet * len(present) + np.searchsorted(present, column)
    return sheet


def _emitter_tree(
    coords: Floats, normal: Floats, sheet: NDArray[np.intp], n_threads: int
) -> KDTree:
    """Tree over emitter coordinates.

    Photons within one on its range axes are of one sheet, on faces turned by no more than
    MAX_NORMAL_CHORD.
    """
    columns, scales = [coords], [1.0]
    if (sheet != sheet[:1]).any():
        columns.append(sheet[:, np.newaxis].astype(np.float64))
        scales.append(2.0)
    if not all_nearly_equal(normal, None):
        columns.append(normal)
        scales.append(1.0 / MAX_NORMAL_CHORD)
    points = hstack_rows(columns, scales, slice(None), n_threads)
    return KDTree(points, n_metric=coords.shape[1], n_threads=n_threads)
