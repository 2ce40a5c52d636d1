"""Spectra of traced photons: those chosen go their way again, with neighbours all around.

Light of collimated and point-like emitters is a sheet: one ray for every emitter coordinate. So
what cuts a piece off, wherever on the way, cuts off a piece of the emitter coordinates, and how far
away that is tells the window that widens the spectrum as it leaves the emitter (see `spectrum`).
It is found by rays around the photon's, at offsets that double: `clear_distance`.

What leaves the emitter, for the rest, is as smooth as it can be:

* collimated light has no spatial frequency, and in angle the bandwidth of a sun of 1e-6 rad;
* a point has in space that of a dot of 1e-6 of the scene's size; in angle none where it shines
  alike in all directions, and that of a cosine where it is Lambertian.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..._ext.transport import trace as _kernel
from ..._util.validation import Floats
from ...photons.energy_ledger import PATH_OUTCOMES
from ...photons.neighbourhoods import MIN_NORMAL_COSINE
from ...scene.emission_region import EmissionRegion
from ...scene.materials import DIFFUSE, MaterialTable
from ...scene.scene import Scene
from ..emission import LUMINANCE, PATHS, EmissionPlan, emission
from ..frequency import operators
from ..raycast import Intersections, RayCaster, empty_intersections
from .path_replay import CHUNK, Beams, Follower, Landings, Ways, started

# Standard deviation of the angles, rad, in light that is called parallel, and, over the size of the
# scene, of what is called a point.
_SMALL = 1e-6
# Probes are at the first of these rungs at first, each the half of the one before.
_FIRST_RUNG, _RUNGS = 6, 11
# From the last rung that is clear towards the next.
_STEPS = (2**0.5, 2**0.25)
_SPOKES = 8
# Of the distance at which probes still find nothing: an edge, or a fold, may be nearest between
# two of them, where an edge is nearer by the cosine of half the angle, a fold by its square.
_BETWEEN_SPOKES = np.cos(np.pi / _SPOKES) ** 2
# How far the second order may carry a probe from where the first expects it, over its offset; and
# by how much of itself the light there may differ: as roughness, both are alike.
_STRAY = 0.5


@dataclass(frozen=True, eq=False)
class Retraced:
    """Photons of one emitter to be traced again.

    Attributes
    ----------
    emitter_id : int
    photons : (m,) int64
        Their indices among those of the emitter; each was stored where it first met a diffuse
        surface.
    rows : (m,) intp
        Of the photons in the map.
    """

    emitter_id: int
    photons: NDArray[np.int64]
    rows: NDArray[np.intp]


def joined(chosen: list[Retraced]) -> Iterator[Retraced]:
    """Yield photons of one emitter together, as many as are followed at a time."""
    for emitter_id in sorted({some.emitter_id for some in chosen}):
        mine = [some for some in chosen if some.emitter_id == emitter_id]
        photons = np.concatenate([some.photons for some in mine])
        rows = np.concatenate([some.rows for some in mine])
        for first in range(0, len(rows), CHUNK):
            part = slice(first, first + CHUNK)
            yield Retraced(emitter_id, photons[part], rows[part])


class SpectrumTracer:
    """A scene, its emission, and what it takes to know the spectra of its photons."""

    def __init__(
        self,
        scene: Scene,
        plan: EmissionPlan,
        caster: RayCaster,
        *,
        seed: int,
        sampler: str,
        max_bounces: int,
        n_threads: int | None = None,
    ) -> None:
        self._plan, self._seed, self._sampler = plan, seed, sampler
        self._table = scene.material_table()
        self._caster = caster
        self._paths = _kernel.Paths(
            surfaces(self._table),
            caster.frame,
            caster.triangles,
            CHUNK,
            wanted=PATHS.index("caustic"),
            max_bounces=max_bounces,
        )
        self._follower = Follower(scene, caster, n_threads)
        self._dot = _SMALL * scene.scale

    def spectra(self, chosen: Retraced) -> Floats:
        """Return (e, b, c) of up to `CHUNK` photons as they land; NaN where followed in vain."""
        emitter_id, photons = chosen.emitter_id, chosen.photons
        region = self._plan.regions[emitter_id]
        ways, rays = self._ways(emitter_id, photons)
        bundle = _Bundle(region, *rays)
        landings = self._follower.follow(bundle.beams(), ways)
        clear = clear_distance(self._follower, bundle, ways, landings)
        light = self._emitted(region, clear)
        out = np.full((len(photons), 3), np.nan)
        known = _known(landings)
        out[known] = operators.roughest(landings.operator[known] @ operators.root(light[known]))
        return out

    def _emitted(self, region: EmissionRegion, clear: Floats) -> Floats:
        """Return the spectra (n, 4, 4) of what leaves the emitter, through windows of a size."""
        light = np.zeros((len(clear), 4, 4))
        angle = range(2, 4)
        if region.is_plane:
            light[:, angle, angle] = 1.0 / (4.0 * np.pi**2 * _SMALL**2)
        else:
            light[:, range(2), range(2)] = 1.0 / (4.0 * np.pi**2 * self._dot**2)
            light[:, angle, angle] = operators.COSINE_LOBE if region.is_cosine_lobe else 0.0
        return operators.occluded(light, clear, angular=not region.is_plane)

    def _ways(
        self, emitter_id: int, photons: NDArray[np.int64]
    ) -> tuple[Ways, tuple[Floats, Floats]]:
        """Trace photons again; note what they meet, and the rays, two of (n, 3), they start as."""
        n = len(photons)
        steps: list[_Step] = []
        self._paths.start(
            emission(self._plan, emitter_id, seed=self._seed, sampler=self._sampler),
            photons,
            luminance=LUMINANCE * self._plan.flux_per_photon[emitter_id],
            ledger=np.zeros((-(-n // _kernel.BLOCK), len(PATH_OUTCOMES), 3)),
            ends=np.zeros(len(PATH_OUTCOMES), dtype=np.int64),
        )
        emitted = self._paths.live()
        rays = np.ascontiguousarray(emitted[:, 1:4]), emitted[:, 4:].copy()
        while self._paths.n_live:
            steps.append(self._step())
        return _noted(steps, n, self._table), rays

    def _step(self) -> _Step:
        before = self._paths.live()
        origin, direction = np.ascontiguousarray(before[:, 1:4]), before[:, 4:].copy()
        hits = empty_intersections(len(before))
        found = self._caster.find(*self._paths.rays)
        self._caster.triangles.refine_hits(origin, direction, found, hits)
        self._paths.advance(found)
        after = self._paths.live()
        path = before[:, 0].astype(np.intp)
        went_on = np.searchsorted(path, after[:, 0])
        towards = np.einsum("ni,ni->n", direction[went_on], hits.geometric_normal[went_on])
        onwards = np.einsum("ni,ni->n", after[:, 4:], hits.geometric_normal[went_on])
        reflected = np.zeros(len(path), dtype=bool)
        reflected[went_on] = towards * onwards < 0.0
        return _Step(path, hits, reflected)


@dataclass(frozen=True, eq=False)
class _Step:
    """What the paths that were still live met next."""

    path: NDArray[np.intp]
    hits: Intersections
    reflected: NDArray[np.bool_]


def _noted(steps: list[_Step], n: int, table: MaterialTable) -> Ways:
    ways = Ways(
        np.full((n, len(steps)), -1, dtype=np.int32),
        np.zeros((n, len(steps)), dtype=bool),
        np.zeros(n, dtype=np.intp),
    )
    for event, step in enumerate(steps):
        ways.objects[step.path, event] = step.hits.object_id
        ways.reflected[step.path, event] = step.reflected
        ended = table.kind[step.hits.object_id] == DIFFUSE
        ways.length[step.path[ended]] = event + 1
    return ways


def surfaces(table: MaterialTable) -> _kernel.Surfaces:
    """Return materials as the kernel takes them."""
    return _kernel.Surfaces(
        table.kind, table.reflectance, table.ior, table.exterior_ior, table.absorption
    )


class _Bundle:
    """Rays of one emitter, and others beside them."""

    def __init__(self, region: EmissionRegion, origin: Floats, direction: Floats) -> None:
        self._region, self._origin, self._direction = region, origin, direction
        self._across = _across(region, direction)
        self.reach = float(np.sqrt(region.area / np.pi))
        if not region.is_plane:
            self.reach = min(self.reach, 1.0)

    def __len__(self) -> int:
        return len(self._origin)

    def __getitem__(self, rows: NDArray) -> _Bundle:
        return _Bundle(self._region, self._origin[rows], self._direction[rows])

    def beams(self) -> Beams:
        return started(self._origin, self._direction, self._across, self._region.start_distance)

    def beside(self, offset: Floats) -> Beams:
        """Return beams that leave the emitter at offsets (n, 2), m or, as tangents, rad."""
        step = np.einsum("ni,nij->nj", offset, self._across)
        region = self._region
        if region.is_plane:
            return started(self._origin + step, self._direction, self._across, 0.0)
        direction = self._direction + step
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        if region.is_cosine_lobe:
            # Nothing leaves backwards; such a ray, turned over, meets nothing on the way.
            behind = direction @ region.frame[2] <= 0.0
            direction[behind] = -region.frame[2]
        origin = region.origin + region.start_distance * direction
        return started(origin, direction, self._across, region.start_distance)

    def stretch(self, landings: Landings) -> Floats:
        """Return how places along the receiver change with the emitter's coordinates (n, 2, 2)."""
        rays = np.swapaxes(np.linalg.inv(landings.operator), 1, 2)
        return rays[:, :2, :2] if self._region.is_plane else rays[:, :2, 2:]


