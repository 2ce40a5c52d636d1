"""Irradiance at points from photons."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._ext.estimation import nearest as _estimate
from .._ext.estimation import refinement as _adaptive
from .._util import validation
from .._util.parallel import thread_count
from .._util.progress import Progress, Reporter
from .._util.validation import Floats
from ..photons.neighbourhoods import normal_range
from ..photons.photon_map import PhotonMap
from ..photons.photon_trees import PhotonTrees
from ..relaxation.structure import Structure
from ..spatial.kdtree import KDTree
from .field import Field
from .kernels import _WELL_SPACED_BIAS, KERNELS, automatic_gather_radius, well_spaced_bias
from .refinement import REFINEMENTS


@dataclass(frozen=True)
class GatherSettings:
    """How photons around a point are weighted.

    Attributes
    ----------
    k : int
        Photons gathered (K = 15, SJ13 §5); the bandwidth is the distance to the k-th. With a
        refinement these are the most, and have to be given: 200, say.
    kernel : {"epanechnikov", "cone", "constant"}
        Each normalised so that a uniform field returns its own value; from well-spaced photons
        within 0.3 % for k of 15 and more.
    gather_radius : float, optional
        Largest distance, m, from which photons are gathered; where it holds fewer than k it is the
        bandwidth, so that black regions stay black; so it is where k photons lie at the very
        point, of which only these count. By default `automatic_gather_radius` takes it from the
        map: the radius within which 95 % of the photons, and 5 % of the area they light, have
        their k-th nearest. Infinite for no limit. With a refinement it limits the
        first k_min photons, and reaches twice as many; k are gathered from √(k / k_min) times as
        far.
    refinement : {"none", "differential-checking", "bias-compensation"}
        How the number of photons adapts to the light around a point; see
        `photonrelax.estimation.refinement`.
    k_min : int
        The fewest photons gathered with a refinement; not looked at without.
    """

    k: int = 15
    kernel: str = "epanechnikov"
    gather_radius: float | None = None
    refinement: str = "none"
    k_min: int = 15

    def __post_init__(self) -> None:
        for name, names in (("kernel", tuple(KERNELS)), ("refinement", tuple(REFINEMENTS))):
            if getattr(self, name) not in names:
                raise ValueError(
                    f"GatherSettings.{name} should be one of {', '.join(names)}, "
                    f"but is {getattr(self, name)!r}"
                )
        for name in ("k", "k_min"):
            number = validation.count(getattr(self, name), f"GatherSettings.{name}", low=2)
            object.__setattr__(self, name, number)
        if self.refinement != "none" and self.k <= self.k_min:
            raise ValueError(
                f"GatherSettings.k should be more than k_min, {self.k_min}, with a refinement, "
                f"which chooses between the two, but is {self.k}: try k=200"
            )
        if self.gather_radius is not None:
            radius = validation.radius(
                self.gather_radius, "GatherSettings.gather_radius", allow_inf=True
            )
            object.__setattr__(self, "gather_radius", radius)

    @property
    def k_reached(self) -> int:
        """Photons that the automatic gather radius reaches: where there is light, k_min surely."""
        return self.k if self.refinement == "none" else 2 * self.k_min


class IrradianceField(Field):
    """The k nearest photons gathered anywhere (Jensen's estimate): a `Field`.

    Parameters
    ----------
    photons : PhotonMap
        As gathered from: unrelaxed or relaxed.
    settings : GatherSettings, optional
    structure : Structure, optional
        What was found for these photons on the way, for those who want to look at it.
    seconds, used : dict, optional
        How long each stage of the preparation took, and with which settings.
    n_threads : int, optional
        Threads; all available by default. Results do not depend on it.

    Attributes
    ----------
    photons, settings, structure, seconds, used
        As given; `settings.gather_radius` holds the radius in use, None for an empty map.

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

    def densities(self, values: ArrayLike) -> Densities:
        """Return what estimates, per area, anything else that photons carry.

        Parameters
        ----------
        values : (n, c) array_like
            One row a photon.

        Returns
        -------
        Densities
            Called as ``densities(points, normals)``, like the field itself; gives (m, c).

        Raises
        ------
        TypeError, ValueError
            If `values` does not have a row for each photon.
        """
        array = validation.float_array(values, "values", (len(self.photons), None))
        return Densities(self, array)


class Densities:
    """Estimates per area of values that the photons of a field carry; see `densities` there."""

    def __init__(self, field: IrradianceField, values: Floats) -> None:
        self._field = field
        self._values = values
        self._gathers: dict[int, _estimate.Gather | _adaptive.Gather] = {}

    def __call__(
        self, points: ArrayLike, normals: ArrayLike, *, progress: Progress | None = None
    ) -> Floats:
        """Return the estimates (m, c) at points (m, 3) on surfaces with the given normals."""
        points = validation.float_array(points, "points", (None, 3))
        normals = validation.float_array(normals, "normals", (len(points), 3), finite=False)
        out = np.zeros((len(points), self._values.shape[1]))
        field, report = self._field, Reporter(progress, "estimate", len(points))
        for number, queries, rows in field._trees.chunks(points, normals, report):
            self._gather(number).densities(queries, rows, out, field._n_threads)
        return out

    def _gather(self, number: int) -> _estimate.Gather | _adaptive.Gather:
        """Return what gathers from a tree of the field."""
        if number not in self._gathers:
            plain = self._field.settings.refinement == "none"
            made = self._plain if plain else self._refined
            self._gathers[number] = made(*self._field._trees.tree(number))
        return self._gathers[number]

    def _plain(self, tree: KDTree, rows: NDArray[np.intp]) -> _estimate.Gather:
        settings, well_spaced = self._field.settings, self._field.photons.well_spaced
        bias = well_spaced_bias(settings.k, settings.kernel) if well_spaced else 1.0
        return _estimate.Gather(
            tree.kernel,
            self._values,
            rows,
            settings.k,
            KERNELS[settings.kernel],
            nearest_scale=1.0 / bias,
            **self._limits(tree),
        )

    def _refined(self, tree: KDTree, rows: NDArray[np.intp]) -> _adaptive.Gather:
        photons, settings = self._field.photons, self._field.settings
        return _adaptive.Gather(
            tree.kernel,
            self._values,
            validation.in_units(photons.flux.mean(axis=1))[0],
            rows,
            k_min=settings.k_min,
            k=settings.k,
            rule=REFINEMENTS[settings.refinement],
            kernel=KERNELS[settings.kernel],
            bias=_WELL_SPACED_BIAS[settings.kernel] if photons.well_spaced else (0.0, 0.0),
            **self._limits(tree),
        )

    def _limits(self, tree: KDTree) -> dict[str, Any]:
        radius = self._field.settings.gather_radius
        return {
            "radius": np.inf if radius is None else radius,
            "normal_range": normal_range(tree),
            "n_threads": self._field._n_threads,
        }


def estimate_irradiance(
    photons: PhotonMap,
    points: ArrayLike,
    normals: ArrayLike,
    settings: GatherSettings | None = None,
    *,
    n_threads: int | None = None,
) -> Floats:
    """Return the irradiance at points from the photons as they are (Jensen's estimate).

    Parameters
    ----------
    photons : PhotonMap
        Photons, unrelaxed or relaxed.
    points, normals : (m, 3) array_like
        Points on surfaces, m, and the normals there. Photons on faces turned by more than 60°
        are not counted.
    settings : GatherSettings, optional
        Photons, kernel and gather radius.
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
