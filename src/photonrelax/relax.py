"""Moving photons: iterations constrained in emitter space, then collapsed (SJ13 §4.4)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from . import _arrays
from ._arrays import Floats
from ._ext import relax as _relax
from ._progress import Progress, Reporter
from ._surfaces import Surfaces
from .photonmap import PhotonMap
from .scene import Scene
from .structure import NORMAL_RANGE, Structure, neighbour_groups, photon_tree


@dataclass(frozen=True)
class RelaxSettings:
    """How photons are moved.

    Attributes
    ----------
    n_iterations : (int, int)
        Iterations constrained in emitter space, then in space alone (R = 7 each, SJ13 §5). More
        are not always better: repulsion rests at uniform density only, so smooth gradients slowly
        flow away. Photons emitted along a Halton sequence need fewer, (3, 3) say.
    k : int
        Photons that repel one another, the photon itself among them (K_f = 16, SJ13 Eq. 8).
    step : float
        Fraction of the force of Eq. 8 by which a photon moves; stable up to 2.5.
    largest_step : float
        Longest move in one iteration, as a fraction of the radius around the photon that held k
        photons before the first. The force at an open edge would carry strays away.
    """

    n_iterations: tuple[int, int] = (7, 7)
    k: int = 16
    step: float = 1.0
    largest_step: float = 0.1

    def __post_init__(self) -> None:
        iterations = self.n_iterations
        if not isinstance(iterations, Iterable) or len(tuple(iterations)) != 2:
            raise ValueError(
                "RelaxSettings.n_iterations should be two numbers, constrained and collapsed, "
                f"but is {self.n_iterations!r}"
            )
        numbers = tuple(_arrays.count(n, "RelaxSettings.n_iterations", low=0) for n in iterations)
        object.__setattr__(self, "n_iterations", numbers)
        object.__setattr__(self, "k", _arrays.count(self.k, "RelaxSettings.k", low=4))
        object.__setattr__(self, "step", _arrays.positive(self.step, "RelaxSettings.step"))
        largest = _arrays.positive(self.largest_step, "RelaxSettings.largest_step", allow_inf=True)
        object.__setattr__(self, "largest_step", largest)


def relax(
    photons: PhotonMap,
    structure: Structure,
    settings: RelaxSettings | None = None,
    *,
    scene: Scene | None = None,
    n_threads: int | None = None,
    progress: Progress | None = None,
) -> PhotonMap:
    """Spread photons evenly within their sheets of light.

    In each iteration every photon moves, all at once, by the repulsion of its nearest photons
    (SJ13 Eq. 8), as far as its constraint basis allows (Eq. 9): first by that of photons in range
    over the emitter coordinates, sheet by sheet, then by that of all of the emitter (Algorithm 1
    lines 10–16).

    Parameters
    ----------
    photons : PhotonMap
        Photons, n of them, of about equal flux.
    structure : Structure
        What `detect_structure` found for this map.
    settings : RelaxSettings, optional
        Defaults are the paper's.
    scene : Scene, optional
        With it photons are put back on their objects by short rays along their normals, and stay
        where they were if they would leave them. Without it they move in their tangent planes,
        which is right for flat receivers that reach beyond their photons.
    n_threads : int, optional
        Threads; all available by default. The result does not depend on it.
    progress : callable, optional
        Called as ``progress("relax", done, total)`` in moves of photons.

    Returns
    -------
    PhotonMap
        The same photons, `well_spaced`, with the normals where they are now. Flux is untouched.

    Raises
    ------
    ValueError
        If `structure` is not of this map, or the map's `object_id` is not of the scene.

    Notes
    -----
    A photon with fewer than four photons in range stays, and photons at the same point repel
    others but not one another.
    """
    settings = settings or RelaxSettings()
    _check_structure(structure, photons)
    if not any(settings.n_iterations) or len(photons) == 0:
        return photons
    threads = _arrays.thread_count(n_threads)
    surfaces = None if scene is None else Surfaces(scene, photons, threads)
    report = Reporter(progress, "relax", len(photons) * sum(settings.n_iterations))
    position, normal = photons.position.copy(), photons.normal.copy()
    for rows in neighbour_groups(photons):
        sheets = _Sheets(photons.subset(rows), structure.subset(rows), settings, threads, report)
        position[rows], normal[rows] = sheets.relaxed(surfaces, rows)
    return photons.replace(position=position, normal=normal, well_spaced=True)


def _check_structure(structure: Structure, photons: PhotonMap) -> None:
    if len(structure) != len(photons):
        raise ValueError(
            f"structure should be of these {len(photons)} photons, but is of {len(structure)}"
        )
    if (structure.emitter_range is None) != (photons.emitter_coords is None):
        raise ValueError(
            "structure should be of this map, but only one of them has emitter coordinates"
        )


class _Sheets:
    """One group of neighbours on the move; see `neighbour_groups`."""

    def __init__(
        self,
        photons: PhotonMap,
        structure: Structure,
        settings: RelaxSettings,
        n_threads: int,
        report: Reporter,
    ) -> None:
        self._photons = photons
        self._structure = structure
        self._settings = settings
        self._n_threads = n_threads
        self._report = report
        # The radius that held n_found photons, scaled to hold k.
        self._radius = structure.radius * np.sqrt(settings.k / structure.n_found)

    def relaxed(self, surfaces: Surfaces | None, rows: _arrays.Rows) -> tuple[Floats, Floats]:
        """Return positions and normals after all iterations."""
        position, normal = self._photons.position, self._photons.normal
        for constrained, n in zip((True, False), self._settings.n_iterations, strict=True):
            if n:
                stage = _Stage(self, position, normal, constrained=constrained)
                position, normal = stage.after(n, surfaces, rows)
        return position, normal


class _Stage:
    """Iterations of one kind, on one tree.

    Photons move, but the tree they are searched in keeps its nodes, whose boxes are drawn anew.
    All that kernels read is kept in the order of the tree.
    """

    def __init__(
        self, sheets: _Sheets, position: Floats, normal: Floats, *, constrained: bool
    ) -> None:
        photons, structure = sheets._photons, sheets._structure
        self._sheets = sheets
        self._n_threads = sheets._n_threads
        coords = photons.emitter_coords if constrained else None
        ranges = structure.emitter_range if constrained else None
        tree, range_radius = photon_tree(
            position, normal, coords, ranges, n_threads=self._n_threads
        )
        self._tree = tree.kernel
        self._order = np.asarray(tree.kernel.ids)
        self._position, self._normal = position[self._order], normal[self._order]
        # Normals are range axes, the last three, of trees that have any of their own.
        self._first_normal_axis = 3 if coords is None else 3 + coords.shape[1]
        self._normal_scale = 0.0 if range_radius is None else range_radius.max() / NORMAL_RANGE
        self._placed = {
            "along": structure.basis[self._order, 0],
            "constraint": structure.constraint[self._order],
            "range_radius": self._by_place(range_radius),
            "reach": self._by_place(structure.reach if constrained else None),
            "largest_step": sheets._settings.largest_step * sheets._radius[self._order],
            "squared_radius": sheets._radius[self._order] ** 2 if constrained else np.full(len(photons), -1.0),
        }

    def _by_place(self, array: Floats | None) -> Floats | None:
        return None if array is None else array[self._order]

    def after(
        self, n_iterations: int, surfaces: Surfaces | None, rows: _arrays.Rows
    ) -> tuple[Floats, Floats]:
        """Return positions and normals, by row, after so many iterations."""
        if surfaces is not None:
            rows = self._order if isinstance(rows, slice) else rows[self._order]
        for _ in range(n_iterations):
            moved = self._moved()
            if surfaces is None:
                self._position = moved
            else:
                self._position, self._normal = surfaces.put_back(
                    self._position, self._normal, moved, rows
                )
            self._refit()
        return self._by_row(self._position), self._by_row(self._normal)

    def _by_row(self, placed: Floats) -> Floats:
        array = np.empty_like(placed)
        array[self._order] = placed
        return array

    def _moved(self) -> Floats:
        settings = self._sheets._settings
        sheet = _relax.Sheet(normal=self._normal, **self._placed)
        moved = np.empty_like(self._position)
        for first, end in self._sheets._report.chunks(len(moved)):
            _relax.move(
                self._tree, first, end, sheet, settings.k, settings.step, moved, self._n_threads
            )
        return moved

    def _refit(self) -> None:
        self._tree.move(self._position, 0, 1.0, self._n_threads)
        if self._first_normal_axis < self._tree.n_axes:
            self._tree.move(
                self._normal, self._first_normal_axis, self._normal_scale, self._n_threads
            )
        self._tree.box(self._n_threads)