def _across(region: EmissionRegion, direction: Floats) -> Floats:
    """Return unit vectors (n, 2, 3) across rays; those on an emitter's plane are all alike."""
    if region.is_plane:
        return np.broadcast_to(region.frame[:2], (len(direction), 2, 3))
    aside = np.eye(3)[np.abs(direction).argmin(axis=1)]
    first = np.cross(direction, aside)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(direction, first)], axis=1)


def clear_distance(follower: Follower, bundle: _Bundle, ways: Ways, landings: Landings) -> Floats:
    """Return how far around rays light goes their way, as their operators say, (n,).

    In the units of the emitter's coordinates, m or rad. Probes around a ray at an offset must meet
    the same surfaces and land, to half of the offset, where the first order expects them. Next to a
    fold that is the offset to the fold, and in general that over which light changes its stretch
    by as much as that is. Nor may they lose or gain half as much light on the way: where Fresnel
    reflectance or absorption change, as at the angle of total reflection.

    Probes are few. What is narrower than two thirds of its distance from the ray may be missed
    between them, and nearer than a 64th of the emitter's reach anything that the first probes, at
    that distance, do not meet.
    """
    clear = np.full(len(bundle), bundle.reach * 0.5**_RUNGS)

    def raised(rows: NDArray, scale: Floats) -> NDArray[np.bool_]:
        """Probe at a scale (m,) and raise what is clear to it where it is."""
        stray = _stray(follower, bundle[rows], ways[rows], landings[rows], scale)
        fine: NDArray[np.bool_] = stray <= _STRAY
        clear[rows[fine]] = scale[fine]
        return fine

    def at(rows: NDArray, rung: int) -> NDArray[np.bool_]:
        return raised(rows, np.full(len(rows), bundle.reach * 0.5**rung))

    rows = np.flatnonzero(_known(landings))
    fine = at(rows, _FIRST_RUNG)
    rising, falling = rows[fine], rows[~fine]
    for rung in reversed(range(_FIRST_RUNG)):
        rising = rising[at(rising, rung)]
    for rung in range(_FIRST_RUNG + 1, _RUNGS):
        falling = falling[~at(falling, rung)]
    for step in _STEPS:
        raised(rows, step * clear[rows])
    return _BETWEEN_SPOKES * clear


