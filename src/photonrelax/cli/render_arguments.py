"""Arguments of `render` from options that `render` and `animate` share."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from .._util.progress import Progress
from ..rendering.error_target import Goal
from ..rendering.presets import choose
from .arguments import SAMPLER
from .settings import settings_from_options

if TYPE_CHECKING:
    import photonrelax as pr


def chosen_method(options: argparse.Namespace, scene: pr.Scene) -> str:
    """Method that options say, or a preset chooses for a scene, whose settings may be given."""
    goal = Goal(options.error, options.seconds)
    return choose(scene, options.method, options.preset, goal.preset_error).method


def render_arguments(
    options: argparse.Namespace, method: str, progress: Progress
) -> dict[str, Any]:
    """Arguments of `render` that images and frames of animations are rendered with, by name."""
    settings = settings_from_options(options, (method,), ("gather", "progressive"))
    return {
        "method": options.method,
        "n_emitted": options.photons,
        "n_global": options.n_global,
        "components": options.components,
        "final_gather": options.final_gather,
        "seed": options.seed or 0,
        "sampler": options.sampler or SAMPLER,
        "supersampling": options.supersampling,
        "preset": options.preset,
        "error": options.error,
        "seconds": options.seconds,
        "memory": options.memory,
        "n_threads": options.threads,
        "progress": progress,
        **settings.given,
    }
