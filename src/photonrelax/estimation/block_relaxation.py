"""Methods that relax photons, of maps larger than memory: from parts on disk to blocks on disk."""

from __future__ import annotations

import os
import shutil
from concurrent.futures import Executor
from pathlib import Path
from typing import Unpack
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
        Of the relaxed photons; there should be none yet. It is there when all is done. On the way
        it takes some twice the room of the parts.
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

    Returns
    -------
    BlockedPhotons

    Raises
    ------
    TypeError, ValueError
        If an argument is invalid, parts are damaged or missing, or the method does not relax by
        structure.
    FileExistsError
        If there is such a folder already.
    """
    chosen, folder = _relaxing_by_structure(method), Path(folder)
    given = settings_of("relax_parts", dict(settings))
    given = Settings(**{**chosen.defaults, **given.given})
    parts = parts if isinstance(parts, PhotonParts) else PhotonParts.open(parts)
    _check_parts(parts)
    if folder.exists():
        raise FileExistsError(f"{folder} should be a new folder, but there is one already")
    threads = thread_count(1 if executor is not None and n_threads is None else n_threads)
    partial = folder.with_name(f".{folder.name}.{uuid4().hex}.part")
    try:
        blocked = sort_into_blocks(
            parts.maps,
            len(parts),
            partial,
            photons_per_block=count(photons_per_block, "photons_per_block"),
            n_threads=threads,
        )
        work = BlockWork(
            blocked,
            given.of("structure"),
            given.of("relax"),
            scene,
            None if scene is None else RayCaster(scene.surfaces),
            threads,
            has_rest="rest_density" in chosen.stages,
        )
        _relax(work, given, Workers(checked_executor(executor), threads), progress)
        partial.replace(folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
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


def _relax(work: BlockWork, given: Settings, workers: Workers, progress: Progress | None) -> None:
    """Do all passes over sorted photons."""
    photons = work.photons
    n = n_passes(
        work.relax,
        has_coords="emitter_coords" in photons.columns,
        has_scene=work.scene is not None,
    )
    report = Reporter(progress, "relax", len(photons) * (n + work.has_rest))
    relaxation = BlockRelaxation(work, workers, report)
    relaxation.detect_structure()
    if work.has_rest:
        rest_density_by_blocks(photons, given.of("rest_density"), workers, report)
    relaxation.relax()
    photons.with_shared(well_spaced=True).write_manifest()
