"""Diffusion based photon mapping: kernels long along edges and short across them (SSO08 §6).

Schjøth, Sporring & Olsen 2008, *Diffusion Based Photon Mapping*.

The gradient of irradiance is estimated at every photon with a bandwidth of its own, the noise
scale (Eq. 13). Around a point the products ∇E ⊗ ∇E of the photons within the bandwidth h, the
integration scale, are averaged with Epanechnikov weights to the structure tensor (Eq. 14). Its
eigenvectors v₁, across the structure, and v₂, along it, become those of the diffusion tensor
(Eq. 15–16)

    D = μ₁ v₂ v₂ᵀ + μ₂ v₁ v₁ᵀ,   μ₁ = 1,   μ₂ = 1 / (1 + (λ₁/q)^(1 + α))

with λ₁ the larger eigenvalue, normalised; the isotropic variant has μ₂ in both places (§7.3). The
estimate weights photons by their Mahalanobis distance,

    E(x) = 2 / (π h² √det D) · Σ (1 − dᵀ D⁻¹ d / h²)₊ Φ,   d = xᵢ − x.

Eq. 20 prints the distance with D where Eq. 19 defines it with the inverse of the covariance; with D
itself the kernel would be long across edges. The normalisation is that of Eq. 11 put into Eq. 20,
and the integral is one: in the coordinates y = D^(-1/2) d / h, an area element h² √det D dy, it is
that of 2/π (1 − |y|²)₊ over the plane. As no eigenvalue exceeds one, the ellipse stays within h.

Photons are projected onto the tangent plane of the point along the direction they came from (Eq.
A1–A2), which is exact for parallel light on curved surfaces, except for photons that would come in
from beyond h. Light from behind the plane does not count. Photons that come in at less than 6° to
the plane are projected no farther than at 6°; those without a direction along the normal of the
plane; those that came from below their own surface along their own normal.

Over a footprint the bandwidth is the radius of its rule (`photonrelax.estimation.footprint`). Its
kernel is the mean over the footprint of a Gaussian of covariance (0.41 h)² D, cut off at the
Mahalanobis distance h from it, and no narrower than the footprint: no eigenvalue of D is less than
(s/2h)², s the longest side. Where that is one, the estimate is that of the rule with radius h.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cached_property
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike

from .._ext.estimation import diffusion as _diffusion
from .._ext.estimation import diffusion_footprint as _diffusion_footprint
from .._ext.estimation import footprint as _footprint
from .._ext.estimation import tangent_plane as _tangent
from .._ext.estimation.surface_edges import EdgeSearch
from .._util import validation
from .._util.frozen import set_field
from .._util.parallel import thread_count
from .._util.progress import Progress, Reporter
from .._util.validation import Floats
from ..photons.axes import normal_range
from ..photons.photon_map import PhotonMap
from ..photons.photon_trees import PhotonTrees
from .field import Densities, Points, TreeField, check_points
from .footprint import Footprints, kernel_integrals, rule_radii
from .kernels import JUST_SHORT, Scale, automatic_gather_radius, bandwidths

NORMALISATIONS = ("maximum", "local")
# Noise scale over integration scale, by default: SSO08 §6.4 wants it lower.
_NOISE_RATIO = 0.5
# Where photons coincide, largest share of the map's places that set a bandwidth, and least number.
_SHARE_OF_PLACES = 1 / 5
_LEAST_PLACES = 15


@dataclass(frozen=True)
class DiffusionSettings:
    """Kernel bandwidth, and its adaptation to the structure around a point.

    By default 500 photons set the bandwidth, as in SJ13 (§5), whose q is 0.02 (``edge_threshold``).
    SSO08 (§7) has a fixed bandwidth, one that "reduces noise to an acceptable level" (``k=None,
    bandwidth=…, normalisation="maximum"``), and q from 0.8 to 0.1.

    The default normalisation and q are neither paper's: docs/methods/diffusion.md has the errors
    measured with theirs and with these.

    Attributes
    ----------
    k : int or None
        The bandwidth, which is the integration scale too, is the distance to the k-th nearest
        photon; None for a fixed one. Photons at the same point count as one; but of a map of few
        such points a fifth will do, or as many points as hold k photons.
    bandwidth : float, optional
        h of Eq. 9 and 20, m: the fixed one, or the largest where `k` is given. By default,
        with `k`, that of `photonrelax.estimation.kernels.automatic_gather_radius`.
    noise_scale : float, optional
        Bandwidth of the gradient, m (h of Eq. 13). By default half of the integration scale: half
        of a fixed bandwidth, or the distance of a photon to its k/4-th nearest.
    edge_threshold : float
        q of Eq. 16: λ₁ from which structure is an edge, not noise. Infinite for no edges.
    edge_steepness : float
        α of Eq. 16, positive.
    normalisation : {"maximum", "local"}
        Divisor of λ₁: its largest value among the photons of the map, as published (§6.2); or
        (E/h)² at the point, so that it is the square of the relative change over a bandwidth,
        |∇E|·h/E, and q means the same in every scene and in its dim parts.
    least_eigenvalue : float
        Least eigenvalue of D, in (0, 1]: kernels are no narrower than its square root times the
        bandwidth. SJ13 adjusts this, "the minimum diameter of the anisotropic kernel", to compare
        methods. Over footprints it is raised to their width.
    """

    k: int | None = 500
    bandwidth: float | None = None
    noise_scale: float | None = None
    edge_threshold: float = 0.5
    edge_steepness: float = 1.0
    normalisation: str = "local"
    least_eigenvalue: float = 0.01

    def __post_init__(self) -> None:
        if self.k is not None:
            k = validation.count(
                self.k, "DiffusionSettings.k", low=2, high=validation.MAX_NEIGHBOURS
            )
            set_field(self, "k", k)
        elif self.bandwidth is None:
            raise ValueError("DiffusionSettings should have k or bandwidth, but both are None")
        for name in ("bandwidth", "noise_scale"):
            value = getattr(self, name)
            if value is not None:
                set_field(self, name, validation.radius(value, f"DiffusionSettings.{name}"))
        for name in ("edge_threshold", "edge_steepness"):
            label, infinite = f"DiffusionSettings.{name}", name == "edge_threshold"
            set_field(
                self, name, validation.positive(getattr(self, name), label, allow_inf=infinite)
            )
        least = validation.positive(self.least_eigenvalue, "DiffusionSettings.least_eigenvalue")
        if least > 1.0:
            raise ValueError(
                f"DiffusionSettings.least_eigenvalue should be at most 1, but is {least}"
            )
        set_field(self, "least_eigenvalue", least)
        validation.check_choice(
            self.normalisation, "DiffusionSettings.normalisation", NORMALISATIONS
        )


class DiffusionField(TreeField):
    """Irradiance by kernels that follow structure.

    Parameters
    ----------
    photons : PhotonMap
        Gradients are of the mean over the channels of their flux.
    settings : DiffusionSettings, optional
    isotropic : bool
        Kernels shrink in both directions where there is structure (SSO08 §7.3).
    n_threads : int, optional
        Threads; all available by default. Results do not depend on it.
    progress : callable, optional
        Called as ``progress("gradient", done, n)``, and with "normalise" where λ₁ is divided by
        its largest value.

    Attributes
    ----------
    photons, settings
        As given; `settings.bandwidth` is the one in use, None for an empty map.
    structure, seconds, used
        See `PhotonField`; no structure.

    Raises
    ------
    ValueError
        If the bandwidth is left open and all photons are at one point.
    """

    def __init__(
        self,
        photons: PhotonMap,
        settings: DiffusionSettings | None = None,
        *,
        isotropic: bool = False,
        n_threads: int | None = None,
        progress: Progress | None = None,
    ) -> None:
        self.photons = photons
        self.isotropic = isotropic
        self._n_threads = thread_count(n_threads)
        self._trees = PhotonTrees(photons, self._n_threads)
        self.settings = self._with_bandwidth(settings or DiffusionSettings())
        self._trees.build()
        self._towards = _towards(photons)
        started = perf_counter()
        self._unit = validation.power_of_two(self.settings.bandwidth or 1.0)
        flux, _ = validation.in_units(photons.flux.mean(axis=1, keepdims=True))
        self._columns = np.column_stack([flux, self._slopes(flux, progress)])
        self.seconds = {"gradient": perf_counter() - started}
        self._largest: float | None = None
        if self.settings.normalisation == "maximum":
            started = perf_counter()
            self._largest = self._largest_slope(progress)
            self.seconds["normalise"] = perf_counter() - started
        self.used = {"diffusion": asdict(self.settings)}

    @cached_property
    def _with_gradients(self) -> dict[int, _tangent.TangentPhotons]:
        return {}

    def half_axes(self, points: ArrayLike, normals: ArrayLike) -> Floats:
        """Half-axes of the elliptical kernels.

        Parameters
        ----------
        points, normals : (m, 3) array_like
            m, and directions of any length.

        Returns
        -------
        (m, 2, 3) float array
            m; along the structure, and across. Zero where no photon faces the point.

        Raises
        ------
        TypeError, ValueError
            If a shape is wrong, a value is not finite or a normal is zero.
        """
        points, normals = check_points(points, normals)
        out = np.zeros((len(points), 2, 3))
        shape, report = self._kernel_shape(), Reporter(None, "axes", len(points))
        for chunk in self._chunks(points, normals, report):
            widths = self._bandwidths(chunk, self._integration_scale())
            around = self._evaluation_points(chunk, widths)
            photons = self._photons_with_gradients(chunk.part)
            _diffusion.half_axes(photons, around, shape, out, self._n_threads)
        return out

    @property
    def has_footprints(self) -> bool:
        """Whether there are means over footprints: there are."""
        return True

    @property
    def reach(self) -> float:
        """Largest bandwidth, m."""
        return self._integration_scale()[0]

    def _fill(self, out: Floats, values: Densities, points: Points) -> None:
        if points.footprint is not None:
            self._fill_footprints(out, values, points, points.footprint)
            return
        widths = self._bandwidths(points, self._integration_scale())
        around = self._evaluation_points(points, widths)
        photons = self._photons_with_gradients(points.part)
        blocks = values.laid_out(points.part).blocks
        shape = self._kernel_shape()
        _diffusion.densities(photons, blocks, around, shape, out, n_threads=self._n_threads)

    def _fill_footprints(
        self, out: Floats, values: Densities, points: Points, footprint: Floats
    ) -> None:
        """Write the means over the footprints of a chunk, whose kernels have no shape if wide."""
        rows = points.rows
        widths = self._footprint_bandwidths(points, footprint)
        sides = _footprint.rectangle_sides(points.normals[rows], footprint[rows])
        wide = sides.max(axis=1) >= 2.0 * widths
        blocks = values.laid_out(points.part).blocks
        self._fill_wide(out, values, points._replace(rows=rows[wide]), widths[wide])
        narrow = self._evaluation_points(points._replace(rows=rows[~wide]), widths[~wide])
        photons, shape = self._photons_with_gradients(points.part), self._kernel_shape()
        kernels = _diffusion_footprint.FootprintKernels(shape, footprint, kernel_integrals())
        _diffusion_footprint.densities(
            *(photons, blocks, narrow, kernels, out), n_threads=self._n_threads
        )

    def _fill_wide(self, out: Floats, values: Densities, points: Points, widths: Floats) -> None:
        """Write the means over footprints that are wider than kernels, all of whose photons count.

        They are those of the rule of footprints with the bandwidths as radii.
        """
        tree, laid_out = self._trees.tree(points.part)[0], values.laid_out(points.part)
        radius = np.empty(len(points.queries))
        radius[points.rows] = widths
        _footprint.gather_within(
            *(tree.kernel, laid_out.blocks, points.queries, points.rows, out),
            normals=points.normals,
            sums=laid_out.node_sums,
            footprint=points.footprint,
            integrals=kernel_integrals(),
            radius=radius,
            range_radius=normal_range(tree),
            surface=self.edges,
            n_threads=self._n_threads,
        )

    def _footprint_bandwidths(self, points: Points, footprint: Floats) -> Floats:
        """Bandwidths (r,) over footprints, m; as those at points, by the rule of footprints."""
        largest, k = self._integration_scale()
        if k is None:
            return np.full(len(points.rows), largest)
        tree = self._trees.tree(points.part)[0]
        footprints = Footprints(points.queries, points.normals, footprint, points.rows)
        radius = rule_radii(
            *(tree, footprints, k), largest=largest, edges=self.edges, n_threads=self._n_threads
        )
        short = (radius > 0.0) & (radius < largest)
        return np.where(short, JUST_SHORT * radius, largest)

    def _with_bandwidth(self, settings: DiffusionSettings) -> DiffusionSettings:
        """Settings with the k and the largest bandwidth of the map, if that is left open."""
        if settings.k is None or not len(self.photons):
            return settings
        tree, k = self._trees.whole(), self.photons.counted(settings.k)
        settings = replace(settings, k=k)
        if len(tree) < len(self.photons):
            k = self._places_of(k, len(tree))
            settings = replace(settings, k=k)
        if settings.bandwidth is not None:
            return settings
        try:
            radius = automatic_gather_radius(tree, k, n_threads=self._n_threads)
        except ValueError:
            raise ValueError(
                f"the map's {len(self.photons)} photons are all at one point, from which no "
                "bandwidth follows: give DiffusionSettings(bandwidth=…)"
            ) from None
        return replace(settings, bandwidth=radius)

    def _places_of(self, k: int, n_places: int) -> int:
        """Number of places that set the bandwidth, of a map in which photons coincide."""
        as_dense = round(k * n_places / len(self.photons))
        return min(k, max(as_dense, round(_SHARE_OF_PLACES * n_places), _LEAST_PLACES))

    def _slopes(self, flux: Floats, progress: Progress | None) -> Floats:
        """Gradients (n, 3) at all photons, in the units of flux and length.

        They keep squares of gradients within the range of floats.
        """
        photons, scale = self.photons, self._noise_scale()
        laid_out: dict[int, _tangent.TangentPhotons] = {}
        out = np.zeros((len(photons), 3))
        report = Reporter(progress, "gradient", len(photons))
        for chunk in self._chunks(photons.position, photons.normal, report):
            around = self._around(chunk, scale)
            if chunk.part not in laid_out:
                laid_out[chunk.part] = self._tangent_photons(chunk.part, flux)
            _diffusion.gradients(laid_out[chunk.part], around, out, self._n_threads)
        return out

    def _largest_slope(self, progress: Progress | None) -> float | None:
        """Largest eigenvalue of the structure tensors at all photons, in these units."""
        photons, scale = self.photons, self._integration_scale()
        out = np.zeros(len(photons))
        report = Reporter(progress, "normalise", len(photons))
        for chunk in self._chunks(photons.position, photons.normal, report):
            around = self._around(chunk, scale)
            laid_out = self._photons_with_gradients(chunk.part)
            _diffusion.eigenvalues(laid_out, around, out, self._n_threads)
        return float(out.max(initial=0.0)) or None

    def _integration_scale(self) -> Scale:
        # It is open for an empty map alone, where it does not matter.
        return self.settings.bandwidth or np.inf, self.settings.k

    def _noise_scale(self) -> Scale:
        if self.settings.noise_scale is not None:
            return self.settings.noise_scale, None
        largest, k = self._integration_scale()
        return _NOISE_RATIO * largest, None if k is None else max(round(_NOISE_RATIO**2 * k), 2)

    def _evaluation_points(self, points: Points, widths: Floats) -> _tangent.EvaluationPoints:
        """Points of a chunk, whose normals may have any length, with bandwidths (r,)."""
        normals = points.normals[points.rows]
        normals = validation.unit_vectors(normals, "normals", normals.shape, self._n_threads)
        search = None if self.edges is None else EdgeSearch(self.edges, self._n_threads)
        return _tangent.EvaluationPoints(points.queries, points.rows, normals, widths, search)

    def _around(self, points: Points, scale: Scale) -> _tangent.EvaluationPoints:
        """Points of a chunk with the bandwidths of their kernels; normals are unit vectors."""
        widths, normals = self._bandwidths(points, scale), points.normals[points.rows]
        return _tangent.EvaluationPoints(points.queries, points.rows, normals, widths)

    def _bandwidths(self, points: Points, scale: Scale) -> Floats:
        """Bandwidths (r,) of the kernels at the points of a chunk, m."""
        tree = self._trees.tree(points.part)[0]
        return bandwidths(tree, points.queries, points.rows, scale, n_threads=self._n_threads)

    def _photons_with_gradients(self, part: int) -> _tangent.TangentPhotons:
        """Photons of a tree with their mean flux and its gradients."""
        if part not in self._with_gradients:
            self._with_gradients[part] = self._tangent_photons(part, self._columns)
        return self._with_gradients[part]

    def _tangent_photons(self, part: int, columns: Floats) -> _tangent.TangentPhotons:
        tree, rows = self._trees.tree(part)
        own = columns[:, :1]
        flux = self._trees.sums(own, part)
        if flux is not own:
            # Of the columns only the flux adds up: coincident photons have the same gradient.
            columns = np.column_stack([flux, columns[:, 1:]])
        return _tangent.TangentPhotons(
            *(tree.kernel, rows, self._towards, columns),
            range_radius=normal_range(tree),
            unit=self._unit,
            n_threads=self._n_threads,
        )

    def _kernel_shape(self) -> _diffusion.KernelShape:
        settings = self.settings
        return _diffusion.KernelShape(
            edge_threshold=settings.edge_threshold,
            exponent=1.0 + settings.edge_steepness,
            least_eigenvalue=settings.least_eigenvalue,
            largest=self._largest or 0.0,
            isotropic=self.isotropic,
        )


def _towards(photons: PhotonMap) -> Floats | None:
    """Directions towards the light (n, 3), the normal where that is below the surface."""
    if photons.wi is None:
        return None
    above = np.einsum("ij,ij->i", photons.wi, photons.normal) > 0.0
    if above.all():
        return photons.wi
    return np.where(above[:, np.newaxis], photons.wi, photons.normal)
