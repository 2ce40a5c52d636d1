"""Moving photons: iterations constrained in emitter space, then collapsed (SJ13 §4.4)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from .._ext.relaxation import relax as _relax
from .._util import validation
from .._util.frozen import set_field
from .._util.parallel import thread_count
from .._util.progress import Progress, Reporter
from .._util.validation import Floats, Rows
from ..photons.axes import hstack_rows
from ..photons.group_trees import group_tree
from ..photons.neighbourhoods import Group, neighbour_groups
from ..photons.photon_map import PhotonMap
from ..scene.scene import Scene
from ..transport.raycast import RayCaster
from .projection import SurfaceProjector
from .rest_density import RestDensity
from .structure import Structure

# Photons projected onto their surfaces at a time, some thousand whole blocks for a thread.
_PROJECTION_CHUNK = 1 << 20
# Largest distance from where a photon started, in units of the length over which the density
# prescribed changes.
_LIMIT_OF_SLOPE = 0.4
# Share of the limit, in units of the radius of photons of all sheets, that iterations in space are
# left: only the noise between sheets is new to them, and their slopes do not know of one another.
_SHARE_IN_SPACE = 0.6
# Moves of photons with a limit over those of others: longer ones take more noise away, and no more
# light.
_LONGER = 1.2
# Relative change of density within the radius of k photons that makes a slope, and iterations of a
# stage after which steps there become shorter, as the square: noise is gone, and errors of the
# slope are left. All that follow are as long as 4.5 of the first.
_STEEP, _FULL_STEPS_ON_SLOPES = 0.2, 5


@dataclass(frozen=True)
class RelaxSettings:
    """Iterations, neighbours and step of the relaxation.

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
        photons before the first. The force at an open edge would carry isolated photons away.
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
        numbers = tuple(
            validation.count(n, "RelaxSettings.n_iterations", low=0, high=validation.MAX_REPEATS)
            for n in iterations
        )
        set_field(self, "n_iterations", numbers)
        k = validation.count(self.k, "RelaxSettings.k", low=4, high=validation.MAX_NEIGHBOURS)
        set_field(self, "k", k)
        set_field(self, "step", validation.positive(self.step, "RelaxSettings.step"))
        largest = validation.positive(
            self.largest_step, "RelaxSettings.largest_step", allow_inf=True
        )
        set_field(self, "largest_step", largest)


def relax(
    photons: PhotonMap,
    structure: Structure,
    settings: RelaxSettings | None = None,
    *,
    rest: RestDensity | None = None,
    scene: Scene | None = None,
    caster: RayCaster | None = None,
    n_threads: int | None = None,
    progress: Progress | None = None,
) -> PhotonMap:
    """Spread photons evenly within their sheets of light.

    In each iteration every photon moves, all at once, by the repulsion of its nearest photons
    (SJ13 Eq. 8), as far as its constraint basis allows (Eq. 9): first by that of photons in range
    over the emitter coordinates, sheet by sheet, then by that of all of the emitter (Algorithm 1
    lines 10–16). A photon with fewer than four in range stays. Photons at the same point, facing
    the same way, are one and stay together. Of emitters that have too few photons for a structure
    of their own all are relaxed together; see `photonrelax.photons.emitter_pools`.

    Parameters
    ----------
    photons : PhotonMap
        Photons, n of them, of about equal flux.
    structure : Structure
        Of this map, from `detect_structure`, or `detect_gradient` for iterations in space.
    settings : RelaxSettings, optional
        Defaults are the paper's.
    rest : RestDensity, optional
        The density of this map in which photons are to rest, from `rest_density`; even by default.
        With it photons stay within its limit of where they started, and within 0.4 of the length
        over which the density changes.
    scene : Scene, optional
        With it photons are projected on their objects by short rays along their normals, and stay
        where they were if they would leave them. Without it they move in their tangent planes,
        which is right for flat receivers that reach beyond their photons.
    caster : RayCaster, optional
        Of the scene, if there is one: building it takes time.
    n_threads, progress : int, callable, optional
        Threads, by default all; called as ``progress("relax", done, total)`` in moves of photons.

    Returns
    -------
    PhotonMap
        The same photons, `well_spaced`, with the normals where they are now. Flux is untouched.

    Raises
    ------
    ValueError
        If `structure` or `rest` is not of this map, `structure` has no emitter range to constrain
        iterations with, or the map's `object_id` is not of the scene.
    """
    settings = settings or RelaxSettings()
    _check_inputs(photons, structure, rest, settings)
    if not any(settings.n_iterations) or len(photons) == 0:
        return photons
    threads = thread_count(n_threads)
    projector = None if scene is None else SurfaceProjector(scene, photons, threads, caster)
    report = Reporter(progress, "relax", len(photons) * sum(settings.n_iterations))
    return Relaxation(photons, structure, settings, rest, projector, threads, report).relaxed()


