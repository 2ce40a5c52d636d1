"""Commands on photon maps larger than memory: folders of parts, and of blocks."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import photonrelax as pr

from .arguments import PHOTONS, SAMPLER
from .interrupts import Interrupts
from .progress_bar import ProgressBars
from .scenes import scene_of
from .streams import write_lines
from .workers import executor_of


def trace_in_parts(options: argparse.Namespace, interrupts: Interrupts) -> None:
    """Trace photons into a folder of parts, or go on with it."""
    if options.frequency_share:
        options.wrong_usage("photons in parts have no spectra: leave out --frequency-share")
    scene, started = scene_of(options.scene, options), perf_counter()
    with ProgressBars(options.quiet, interrupts) as bars, executor_of(options) as executor:
        parts = pr.trace_parts(
            scene,
            options.photons or PHOTONS,
            options.output,
            chunk=options.chunk,
            seed=options.seed or 0,
            sampler=options.sampler or SAMPLER,
            n_threads=options.threads,
            progress=bars,
            executor=executor,
        )
    _report(options, "trace", perf_counter() - started, len(parts))


def relax_in_blocks(options: argparse.Namespace, interrupts: Interrupts) -> None:
    """Relax photons in a folder of parts into one of blocks."""
    from ..estimation.methods import method_named
    from ..photons.blocks import PHOTONS_PER_BLOCK

    scene, started = None, perf_counter()
    if options.scene is not None:
        scene = scene_of(options.scene, options)
    settings = {}
    if options.iterations is not None:
        default = method_named(options.method).default("relax")
        settings["relax"] = replace(default, n_iterations=tuple(options.iterations))
    with ProgressBars(options.quiet, interrupts) as bars, executor_of(options) as executor:
        blocked = pr.relax_parts(
            options.photon_map,
            options.output,
            method=options.method,
            scene=scene,
            photons_per_block=options.block or PHOTONS_PER_BLOCK,
            n_threads=options.threads,
            progress=bars,
            executor=executor,
            **settings,
        )
    _report(options, "relax", perf_counter() - started, len(blocked))


def photons_given(path: Path, scene: pr.Scene) -> pr.PhotonMap | pr.BlockedPhotons:
    """Photons of a scene in a file, or in a folder of blocks.

    Raises
    ------
    ValueError
        If they are of another scene.
    """
    from ..rendering.render import check_scene

    if not path.is_dir():
        photons = pr.PhotonMap.load(path)
        check_scene(photons, scene)
        return photons
    blocked = pr.BlockedPhotons.open(path)
    check_scene(blocked.photons(0, 0), scene)
    return blocked


def _report(options: argparse.Namespace, stage: str, seconds: float, n_photons: int) -> None:
    from .reports import stage_table

    stages = {stage: {"seconds": seconds, "photons": n_photons}}
    if not options.quiet:
        write_lines(stage_table(stages), f"wrote {options.output}")
