"""Tracing into a folder of parts: maps larger than memory, and runs that go on where they ended."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from .._util.files import file_lock
from .._util.progress import Progress, Reporter
from .._util.validation import count
from .._version import SEED_LAYOUT, __version__
from ..photons.parts import MANIFEST, PhotonParts
from ..scene.digest import scene_digest
from ..scene.scene import Scene
from .emission import checked_numbers
from .raycast import RayCaster
from .trace import trace_photons


def trace_parts(
    scene: Scene,
    n_emitted: int | Sequence[int],
    folder: str | os.PathLike[str],
    *,
    chunk: int,
    seed: int = 0,
    paths: str = "caustic",
    sampler: str = "halton",
    max_bounces: int | None = None,
    sensors: bool = True,
    n_threads: int | None = None,
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> PhotonParts:
    """Trace photons into a folder, a part at a time.

    A folder that has some of the parts already is completed, to the bytes that a run without an end
    would have written. The parts together are the map of `trace_photons`, to the bit.

    Parameters
    ----------
    scene, n_emitted, seed, paths, sampler, max_bounces, sensors, n_threads, executor
        As of `trace_photons`.
    folder : path
        A new or empty folder, or one that a run with the same arguments has begun.
    chunk : int
        Photons emitted for a part, at most: memory follows it.
    progress : callable, optional
        Called as ``progress("trace", done, n_emitted)`` after each part.

    Raises
    ------
    TypeError, ValueError, MemoryError
        As `trace_photons`; if the folder is damaged, or of other arguments.
    OSError
        If the folder has other files, another run writes to it, or it cannot be written to.
    """
    numbers, chunk = checked_numbers(n_emitted, scene), count(chunk, "chunk")
    sequence: dict[str, Any] = {"seed": seed, "paths": paths, "sampler": sampler}
    sequence |= {"max_bounces": max_bounces, "sensors": bool(sensors)}
    about = _about(scene, np.ravel(numbers).tolist(), chunk) | sequence
    caster, total = RayCaster(scene.surfaces), int(np.sum(numbers))
    trace = partial(trace_photons, scene, n_emitted, **sequence, caster=caster)
    report = Reporter(progress, "trace", total)
    if not Path(folder).exists():
        PhotonParts.create(folder, about)
    with file_lock(Path(folder) / MANIFEST):
        parts = _begun(Path(folder), about)
        report.advance(parts.n_traced)
        for start in range(parts.n_traced, total, chunk):
            if parts.is_whole:
                # Fewer were emitted than asked, see `trace_photons`.
                break
            some = range(start, min(start + chunk, total))
            parts = parts.append(trace(photons=some, n_threads=n_threads, executor=executor))
            report.advance(len(some))
    return parts


def _about(scene: Scene, n_emitted: list[int], chunk: int) -> dict[str, Any]:
    """Entries of a manifest that all parts of a folder share, without those of the sequence."""
    return {
        "photonrelax": __version__,
        "seed_layout": SEED_LAYOUT,
        "scene": scene_digest(scene),
        "n_emitted": n_emitted,
        "chunk": chunk,
    }


def _begun(folder: Path, about: dict[str, Any]) -> PhotonParts:
    """The parts that a run with the same arguments has written; a folder without any is begun."""
    if not (folder / MANIFEST).exists():
        return PhotonParts.create(folder, about)
    parts = PhotonParts.open(folder)
    for name, value in about.items():
        if parts.about.get(name) != value:
            raise ValueError(
                f"{folder} should be of the same {name}, {value!r}, to go on with it, but is of "
                f"{parts.about.get(name)!r}: choose another folder, or remove it"
            )
    return parts