def _check_inputs(
    photons: PhotonMap, structure: Structure, rest: RestDensity | None, settings: RelaxSettings
) -> None:
    if len(structure) != len(photons):
        raise ValueError(
            f"structure should be of these {len(photons)} photons, but is of {len(structure)}"
        )
    if rest is not None and len(rest) != len(photons):
        raise ValueError(f"rest should be of these {len(photons)} photons, but is of {len(rest)}")
    ranged, located = structure.emitter_range is not None, photons.emitter_coords is not None
    if settings.n_iterations[0] and ranged != located:
        raise ValueError(
            "structure should be of this map, but only one of them has emitter coordinates: "
            "iterations in emitter space need both or neither"
        )


@dataclass(frozen=True)
class Relaxation:
    """All photons, with the structure, settings and surfaces that their moves follow."""

    photons: PhotonMap
    structure: Structure
    settings: RelaxSettings
    rest: RestDensity | None
    projector: SurfaceProjector | None
    n_threads: int
    report: Reporter

    def staged(
        self,
        group: Group,
        before: tuple[Floats, Floats],
        paths: _relax.Paths,
        n: int,
        *,
        constrained: bool,
    ) -> tuple[Floats, Floats]:
        """Positions and normals after n iterations of a stage, whose paths are added.

        `before` are positions and normals before it.
        """
        position, normal = np.empty_like(before[0]), before[1]
        if self.projector is not None:
            normal = np.empty_like(normal)
        stage = _Stage(self, group, *before, constrained=constrained, paths=paths)
        stage.finish(n, position, normal)
        return position, normal

    def relaxed(self) -> PhotonMap:
        """The photons after all iterations."""
        photons = self.photons
        position = np.empty_like(photons.position)
        normal = photons.normal if self.projector is None else np.empty_like(photons.normal)
        for group in neighbour_groups(photons, self.n_threads):
            self._relax(group, position, normal)
        # The map copies arrays that could still be written to.
        for array in (position, normal):
            array.setflags(write=False)
        return photons.replace(position=position, normal=normal, well_spaced=True)

    def _relax(self, group: Group, position: Floats, normal: Floats) -> None:
        """Write positions and normals of a group of neighbours after all iterations."""
        before = self.photons.position, self.photons.normal
        if group.at_rest:
            self._rest(group.rows, position, normal)
            return
        for constrained, n in zip((True, False), self.settings.n_iterations, strict=True):
            if n:
                # A stage has no name, so its tree is dropped before the next is built.
                _Stage(self, group, *before, constrained=constrained).finish(n, position, normal)
                before = position, normal

    def _rest(self, rows: Rows, position: Floats, normal: Floats) -> None:
        """Write positions and normals as they are."""
        position[rows] = self.photons.position[rows]
        if self.projector is not None:
            normal[rows] = self.photons.normal[rows]
        self.report.advance(len(position[rows]) * sum(self.settings.n_iterations))


