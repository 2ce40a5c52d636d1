"""Light that leaves points of an emitter, along all paths through mirrors and glass."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from .._ext.transport.materials import Materials
from .._ext.transport.splitting import SplitPaths
from .._util.parallel import ordered_map, thread_executor
from .._util.validation import Floats
from ..scene.scene import Scene
from .media import MediaFinder
from .raycast import RayCaster

# Rays traced together.
_BATCH = 8192
# Events after which a ray ends.
MAX_BOUNCES = 32


@dataclass(frozen=True, eq=False)
class Arrivals:
    """Light that has arrived on diffuse surfaces by specular paths, of m nodes and paths.

    Attributes
    ----------
    node : (m,) int64
        Row of the ray that the light left its emitter by.
    signature : (m,) uint64
        Of the path: objects met, and whether light was reflected, entered or left.
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
    signature: NDArray[np.uint64]
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


class SplittingTracer:
    """A scene prepared for following both branches of rays at dielectrics.

    Parameters
    ----------
    scene : Scene
        Its surfaces and emitters.
    least_throughput : float
        Branches of less in every channel go on as single photons, by roulette.
    n_threads : int
        Threads, between which batches are divided; results do not depend on them.

    Attributes
    ----------
    n_segments : int
        Rays cast so far.
    """

    def __init__(
        self,
        scene: Scene,
        least_throughput: float,
        n_threads: int,
        *,
        caster: RayCaster | None = None,
    ) -> None:
        if scene.has_dispersion:
            raise ValueError(
                "scene should have no dispersion for method='envelope', whose rays have one index "
                "of refraction: take a method of photons, 'mapped' say, or give dielectrics a "
                "number as ior"
            )
        self._materials = Materials(scene.material_table())
        self._caster = caster or RayCaster(scene.surfaces)
        self._media = MediaFinder(scene, self._caster, self._materials).at_emitters()
        self._least_throughput, self._n_threads = least_throughput, n_threads
        self.n_segments = 0

    def trace(
        self, origin: Floats, direction: Floats, key: NDArray[np.uint64], emitter_id: int
    ) -> Arrivals:
        """Arrivals of rays (n, 3) of an emitter, by node; `key` (n,) seeds what roulette draws."""
        with thread_executor(self._n_threads) as executor:
            batches = [slice(first, first + _BATCH) for first in range(0, len(key), _BATCH)]
            parts = ordered_map(
                lambda rows: self._batch(origin, direction, key, rows, emitter_id),
                batches,
                executor,
                max_pending=2 * self._n_threads,
            )
            arrivals = []
            for part, n_segments in parts:
                arrivals.append(part)
                self.n_segments += n_segments
        return Arrivals.concatenate(arrivals)

    def _batch(
        self,
        origin: Floats,
        direction: Floats,
        key: NDArray[np.uint64],
        rows: slice,
        emitter_id: int,
    ) -> tuple[Arrivals, int]:
        paths = SplitPaths(
            self._materials,
            self._caster.frame,
            self._caster.triangles,
            least_throughput=self._least_throughput,
            max_bounces=MAX_BOUNCES,
        )
        paths.start(origin[rows], direction[rows], key[rows], media=int(self._media[emitter_id]))
        n_segments = 0
        while paths.n_live:
            n_segments += paths.n_live
            paths.advance(self._caster.find_paths(paths))
        columns = paths.arrivals()
        order = np.argsort(columns["node"], kind="stable")
        columns = {name: column[order] for name, column in columns.items()}
        columns["node"] = columns["node"].astype(np.int64) + (rows.start or 0)
        return Arrivals(**columns), n_segments
