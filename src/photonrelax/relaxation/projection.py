"""The objects photons lie on, and putting photons that moved back on them."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from .._ext.relaxation.projection import DOWN, UP, Moves, Places
from .._util.validation import Floats, Rows
from ..photons.photon_map import PhotonMap
from ..scene.scene import Scene
from ..transport.raycast import RayCaster

# The rays that put a photon back start this fraction of the scene before it, a few times what
# float32 rays resolve.
_START = 2e-6
# Photons a thread puts back at a time.
_CHUNK = 16384


class Surfaces:
    """The objects of a scene, and where on them each of n photons lies.

    Parameters
    ----------
    scene : Scene
        What the photons lie on.
    photons : PhotonMap
        Where they lie to begin with.
    n_threads : int
        Threads to use; the result does not depend on it.

    Raises
    ------
    ValueError
        If the map has no `object_id`, or one that is not of the scene.
    """

    def __init__(self, scene: Scene, photons: PhotonMap, n_threads: int) -> None:
        if photons.object_id is None:
            raise ValueError("photons should have an object_id to be kept on the scene's objects")
        n_objects = len(scene.objects)
        if photons.object_id.min() < 0 or photons.object_id.max() >= n_objects:
            raise ValueError(
                f"object_id should be of the scene's {n_objects} objects, but ranges from "
                f"{photons.object_id.min()} to {photons.object_id.max()}"
            )
        self._caster = RayCaster(scene.objects)
        self._places = Places(
            self._caster.frame, self._caster.triangles, photons.object_id, _START * scene.scale
        )
        self._n_threads = n_threads
        self._n_photons = len(photons)
        numbers = np.arange(len(photons))
        here, normal = photons.position, photons.normal
        self._for_chunks(
            lambda part: self._answer(Moves(here[part], normal[part], here[part], numbers[part])),
            len(photons),
        )

    def put_back(
        self, position: Floats, normal: Floats, moved: Floats, rows: Rows
    ) -> tuple[Floats, Floats]:
        """Return where moved photons meet their own object, and the normals there.

        Where a photon meets nothing, another object or a face that is turned away, it has left
        its surface, and the move is not made. A photon still over or under the triangle it lay
        on, no farther than rays resolve, is on it whatever else is that near.

        Parameters
        ----------
        position, normal : (m, 3)
            Where the photons lie, from the map or from the last call, m.
        moved : (m, 3)
            Where they would like to be, m.
        rows : slice or (m,) intp
            Which photons of the map they are, each at most once.
        """
        photons = rows if isinstance(rows, np.ndarray) else np.arange(self._n_photons)[rows]
        to, to_normal = np.empty_like(position), np.empty_like(normal)
        columns = (position, normal, moved, photons, to, to_normal)
        self._for_chunks(lambda part: self._answer(Moves(*(c[part] for c in columns))), len(moved))
        return to, to_normal

    def _answer(self, moves: Moves) -> None:
        """Put photons back, first without rays, then down their normals, then up."""
        self._places.put_back(moves)
        for way in (DOWN, UP):
            if moves.n_pending:
                self._places.cast(moves, way)
                found = self._caster.find(moves.origins, moves.directions)
                self._places.settle(moves, found, way)

    def _for_chunks(self, work: Callable[[slice], None], n: int) -> None:
        chunks = [slice(first, first + _CHUNK) for first in range(0, n, _CHUNK)]
        if self._n_threads == 1 or len(chunks) == 1:
            for chunk in chunks:
                work(chunk)
            return
        with ThreadPoolExecutor(self._n_threads) as pool:
            list(pool.map(work, chunks))
