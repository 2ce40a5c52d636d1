"""Structure around each photon: PCA, noise attenuation, constraint basis (SJ13 §4.2–4.3)."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._ext.relaxation import structure as _structure
from .._ext.relaxation.structure import (
    anisotropy_to_gradient,
    constraint,
    isotropic_mean,
    isotropic_sd,
    noise_attenuation,
)
from .._util import validation
from .._util.frozen import set_field
from .._util.parallel import thread_count
from .._util.progress import Progress, Reporter
from .._util.validation import Floats
from ..photons.axes import MAX_NORMAL_CHORD
from ..photons.group_trees import group_tree
from ..photons.neighbourhoods import Group, neighbour_groups
from ..photons.photon_map import PhotonMap

__all__ = [
    "MAX_NORMAL_CHORD",
    "Structure",
    "StructureSettings",
    "anisotropy_to_gradient",
    "constraint",
    "detect_structure",
    "emitter_range",
    "empty_columns",
    "isotropic_mean",
    "isotropic_sd",
    "noise_attenuation",
    "principal_components",
    "take_rows",
]


@dataclass(frozen=True)
class StructureSettings:
    """Neighbours and ranges that structure is detected in.

    Attributes
    ----------
    k : int
        Photons in a neighbourhood, the photon itself among them (K_c = 50, SJ13 §5).
    range_scale : float
        Size of the range allowed over the emitter coordinates (β = 3, SJ13 Eq. 1).
    reach_scale : float
        Largest radius of a neighbourhood in range, in units of the radius that holds k photons of
        any sheet. SJ13 has no such limit (infinity); but photons of a sheet of less than a
        ninth of the light around them have their neighbours so far away that, moved by these,
        they flow down its slopes, while their own noise is hidden by the other sheets'.
    """

    k: int = 50
    range_scale: float = 3.0
    reach_scale: float = 3.0

    def __post_init__(self) -> None:
        k = validation.count(self.k, "StructureSettings.k", low=4, high=validation.MAX_NEIGHBOURS)
        set_field(self, "k", k)
        scale = validation.positive(self.range_scale, "StructureSettings.range_scale")
        set_field(self, "range_scale", scale)
        reach = validation.positive(
            self.reach_scale, "StructureSettings.reach_scale", allow_inf=True
        )
        set_field(self, "reach_scale", reach)


@dataclass(frozen=True, eq=False)
class Structure:
    """Structure of a photon map; row i belongs to photon i.

    Attributes
    ----------
    eigenvalues : (n, 2) float array
        Variances of the neighbourhood in the tangent plane over radius², larger first; 1/4 both
        where photons are evenly spread. Zero where fewer than four photons are in range or all
        are at one point.
    constraint : (n,) float array
        3π/4·M·Φ in [0, 1]: 0 leaves the photon free, 1 keeps it from moving along ``basis[:, 1]``
        (SJ13 Eq. 7). Zero where no structure is found.
    basis : (n, 2, 3) float array
        Unit vectors in the tangent plane: the direction in which the photon is free, along the
        structure, and the one in which it is constrained, across it.
    radius : (n,) float array
        Distance to the farthest neighbour, m.
    n_found : (n,) int32 array
        Photons in the neighbourhood; fewer than asked for where the range holds fewer.
    emitter_range : (n,) float array or None
        Radius allowed over the emitter coordinates (SJ13 Eq. 1); None in a map without them.
    reach : (n,) float array or None
        Radius allowed in space while that range is kept to, m; None in a map without one.

    Raises
    ------
    TypeError, ValueError
        If shapes differ, values are not finite or a constraint is not in [0, 1].
    """

    eigenvalues: Floats
    constraint: Floats
    basis: Floats
    radius: Floats
    n_found: NDArray[np.int32]
    emitter_range: Floats | None
    reach: Floats | None = None

    def __post_init__(self) -> None:
        n = len(self.constraint)
        shapes = {"eigenvalues": (n, 2), "constraint": (n,), "basis": (n, 2, 3), "radius": (n,)}
        for name, shape in shapes.items():
            set_field(self, name, validation.float_array(getattr(self, name), name, shape))
        for name in ("emitter_range", "reach"):
            if getattr(self, name) is not None:
                array = validation.float_array(getattr(self, name), name, (n,), finite=False)
                set_field(self, name, array)
        n_found = validation.int_array(self.n_found, "n_found", (n,), np.int32)
        set_field(self, "n_found", n_found)
        if n and not (self.constraint.min() >= 0.0 and self.constraint.max() <= 1.0):
            raise ValueError("constraint should lie in [0, 1]")
        if n and n_found.min() < 1:
            raise ValueError("n_found should count the photon itself, but is below 1 somewhere")

    def __len__(self) -> int:
        return len(self.constraint)

    def subset(self, rows: validation.Rows) -> Structure:
        """Structure of the photons of some rows."""
        columns: dict[str, Any] = {
            field.name: take_rows(getattr(self, field.name), rows) for field in fields(self)
        }
        return Structure(**columns)


def detect_structure(
    photons: PhotonMap,
    settings: StructureSettings | None = None,
    *,
    n_threads: int | None = None,
    progress: Progress | None = None,
) -> Structure:
    """Constraint of each photon's moves, and its direction, from the photons around it.

    Each photon's k nearest photons in space are gathered among those of its emitter whose emitter
    coordinates lie within a range of its own; the principal components of their positions in its
    tangent plane separate edges and filaments from evenly spread light (SJ13 §4.2–4.3, Algorithm 1
    lines 2–9).

    Parameters
    ----------
    photons : PhotonMap
        Photons, n of them. Without emitter coordinates the search is limited by space alone.
    settings : StructureSettings, optional
        Defaults are the paper's.
    n_threads : int, optional
        Threads; all available by default. The result does not depend on it.
    progress : callable, optional
        Called as ``progress("structure", done, n)``.

    Returns
    -------
    Structure
        One row a photon.

    Raises
    ------
    ValueError
        If the map has emitter coordinates but no emitter density, or the other way round.
    """
    settings = settings or StructureSettings()
    threads = thread_count(n_threads)
    report = Reporter(progress, "structure", len(photons))
    reach = None if photons.emitter_coords is None else np.empty(len(photons))
    detection = StructureDetection(photons, settings, threads, report, reach)
    for group in neighbour_groups(photons, threads):
        detection.fill(group, coincident=detection.fill_reach(group))
    return Structure(**detection.found, emitter_range=detection.ranges, reach=detection.reach)


def emitter_range(photons: PhotonMap, settings: StructureSettings) -> Floats | None:
    """Range r_θφ = β √(K_c / (π ρ_θφ)) (n,) of each photon (SJ13 Eq. 1), None without coordinates.

    In the chart of `emitter_coords`: m on an emitter plane; for points, the length of the chord
    between unit vectors, whose ball cuts a cap of exactly π r² from the sphere of directions.

    Raises
    ------
    ValueError
        If one of coordinates and density is missing, or a density is zero.
    """
    coords, density = photons.emitter_coords, photons.emitter_density
    if (coords is None) != (density is None):
        given, missing = ("emitter_coords", "emitter_density")[:: 1 if density is None else -1]
        raise ValueError(
            f"photons have {given} but no {missing}: give both, or neither to work in space alone"
        )
    return None if density is None else ranges_of(density, settings)


def ranges_of(density: Floats, settings: StructureSettings) -> Floats:
    """Range (n,) of photons by their emitter density (n,); see `emitter_range`."""
    if (density <= 0.0).any():
        raise ValueError(f"emitter_density should be positive, but its least is {density.min()}")
    # Of the least densities the range is infinite: all coordinates are in it.
    with np.errstate(over="ignore"):
        return settings.range_scale * np.sqrt(settings.k / (np.pi * density))


def principal_components(offsets: Floats) -> tuple[Floats, Floats]:
    """Principal components of sets of points in a plane (SJ13 §4.3.1).

    Parameters
    ----------
    offsets : (n, k, 2) array_like
        n sets of k points.

    Returns
    -------
    eigenvalues : (n, 2) float array
        Of the covariance about the mean with divisor k, larger first.
    vectors : (n, 2) float array
        Unit eigenvector of the larger; the other is perpendicular.

    Raises
    ------
    TypeError, ValueError
        If `offsets` is not a finite (n, k, 2) array with k >= 1.
    """
    array = validation.float_array(offsets, "offsets", (None, None, 2))
    validation.count(array.shape[1], "k, the second axis of offsets,")
    return _structure.principal_components(array, thread_count(None))


def take_rows(array: NDArray | None, rows: validation.Rows) -> NDArray | None:
    """Some rows of a column; None for a column that the structure does not have."""
    return None if array is None else array[rows]


def empty_columns(n: int) -> dict[str, Any]:
    """Columns of a `Structure` that kernels fill: n rows, not initialised."""
    return {
        "eigenvalues": np.empty((n, 2)),
        "constraint": np.empty(n),
        "basis": np.empty((n, 2, 3)),
        "radius": np.empty(n),
        "n_found": np.empty(n, dtype=np.int32),
    }


class StructureDetection:
    """Structure of all photons, filled one group of neighbours after the other.

    `reach` (n,) is None for a map without emitter coordinates. With `k_inner` there is a column
    `inner`, a bound of the distance to the nearest so many photons in range.
    """

    def __init__(
        self,
        photons: PhotonMap,
        settings: StructureSettings,
        n_threads: int,
        report: Reporter,
        reach: Floats | None,
        *,
        k_inner: int = 0,
    ) -> None:
        self._photons = photons
        self._settings = settings
        self._n_threads = n_threads
        self._report = report
        self.ranges = emitter_range(photons, settings)
        self.reach = reach
        self.found = empty_columns(len(photons))
        self._k_inner = k_inner
        if k_inner:
            self.found["inner"] = np.empty(len(photons))

    def fill(self, group: Group, *, coincident: bool) -> int:
        """Detect the structure of a group; photons at rest are alone in theirs.

        `coincident` says that some are at the same point; returns the number of those that others
        stand for.
        """
        photons, n_threads = self._photons, self._n_threads
        of_group = group_tree(
            photons.position,
            photons.normal,
            photons.emitter_coords,
            self.ranges,
            group=group,
            coincident=coincident,
            n_threads=n_threads,
        )
        inputs = _structure.StructureInputs(
            rows=of_group.rows,
            normal=photons.normal,
            range_radius=of_group.ranges,
            reach=self.reach,
        )
        k = 1 if group.at_rest else self._settings.k
        tree = of_group.tree
        for first, end in self._report.chunks(len(tree)):
            _structure.detect(
                *(tree.kernel, first, end, inputs, self.found),
                k=k,
                k_inner=self._k_inner,
                n_threads=n_threads,
            )
        of_group.repeat(*self.found.values())
        if of_group.n_merged:
            self._report.advance(of_group.n_merged)
        return of_group.n_merged

    def fill_reach(self, group: Group, *, of_fewer: bool = True) -> bool:
        """Set the rows of a group: `reach_scale` times the radius of k photons of any sheet.

        Where there are fewer it is that of the farthest, or infinite without `of_fewer`. True if
        some are at the same point; without a reach nothing is done.
        """
        if self.reach is None:
            return False
        photons, settings, n_threads = self._photons, self._settings, self._n_threads
        of_group = group_tree(photons.position, photons.normal, group=group, n_threads=n_threads)
        tree = of_group.tree
        facing = None if of_group.ranges is None else MAX_NORMAL_CHORD
        radius = tree.farthest(
            settings.k, range_radius=facing, of_fewer=of_fewer, n_threads=n_threads
        )
        with np.errstate(invalid="ignore"):
            radius *= settings.reach_scale
        # An open reach stays open where photons coincide.
        radius[np.isnan(radius)] = np.inf
        self.reach[of_group.rows] = radius[np.asarray(tree.kernel.ids)]
        of_group.repeat(self.reach)
        return of_group.n_merged > 0
