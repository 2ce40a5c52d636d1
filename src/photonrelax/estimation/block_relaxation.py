"""Methods that relax photons, of maps larger than memory: from parts on disk to blocks on disk."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple, Unpack
from uuid import uuid4

from .._util.parallel import thread_count
from .._util.progress import Progress, Reporter
from .._util.validation import count
from .._util.workers import Workers, checked_executor
from ..photons.blocks import PHOTONS_PER_BLOCK, BlockedPhotons, sort_into_blocks
from ..photons.parts import PhotonParts
from ..relaxation.block_rest import rest_density_by_blocks
from ..relaxation.blocks import BlockRelaxation, BlockWork, n_passes
from ..scene.scene import Scene
from ..transport.raycast import RayCaster
from .methods import DEFAULT_METHOD, Method, Settings, StageSettings, method_named, settings_of


def relax_parts(
    parts: PhotonParts | str | os.PathLike[str],
    folder: str | os.PathLike[str],
    *,
    method: str = DEFAULT_METHOD,
    scene: Scene | None = None,
    photons_per_block: int = PHOTONS_PER_BLOCK,
    n_threads: int | None = None,
    progress: Progress | None = None,
    executor: Executor | None = None,
    **settings: Unpack[StageSettings],
) -> BlockedPhotons:
    """Relax photons in parts on disk, by blocks of space; memory follows the blocks.

    The photons are those that the method relaxes in one piece, but for rounding.

    Parameters
    ----------
    parts : PhotonParts or path
        All parts of an emission, from `trace_parts`.
    folder : path
        A new one, of the relaxed photons, there when all is done; meanwhile twice the parts' room.
    method : str
        One that relaxes by structure: ``mapped`` or ``parameterised``.
    scene : Scene, optional
        Keeps moved photons on their objects; see `photonrelax.relaxation.relax`.
    photons_per_block : int
        Photons of a block, about, each of which takes some 500 bytes.
    n_threads : int, optional
        Threads, of a task with an executor; all available by default. Results do not depend on it.
    progress : callable, optional
        Called as ``progress("relax", done, total)`` in photons, in all passes over them.
    executor : concurrent.futures.Executor, optional
        Relaxes blocks; its workers have to see both folders.
    **settings
        Of stages; see `StageSettings`.

    Raises
    ------
    TypeError, ValueError
        If an argument is invalid, parts are damaged or missing, or the method does not relax by
        structure.
    FileExistsError
        If there is such a folder already.
    """
    chosen, folder = _relaxing_by_structure(method), Path(folder)
    given = settings_of("relax_parts", dict(settings)).given
    parts = parts if isinstance(parts, PhotonParts) else PhotonParts.open(parts)
    _check_parts(parts)
    if folder.exists():
        raise FileExistsError(f"{folder} should be a new folder, but there is one already")
    threads = thread_count(1 if executor is not None and n_threads is None else n_threads)
    with _unfinished(folder) as unfinished:
        n = count(photons_per_block, "photons_per_block")
        blocked = sort_into_blocks(
            parts.maps, len(parts), unfinished, photons_per_block=n, n_threads=threads
        )
        relaxing = _Relaxing(blocked, chosen, Settings(**{**chosen.defaults, **given}), scene)
        relaxing.run(Workers(checked_executor(executor), threads), threads, progress)
    return BlockedPhotons.open(folder)


def _relaxing_by_structure(name: str) -> Method:
    method = method_named(name)
    if method.relax is None or "structure" not in method.stages:
        raise ValueError(
            f"method should be one that relaxes photons by their structure, mapped or "
            f"parameterised, to relax them by blocks, but is {name!r}"
        )
    return method


def _check_parts(parts: PhotonParts) -> None:
    if not parts.is_whole:
        raise ValueError(
            f"{parts.folder} should have all photons of the emission, but has the first "
            f"{parts.n_traced:,}: go on tracing with the same arguments"
        )
    if not len(parts):
        raise ValueError(f"{parts.folder} should have photons, but none were stored")


@contextmanager
def _unfinished(folder: Path) -> Iterator[Path]:
    """Path that takes the place of a folder if all goes well, and is removed otherwise."""
    path = folder.with_name(f".{folder.name}.{uuid4().hex}.part")
    try:
        yield path
        path.replace(folder)
    finally:
        shutil.rmtree(path, ignore_errors=True)


class _Relaxing(NamedTuple):
    """Sorted photons, and the method that relaxes them."""

    photons: BlockedPhotons
    method: Method
    settings: Settings
    scene: Scene | None

    def run(self, workers: Workers, n_threads: int, progress: Progress | None) -> None:
        """Do all passes over the photons."""
        photons, scene, relax = self.photons, self.scene, self.settings.of("relax")
        has_rest = "rest_density" in self.method.stages
        caster = None if scene is None else RayCaster(scene.surfaces)
        structure = self.settings.of("structure")
        work = BlockWork(photons, structure, relax, scene, caster, n_threads, has_rest=has_rest)
        has_coords = "emitter_coords" in photons.columns
        n = n_passes(relax, has_coords=has_coords, has_scene=scene is not None, has_rest=has_rest)
        report = Reporter(progress, "relax", len(photons) * (n + has_rest))
        relaxation = BlockRelaxation(work, workers, report)
        relaxation.detect_structure()
        if has_rest:
            settings = self.settings.of("rest_density")
            rest_density_by_blocks(photons, settings, workers, report)
        relaxation.relax()
        photons.with_shared(well_spaced=True).write_manifest()
