r"""Progressive photon mapping: statistics of hit points, updated by passes of photons.

Hachisuka, Ogaki & Jensen 2008. The statistics of a hit point are the radius R of its disc, the
number N of photons kept, and their flux τ, not divided by the number emitted. When a pass has M
more photons, of flux Φ, within R, a share α of them is kept and the radius is reduced so that the
density stays the same (radius reduction)::

    N' = N + α M,   R'² = R² N' / (N + M),   τ' = (τ + Φ) R'² / R²
    E  = τ / (π R² · photons emitted in all)

Over passes i, R² ~ i^(α - 1) and N ~ i^α, so that both the bias of the estimate, ~ R², and its
variance, ~ 1/N, vanish: as i^(α - 1) and i^-α. The kernel is constant.

A pass adds Φ/πR² to the estimate, times the photons emitted in all, with its own R. Over a
footprint that is the mean over it, the density with radius R of `photonrelax.estimation.footprint`,
and M is the number of photons that a disc of radius R has at their mean density there. So R² goes
as at points, while the estimates converge to the mean over the footprint.

Radii may also go by the number of the pass alone (Knaus & Zwicker 2011), as they do on average
above: R² of pass i is that of pass 0 times the product of (k + α) / (k + 1) over k from 1 to i. So
a pass needs nothing of those before it; τ is then the sum of Φ / share, with the initial R.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from .._ext.estimation import footprint as _footprint
from .._ext.estimation import progressive as _kernel
from .._ext.spatial.radius import RadiusGather
from .._util import validation
from .._util.frozen import set_field
from .._util.parallel import thread_count
from .._util.validation import Floats
from ..photons.axes import normal_range
from ..photons.photon_map import PhotonMap
from ..photons.photon_trees import Order, PhotonTrees
from .field import TreeValues
from .footprint import Footprints, kernel_integrals, rule_radii
from .kernels import JUST_SHORT, KERNELS, automatic_gather_radius, kth_distance
from .surface import Surface

# Least initial radius as a fraction of the largest, also where k photons are at the hit point.
_LEAST_RADIUS = 1e-6


@dataclass(frozen=True)
class ProgressiveSettings:
    """Initial radius and radius reduction.

    Attributes
    ----------
    alpha : float
        Share of the photons in a disc that is kept, in (0, 1] (α = 0.7); with 1 radii stay.
    n_passes : int
        Passes that the photons of a map are split into. Not read with fresh photons in every pass.
    k : int
        Unless `radius` is given, the initial radius is just short of the k-th nearest photon of
        the first pass, but no larger than `automatic_gather_radius` of that pass.
        Estimates keep some k · n_passes^α photons.
    radius : float or "global", optional
        Initial radius of all discs, m. "global": initial radii are as by default, but shrink by the
        number of the pass alone, whatever it finds (Knaus & Zwicker 2011): passes can be made in
        any order, on any machine.

    Notes
    -----
    The defaults are a compromise: small discs keep filaments, large ones are less noisy where light
    is smooth or photons are random. docs/measurements/progressive.md has the errors measured, which
    ``python -m bench initial-radius`` prints.
    """

    alpha: float = 0.7
    n_passes: int = 8
    k: int = 5
    radius: float | Literal["global"] | None = None

    def __post_init__(self) -> None:
        alpha = validation.positive(self.alpha, "ProgressiveSettings.alpha")
        if alpha > 1.0:
            raise ValueError(f"ProgressiveSettings.alpha should be at most 1, but is {alpha}")
        set_field(self, "alpha", alpha)
        for name, low, high in (
            ("n_passes", 1, validation.MAX_REPEATS),
            ("k", 2, validation.MAX_NEIGHBOURS),
        ):
            number = getattr(self, name)
            number = validation.count(number, f"ProgressiveSettings.{name}", low=low, high=high)
            set_field(self, name, number)
        if isinstance(self.radius, str):
            validation.check_choice(self.radius, "ProgressiveSettings.radius", ("global",))
        elif self.radius is not None:
            radius = validation.radius(self.radius, "ProgressiveSettings.radius")
            set_field(self, "radius", radius)

    @property
    def is_global(self) -> bool:
        """True if radii shrink by the number of the pass alone."""
        return self.radius == "global"

    @property
    def initial_radius(self) -> float | None:
        """Initial radius of all discs, m; None if it follows from the first pass."""
        return None if isinstance(self.radius, str) else self.radius


def radius_share(number: int, alpha: float) -> float:
    """Squared radius of a pass over that of pass 0, whatever passes find.

    The product over k of (k + α) / (k + 1) (Knaus & Zwicker 2011), by arithmetic that is the
    same on all processors.
    """
    return math.prod((k + alpha) / (k + 1) for k in range(1, number + 1))


class HitPointStatistics:
    """Statistics of hit points, of which passes of photons are gathered in discs.

    Attributes
    ----------
    radius : (m,) float64
        Radii R of the discs, m; the initial ones if they shrink by the number of the pass alone.
    n : (m,) float64
        Numbers N of photons kept.
    tau : (m, c) float64
        Sums τ of their values, times the weights of their passes.
    weight : float
        Sum of the weights of all passes.
    n_passes : int
        Number of passes.
    """

    def __init__(
        self,
        radius: Floats,
        n_channels: int,
        *,
        alpha: float,
        n_threads: int,
        is_global: bool = False,
    ) -> None:
        self.radius = radius.copy()
        self.n = np.zeros(len(radius))
        self.tau = np.zeros((len(radius), n_channels))
        self.weight = 0.0
        self.n_passes = 0
        self._alpha = alpha
        self._n_threads = n_threads
        self._is_global = is_global

    @classmethod
    def from_columns(
        cls,
        radius: ArrayLike,
        n: ArrayLike,
        tau: ArrayLike,
        *,
        shape: tuple[int, int],
        **settings: Any,
    ) -> HitPointStatistics:
        """Statistics whose columns are given, before any pass; `shape` is that of `tau`.

        Settings are those of statistics.

        Raises
        ------
        TypeError, ValueError
            If a column is not of numbers, of another length, negative or not finite.
        """
        points = shape[:1]
        start = _radii(validation.float_array(radius, "radius", points), "radius", *points)
        statistics = cls(start, shape[1], **settings)
        statistics.n = validation.not_negative(n, "n", points)
        statistics.tau = validation.not_negative(tau, "tau", shape)
        return statistics

    def update(
        self,
        counts: Floats,
        sums: Floats,
        weight: float,
        least_radius: Floats | None = None,
    ) -> None:
        """Add the photons of a pass, numbers (m,) and sums (m, c); see `PhotonPass.within`.

        They are those within `pass_radius`.
        """
        if self._is_global:
            self.n += counts
            self.tau += weight / radius_share(self.n_passes, self._alpha) * sums
        else:
            _kernel.update(
                self.n,
                self.tau,
                self.radius,
                counts=counts,
                sums=sums,
                least=least_radius,
                alpha=self._alpha,
                weight=weight,
                n_threads=self._n_threads,
            )
        self.weight += weight
        self.n_passes += 1

    def pass_radius(self, number: int | None = None) -> Floats:
        """Radii (m,) of the discs of the next pass, m; if they are global, of any pass."""
        if not self._is_global:
            return self.radius
        share = radius_share(self.n_passes if number is None else number, self._alpha)
        return np.sqrt(share) * self.radius

    def copy(self) -> HitPointStatistics:
        """A copy that is updated independently."""
        c = HitPointStatistics(
            self.radius,
            self.tau.shape[1],
            alpha=self._alpha,
            n_threads=self._n_threads,
            is_global=self._is_global,
        )
        c.n, c.tau = self.n.copy(), self.tau.copy()
        c.weight, c.n_passes = self.weight, self.n_passes
        return c

    def densities(self) -> Floats:
        """Densities (m, c), per m²; zero before the first pass."""
        if self.weight == 0.0:
            return np.zeros_like(self.tau)
        return self.tau / (np.pi * self.weight * self.radius**2)[:, np.newaxis]


class ProgressiveStatistics(HitPointStatistics):
    """Hit points with their statistics; memory does not grow with the passes.

    Parameters
    ----------
    positions, normals : (m, 3) array_like
        Points on surfaces, m, and directions of any length. Photons on faces turned by more than
        60° are not counted.
    radius : float or (m,) array_like
        Initial radius, m; see `initial_radius`.
    alpha : float
        Share of the photons in a disc that is kept.
    n_threads : int, optional
        Threads; all available by default. Results do not depend on it.

    Raises
    ------
    TypeError, ValueError
        If a shape is wrong, a value not finite, `alpha` not positive, or a radius not from 1e-150
        to 1e150.
    """

    def __init__(
        self,
        positions: ArrayLike,
        normals: ArrayLike,
        radius: ArrayLike,
        *,
        alpha: float = 0.7,
        n_threads: int | None = None,
    ) -> None:
        self.positions = validation.float_array(positions, "positions", (None, 3))
        m = len(self.positions)
        threads = thread_count(n_threads)
        self.normals = validation.unit_vectors(normals, "normals", (m, 3), threads)
        settings = ProgressiveSettings(alpha=alpha)
        start = _radii(radius, "radius", m)
        super().__init__(start, 3, alpha=settings.alpha, n_threads=threads)

    def add(
        self,
        photons: PhotonMap,
        *,
        weight: float | None = None,
        least_radius: ArrayLike | None = None,
    ) -> None:
        """Add a pass of photons, and reduce the radii.

        Parameters
        ----------
        photons : PhotonMap
            With flux in W, divided by the number emitted in this pass, as in traced maps.
        weight : float, optional
            Weight of this pass: by default its `n_emitted`, so that all photons emitted count
            alike whatever the sizes of passes.
        least_radius : float or (m,) array_like, optional
            Radii are not reduced below it, m; where they stay as they are all photons are kept.

        Raises
        ------
        ValueError
            If the map has no `n_emitted`, and no weight is given.
        """
        least = None
        if least_radius is not None:
            least = _radii(least_radius, "least_radius", len(self.n))
        weight = pass_weight(photons) if weight is None else validation.positive(weight, "weight")
        trees = PhotonTrees(photons, self._n_threads)
        found = PhotonPass(trees, photons.flux, self._n_threads).within(
            (self.positions, self.normals), self.radius
        )
        self.update(*found, weight, least)

    def irradiance(self) -> Floats:
        """Irradiance (m, 3) from all passes so far, W/m²."""
        return self.densities()


def pass_weight(photons: PhotonMap) -> float:
    """Number of photons emitted in a pass; raises ValueError if that is not known."""
    if not photons.n_emitted:
        raise ValueError(
            "photons.n_emitted should say how many photons were emitted in the pass, or weight "
            f"how much it counts, but is {photons.n_emitted}"
        )
    return float(photons.n_emitted)


class PhotonPass:
    """Photons of one pass, whose values (n, c) are summed within discs.

    Beside edges of a `surface`, if there is one, numbers and sums are those of whole discs with as
    many photons per area of surface.
    """

    def __init__(
        self, trees: PhotonTrees, values: Floats, n_threads: int, surface: Surface | None = None
    ) -> None:
        self._trees = trees
        self._values = values
        self._n_threads = n_threads
        self._surface = surface
        self._sums: dict[int, RadiusGather] = {}
        self._with_numbers: dict[int, TreeValues] = {}

    def within(
        self,
        hits: tuple[Floats, Floats],
        radius: Floats,
        order: Order | None = None,
        footprint: Floats | None = None,
    ) -> tuple[Floats, Floats]:
        """Numbers (m,) and sums (m, c) of the photons within radii of positions and normals.

        Over footprints they are those that a disc of the radius has at the mean densities over
        the footprint. `order` is the `morton_order` of the positions, if it is known.
        """
        if footprint is not None:
            return self._over_footprints(hits, radius, order, footprint)
        counts = np.zeros(len(radius), dtype=np.int64)
        sums = np.zeros((len(radius), self._values.shape[1]))
        for number, queries, rows in self._trees.parts(*hits, order):
            self._within(number).sums(
                queries, rows, radius, out=sums, counts=counts, n_threads=self._n_threads
            )
        if self._surface is None or self._surface.edges is None:
            return counts.astype(np.float64), sums
        shares = self._surface.shares(*hits, radius, KERNELS["constant"])
        return counts / shares, sums / shares[:, np.newaxis]

    def _over_footprints(
        self, hits: tuple[Floats, Floats], radius: Floats, order: Order | None, footprint: Floats
    ) -> tuple[Floats, Floats]:
        found = np.zeros((len(radius), self._values.shape[1] + 1))
        for number, queries, rows in self._trees.parts(*hits, order):
            tree, laid_out = self._trees.tree(number)[0], self._numbered(number)
            _footprint.gather_within(
                *(tree.kernel, laid_out.blocks, queries, rows, found),
                normals=hits[1],
                sums=laid_out.node_sums,
                footprint=footprint,
                integrals=kernel_integrals(),
                radius=radius,
                range_radius=normal_range(tree),
                surface=None if self._surface is None else self._surface.edges,
                n_threads=self._n_threads,
            )
        found *= (np.pi * radius**2)[:, np.newaxis]
        return found[:, -1].copy(), found[:, :-1].copy()

    def _numbered(self, number: int) -> TreeValues:
        """Values of the photons of a tree, and the numbers of photons that each stands for."""
        if number not in self._with_numbers:
            tree, rows = self._trees.tree(number)
            values = np.column_stack([self._values, np.ones(len(self._values))])
            summed = self._trees.sums(values, number)
            self._with_numbers[number] = TreeValues(tree, rows, summed, self._n_threads)
        return self._with_numbers[number]

    def _within(self, number: int) -> RadiusGather:
        if number not in self._sums:
            tree, rows = self._trees.tree(number)
            self._sums[number] = RadiusGather(
                tree.kernel,
                self._trees.sums(self._values, number),
                rows,
                KERNELS["constant"],
                normal_range=normal_range(tree),
                numbers=self._trees.numbers(number),
                n_threads=self._n_threads,
            )
        return self._sums[number]


def _radii(value: ArrayLike, name: str, m: int) -> Floats:
    array, (least, most) = validation.float_array(value, name), validation.RADII
    if array.shape not in ((), (m,)):
        raise ValueError(f"{name} should be a number or of shape ({m},), but has {array.shape}")
    if not (array > 0.0).all():
        raise ValueError(f"{name} should be positive, but its least value is {array.min()}")
    if (array < least).any() or (array > most).any():
        raise ValueError(
            f"{name} should lie in [{least:g}, {most:g}], but spans {array.min():g} to "
            f"{array.max():g}"
        )
    return np.ascontiguousarray(np.broadcast_to(array, (m,)))


class InitialRadius:
    """Initial radii at any hit points, from the photons of the first pass.

    A radius is just short of the k-th nearest photon, so that the k - 1 photons in the disc, if
    they are random, give the density without bias. Over a footprint it is just short of the radius
    of its rule, which does the same (`photonrelax.estimation.footprint`). It is at most the
    `largest`, the `automatic_gather_radius` of the pass: regions farther from light stay black.

    Parameters
    ----------
    photons : PhotonMap
        Photons of the first pass.
    settings : ProgressiveSettings
    n_threads : int
    trees : PhotonTrees, optional
        Trees of these photons.
    """

    def __init__(
        self,
        photons: PhotonMap,
        settings: ProgressiveSettings,
        n_threads: int,
        trees: PhotonTrees | None = None,
    ) -> None:
        self._settings = settings
        self._n_threads = n_threads
        self._k = photons.counted(settings.k)
        self._trees = PhotonTrees(photons, n_threads) if trees is None else trees
        # Without photons any radius does.
        self.largest = settings.initial_radius or 1.0
        if settings.initial_radius is None and len(photons):
            self.largest = self._automatic(photons)

    def _automatic(self, photons: PhotonMap) -> float:
        if not np.ptp(photons.position, axis=0).any():
            raise ValueError(
                f"the {len(photons)} photons of the first pass that stored any are all at one "
                "point, from which no radius follows: give ProgressiveSettings(radius=…)"
            )
        tree = self._trees.whole()
        return automatic_gather_radius(tree, self._k, n_threads=self._n_threads)

    def __call__(
        self,
        positions: Floats,
        normals: Floats,
        footprint: Floats | None = None,
        edges: Any = None,
    ) -> Floats:
        """Radii (m,), m, at positions (m, 3) on surfaces with the given normals, or footprints.

        `edges` are those of the surface, as of `Field.edges`.
        """
        radius = np.full(len(positions), self.largest)
        if self._settings.initial_radius is not None:
            return radius
        for part, queries, rows in self._trees.parts(positions, normals):
            tree, k, threads = self._trees.tree(part)[0], self._k, self._n_threads
            if footprint is None:
                distance = kth_distance(
                    tree, queries, rows, k, radius=self.largest, n_threads=threads
                )
            else:
                footprints = Footprints(queries, normals, footprint, rows)
                distance = rule_radii(
                    *(tree, footprints, k),
                    largest=self.largest,
                    edges=edges,
                    n_threads=threads,
                )
            radius[rows] = np.where(distance < np.inf, distance, self.largest)
        np.multiply(radius, JUST_SHORT, out=radius, where=radius < self.largest)
        return np.maximum(radius, _LEAST_RADIUS * self.largest)


def initial_radius(
    photons: PhotonMap,
    positions: ArrayLike,
    normals: ArrayLike,
    settings: ProgressiveSettings | None = None,
) -> Floats:
    """Initial radii (m,), m, at hit points; see `InitialRadius`.

    Raises
    ------
    TypeError, ValueError
        If a shape is wrong, a value is not finite, a normal is zero, or all photons are at one
        point.
    """
    positions = validation.float_array(positions, "positions", (None, 3))
    normals = validation.float_array(normals, "normals", positions.shape)
    start = InitialRadius(photons, settings or ProgressiveSettings(), thread_count(None))
    return start(positions, normals)
