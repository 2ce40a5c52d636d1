"""Fields: irradiance at any points, of elements that are prepared once."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._ext.spatial.blocks import to_soa_blocks
from .._ext.spatial.node_sums import node_sums
from .._ext.spatial.radius import RadiusGather
from .._util import validation
from .._util.parcels import state_without_caches
from .._util.progress import CHUNK, Progress, Reporter
from .._util.validation import Floats
from ..photons.axes import normal_range
from ..photons.photon_map import PhotonMap
from ..photons.photon_trees import PhotonTrees, morton_order
from ..relaxation.structure import Structure
from ..spatial.kdtree import KDTree
from .footprint import check_footprint
from .surface import Surface
from .texels import TexelGrid

Rows = NDArray[np.intp]


class Points(NamedTuple):
    """A chunk of the points that a field is evaluated at, served by one part of its elements.

    Attributes
    ----------
    part : int
        Number of the part.
    queries : (m, d) float array
        All points as the kernel of the part reads them.
    normals : (m, 3) float array
        All normals, of any length.
    rows : (r,) intp array
        Rows of the points of the chunk, those close to one another in sequence.
    footprint : (m, 2, 3) or (m,) float array, optional
        Footprints of all points, edge vectors or sides of squares; None for estimates at points.
    """

    part: int
    queries: Floats
    normals: Floats
    rows: Rows
    footprint: Floats | None = None


class Field(ABC):
    """Irradiance at any points, of elements (photons, say) that are prepared once.

    A method derives its field and implements `flux`, `_lay_out` and `_fill`, and `_parts` where
    points are served by one or another part of the elements. Shapes and values are checked here,
    and points are divided into chunks.

    Attributes
    ----------
    seconds : dict
        Duration of each stage of the preparation.
    used : dict
        Settings of each stage, by the stages' names, with what was left open filled in.
    surface : Surface, optional
        Surfaces that light is estimated on. With them estimates beside their edges are divided by
        the part of their kernel that is on surface, and are NaN where there is none; without them
        all surface is taken to go on for ever.
    """

    __getstate__ = state_without_caches

    seconds: dict[str, float]
    used: dict[str, dict[str, Any]]
    surface: Surface | None = None
    _n_threads: int
    # Points of a chunk.
    _chunk = CHUNK

    def __call__(
        self,
        points: ArrayLike,
        normals: ArrayLike,
        *,
        footprint: ArrayLike | None = None,
        progress: Progress | None = None,
    ) -> Floats:
        """Irradiance at points on surfaces, or its means over footprints around them.

        Parameters
        ----------
        points, normals : (m, 3) array_like
            m, and directions of any length.
        footprint : (m, 2, 3) or (m,) array_like, optional
            Of each point the two edge vectors, m, of the parallelogram on the surface whose mean
            is wanted, a pixel or a texel say, with the point in its middle; or the side of a
            square in the tangent plane. By default estimates are at the points.
        progress : callable, optional
            Called as ``progress("estimate", done, m)``.

        Returns
        -------
        (m, 3) float array
            W/m².

        Raises
        ------
        TypeError, ValueError
            If a shape is wrong, a value is not finite or a normal is zero; with a footprint, if
            the method has estimates at points only.
        """
        irradiance = Densities(self, self.flux, self._laid_out_flux)
        return irradiance(points, normals, footprint=footprint, progress=progress)

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

    def over_texels(self, grid: TexelGrid, rows: range) -> Floats:
        """Means (n, 3) of the irradiance over the texels of some rows of a grid, row by row."""
        centres = grid.centres(rows)
        normals = np.broadcast_to(grid.normal, centres.shape)
        footprint = np.broadcast_to(grid.edges, (len(centres), 2, 3))
        return self(centres, normals, footprint=footprint)

    @property
    @abstractmethod
    def flux(self) -> Floats:
        """Values (n, 3) of the elements whose densities are the irradiance, W."""

    @property
    def layers(self) -> dict[str, Floats]:
        """Attributes (n, 1) or (n, 3) of the elements, by the image layer of their mean."""
        return {}

    @property
    def has_footprints(self) -> bool:
        """Whether there are means over footprints, or estimates at points only."""
        return False

    @property
    def edges(self) -> Any:
        """Edges of the surfaces as kernels read them; None if no surface or no edge is known."""
        return None if self.surface is None else self.surface.edges

    @property
    def reach(self) -> float:
        """Largest distance, m, from a footprint of what counts in its estimate."""
        return np.inf

    @abstractmethod
    def _lay_out(self, values: Floats, part: int) -> Any:
        """Values (n, c) as the kernel reads those of one part of the elements."""

    @abstractmethod
    def _fill(self, out: Floats, values: Densities, points: Points) -> None:
        """Write the densities at a chunk of points to their rows of `out` (m, c)."""

    def _parts(self, points: Floats, normals: Floats) -> Iterator[tuple[int, Floats, Rows]]:
        """Divide points by the part of the elements that serves them: one for all by default.

        Yields
        ------
        int, (m, d) float array, (r,) intp array
            Number of the part; all points as its kernel reads them; rows of the points that it
            serves, those close to one another in sequence. Densities are zero elsewhere.

        Raises
        ------
        ValueError
            If a normal is not finite or zero.
        """
        validation.unit_vectors(normals, "normals", normals.shape, self._n_threads)
        yield 0, points, morton_order(points, self._n_threads)

    def _chunks(self, points: Floats, normals: Floats, report: Reporter) -> Iterator[Points]:
        """Divide points into chunks, each served by one part; their progress is reported."""
        n_dark = len(points)
        for part, queries, rows in self._parts(points, normals):
            for first, end in report.chunks(len(rows), self._chunk):
                yield Points(part, queries, normals, rows[first:end])
            n_dark -= len(rows)
        if n_dark:
            report.advance(n_dark)

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


class TreeField(PhotonField):
    """A photon field whose parts are the trees of its photons; see `PhotonTrees`."""

    _trees: PhotonTrees

    def _parts(self, points: Floats, normals: Floats) -> Iterator[tuple[int, Floats, Rows]]:
        return self._trees.parts(points, normals)

    def _lay_out(self, values: Floats, part: int) -> TreeValues:
        """Values in tree order."""
        tree, rows = self._trees.tree(part)
        return TreeValues(tree, rows, self._trees.sums(values, part), self._n_threads)


class TreeValues:
    """Values of the photons of a tree, in its order.

    Attributes
    ----------
    blocks : (n_blocks, c, 16) float array
        Values of the photons, zero in lanes without one.
    """

    def __init__(self, tree: KDTree, rows: Rows, values: Floats, n_threads: int) -> None:
        self.blocks = to_soa_blocks(values, rows, n_threads)
        self._tree = tree
        self._rows = rows
        self._values = values
        self._n_threads = n_threads
        self._gathers: dict[int, RadiusGather] = {}

    @cached_property
    def node_sums(self) -> Floats:
        """Sums (groups, c, 16) of the values over the nodes of the tree."""
        sums: Floats = node_sums(self._tree.kernel, self.blocks, self._n_threads)
        return sums

    def within(self, queries: Floats, radius: Floats, kernel: int) -> Floats:
        """Densities (r, c), of a kernel and radii (r,) at queries (r, axes)."""
        if kernel not in self._gathers:
            self._gathers[kernel] = RadiusGather(
                *(self._tree.kernel, self._values, self._rows, kernel),
                normal_range=normal_range(self._tree),
                n_threads=self._n_threads,
            )
        out = np.empty((len(queries), self._values.shape[1]))
        counts = np.empty(len(queries), dtype=np.int64)
        self._gathers[kernel].sums(
            *(queries, np.arange(len(queries)), radius),
            out=out,
            counts=counts,
            n_threads=self._n_threads,
        )
        return out / (np.pi * radius**2)[:, np.newaxis]


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

    def __reduce__(self) -> tuple[type, tuple[Field, Floats]]:
        return type(self), (self._field, self._values)

    def __call__(
        self,
        points: ArrayLike,
        normals: ArrayLike,
        *,
        footprint: ArrayLike | None = None,
        progress: Progress | None = None,
    ) -> Floats:
        """Densities (m, c) at points (m, 3) on surfaces; arguments and errors as of `Field`."""
        points, normals = check_points(points, normals)
        footprint = check_footprint(footprint, len(points))
        if footprint is not None and not self._field.has_footprints:
            raise ValueError(
                f"a {type(self._field).__name__} has estimates at points only, but a footprint was "
                "given: leave it out, or take a method whose field has_footprints"
            )
        out = np.zeros((len(points), self.n_channels))
        report = Reporter(progress, "estimate", len(points))
        for chunk in self._field._chunks(points, normals, report):
            self._field._fill(out, self, chunk._replace(footprint=footprint))
        if self._field.surface is not None:
            self._field.surface.mark_absent(
                out, points, normals, footprint=footprint, reach=self._field.reach
            )
        return out

    @property
    def has_footprints(self) -> bool:
        """Whether there are means over footprints; see `Field`."""
        return self._field.has_footprints

    @property
    def n_channels(self) -> int:
        """Number of values per element, c."""
        return self._values.shape[1]

    def of(self, rows: Rows) -> Floats:
        """Values (m, c) of some elements."""
        return self._values[rows]

    def laid_out(self, part: int) -> Any:
        """The values as the field's kernel reads them of one part of the elements."""
        if part not in self._laid_out:
            self._laid_out[part] = self._field._lay_out(self._values, part)
        return self._laid_out[part]


def check_points(points: ArrayLike, normals: ArrayLike) -> tuple[Floats, Floats]:
    """Points and normals (m, 3) as float arrays; normals may still be zero or not finite.

    Raises
    ------
    TypeError, ValueError
        If a shape is wrong or a point is not finite.
    """
    points = validation.float_array(points, "points", (None, 3))
    return points, validation.float_array(normals, "normals", points.shape, finite=False)


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