def _known(landings: Landings) -> NDArray[np.bool_]:
    return ~np.isnan(landings.position[:, 0])


def _stray(
    follower: Follower, bundle: _Bundle, ways: Ways, landings: Landings, scale: Floats
) -> Floats:
    """Return how far, over the offset, probes land from where they should; inf if elsewhere.

    Or by how much of itself the light changes that comes with them, if that is more.
    """
    stretch = bundle.stretch(landings)
    determinant = np.abs(stretch[:, 0, 0] * stretch[:, 1, 1] - stretch[:, 0, 1] * stretch[:, 1, 0])
    worst = np.zeros(len(bundle))
    for turn in 2.0 * np.pi * np.arange(_SPOKES) / _SPOKES:
        offset = scale[:, np.newaxis] * [np.cos(turn), np.sin(turn)]
        probes = follower.follow(bundle.beside(offset), ways)
        along = np.einsum("nij,nj->ni", landings.axes, probes.position - landings.position)
        error = along - np.einsum("nij,nj->ni", stretch, offset)
        # The adjugate, for the stretch has no inverse at folds.
        back = np.column_stack(
            [
                stretch[:, 1, 1] * error[:, 0] - stretch[:, 0, 1] * error[:, 1],
                stretch[:, 0, 0] * error[:, 1] - stretch[:, 1, 0] * error[:, 0],
            ]
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.linalg.norm(back, axis=1) / (scale * determinant)
            change = np.abs(probes.throughput / landings.throughput - 1.0).max(axis=1)
        ratio = np.maximum(ratio, change)
        alike = np.einsum("ni,ni->n", probes.normal, landings.normal) > MIN_NORMAL_COSINE
        worst = np.maximum(worst, np.where(alike & ~np.isnan(ratio), ratio, np.inf))
    return worst
