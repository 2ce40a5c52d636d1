"""Moving photons: iterations constrained in emitter space, then collapsed (SJ13 §4.4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import _arrays
from ._arrays import Floats
from ._ext import relax as _relax
from ._progress import Progress, Reporter
from .kdtree import KDTree
from .photonmap import PhotonMap
from .raycast import RayCaster
from .scene import Scene
from .structure import Structure, emitter_groups, photon_tree

# How far above the surface the ray that puts a photon back starts: this many times the length of
# the move, and at least this fraction of the scene, above what float32 rays resolve.
_REACH = 2.0
_LEAST_REACH = 1e-5
# A photon put back on a face turned by more than this (cosine) has gone round a corner.
_LEAST_ALIGNMENT = 0.5


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
        if len(self.n_iterations) != 2:
            raise ValueError(
                "RelaxSettings.n_iterations should be two numbers, constrained and collapsed, "
                f"but is {self.n_iterations!r}"
            )
        for number in self.n_iterations:
            _arrays.count(number, "RelaxSettings.n_iterations", low=0)
        _arrays.count(self.k, "RelaxSettings.k", low=4)
        _arrays.positive(self.step, "RelaxSettings.step")
        _arrays.positive(self.largest_step, "RelaxSettings.largest_step", allow_inf=True)


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
    (SJ13 Eq. 8), as far as its constraint basis allows (Eq. 9). In the first iterations only
    photons in range over the emitter coordinates repel each other, so that each sheet is spread
    by itself; in the last all photons of the emitter do (Algorithm 1 lines 10–16).

    Parameters
    ----------
    photons : PhotonMap
        Photons, n of them, of about equal flux.
    structure : Structure
        What `detect_structure` found for this map.
    settings : RelaxSettings, optional
        Defaults are the paper's.
    scene : Scene, optional
        With it a moved photon is put back on its object by a short ray along its normal, and
        stays where it was if it has left the object's surface. Without it photons move in their
        tangent planes, which is right for flat receivers that reach beyond their photons.
    n_threads : int, optional
        Threads; all available by default. The result does not depend on it.
    progress : callable, optional
        Called as ``progress("relax", done, total)`` in moves of photons.

    Returns
    -------
    PhotonMap
        The same photons at new positions, with the normals found there. Flux is untouched.

    Raises
    ------
    ValueError
        If `structure` is not of this map, or `scene` is given and the map has no `object_id`.

    Notes
    -----
    A photon with fewer than four photons in range stays, and photons at the same point repel
    others but not one another.
    """
    settings = settings or RelaxSettings()
    if len(structure) != len(photons):
        raise ValueError(
            f"structure should be of these {len(photons)} photons, but is of {len(structure)}"
        )
    if not any(settings.n_iterations) or len(photons) == 0:
        return photons
    threads = _arrays.thread_count(n_threads)
    surfaces = None if scene is None else _Surfaces(scene, photons, threads)
    report = Reporter(progress, "relax", len(photons) * sum(settings.n_iterations))
    position, normal = photons.position.copy(), photons.normal.copy()
    for rows in emitter_groups(photons):
        sheets = _Sheets(photons.subset(rows), structure.subset(rows), settings, threads, report)
        position[rows], normal[rows] = sheets.relaxed(surfaces, rows)
    return photons.replace(position=position, normal=normal, well_spaced=True)


class _Sheets:
    """The photons of one emitter on the move."""

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
        radius = structure.radius * np.sqrt(settings.k / structure.n_found)
        self._largest_step = settings.largest_step * radius

    def relaxed(self, surfaces: _Surfaces | None, rows: _arrays.Rows) -> tuple[Floats, Floats]:
        """Return positions and normals after all iterations."""
        position, normal = self._photons.position, self._photons.normal
        constrained, collapsed = self._settings.n_iterations
        coords, ranges = self._photons.emitter_coords, self._structure.emitter_range
        stages = [(coords, ranges)] * constrained + [(None, None)] * collapsed
        for stage_coords, stage_ranges in stages:
            tree = photon_tree(
                position, None if stage_ranges is None else stage_coords, n_threads=self._n_threads
            )
            moved = self._moved(tree, normal, stage_ranges)
            if surfaces is None:
                position = moved
            else:
                position, normal = surfaces.put_back(position, normal, moved, rows)
        return position, normal

    def _moved(self, tree: KDTree, normal: Floats, ranges: Floats | None) -> Floats:
        moved = np.empty((len(self._photons), 3))
        sheet = _relax.Sheet(normal, self._structure, ranges, self._largest_step)
        for first, end in self._report.chunks(len(moved)):
            _relax.move(
                tree.kernel,
                first,
                end,
                sheet,
                self._settings.k,
                self._settings.step,
                moved,
                self._n_threads,
            )
        return moved


class _Surfaces:
    """The objects photons lie on."""

    def __init__(self, scene: Scene, photons: PhotonMap, n_threads: int) -> None:
        if photons.object_id is None:
            raise ValueError("photons should have an object_id to be kept on the scene's objects")
        self._caster = RayCaster(scene.objects)
        self._least_reach = _LEAST_REACH * scene.scale
        self._object_id = photons.object_id
        self._n_threads = n_threads

    def put_back(
        self, position: Floats, normal: Floats, moved: Floats, rows: _arrays.Rows
    ) -> tuple[Floats, Floats]:
        """Return where moved photons meet their own object, and the normals there.

        A ray comes down along each photon's normal. Where it meets nothing, another object, or
        a face turned away, the photon has left its surface and the move is not made.
        """
        length = np.linalg.norm(moved - position, axis=1)
        reach = np.maximum(_REACH * length, self._least_reach)[:, np.newaxis]
        found = self._caster.intersect(moved + reach * normal, -normal, n_threads=self._n_threads)
        facing = np.einsum("ij,ij->i", found.geometric_normal, normal)
        stays = (
            (length > 0.0)
            & (found.object_id == self._object_id[rows])
            & (found.distance <= 2.0 * reach[:, 0])
            & (np.abs(facing) >= _LEAST_ALIGNMENT)
        )[:, np.newaxis]
        outward = np.copysign(1.0, facing)[:, np.newaxis] * found.geometric_normal
        return np.where(stays, found.position, position), np.where(stays, outward, normal)
