"""Fields: irradiance at any points, of elements that are prepared once."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._util import validation
from .._util.progress import Progress, Reporter
from .._util.validation import Floats
from ..photons.photon_map import PhotonMap
from ..photons.photon_trees import morton_order
from ..relaxation.structure import Structure


class Field(ABC):
    """Irradiance at any points, of elements (photons, say) that are prepared once.

    A method derives its field and implements `flux`, `_lay_out` and `_evaluate`. Shapes and
    values are checked here, and points are divided into chunks.

    Attributes
    ----------
    seconds : dict
        Duration of each stage of the preparation.
    used : dict
        Settings of each stage, by the stages' names, with what was left open filled in.
    """

    seconds: dict[str, float]
    used: dict[str, dict[str, Any]]
    _n_threads: int

    def __call__(
        self, points: ArrayLike, normals: ArrayLike, *, progress: Progress | None = None
    ) -> Floats:
        """Irradiance at points on surfaces.

        Parameters
        ----------
        points, normals : (m, 3) array_like
            m, and directions of any length.
        progress : callable, optional
            Called as ``progress("estimate", done, m)``.

        Returns
        -------
        (m, 3) float array
            W/m².

        Raises
        ------
        TypeError, ValueError
            If a shape is wrong, a value is not finite or a normal is zero.
        """
        irradiance = Densities(self, self.flux, self._laid_out_flux)
        return irradiance(points, normals, progress=progress)

    def densities(self, values: ArrayLike) -> Densities:
        """Estimator of the densities, per m², of any other values of the elements.

        Parameters
        ----------
        values : (n, c) array_like
            One row per element. Kernels stay those of the flux.

        Returns
        -------
        Densities
            Called as ``densities(points, normals)``, like the field itself; returns (m, c).

        Raises
        ------
        TypeError, ValueError
            If `values` does not have a row for each element.
        """
        return Densities(self, validation.float_array(values, "values", (len(self.flux), None)))

    @property
    @abstractmethod
    def flux(self) -> Floats:
        """Values (n, 3) of the elements whose densities are the irradiance, W."""

    @property
    def layers(self) -> dict[str, Floats]:
        """Attributes (n, 1) or (n, 3) of the elements, by the image layer of their mean."""
        return {}

    @abstractmethod
    def _lay_out(self, values: Floats, part: int) -> Any:
        """Values (n, c) as the kernel reads them of one part of the elements, a tree say."""

    @abstractmethod
    def _evaluate(self, values: Densities, points: Floats, normals: Floats) -> Floats:
        """Densities (m, c) at points that are close to one another in sequence.

        Normals (m, 3) are finite and of any length but zero.
        """

    @cached_property
    def _laid_out_flux(self) -> dict[int, Any]:
        return {}


class PhotonField(Field):
    """A field whose elements are the photons of a map.

    Attributes
    ----------
    photons : PhotonMap
        As gathered from, relaxed ones say.
    structure : Structure or None
        Structure that was detected in the preparation.
    seconds, used
        See `Field`.
    """

    photons: PhotonMap
    structure: Structure | None = None

    @property
    def flux(self) -> Floats:
        """Flux (n, 3) of the photons, W."""
        return self.photons.flux

    @property
    def layers(self) -> dict[str, Floats]:
        """Attributes (n, 1) or (n, 3) of the photons, by the image layer of their mean."""
        photons, layers = self.photons, {}
        if self.structure is not None:
            layers["photons.constraint"] = self.structure.constraint[:, np.newaxis]
        if photons.emitter_coords is not None:
            layers["photons.emitter"] = emitter_colours(photons.emitter_coords)
        if photons.n_bounces is not None:
            layers["photons.bounces"] = photons.n_bounces[:, np.newaxis].astype(np.float64)
        return layers


class Densities:
    """Estimator of the densities, per m², of values of a field's elements.

    Parameters
    ----------
    field : Field
    values : (n, c) float array
        One row per element.
    laid_out : dict, optional
        The values as kernels read them, by the part of the elements; filled as parts are used.
    """

    def __init__(
        self, field: Field, values: Floats, laid_out: dict[int, Any] | None = None
    ) -> None:
        self._field = field
        self._values = values
        self._laid_out = {} if laid_out is None else laid_out

    def __call__(
        self, points: ArrayLike, normals: ArrayLike, *, progress: Progress | None = None
    ) -> Floats:
        """Densities (m, c) at points (m, 3) on surfaces; arguments and errors as of `Field`."""
        points, normals = checked_points(points, normals)
        out = np.empty((len(points), self.n_channels))
        report = Reporter(progress, "estimate", len(points))
        evaluate = partial(self._field._evaluate, self)
        fill_in_chunks(out, evaluate, points, normals, report, self._field._n_threads)
        return out

    @property
    def n_channels(self) -> int:
        """Number of values per element, c."""
        return self._values.shape[1]

    def laid_out(self, part: int) -> Any:
        """The values as the field's kernel reads them of one part of the elements."""
        if part not in self._laid_out:
            self._laid_out[part] = self._field._lay_out(self._values, part)
        return self._laid_out[part]


def checked_points(points: ArrayLike, normals: ArrayLike) -> tuple[Floats, Floats]:
    """Points and normals (m, 3) as float arrays.

    Raises
    ------
    TypeError, ValueError
        If a shape is wrong, a value is not finite or a normal is zero.
    """
    points = validation.float_array(points, "points", (None, 3))
    normals = validation.float_array(normals, "normals", points.shape)
    if not normals.any(axis=1).all():
        validation.unit_vectors(normals, "normals", normals.shape)
    return points, normals


def fill_in_chunks(
    out: Floats,
    evaluate: Callable[[Floats, Floats], Floats],
    points: Floats,
    normals: Floats,
    report: Reporter,
    n_threads: int,
) -> None:
    """Fill rows of `out` with ``evaluate(points, normals)`` of chunks of points.

    The points of a chunk are close to one another in sequence, which makes searches fast.
    """
    order = morton_order(points, n_threads)
    for first, end in report.chunks(len(points)):
        rows = order[first:end]
        out[rows] = evaluate(points[rows], normals[rows])


def emitter_colours(emitter_coords: Floats) -> Floats:
    """Emitter coordinates as colours (n, 3) in [0, 1], for images as SJ13 Fig. 6e.

    Each coordinate is stretched over the range it has in the map; on emitter planes blue falls
    as red and green rise.
    """
    low = emitter_coords.min(axis=0, initial=np.inf)
    extent = emitter_coords.max(axis=0, initial=-np.inf) - low
    colours = np.divide(
        emitter_coords - low, extent, out=np.zeros_like(emitter_coords), where=extent > 0.0
    )
    if colours.shape[1] == 2:
        colours = np.column_stack([colours, 1.0 - colours.mean(axis=1)])
    return colours
