"""Local frequency spectra of traced photons, by replay of their paths with neighbours around them.

Light of collimated and point-like emitters has one ray for every emitter coordinate. Whatever cuts
off a part of it, wherever on the path, therefore cuts off a part of the emitter coordinates, and
the distance to that part is the width of the window that widens the spectrum at the emitter
("Occlusion" in docs/methods/frequency.md). `occlusion_distance` finds it with probe rays around the
photon's, at offsets that double.

Apart from the window, the light that leaves an emitter is as smooth as can be:

* collimated light has no spatial frequencies, and the angular bandwidth of a source of 1e-6 rad;
* a point has the spatial bandwidth of a source of 1e-6 of the scene's size, and no angular
  frequencies where it is isotropic, or those of a cosine where it is Lambertian.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..._util.validation import Floats
from ...photons.axes import MIN_NORMAL_COSINE
from ...scene.emission_region import DISK, EmissionRegion
from ..batch import TraceContext
from ..frequency import operators
from ..raycast import Intersections, empty_intersections
from .paraxial import ParaxialRays, emitted_rays
from .path_replay import PathEvents, PathReplayer, ReplayHits

# Photons replayed at a time.
BATCH_SIZE = 4096
# Standard deviation of the angles in collimated light, rad, and of the positions in the light of a
# point, over the scene's size.
_SOURCE_SIZE = 1e-6
# Offsets of probes: level l is 2^-l of the emitter's radius. The first level that is tried, and
# the number of levels.
_FIRST_LEVEL, _N_LEVELS = 6, 11
# Factors tried between the largest level without occlusion and the next.
_REFINEMENTS = (2**0.5, 2**0.25)
# Probes around a ray, at equal angles.
_N_PROBES = 8
# Lower bound of the distance to an edge or fold over the offset of probes that do not see it. An
# edge between two probes is nearer by the cosine of half the angle between them, a fold by its
# square.
_BETWEEN_PROBES = np.cos(np.pi / _N_PROBES) ** 2
# Largest deviation of a probe from the linear prediction, over its offset, and largest relative
# change of its throughput: as roughness of the light the two count alike.
_MAX_LINEARISATION_ERROR = 0.5


@dataclass(frozen=True, eq=False)
class ReplayBatch:
    """Photons of one emission region whose paths are replayed.

    Attributes
    ----------
    region_id : int
        Index of the region in the emission plan.
    photons : (m,) int64
        Indices among the candidates of the region; each was stored at its first diffuse hit.
    rows : (m,) intp
        Rows of the photons in the map.
    """

    region_id: int
    photons: NDArray[np.int64]
    rows: NDArray[np.intp]


def batches_by_region(
    region_id: NDArray[np.intp], photons: NDArray[np.int64], rows: NDArray[np.intp]
) -> Iterator[ReplayBatch]:
    """Divide photons (m,), sorted by their regions, into batches of up to `BATCH_SIZE` of one."""
    starts = np.flatnonzero(np.diff(region_id, prepend=-1))
    for start, stop in zip(starts, [*starts, len(rows)][1:], strict=True):
        for first in range(start, stop, BATCH_SIZE):
            part = slice(first, min(first + BATCH_SIZE, stop))
            yield ReplayBatch(int(region_id[first]), photons[part], rows[part])


class SpectrumTracer:
    """A scene and its emission, prepared for the spectra of its photons."""

    def __init__(self, context: TraceContext, n_threads: int | None = None) -> None:
        self._context = context
        self._paths = context.new_paths(BATCH_SIZE, "caustic")
        self._replayer = PathReplayer(context.scene, context.caster, n_threads)
        self._point_size = _SOURCE_SIZE * context.scene.scale

    def spectra(self, batch: ReplayBatch) -> Floats:
        """(e, b, c) of up to `BATCH_SIZE` photons at their receivers, (n, 3).

        NaN for photons whose replay leaves the path.
        """
        emitter_id, _, region, _ = self._context.plan.aimed[batch.region_id]
        events, origin, direction = self._trace_events(batch.region_id, batch.photons)
        bundle = _Bundle(region, origin, direction, self._context.media[emitter_id])
        hits = self._replayer.replay(bundle.rays(), events)
        distance = occlusion_distance(self._replayer, bundle, events, hits)
        light = self._emitted(region, distance)
        out = np.full((len(events), 3), np.nan)
        on_path = hits.on_path
        out[on_path] = operators.roughest(hits.operator[on_path] @ operators.root(light[on_path]))
        return out

    def _emitted(self, region: EmissionRegion, distance: Floats) -> Floats:
        """Spectra (n, 4, 4) of the light at the emitter, occluded at a distance (n,)."""
        light = np.zeros((len(distance), 4, 4))
        space, angle = range(2), range(2, 4)
        if region.is_plane:
            light[:, angle, angle] = 1.0 / (4.0 * np.pi**2 * _SOURCE_SIZE**2)
        else:
            light[:, space, space] = 1.0 / (4.0 * np.pi**2 * self._point_size**2)
            light[:, angle, angle] = operators.COSINE_LOBE if region.is_cosine_lobe else 0.0
        return operators.occluded(light, distance, angular=not region.is_plane)

    def _trace_events(
        self, region_id: int, photons: NDArray[np.int64]
    ) -> tuple[PathEvents, Floats, Floats]:
        """Trace photons again; return their events and their primal rays, two of (n, 3)."""
        steps: list[_Step] = []
        region, counts = np.array([region_id]), np.array([len(photons)])
        self._context.start(self._paths, region, counts, photons, in_order=True)
        _, origin, direction = self._paths.live_rays()
        while self._paths.n_live:
            steps.append(self._step())
        return _path_events(steps, len(photons), self._context.materials.diffuse), origin, direction

    def _step(self) -> _Step:
        """Advance the live paths by one event."""
        path, origin, direction = self._paths.live_rays()
        hits = empty_intersections(len(path))
        found = self._context.caster.find_paths(self._paths)
        self._context.caster.triangles.refine_hits(origin, direction, found, hits)
        self._paths.advance(found)
        live, _, outgoing = self._paths.live_rays()
        row = np.searchsorted(path, live)
        normal = hits.geometric_normal[row]
        height_in = np.einsum("ni,ni->n", direction[row], normal)
        height_out = np.einsum("ni,ni->n", outgoing, normal)
        reflected = np.zeros(len(path), dtype=bool)
        reflected[row] = height_in * height_out < 0.0
        return _Step(path, hits, reflected)


@dataclass(frozen=True, eq=False)
class _Step:
    """The next event of each path that was still live."""

    path: NDArray[np.intp]
    hits: Intersections
    reflected: NDArray[np.bool_]


def _path_events(steps: list[_Step], n: int, is_diffuse: NDArray[np.bool_]) -> PathEvents:
    """Collect the steps of n paths; `is_diffuse` (n_objects,) flags objects."""
    events = PathEvents(
        np.full((n, len(steps)), -1, dtype=np.int32),
        np.zeros((n, len(steps)), dtype=bool),
        np.zeros(n, dtype=np.intp),
    )
    for event, step in enumerate(steps):
        events.objects[step.path, event] = step.hits.object_id
        events.reflected[step.path, event] = step.reflected
        ended = is_diffuse[step.hits.object_id]
        events.length[step.path[ended]] = event + 1
    return events


class _Bundle:
    """Primal rays of one emitter, and probes beside them; `media` are those at the emitter.

    `radius` is that of a disk of the area of the emission region, at most one radian: m or rad.
    """

    def __init__(
        self, region: EmissionRegion, origin: Floats, direction: Floats, media: int = 0
    ) -> None:
        self._region, self._origin, self._direction = region, origin, direction
        self._media = media
        self._across = _across(region, direction)
        self.radius = float(np.sqrt(region.area / np.pi))
        if not region.is_plane:
            self.radius = min(self.radius, 1.0)

    def __len__(self) -> int:
        return len(self._origin)

    def __getitem__(self, rows: NDArray) -> _Bundle:
        return _Bundle(self._region, self._origin[rows], self._direction[rows], self._media)

    def rays(self) -> ParaxialRays:
        """The primal rays."""
        return self._emitted(self._origin, self._direction, self._region.start_distance)

    def probes(self, offset: Floats) -> ParaxialRays:
        """Rays at offsets (n, 2) of the emitter coordinates, m or, as tangents, rad."""
        step = np.einsum("ni,nij->nj", offset, self._across)
        region = self._region
        if region.is_plane:
            return self._emitted(self._origin + step, self._direction, 0.0)
        direction = self._direction + step
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        if region.is_cosine_lobe:
            # Nothing leaves backwards; such a probe leaves the path at once if it is turned over.
            behind = direction @ region.frame[2] <= 0.0
            direction[behind] = -region.frame[2]
        origin = region.origin + region.start_distance * direction
        return self._emitted(origin, direction, region.start_distance)

    def _emitted(self, origin: Floats, direction: Floats, travelled: float) -> ParaxialRays:
        return emitted_rays(origin, direction, self._across, travelled=travelled, media=self._media)

    def jacobian(self, hits: ReplayHits) -> Floats:
        """Derivatives (n, 2, 2) of positions on the receiver by the emitter coordinates."""
        rays = np.swapaxes(np.linalg.inv(hits.operator), 1, 2)
        return rays[:, :2, :2] if self._region.is_plane else rays[:, :2, 2:]


def _across(region: EmissionRegion, direction: Floats) -> Floats:
    """Unit vectors (n, 2, 3) across rays; the same for all rays of a plane."""
    if region.kind == DISK:
        return np.broadcast_to(region.frame[:2], (len(direction), 2, 3))
    aside = np.eye(3)[np.abs(direction).argmin(axis=1)]
    first = np.cross(direction, aside)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(direction, first)], axis=1)


def occlusion_distance(
    replayer: PathReplayer, bundle: _Bundle, events: PathEvents, hits: ReplayHits
) -> Floats:
    """Distances (n,) around rays up to which light follows the same path, nearly linearly.

    In the units of the emitter coordinates, m or rad. Probes at this offset hit the same surfaces
    and arrive, to half of the offset, where the operator predicts. Next to a fold that is the
    distance to the fold; in general it is that over which the Jacobian changes by as much as it
    is. Nor does the throughput change by more than half, as it does by the Fresnel reflectance near
    the angle of total reflection, or by absorption.

    Occluders narrower than two thirds of their distance from the ray may lie between the probes
    undetected. So may any that are nearer than the first probes, at a 64th of the emitter's
    radius, if those miss them.
    """
    distance = np.full(len(bundle), bundle.radius * 0.5**_N_LEVELS)

    def probe(rows: NDArray, offset: Floats) -> NDArray[np.bool_]:
        """Raise the distances of rows to an offset (m,) where probes there are not occluded."""
        error = _linearisation_error(replayer, bundle[rows], events[rows], hits[rows], offset)
        clear: NDArray[np.bool_] = error <= _MAX_LINEARISATION_ERROR
        distance[rows[clear]] = offset[clear]
        return clear

    def probe_level(rows: NDArray, level: int) -> NDArray[np.bool_]:
        return probe(rows, np.full(len(rows), bundle.radius * 0.5**level))

    rows = np.flatnonzero(hits.on_path)
    clear = probe_level(rows, _FIRST_LEVEL)
    rising, falling = rows[clear], rows[~clear]
    for level in reversed(range(_FIRST_LEVEL)):
        rising = rising[probe_level(rising, level)]
    for level in range(_FIRST_LEVEL + 1, _N_LEVELS):
        falling = falling[~probe_level(falling, level)]
    for factor in _REFINEMENTS:
        probe(rows, factor * distance[rows])
    return _BETWEEN_PROBES * distance


def _linearisation_error(
    replayer: PathReplayer,
    bundle: _Bundle,
    events: PathEvents,
    hits: ReplayHits,
    offset: Floats,
) -> Floats:
    """Largest errors (n,) of the linear prediction among probes around rays at an offset (n,).

    The error of a probe is the distance, in emitter coordinates, between its hit and the predicted
    one over the offset, or the relative change of its throughput if that is larger; infinite if it
    leaves the path or hits a face that is turned away from that of the ray.
    """
    jacobian = bundle.jacobian(hits)
    determinant = np.abs(
        jacobian[:, 0, 0] * jacobian[:, 1, 1] - jacobian[:, 0, 1] * jacobian[:, 1, 0]
    )
    worst = np.zeros(len(bundle))
    for angle in 2.0 * np.pi * np.arange(_N_PROBES) / _N_PROBES:
        step = offset[:, np.newaxis] * [np.cos(angle), np.sin(angle)]
        probes = replayer.replay(bundle.probes(step), events)
        along = np.einsum("nij,nj->ni", hits.axes, probes.position - hits.position)
        error = _adjugate(jacobian, along - np.einsum("nij,nj->ni", jacobian, step))
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.linalg.norm(error, axis=1) / (offset * determinant)
            change = np.abs(probes.throughput / hits.throughput - 1.0).max(axis=1)
        ratio = np.maximum(ratio, change)
        facing = np.einsum("ni,ni->n", probes.normal, hits.normal) > MIN_NORMAL_COSINE
        worst = np.maximum(worst, np.where(facing & ~np.isnan(ratio), ratio, np.inf))
    return worst


def _adjugate(matrix: Floats, vector: Floats) -> Floats:
    """Adjugate of matrices (n, 2, 2), which unlike the inverse exists at folds, times vectors."""
    return np.column_stack(
        [
            matrix[:, 1, 1] * vector[:, 0] - matrix[:, 0, 1] * vector[:, 1],
            matrix[:, 0, 0] * vector[:, 1] - matrix[:, 1, 0] * vector[:, 0],
        ]
    )
