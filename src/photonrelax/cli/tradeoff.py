"""The command `tradeoff`: errors of methods over the time they take, on one scene."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from .interrupts import Interrupts
from .progress_bar import ProgressBars
from .scenes import scene_of
from .streams import write_lines
from .workers import executor_of

# Import lazily, so that Ctrl-C during an import reaches `main`.
if TYPE_CHECKING:
    from ..evaluation.tradeoff import TradeoffRequest


def tradeoff(options: argparse.Namespace, interrupts: Interrupts) -> None:
    """Sweep a scene, and write table, plot, numbers and page into a folder."""
    from ..evaluation.report import front
    from ..evaluation.tradeoff import Sweep
    from ..imaging import metrics
    from ..imaging.image import read_exr
    from ..rendering.view import resized

    metrics.check_installed()
    front.check_installed()
    settings = _settings(options)
    reference = None if options.reference is None else read_exr(options.reference)
    scene = resized(scene_of(options.scene, options), options.width, options.height)
    front.prepare_folder(options.output)
    sweep = Sweep(scene, options.output, settings, reference, options.threads)
    if not options.quiet:
        write_lines(f"this takes about {_duration(sweep.estimated_seconds())}")
    with ProgressBars(options.quiet, interrupts) as bars, executor_of(options) as executor:
        found = sweep.run(bars, executor)
    shown = front.write(found, options.output)
    if not options.quiet:
        write_lines(shown.text(), f"wrote {options.output / front.PAGE}")


def _settings(options: argparse.Namespace) -> TradeoffRequest:
    from ..evaluation.reference import ReferenceSettings
    from ..evaluation.tradeoff import TradeoffRequest
    from .arguments import PHOTONS, REFERENCE_PASSES, REFERENCE_PHOTONS

    return TradeoffRequest(
        options.photons or PHOTONS,
        tuple(options.methods or ()),
        options.seed or 0,
        ReferenceSettings(
            options.reference_passes or REFERENCE_PASSES,
            options.reference_photons or REFERENCE_PHOTONS,
        ),
    )


def _duration(seconds: float) -> str:
    """Time in a fitting unit, as ``12 min``."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