class _Stage:
    """Iterations of one kind, on one tree, of one group of neighbours; see `neighbour_groups`.

    Photons move, but the tree they are searched in keeps its nodes, whose boxes are drawn anew.
    Arrays read or written in every iteration are kept in tree order.
    """

    def __init__(
        self,
        relaxation: Relaxation,
        group: Group,
        position: Floats,
        normal: Floats,
        *,
        constrained: bool,
        paths: _relax.Paths | None = None,
    ) -> None:
        photons, structure = relaxation.photons, relaxation.structure
        self._relaxation = relaxation
        coords = photons.emitter_coords if constrained else None
        ranges = structure.emitter_range if constrained else None
        self._group_tree = group_tree(
            position, normal, coords, ranges, group=group, n_threads=relaxation.n_threads
        )
        self._tree = self._group_tree.tree.kernel
        self._rows = self._group_tree.rows
        self._distinct, self._n_merged = self._group_tree.distinct, self._group_tree.n_merged
        range_radius = self._group_tree.ranges
        self._normal_scale = self._group_tree.normal_scale
        self._position = np.empty((len(self._rows), 3))
        self._normal = self._normals_in_tree_order(normal)
        # The radius that held n_found photons, scaled to hold k.
        radius = structure.radius[self._rows]
        radius *= np.sqrt(relaxation.settings.k / structure.n_found[self._rows])
        self._squared = np.square(radius) if constrained else np.full_like(radius, -1.0)
        self._few = constrained & (structure.n_found[self._rows] < relaxation.settings.k)
        start = None if constrained else position
        self._paths = paths
        if paths is not None:
            paths.begin(hstack_rows([position], [1.0], self._rows, relaxation.n_threads))
        self._inputs = _relax.RelaxInputs(
            rows=self._rows,
            normal=self._normal,
            largest_step=relaxation.settings.largest_step * radius,
            squared_radius=self._squared,
            too_few=self._few,
            basis=structure.basis,
            constraint=structure.constraint,
            range_radius=range_radius,
            reach=structure.reach if constrained else None,
            rest=None
            if relaxation.rest is None
            else self._rest_inputs(relaxation.rest, start, radius),
            paths=paths,
        )

    def _rest_inputs(self, rest: RestDensity, start: Floats | None, radius: Floats) -> _relax.Rest:
        """Inputs of a kernel for a density to rest in; `start` is where moves in space start."""
        return _relax.Rest(
            rows=self._rows,
            slope=rest.slope,
            limit=rest.limit,
            radius=radius,
            limit_of_slope=_LIMIT_OF_SLOPE,
            origin=self._relaxation.photons.position,
            start=start,
            share=_SHARE_IN_SPACE,
            longer=_LONGER,
            steep=_STEEP,
            n_threads=self._relaxation.n_threads,
        )

    def _normals_in_tree_order(self, normal: Floats) -> Floats:
        """Normals (n, 3) in tree order; a view of one where all are equal and stay so."""
        if self._relaxation.projector is None and self._group_tree.normal_axis == self._tree.n_axes:
            return np.broadcast_to(normal[self._rows[:1]], self._position.shape)
        return normal[self._rows]

    def finish(self, n_iterations: int, position: Floats, normal: Floats) -> None:
        """Iterate so often, then write positions and, on surfaces, normals to their rows."""
        for iteration in range(n_iterations):
            if iteration:
                self._refit()
            self._move(min((_FULL_STEPS_ON_SLOPES / (iteration + 1)) ** 2, 1.0))
            if self._relaxation.projector is not None:
                self._project(self._relaxation.projector)
        if self._n_merged:
            self._relaxation.report.advance(n_iterations * self._n_merged)
        # Positions that have not been written yet take no memory; that of the tree will do.
        del self._tree, self._group_tree
        position[self._rows] = self._position
        written: tuple[Floats, ...] = (position,)
        if self._relaxation.projector is not None:
            normal[self._rows] = self._normal
            written = position, normal
        if self._paths is not None:
            written = *written, self._paths.searched, self._paths.travelled
        if self._distinct is not None:
            self._distinct.repeat(*written)

    def _move(self, share_on_slopes: float) -> None:
        """Write the positions that photons move to; the tree keeps those before."""
        settings, n_threads = self._relaxation.settings, self._relaxation.n_threads
        if self._paths is not None:
            self._paths.next()
        for first, end in self._relaxation.report.chunks(len(self._position)):
            _relax.move(
                *(self._tree, first, end, self._inputs),
                k=settings.k,
                step=settings.step,
                moved=self._position,
                n_threads=n_threads,
                share_on_slopes=share_on_slopes,
            )

    def _project(self, projector: SurfaceProjector) -> None:
        for first in range(0, len(self._position), _PROJECTION_CHUNK):
            part = slice(first, first + _PROJECTION_CHUNK)
            self._position[part], self._normal[part] = projector.project(
                self._from_tree(part), self._normal[part], self._position[part], self._rows[part]
            )

    def _from_tree(self, part: slice) -> Floats:
        """Positions (m, 3) in the tree of the points of some blocks."""
        lanes = np.asarray(self._tree.coords)
        block = lanes.shape[2]
        position = lanes[part.start // block : part.stop // block, :3].transpose(0, 2, 1)
        # Of a single block that would be a view.
        return np.ascontiguousarray(position.reshape(-1, 3)[: len(self._position) - part.start])

    def _refit(self) -> None:
        n_threads = self._relaxation.n_threads
        self._tree.move(self._position, 0, 1.0, n_threads)
        axis = self._group_tree.normal_axis
        # Only surfaces turn photons.
        if self._relaxation.projector is not None and axis < self._tree.n_axes:
            self._tree.move(self._normal, axis, self._normal_scale, n_threads)
        self._tree.box(n_threads)
