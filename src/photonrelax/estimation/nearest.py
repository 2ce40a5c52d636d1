"""Irradiance from the k nearest photons (Jensen's estimate; SJ13 §5)."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._ext.estimation import footprint as _footprint
from .._ext.estimation import nearest as _nearest
from .._ext.estimation import refinement as _refinement
from .._util import validation
from .._util.frozen import set_field
from .._util.parallel import thread_count
from .._util.validation import Floats
from ..photons.axes import normal_range
from ..photons.photon_map import PhotonMap
from ..photons.photon_trees import PhotonTrees
from ..relaxation.structure import Structure
from .field import Densities, Points, Rows, TreeField
from .footprint import BIAS_DECAY, kernel_integrals, number_within
from .kernels import (
    JUST_SHORT,
    KERNELS,
    WELL_SPACED_BIAS,
    Number,
    automatic_gather_radius,
    kth_distance,
    well_spaced_mean,
)
from .refinement import REFINEMENTS
from .surface import Surface


@dataclass(frozen=True)
class GatherSettings:
    """Number of photons in an estimate, kernel and gather radius.

    Attributes
    ----------
    k : int
        Photons gathered (K = 15, SJ13 §5); the bandwidth is the distance to the k-th. With a
        refinement it is their largest number, and has to be given: 200, say.
    kernel : {"epanechnikov", "cone", "constant", "gaussian"}
        Profile of estimates at points; those over footprints have the Gaussian's. Each is
        normalised so that a uniform field returns its own value; from well-spaced photons within
        0.5 % for k of 15 and more.
    gather_radius : float, optional
        Largest distance, m, from which photons are gathered. Where it holds fewer than k it is the
        bandwidth, so that black regions stay black. Photons at the same point that face the same
        way count as one with the flux of all. By default it is the `automatic_gather_radius` of the
        map: the radius within which 95 % of the photons, and 5 % of the area they light, have their
        k-th nearest. Infinite for no limit. With a refinement it limits the first k_min photons,
        and holds twice as many by default; k are gathered from √(k / k_min) times as far.
    refinement : {"none", "differential-checking", "bias-compensation"}
        Rule by which the number of photons adapts to the light around a point; see
        `photonrelax.estimation.refinement`.
    k_min : int
        Least number of photons gathered with a refinement; not read without.
    """

    k: int = 15
    kernel: str = "epanechnikov"
    gather_radius: float | None = None
    refinement: str = "none"
    k_min: int = 15

    def __post_init__(self) -> None:
        validation.check_choice(self.kernel, "GatherSettings.kernel", KERNELS)
        validation.check_choice(self.refinement, "GatherSettings.refinement", REFINEMENTS)
        for name in ("k", "k_min"):
            number = getattr(self, name)
            number = validation.count(
                number, f"GatherSettings.{name}", low=2, high=validation.MAX_NEIGHBOURS
            )
            set_field(self, name, number)
        if self.refinement != "none" and self.k <= self.k_min:
            raise ValueError(
                f"GatherSettings.k should be more than k_min, {self.k_min}, with a refinement, "
                f"which chooses between the two, but is {self.k}: try k=200"
            )
        if self.gather_radius is not None:
            radius = validation.radius(
                self.gather_radius, "GatherSettings.gather_radius", allow_inf=True
            )
            set_field(self, "gather_radius", radius)

    @property
    def k_reached(self) -> int:
        """Number of photons within the automatic gather radius: with a refinement, 2 k_min."""
        return self.k if self.refinement == "none" else 2 * self.k_min


class IrradianceField(TreeField):
    """Irradiance from the k nearest photons (Jensen's estimate).

    Parameters
    ----------
    photons : PhotonMap
        Unrelaxed or relaxed photons.
    settings : GatherSettings, optional
    structure : Structure, optional
        Structure that these photons were relaxed by.
    seconds, used : dict, optional
        Duration and settings of each stage of their preparation.
    n_threads : int, optional
        Threads; all available by default. Results do not depend on it.

    Attributes
    ----------
    photons, settings, structure, seconds, used
        As given; `settings.gather_radius` is the radius in use, None for an empty map, and k and
        k_min count the photons of all wavelengths of a path.

    Raises
    ------
    ValueError
        If the gather radius is left open and all photons are at one point.
    """

    def __init__(
        self,
        photons: PhotonMap,
        settings: GatherSettings | None = None,
        *,
        structure: Structure | None = None,
        seconds: dict[str, float] | None = None,
        used: dict[str, dict[str, Any]] | None = None,
        n_threads: int | None = None,
    ) -> None:
        settings = settings or GatherSettings()
        settings = replace(
            settings, k=photons.counted(settings.k), k_min=photons.counted(settings.k_min)
        )
        self.photons = photons
        self.structure = structure
        self.seconds = seconds or {}
        self._n_threads = thread_count(n_threads)
        self._trees = PhotonTrees(photons, self._n_threads)
        if settings.gather_radius is None and len(photons):
            tree = self._trees.whole()
            radius = automatic_gather_radius(tree, settings.k_reached, n_threads=self._n_threads)
            settings = replace(settings, gather_radius=radius)
            del tree
        self._trees.build()
        self.settings = settings
        self.used = {"gather": asdict(settings), **(used or {})}

    @property
    def has_footprints(self) -> bool:
        """Whether there are means over footprints: there are."""
        return True

    @cached_property
    def _mean_flux(self) -> dict[int, Floats]:
        return {}

    def _fill(self, out: Floats, values: Densities, points: Points) -> None:
        laid_out, tree = values.laid_out(points.part), self._trees.tree(points.part)[0]
        where = tree.kernel, laid_out.blocks, points.queries, points.rows, out
        options: dict[str, Any] = {
            "radius": self.reach,
            "range_radius": normal_range(tree),
            "n_threads": self._n_threads,
        }
        if points.footprint is not None and self.settings.refinement != "none":
            self._fill_refined(out, values, points, points.footprint)
        elif points.footprint is not None:
            options.update(normals=points.normals, sums=laid_out.node_sums)
            options["surface"] = self.edges
            rule = self._rule(self.settings.k)
            _footprint.gather(*where, footprint=points.footprint, **rule, **options)
        elif self.settings.refinement == "none":
            scale = 1.0 / self._uniform_mean
            _nearest.gather(*where, kth_scale=scale, **self._kernel, **options)
        else:
            flux = self._flux_of(points.part)
            bias = WELL_SPACED_BIAS[self.settings.kernel]
            bias = bias if self.photons.well_spaced else (0.0, 0.0)
            _refinement.gather(
                *where, flux=flux, bias=bias, **self._kernel, **self._refined, **options
            )
        if points.footprint is None and self.surface is not None:
            self._fill_near_edges(out, values, points, self.surface)

    def _fill_refined(
        self, out: Floats, values: Densities, points: Points, footprint: Floats
    ) -> None:
        """Write the means over the footprints of a chunk, by the numbers chosen at their points.

        Where none is chosen k_min photons set the radius, and the gather radius limits it.
        """
        laid_out, tree = values.laid_out(points.part), self._trees.tree(points.part)[0]
        queries, rows = points.queries[points.rows], np.arange(len(points.rows))
        found = np.zeros((len(rows), values.n_channels))
        number = self._numbers(points.part, queries)
        k, k_min, radius = self.settings.k, self.settings.k_min, self.reach
        rule, chosen = self._rule(np.maximum(number, k_min)), number > 0.0
        for some, largest in ((chosen, radius * np.sqrt(k / k_min)), (~chosen, radius)):
            _footprint.gather(
                *(tree.kernel, laid_out.blocks, queries, rows[some], found),
                normals=points.normals[points.rows],
                sums=laid_out.node_sums,
                footprint=footprint[points.rows],
                radius=largest,
                range_radius=normal_range(tree),
                surface=self.edges,
                n_threads=self._n_threads,
                **rule,
            )
        out[points.rows] = found

    def _numbers(self, part: int, queries: Floats) -> Floats:
        """Numbers of photons (m,) that a refinement chooses at points, zero for none."""
        tree, number = self._trees.tree(part)[0], np.zeros(len(queries))
        _refinement.write_numbers(
            *(tree.kernel, queries, np.arange(len(queries)), number),
            flux=self._flux_of(part),
            k=self.settings.k,
            radius=self.reach,
            range_radius=normal_range(tree),
            n_threads=self._n_threads,
            **self._refined,
        )
        return number

    def _fill_near_edges(
        self, out: Floats, values: Densities, points: Points, surface: Surface
    ) -> None:
        """Write the densities at those points of a chunk whose kernels may hang over an edge."""
        place = np.ascontiguousarray(points.queries[points.rows, :3])
        near = surface.near_edges(place, self._largest_reach)
        rows, place = points.rows[near], place[near]
        if not len(rows):
            return
        if self.settings.refinement != "none":
            # Over footprints of no extent, whose kernel is the Gaussian.
            sides = np.zeros(len(points.queries))
            self._fill_refined(out, values, points._replace(rows=rows), sides)
            return
        normals = validation.unit_vectors(
            points.normals[rows], "normals", place.shape, self._n_threads
        )
        radius, is_kth = self._radii(points, rows, (place, normals), surface)
        kernel = KERNELS[self.settings.kernel]
        densities = values.laid_out(points.part).within(points.queries[rows], radius, kernel)
        shares = surface.shares(place, normals, radius, kernel)
        densities /= (shares * np.where(is_kth, self._uniform_mean, 1.0))[:, np.newaxis]
        # Of an infinite disc with fewer photons the density is zero.
        densities[~is_kth & np.isinf(self.reach)] = 0.0
        out[rows] = densities

    def _radii(
        self, points: Points, rows: Rows, places: tuple[Floats, Floats], surface: Surface
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """Radii (r,) at rows of points, and whether they are those of the k-th photon.

        They are 1 m where they are not limited and there are fewer photons. `places` are positions
        and unit normals of the rows.
        """
        tree, k, threads = self._trees.tree(points.part)[0], self.settings.k, self._n_threads
        radius = kth_distance(tree, points.queries, rows, k, radius=self.reach, n_threads=threads)
        is_kth = (radius > 0.0) & np.isfinite(radius)
        rest = np.flatnonzero(~is_kth)
        if len(rest) and np.isfinite(self.reach):
            largest = surface.largest_radii(places[0][rest], places[1][rest], self.reach)
            further = kth_distance(
                tree, points.queries, rows[rest], k, radius=largest.max(), n_threads=threads
            )
            is_kth[rest] = (further > 0.0) & (further <= largest)
            radius[rest] = np.where(is_kth[rest], further, largest)
        radius = np.where(is_kth, JUST_SHORT * radius, radius)
        return np.where(np.isfinite(radius) & (radius > 0.0), radius, 1.0), is_kth

    @property
    def reach(self) -> float:
        """Gather radius, m."""
        radius = self.settings.gather_radius
        return np.inf if radius is None else radius

    @property
    def _largest_reach(self) -> float:
        """Largest distance of a photon; that of k photons where k_min are at the gather radius."""
        settings = self.settings
        far = 1.0 if settings.refinement == "none" else np.sqrt(settings.k / settings.k_min)
        return self.reach * float(far)

    @property
    def _kernel(self) -> dict[str, Any]:
        return {"k": self.settings.k, "kernel": KERNELS[self.settings.kernel]}

    @property
    def _uniform_mean(self) -> float:
        """Mean estimate of a uniform field, over its value."""
        if not self.photons.well_spaced:
            return 1.0
        # The wavelengths of a path lie together, or are spaced by themselves.
        k = max(round(self.settings.k / self.photons.photons_per_path), 2)
        return well_spaced_mean(k, self.settings.kernel)

    @property
    def _refined(self) -> dict[str, Any]:
        """Rule that chooses numbers of photons."""
        return {"k_min": self.settings.k_min, "rule": REFINEMENTS[self.settings.refinement]}

    def _rule(self, k: Number) -> dict[str, Any]:
        """Rule of means over footprints from k photons, or numbers (m,) of them.

        Its kernel is the Gaussian, whatever that at points is.
        """
        bias = 1.0 - well_spaced_mean(k, "gaussian") if self.photons.well_spaced else 0.0
        return {
            "number": number_within(k),
            "integrals": kernel_integrals(),
            "bias": (bias, BIAS_DECAY),
        }

    def _flux_of(self, part: int) -> Floats:
        """Mean flux of the photons of a tree, in its order and in a unit near the largest."""
        if part not in self._mean_flux:
            flux, _ = validation.in_units(self.photons.flux.mean(axis=1, keepdims=True))
            flux = self._trees.sums(flux, part)
            self._mean_flux[part] = flux[self._trees.tree(part)[1], 0]
        return self._mean_flux[part]


def estimate_irradiance(
    photons: PhotonMap,
    points: ArrayLike,
    normals: ArrayLike,
    settings: GatherSettings | None = None,
    *,
    n_threads: int | None = None,
) -> Floats:
    """Irradiance at points from the k nearest photons (Jensen's estimate).

    Parameters
    ----------
    photons : PhotonMap
        Photons, unrelaxed or relaxed.
    points, normals : (m, 3) array_like
        Points on surfaces, m, and the normals there. Photons on faces turned by more than 60°
        are not counted.
    settings : GatherSettings, optional
    n_threads : int, optional
        Threads; all available by default. The result does not depend on it.

    Returns
    -------
    (m, 3) float array
        W/m²; zero where no photon is within the gather radius, and everywhere for an empty map.

    Raises
    ------
    TypeError, ValueError
        If a shape is wrong, a value is not finite or a normal is zero.
    """
    return IrradianceField(photons, settings, n_threads=n_threads)(points, normals)
