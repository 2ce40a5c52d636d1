"""Light that leaves points of an emitter, along all paths through mirrors and glass."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._ext.transport.materials import Materials
from .._ext.transport.splitting import SplitPaths
from .._util.validation import Floats
from .._util.workers import worker_map
from ..scene.scene import Scene
from .media import media_at_emitters
from .raycast import RayCaster

Signatures = NDArray[np.uint64]

# Rays traced together, at most and at least.
_BATCH, _LEAST_BATCH = 2048, 512
# Events after which a ray ends.
MAX_BOUNCES = 32


@dataclass(frozen=True, eq=False)
class Arrivals:
    """Light that has arrived on diffuse surfaces by specular paths, of m nodes and paths.

    Attributes
    ----------
    node : (m,) int64
        Row of the ray that the light left its emitter by.
    sheet : (m,) uint64
        Path, objects met and whether light was reflected, entered or left, and surface it is on.
    position, normal : (m, 3) float64
        m, and the geometric normal on the side of the light.
    throughput : (m, 3) float64
        Share of the node's light.
    object_id : (m,) int32
        Surface that the light arrived on.
    is_single : (m,) bool
        True where roulette has chosen between paths: such light stands for that of other nodes.
    """

    node: NDArray[np.int64]
    sheet: NDArray[np.uint64]
    position: Floats
    normal: Floats
    throughput: Floats
    object_id: NDArray[np.int32]
    is_single: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.node)

    def __getitem__(self, rows: NDArray) -> Arrivals:
        return Arrivals(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    def moved(self, n_nodes: int) -> Arrivals:
        """The same of nodes that are counted from `n_nodes` on."""
        return replace(self, node=self.node + n_nodes)

    @classmethod
    def none(cls) -> Arrivals:
        """No arrivals."""
        vectors = {name: np.empty((0, 3)) for name in ("position", "normal", "throughput")}
        return cls(
            np.empty(0, np.int64),
            np.empty(0, np.uint64),
            **vectors,
            object_id=np.empty(0, np.int32),
            is_single=np.empty(0, np.bool_),
        )

    @classmethod
    def concatenate(cls, parts: list[Arrivals]) -> Arrivals:
        """All arrivals, in the order of the parts."""
        return cls(
            **{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)}
        )


class _Job(NamedTuple):
    """Rays (n, 3) with keys (n,), whose nodes are counted from `first` on.

    `media` are those around their emitter; `followed` (k,) is None for all paths.
    """

    origin: Floats
    direction: Floats
    key: Signatures
    first: int
    media: int
    followed: Signatures | None


class _Batch(NamedTuple):
    """Arrivals of some rays; signatures (k, 2) as of `SplittingTracer.explore`; rays cast."""

    arrivals: Arrivals
    signatures: Signatures
    n_segments: int


class _Context:
    """A scene prepared for tracing batches, from several threads at once.

    It is pickled by its arguments: `worker_map` keeps it in its workers.
    """

    def __init__(
        self, scene: Scene, least_throughput: float, *, caster: RayCaster | None = None
    ) -> None:
        self.scene, self.least_throughput = scene, least_throughput
        self.materials = Materials(scene.material_table())
        self.caster = caster or RayCaster(scene.surfaces)

    def __reduce__(self) -> tuple:
        return partial(_Context, caster=self.caster), (self.scene, self.least_throughput)

    def paths(self, followed: Signatures | None) -> SplitPaths:
        """Paths, all or those that are followed."""
        return SplitPaths(
            self.materials,
            self.caster.frame,
            self.caster.triangles,
            least_throughput=self.least_throughput,
            max_bounces=MAX_BOUNCES,
            followed=followed,
        )


def _traced_batch(context: _Context, job: _Job) -> _Batch:
    """Arrivals of some rays."""
    paths = context.paths(job.followed)
    paths.start(job.origin, job.direction, job.key, media=job.media)
    n_segments, signatures = 0, [np.empty((0, 2), np.uint64)]
    while paths.n_live:
        n_segments += paths.n_live
        paths.advance(context.caster.find_paths(paths))
        if paths.follows_all:
            signatures.append(paths.signatures())
    columns = paths.arrivals()
    order = np.argsort(columns["node"], kind="stable")
    columns = {name: column[order] for name, column in columns.items()}
    columns["node"] = columns["node"].astype(np.int64) + job.first
    before = np.unique(np.concatenate(signatures), axis=0)
    return _Batch(Arrivals(**columns), before, n_segments)


class SplittingTracer:
    """A scene prepared for following both branches of rays at dielectrics.

    Parameters
    ----------
    scene : Scene
        Its surfaces and emitters.
    least_throughput : float
        Branches of less in every channel go on as single photons, by roulette.
    executor : concurrent.futures.Executor, optional
        As of `worker_map`: batches are divided between its workers, on which results do not depend.

    Attributes
    ----------
    n_rays, n_segments : int
        Rays from emitters so far, and all that were cast.
    """

    def __init__(
        self,
        scene: Scene,
        least_throughput: float,
        *,
        caster: RayCaster | None = None,
        executor: Executor | None = None,
    ) -> None:
        if scene.has_dispersion:
            raise ValueError(
                "scene should have no dispersion for method='envelope', whose rays have one index "
                "of refraction: take a method of photons, 'mapped' say, or give dielectrics a "
                "number as ior"
            )
        self._context = _Context(scene, least_throughput, caster=caster)
        context = self._context
        self._media = media_at_emitters(scene, context.caster, context.materials)[0]
        self._executor = executor
        self.n_rays = self.n_segments = 0

    def explore(
        self, origin: Floats, direction: Floats, key: NDArray[np.uint64], emitter_id: int
    ) -> tuple[Arrivals, Signatures]:
        """Arrivals of rays (n, 3) of an emitter along all paths, by node.

        `key` (n,) seeds what roulette draws. The second are the signatures of all paths (k, 2),
        and of those one event before, in ascending order.
        """
        found = self._traced((origin, direction, key), None, emitter_id)
        before = np.unique(np.concatenate([part.signatures for part in found]), axis=0)
        return Arrivals.concatenate([part.arrivals for part in found]), before

    def trace(
        self, origin: Floats, direction: Floats, followed: Signatures, emitter_id: int
    ) -> Arrivals:
        """Arrivals of rays (n, 3) of an emitter by some paths, by node.

        `followed` (k,) are the sheets, and the signatures of paths that lead to them, ascending.
        """
        unused = np.zeros(len(origin), np.uint64)
        found = self._traced((origin, direction, unused), followed, emitter_id)
        return Arrivals.concatenate([part.arrivals for part in found])

    def _traced(
        self, rays: tuple[Floats, Floats, Signatures], followed: Signatures | None, emitter_id: int
    ) -> list[_Batch]:
        """Batches of rays: their origins, directions and keys."""
        media, n = int(self._media[emitter_id]), len(rays[2])
        origin, direction, key = rays
        # Two batches at least, if they are worth sending.
        size = min(max(-(-n // 2), _LEAST_BATCH), _BATCH)
        parts = (slice(first, first + size) for first in range(0, max(n, 1), size))
        jobs = (
            _Job(origin[part], direction[part], key[part], part.start, media, followed)
            for part in parts
        )
        executor = self._executor if n > size else None
        found = list(worker_map(_traced_batch, self._context, jobs, executor))
        self.n_rays += n
        self.n_segments += sum(part.n_segments for part in found)
        return found
