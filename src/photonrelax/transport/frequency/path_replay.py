"""Replay of photon paths: rays sent through the recorded events of a path.

Neighbours of a photon's primal ray meet the same surfaces and are reflected or refracted like it;
each carries the operator of its path (see `operators`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from ..._util.parallel import thread_count
from ..._util.validation import Floats
from ...scene.scene import Scene
from ..hidden import first_hits
from ..raycast import Intersections, RayCaster
from .paraxial import ParaxialOptics, ParaxialRays, at_receivers


@dataclass(frozen=True, eq=False)
class PathEvents:
    """Event sequences of n paths, up to the first diffuse surface.

    Attributes
    ----------
    objects : (n, depth) int32
        Objects hit, the diffuse receiver last; -1 beyond.
    reflected : (n, depth) bool
        True for reflections, false for refractions.
    length : (n,) intp
        Number of objects hit.
    """

    objects: NDArray[np.int32]
    reflected: NDArray[np.bool_]
    length: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.length)

    def __getitem__(self, rows: NDArray | slice) -> PathEvents:
        return PathEvents(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


@dataclass(frozen=True, eq=False)
class ReplayHits:
    """Hits of rays on the receivers of their paths; NaN for rays that left the path.

    Attributes
    ----------
    position, normal : (n, 3)
        m, and the geometric normal on the side of the light.
    axes : (n, 2, 3)
        Unit vectors along the surface, in the plane of incidence and perpendicular to it.
    operator : (n, 4, 4)
        From the frequencies of the light as it left the emitter to those along `axes`.
    throughput : (n, 3)
        Transmitted share of the light, without tints and reflectances that do not rise.
    """

    position: Floats
    normal: Floats
    axes: Floats
    operator: Floats
    throughput: Floats

    def __getitem__(self, rows: NDArray | slice) -> ReplayHits:
        return ReplayHits(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    @property
    def on_path(self) -> NDArray[np.bool_]:
        """True for rays that followed their path to its receiver, (n,)."""
        return ~np.isnan(self.position[:, 0])


class PathReplayer:
    """A scene prepared for the replay of paths."""

    def __init__(self, scene: Scene, caster: RayCaster, n_threads: int | None = None) -> None:
        self._caster = caster
        self._optics = ParaxialOptics(scene)
        self._n_threads = thread_count(n_threads)

    def replay(self, rays: ParaxialRays, events: PathEvents) -> ReplayHits:
        """Hits of rays on the receivers of their paths, a row each."""
        n = len(events)
        shapes = ((n, 3), (n, 3), (n, 2, 3), (n, 4, 4), (n, 3))
        out = ReplayHits(*(np.full(shape, np.nan) for shape in shapes))
        rows = np.arange(n)
        for event in range(int(events.length.max(initial=0))):
            hits, media = first_hits(
                self._caster,
                self._optics.materials,
                (rays.origin, rays.direction, rays.origin_offset),
                rays.media,
                self._n_threads,
            )
            rays = replace(rays, media=media)
            on_path = hits.object_id == events.objects[rows, event]
            rows, rays, hits = rows[on_path], rays[on_path], hits[on_path]
            rays = self._optics.propagate(rays, hits)
            ends = events.length[rows] == event + 1
            _record_hits(out, rows[ends], rays[ends], hits[ends])
            rows, rays, hits = rows[~ends], rays[~ends], hits[~ends]
            rays = self._optics.scatter(rays, hits, events.reflected[rows, event])
        return out


def _record_hits(out: ReplayHits, rows: NDArray, rays: ParaxialRays, hits: Intersections) -> None:
    out.normal[rows], out.axes[rows], out.operator[rows] = at_receivers(rays, hits)
    out.position[rows] = hits.position
    out.throughput[rows] = rays.throughput
